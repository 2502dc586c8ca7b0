"""The sides of the box: walls with a given velocity, or periodic.

The kind of each side is decided by the grid, which the sides in one direction share; what walls do
there is decided here.
"""

import numpy as np

from .flows import velocity

# By name: the direction across (0: x) and the end of it (0: first, -1: last).
WALLS = {"left": (0, 0), "right": (0, -1), "bottom": (1, 0), "top": (1, -1)}
OUTWARDS = {0: -1, -1: 1}  # by the end, the sign of a velocity out of the box

# Of a smooth flow through 24 cells the midpoint rule misses some 1e-3.
LARGEST_FLUX = 1e-2


class Sides:
    """Dirichlet data on the walls, taken from a background flow; periodic sides have none.

    Parameters
    ----------
    grid : Grid
    flow : str or own.Function
        Name in `flows.FLOWS`, or a function of the user's.
    shear_rate : float
        Strength of the flow (1/time).

    Attributes
    ----------
    normal, tangential : dict of str to ndarray
        Velocity of each wall ("left", "right", "bottom", "top"; those that are walls): the normal
        one on its faces, shape (n,) or (m,), and the tangential one at the places of the first
        faces inside along it, shape (rows of v_index,) or (columns of u_index,).
    moving : bool
        False when the walls are at rest, or there are none: then no wall term need be computed.
    """

    def __init__(self, grid, flow="rest", shear_rate=0.0):
        self.grid = grid
        self.flow = flow
        self.shear_rate = shear_rate
        (a, b, c, d), u_points, v_points = grid.domain, grid.u_points(), grid.v_points()
        ends = (a, b), (c, d)
        self.normal, self.tangential = {}, {}
        for side, (direction, end) in WALLS.items():
            if grid.periodic[direction]:
                continue
            wall = ends[direction][end]
            # Normal velocity lies on the wall; the tangential one half a cell off the first face.
            if direction == 0:
                normal = self._at(wall, u_points[1])[0]
                tangential = self._at(wall, v_points[1])[1]
            else:
                normal = self._at(v_points[0], wall)[1]
                tangential = self._at(u_points[0], wall)[0]
            self.normal[side], self.tangential[side] = normal.ravel(), tangential.ravel()
        if callable(flow):
            self._balance()
        data = (*self.normal.values(), *self.tangential.values())
        self.moving = any(values.any() for values in data)

    def _at(self, x, y):
        return velocity(
            self.flow, np.asarray(x), np.asarray(y), self.shear_rate, self.grid.domain)

    def _balance(self):
        """See to it that as much fluid comes in as goes out.

        The midpoint rule leaves a little of a flow that does so.
        """
        grid, flux, size = self.grid, 0.0, 0.0
        for side, normal in self.normal.items():
            direction, end = WALLS[side]
            spacing = grid.dx if direction else grid.dy
            flux += OUTWARDS[end] * normal.sum() * spacing
            size += np.abs(normal).sum() * spacing
        if abs(flux) > LARGEST_FLUX * size:
            raise self.flow.refused(
                f"lets {flux:.3g} more fluid out of the box than in",
                "a flow without divergence")
        for side, normal in self.normal.items():
            if size:
                normal -= OUTWARDS[WALLS[side][1]] * flux / size * np.abs(normal)

    def fill(self, vector):
        """Set `vector` to the background flow on all faces.  Collective."""
        grid = self.grid
        u = self._at(*grid.u_points(grid.u_box))[0]
        v = self._at(*grid.v_points(grid.v_box))[1]
        for side, normal in self.normal.items():
            direction, end = WALLS[side]
            faces, box, index = ((v, grid.v_box, grid.v_index) if direction else
                                 (u.T, grid.u_box[::-1], grid.u_index.T))
            wall = len(index) - 1 if end else 0
            if box[0].start <= wall < box[0].stop:
                faces[wall - box[0].start] = normal[box[1]]
        grid.set_velocity(vector, u, v)
