"""The tube's block of the coupled system, solved in the discrete stream function.

Within the tube the coupled equations read

    A_tt w + G_tq q = r,    G_tq^T w = 0,

with w the velocities on its faces and q the pressures of its inner cells.  Every w without
divergence is w = Z psi: differences of a stream function at the corners of the cells, and, for
each hole that the tube leaves (the inside of a vesicle), a flux from the hole outwards.  Then
Z^T A_tt Z psi = Z^T r is symmetric positive definite, half the size, and free of pressure; q is
found afterwards, where it is wanted.
"""

import numpy as np
from petsc4py import PETSc

from ..fluid.operators import assemble
from .cholesky import Cholesky


def _edge_map(tube):
    """Corners, faces and cells of the window on one array of twice the resolution.

    Corners stand at even rows and columns, cells at odd ones, faces between.  True are the tube's
    faces and the corners that they join.
    """
    rows, columns = tube.inner.shape
    edges = np.zeros((2 * rows + 1, 2 * columns + 1), dtype=bool)
    edges[1::2, ::2] = tube.u
    edges[::2, 1::2] = tube.v
    corners = np.zeros((rows + 1, columns + 1), dtype=bool)
    corners[:-1] |= tube.u
    corners[1:] |= tube.u
    corners[:, :-1] |= tube.v
    corners[:, 1:] |= tube.v
    edges[::2, ::2] = corners
    return edges


def _number_corners(edges, label):
    """Number the corners of the tube, leaving out one of each connected part; -1 elsewhere.

    The stream function is determined up to a constant on each part.
    """
    parts = label(edges)[0][::2, ::2]
    _, first = np.unique(parts, return_index=True)
    kept = parts > 0
    kept.flat[first] = False
    numbers = np.full(parts.shape, -1, dtype=PETSc.IntType)
    numbers[kept] = np.arange(np.count_nonzero(kept))
    return numbers


def _paths_from_holes(edges, inner, label):
    """For each hole a row of x-faces across the tube, from the hole to the right.

    Returns a list of (row, first column, last column + 1).  Each path starts at the rightmost
    cell of its hole, so that it ends outside the tube or in a hole farther right.
    """
    outside = np.pad(~edges, 1, constant_values=True)
    outside[2:-2:2, 2:-2:2] &= ~inner
    regions = label(outside)[0]
    cells = regions[2:-2:2, 2:-2:2]
    paths = []
    for hole in np.setdiff1d(cells, (0, regions[0, 0])):
        rows, columns = np.nonzero(cells == hole)
        last = np.argmax(columns)
        row, start = rows[last], columns[last] + 1
        paths.append((row, start, start + np.argmin(inner[row, start:]) + 1))
    return paths


def divergence_free_basis(tube):
    """The matrix Z (sequential): one row a tube face, one column a corner or a hole."""
    from scipy.ndimage import label

    edges = _edge_map(tube)
    corner = _number_corners(edges, label)
    paths = _paths_from_holes(edges, tube.inner, label)
    corners = corner.max(initial=-1) + 1
    u = np.full(tube.u.shape + (3,), -1, dtype=PETSc.IntType)
    v = np.full(tube.v.shape + (3,), -1, dtype=PETSc.IntType)
    u[..., 0], u[..., 1] = corner[1:], corner[:-1]
    v[..., 0], v[..., 1] = corner[:, :-1], corner[:, 1:]
    for number, (row, start, stop) in enumerate(paths):
        u[row, start:stop, 2] = corners + number
    columns = np.concatenate((u[tube.u], v[tube.v]))
    count = np.count_nonzero(tube.u)
    values = np.empty(columns.shape)
    values[:count] = (1 / tube.grid.dy, -1 / tube.grid.dy, 1 / tube.grid.dy)
    values[count:] = (1 / tube.grid.dx, -1 / tube.grid.dx, 0.0)
    return assemble(PETSc.COMM_SELF, (len(columns), corners + len(paths)), columns, values)


class TubePressure:
    """The pressures that belong to velocities in the tube, on rank 0.

    Parameters
    ----------
    gradient : PETSc.Mat
        From the tube's inner cells to its faces (sequential).
    prefix : str
        Options prefix of the Cholesky factorisation.
    """

    def __init__(self, gradient, prefix):
        self.gradient = gradient
        self.cholesky = Cholesky(prefix)
        self.cholesky.factor(gradient.transposeMatMult(gradient))
        self._slope, self._rest = gradient.createVecs()

    def solve(self, rest):
        """Pressures whose gradient is the array `rest` on the faces."""
        self._rest.getArray()[:] = rest
        self.gradient.multTranspose(self._rest, self._slope)
        return self.cholesky.solve(self._slope.getArray(readonly=True))

    def destroy(self):
        """Free the factor."""
        self.cholesky.destroy()


class TubeSaddle:
    """Direct solver of the tube's block of the coupled system, on rank 0.

    Parameters
    ----------
    direct : TubeDirect
        Of the velocities without divergence.
    gradient : PETSc.Mat
        As for `TubePressure`.
    prefix : str
        Options prefix of the Cholesky factorisation for the pressure.
    """

    def __init__(self, direct, gradient, prefix):
        self.direct = direct
        self.faces, self.cells = gradient.getSize()
        self.pressure = TubePressure(gradient, prefix) if self.faces else None

    def solve(self, rhs):
        """Velocities for the array r on the faces, zeros in place of pressures.

        Entries of `rhs` on cells must be zero; they are not read.
        """
        return np.concatenate((self.direct.solve(rhs[: self.faces]), np.zeros(self.cells)))

    def solve_with_pressure(self, rhs):
        """Velocities and pressures for the array r on the faces."""
        if not self.faces:
            return np.empty(0)
        rhs = rhs[: self.faces]
        force, velocity = self.direct.solve_forces(rhs)
        rest = rhs - self.direct.block.multiply(velocity, force)
        return np.concatenate((velocity, self.pressure.solve(rest)))

    def destroy(self):
        """Free the factor of the pressure."""
        if self.pressure:
            self.pressure.destroy()
