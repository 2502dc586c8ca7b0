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
        widths = [np.full(len(law.columns), law.columns.shape[1]) for law in laws]
        self._starts = np.cumsum(np.concatenate([[0], *widths]), dtype=np.int32)
        # Sorted, as sparse products may sort the columns that all the matrices share.
        orders = [np.argsort(law.columns, axis=1) for law in laws]
        self._columns = self._flat([law.columns for law in laws], orders).astype(np.int32)
        self._orders = orders
        self._shape = (len(self._starts) - 1, 2 * len(curves.ds))

    @staticmethod
    def _flat(parts, orders):
        """Entries of some laws' rows, one after the other, in another order in each row."""
        return np.concatenate([np.empty(0)] + [
            np.take_along_axis(part, order, axis=1).ravel() for part, order in zip(parts, orders)
        ])

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
        values = self._flat([law.weights(before, after) for law in self.laws], self._orders)
        return csr_matrix((values, self._columns, self._starts), self._shape)

    def energies(self, stress):
        """Energy of each law, by name."""
        return {name: stress[rows] @ stress[rows] / 2 for name, rows in self.rows.items()}
