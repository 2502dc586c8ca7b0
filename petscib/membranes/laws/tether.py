"""Tethers: springs from markers to given places, which may move."""

import numpy as np


class Tether:
    """Tethers of the markers, with energy k / 2 |X - target|^2 per parameter length.

    However stiff, they do not limit the time step.

    Parameters
    ----------
    curves : Curves
    stiffness : ndarray or float
        k at the markers (force per length^2); those with 0 are free.
    target : ndarray, shape (M, 2), or callable
        Places, or a function of time that gives them.
    """

    name, linear = "tether", True
    measures = "drag", "lift"  # force of the fluid on what is held, along x and along y

    def __init__(self, curves, stiffness, target):
        stiffness = np.broadcast_to(np.asarray(stiffness, float), curves.ds.shape)
        self._held = np.flatnonzero(stiffness)
        self._root = np.repeat(np.sqrt(stiffness * curves.ds)[self._held], 2)
        self.moves = callable(target)
        self.target = target if callable(target) else lambda time: target
        self._owner, self._count = curves.owner[self._held], curves.count
        self.columns = (2 * self._held[:, None] + np.arange(2)).reshape(-1, 1)

    def stress(self, markers, stretch, time=0.0):
        """sqrt(k ds) (X - target), both components of a marker side by side."""
        apart = markers[self._held] - self.target(time)[self._held]
        return self._root * apart.ravel()

    def weights(self, before, after):
        """Its rows, the same wherever the markers are."""
        return self._root[:, None]

    def measure(self, stress):
        """Drag and lift of each membrane, shape (2, V): the pull on its tethers, per depth.

        Parameters
        ----------
        stress : ndarray, shape (rows,)
            Of this law.
        """
        pulls = (self._root * stress).reshape(-1, 2).T
        return np.array([np.bincount(self._owner, pull, self._count) for pull in pulls])
