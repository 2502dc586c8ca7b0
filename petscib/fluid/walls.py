"""Velocity of the four walls, and what it contributes to the difference operators."""

import numpy as np

from .flows import FLOWS


class Walls:
    """Dirichlet data on the four sides of the box, taken from a background flow.

    Parameters
    ----------
    grid : Grid
    flow : str
        Name in `flows.FLOWS`.
    shear_rate : float
        Strength of the flow (1/time).

    Attributes
    ----------
    moving : bool
        False when the walls are at rest: then no wall term need be computed.
    """

    def __init__(self, grid, flow="rest", shear_rate=0.0):
        self.grid = grid
        self.flow = flow
        self.shear_rate = shear_rate
        a, b, c, d = grid.domain
        x_u, y_u = grid.u_points()
        x_v, y_v = grid.v_points()
        sides = {
            "left": self._at(np.array([[a]]), y_u)[0],
            "right": self._at(np.array([[b]]), y_u)[0],
            "bottom": self._at(x_v, np.array([[c]]))[1],
            "top": self._at(x_v, np.array([[d]]))[1],
        }
        # Normal velocity lies on the wall; the tangential one half a cell off the first face.
        self.normal = {side: value.ravel() for side, value in sides.items()}
        self.tangential = {
            "left": self._at(np.array([[a]]), y_v)[1].ravel(),
            "right": self._at(np.array([[b]]), y_v)[1].ravel(),
            "bottom": self._at(x_u, np.array([[c]]))[0].ravel(),
            "top": self._at(x_u, np.array([[d]]))[0].ravel(),
        }
        data = (*self.normal.values(), *self.tangential.values())
        self.moving = any(values.any() for values in data)

    def _at(self, x, y):
        return FLOWS[self.flow](x, y, self.shear_rate, self.grid.domain)

    def fill(self, vector):
        """Set `vector` to the background flow on all faces.  Collective."""
        grid = self.grid
        u = self._at(*grid.u_points(grid.u_box))[0]
        v = self._at(*grid.v_points(grid.v_box))[1]
        grid.set_velocity(vector, u, v)
