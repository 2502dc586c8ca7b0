"""All membranes of a problem together: curves of markers and the laws of their forces."""

import numpy as np
from scipy.sparse import csr_matrix


class Membranes:
    """Some membranes.  Not collective; arrays over markers have no entries but on rank 0.

    Parameters
    ----------
    count : int
        How many there are; the same on all ranks.
    curves : Curves
        On rank 0; of no curves elsewhere.
    laws : list of laws
        See `petscib.membranes.laws`; the same on all ranks, though without markers.
    rest_stretch : ndarray, shape (H,)
        Stretching without tension, at the half points.

    Attributes
    ----------
    rows : dict of str to slice
        Which of the stresses are a law's.
    """

    def __init__(self, count, curves, laws, rest_stretch):
        self.count, self.curves, self.laws = count, curves, laws
        self.rest_stretch = rest_stretch
        ends = np.cumsum([len(law.columns) for law in laws], dtype=int)
        self.rows = {
            law.name: slice(end - len(law.columns), end) for law, end in zip(laws, ends)
        }
        columns = [law.columns for law in laws]
        widths = np.concatenate(
            [[0]] + [np.full(len(part), part.shape[1]) for part in columns]
        )
        self._starts = np.cumsum(widths).astype(np.int32)
        self._columns = np.concatenate(
            [np.empty(0, np.int32)] + [part.ravel().astype(np.int32) for part in columns]
        )
        self._shape = (len(widths) - 1, 2 * len(curves.ds))

    @property
    def stress_count(self):
        """Number of stresses; 0 on ranks without markers."""
        return self._shape[0]

    @property
    def act(self):
        """Whether they exert forces; without, their markers only drift with the fluid."""
        return bool(self.laws)

    def law(self, name):
        """The law of that name, or None."""
        return next((law for law in self.laws if law.name == name), None)

    def stress(self, markers, stretch):
        """Stresses of all laws, one after the other."""
        parts = [law.stress(markers, stretch) for law in self.laws]
        return np.concatenate([np.empty(0), *parts])

    def rates(self, before, after):
        """The sparse matrix C from marker velocities to rates of stress, components interleaved.

        Along the way between two configurations, C (after - before) is the change of the stress.
        """
        values = [law.weights(before, after).ravel() for law in self.laws]
        return csr_matrix(
            (np.concatenate([np.empty(0), *values]), self._columns, self._starts), self._shape
        )

    def energies(self, stress):
        """Energy of each law, by name."""
        return {name: stress[rows] @ stress[rows] / 2 for name, rows in self.rows.items()}
