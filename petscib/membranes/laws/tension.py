"""Tension: an elastic force along the membrane, sigma = sigma0 (|X_s| - rest) (Hu & Lai, 4.3)."""

import numpy as np


class Tension:
    """Tension in some curves, with energy sigma0 / 2 times the squared excess stretching (3.17).

    Parameters
    ----------
    curves : Curves
    sigma0 : ndarray or float
        Elastic coefficient at the half points.
    rest : ndarray, shape (H,)
        Stretching without tension at the half points.
    """

    name, linear = "tension", False

    def __init__(self, curves, sigma0, rest):
        self.curves, self.sigma0, self.rest = curves, sigma0, rest
        self._root = np.sqrt(sigma0 * curves.edge_ds)
        self.columns = (2 * curves.edges[:, :, None] + np.arange(2)).reshape(-1, 4)

    def stress(self, markers, stretch, time=0.0):
        """sqrt(sigma0 ds) (|X_s| - rest) for a stretching |X_s|, shape (H,)."""
        return self._root * (stretch - self.rest)

    def weights(self, before, after):
        """Rows of sqrt(sigma0 ds) T, where T acts along the tangent averaged between two curves.

        With tau = (D_s X' + D_s X) / (|D_s X'| + |D_s X|) the change of |D_s X| is exactly
        D_s (X' - X) . tau.
        """
        ahead = self.curves.edge_vectors(after)
        length = np.hypot(*ahead.T)
        if before is not after:
            behind = self.curves.edge_vectors(before)
            ahead = ahead + behind
            length = length + np.hypot(*behind.T)
        weights = (self._root / self.curves.edge_ds / length)[:, None] * ahead
        return np.concatenate((-weights, weights), axis=1)

    def tension(self, stretch):
        """Tension sigma at the half points."""
        return self.sigma0 * (stretch - self.rest)

    def of_stress(self, stress):
        """Tension sigma at the half points, from the stress there; 0 where sigma0 is."""
        return np.divide(self.sigma0 * stress, self._root, out=np.zeros_like(stress),
                         where=self._root > 0)

    def stretch_rate(self, stress_rate):
        """Rate of stretching at the half points, from that of the stress; 0 without tension."""
        return np.divide(stress_rate, self._root, out=np.zeros_like(stress_rate),
                         where=self._root > 0)
