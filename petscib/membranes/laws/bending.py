"""Bending: the force -c_b D_s^4 X (Hu & Lai, A.2)."""

import numpy as np


class Bending:
    """Bending of some curves, with energy c_b / 2 times the squared norm of D_s D_s X.

    Parameters
    ----------
    curves : Curves
    rigidity : ndarray or float
        Bending rigidity c_b at the markers with two neighbours.
    """

    name, linear = "bending", True

    def __init__(self, curves, rigidity):
        middle = curves.triples[:, 1]
        scale = np.sqrt(rigidity * curves.ds[middle]) / curves.ds[middle] ** 2
        self._weights = np.repeat(scale[:, None] * np.array([1.0, -2.0, 1.0]), 2, axis=0)
        joint = (curves.behind + curves.ahead)[middle]
        self._joint = (scale[:, None] * joint).ravel() if joint.any() else 0.0
        self.columns = (
            2 * curves.triples[:, None, :] + np.arange(2)[None, :, None]
        ).reshape(-1, 3)

    def stress(self, markers, stretch, time=0.0):
        """sqrt(c_b ds) D_s D_s X, both components of a marker side by side, shape (2 B,)."""
        return np.einsum("kj,kj->k", self._weights, markers.ravel()[self.columns]) + self._joint

    def weights(self, before, after):
        """Its rows, the same wherever the markers are."""
        return self._weights
