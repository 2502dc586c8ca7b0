"""Loads: given forces on membranes, such as gravity."""

import numpy as np


class Load:
    """A given force per parameter length, in addition to what laws say.

    Parameters
    ----------
    curves : Curves
    density : ndarray, shape (M, 2), or callable
        Force per length at the markers, or a function of time that gives it.
    """

    def __init__(self, curves, density):
        self.density = density if callable(density) else lambda time: density
        self._ds = curves.ds[:, None]

    def force(self, time):
        """Force on each marker, shape (M, 2)."""
        return self._ds * np.asarray(self.density(time))
