"""All membranes of a problem together: curves of markers and the laws of their forces."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from .curves import Curves
from .laws import Tension


@dataclass(frozen=True)
class Constants:
    """What of the membranes a checkpoint keeps besides the state.  The same on all ranks.

    Attributes
    ----------
    curves : Curves
    rest_stretch : ndarray, shape (H,)
    target : ndarray, shape (M, 2), or None
        Where tethers hold the markers, if they do and the places are fixed.
    """

    curves: Curves
    rest_stretch: np.ndarray
    target: np.ndarray = None


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
    loads : list of Load
        Given forces.
    constants : Constants, optional
        Needed on several ranks.

    Attributes
    ----------
    constants : Constants
    rows : dict of str to slice
        Which of the stresses are a law's.
    fixed : int
        How many of the stresses are always the same, those of the first laws.
    version : int
        Counts the changes of the others.
    """

    def __init__(self, count, curves, laws, rest_stretch, loads=(), constants=None):
        varying = [law for law in laws if hasattr(law, "cover")]
        laws = [law for law in laws if law not in varying] + varying
        self.count, self.curves, self.laws, self.loads = count, curves, laws, list(loads)
        self.constants = constants or Constants(curves, rest_stretch)
        self._varying, self.version = varying, 0
        self.fixed = sum(len(law.columns) for law in laws if law not in varying)
        self._lay_out()

    def _lay_out(self):
        """Which stress and which component of the markers each entry of C belongs to."""
        laws = self.laws
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
        self._shape = (len(self._starts) - 1, 2 * len(self.curves.ds))

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
        """Whether they exert forces of their own; without, they drift with fluid and loads."""
        return bool(self.laws)

    @property
    def linear(self):
        """Whether C is the same everywhere."""
        return all(law.linear for law in self.laws)

    @property
    def varies(self):
        """Whether stresses come and go."""
        return bool(self._varying)

    @property
    def move(self):
        """Whether stresses change by themselves in time."""
        return any(getattr(law, "moves", False) for law in self.laws)

    def law(self, name):
        """The law of that name, or None."""
        return next((law for law in self.laws if law.name == name), None)

    def cover(self, before, after):
        """Have all stresses at hand that count in two configurations."""
        if any([law.cover(before, after) for law in self._varying]):
            self._lay_out()
            self.version += 1

    def forget(self):
        """Choose the stresses that come and go anew at the next step."""
        for law in self._varying:
            law.forget()

    def stress(self, markers, stretch, time=0.0):
        """Stresses of all laws, one after the other."""
        parts = [law.stress(markers, stretch, time) for law in self.laws]
        return np.concatenate([np.empty(0), *parts])

    def rates(self, before, after):
        """The sparse matrix C from marker velocities to rates of stress, components interleaved.

        Along the way between two configurations, C (after - before) is the change of the stress.
        """
        self.cover(before, after)
        values = self._flat([law.weights(before, after) for law in self.laws], self._orders)
        return csr_matrix((values, self._columns, self._starts), self._shape)

    def tension(self, stretch, stress=None):
        """Tension sigma at the half points, shape (H,): from the stresses if these are given."""
        law = self.law(Tension.name)
        if law is None:
            return np.zeros_like(stretch)
        return law.tension(stretch) if stress is None else law.of_stress(
            stress[self.rows[law.name]])

    def measures(self, stress):
        """What laws measure of each membrane, arrays (V,) by column."""
        found = {}
        for law in self.laws:
            if hasattr(law, "measures"):
                found.update(zip(law.measures, law.measure(stress[self.rows[law.name]])))
        return found

    def load(self, time):
        """Given force on each marker, shape (M, 2)."""
        return sum(load.force(time) for load in self.loads)

    def by_law(self, stress):
        """|m|^2 / 2 of each law's part of an array over the stresses, by name."""
        return {name: stress[rows] @ stress[rows] / 2 for name, rows in self.rows.items()}

    def energies(self, markers, stretch, time=0.0):
        """Energy of each law, by name."""
        energies = {}
        for law in self.laws:
            if law in self._varying:
                energies[law.name] = law.energy(markers)
            else:
                stress = law.stress(markers, stretch, time)
                energies[law.name] = stress @ stress / 2
        return energies
