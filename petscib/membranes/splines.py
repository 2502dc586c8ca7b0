"""Smooth closed curves through points."""

import numpy as np
from scipy.interpolate import CubicSpline

from .shapes import PANELS, arc_length, equal_arcs


class Spline:
    """Periodic cubic spline through points, parametrised by the length of the chords.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        Corners of a closed polygon.

    Attributes
    ----------
    length : float
        Length of the curve.

    Raises
    ------
    ValueError
        Some points are the same but for round-off.
    """

    def __init__(self, points):
        closed = np.concatenate((points, points[:1]))
        knots = np.concatenate(([0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))))
        if (np.diff(knots) <= 0).any():
            raise ValueError("some points are too close together to draw a curve through them")
        self._curve = CubicSpline(knots, closed, bc_type="periodic")
        pieces = -(-PANELS // len(points))
        self._edges = np.unique(np.linspace(knots[:-1], knots[1:], pieces + 1))
        self.length = arc_length(self._speed, self._edges[:-1], self._edges[1:]).sum()

    def _speed(self, parameter):
        return np.linalg.norm(self._curve(parameter, 1), axis=-1)

    def markers(self, count):
        """Markers equally spaced in arclength, shape (count, 2); the first is the first point."""
        return self._curve(equal_arcs(self._speed, self._edges, count))
