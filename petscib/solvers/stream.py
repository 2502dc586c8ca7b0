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
from .block import ForceSystem
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


class TubeStream:
    """Direct solver of the tube's block of the coupled system, on rank 0.

    Parameters
    ----------
    tube : Tube
    block : TubeBlock
        The momentum matrix among the tube's faces.
    gradient : PETSc.Mat
        The gradient from the tube's inner cells to its faces (sequential).
    prefix : str
        Options prefix of the Cholesky factorisations.
    """

    def __init__(self, tube, block, gradient, prefix):
        self.block, self.gradient = block, gradient
        self.count = len(tube.faces) + len(tube.cells)
        self.velocity = ForceSystem(prefix)
        self.pressure = Cholesky(prefix)
        self._forces = None
        if not block.size:
            return
        self.basis = divergence_free_basis(tube)
        self.velocity.set_fluid(block.fluid.ptap(self.basis))
        self.move(tube)
        self.pressure.factor(gradient.transposeMatMult(gradient))
        self._psi, self._w = self.basis.createVecs()

    def move(self, tube):
        """Take new positions of the markers in a tube of the same faces."""
        if self.block.size:
            self.block.move(tube)
            self._projected_interpolation = self.block.interpolation.matMult(self.basis)
            self._forces = None

    def factor(self, stiffness, scale):
        """Factor for a membrane stiffness W; `scale` is the factor of J^T W J."""
        self.block.set(stiffness, scale)
        if not self.block.size:
            return
        self._forces = self.block.root.matMult(
            self._projected_interpolation, result=self._forces
        )
        self.velocity.factor(self._forces)

    def solve(self, rhs):
        """Velocities for the array r on the faces, zeros in place of pressures.

        Entries of `rhs` on cells must be zero; they are not read.
        """
        answer = np.zeros(self.count)
        faces = self.block.size
        if faces:
            answer[:faces] = self._solve(rhs[:faces])[1]
        return answer

    def _solve(self, rhs):
        """Membrane forces f = B w and velocities w."""
        self._w.getArray()[:] = rhs
        self.basis.multTranspose(self._w, self._psi)
        no_force = np.zeros(self.velocity.count)
        force, psi = self.velocity.solve(no_force, self._psi.getArray(readonly=True))
        self._psi.getArray()[:] = psi
        self.basis.mult(self._psi, self._w)
        return force, self._w.getArray(readonly=True).copy()

    def solve_with_pressure(self, rhs):
        """Velocities and pressures for the array r on the faces."""
        answer = np.zeros(self.count)
        faces = self.block.size
        if faces:
            force, answer[:faces] = self._solve(rhs[:faces])
            self._w.getArray()[:] = rhs[:faces] - self.block.multiply(answer[:faces], force)
            slope = self.gradient.createVecRight()
            self.gradient.multTranspose(self._w, slope)
            answer[faces:] = self.pressure.solve(slope.getArray(readonly=True))
        return answer

    def destroy(self):
        """Free the factors."""
        self.velocity.destroy()
        self.pressure.destroy()
