"""Fast direct solves of A0 u = r where both the force and the answer lie in a window.

Forces near a membrane, and the velocities that they cause there, need no transforms of the whole
box.  Along the direction in which the window is long compared with the box, lines are transformed
whole (see `spectral`), but only those that cross the window.  For each wave number there remains

    (a + b lambda_k) y_j - b / h^2 (y_{j-1} - 2 y_j + y_{j+1}) = r_j

across them, up to the walls.  Outside the window r = 0: there y_j is proportional to
sinh((j + s) phi), with s the distance of the first point from the wall in cells and
2 cosh(phi) = 2 + (a + b lambda_k) h^2 / b.  Eliminating j = 0 .. i - 1 so leaves at i the pivot

    b / h^2 sinh((i + 1 + s) phi) / sinh((i + s) phi)

on the diagonal.  What is left is a tridiagonal system over the window, with no approximation.
"""

import numpy as np
from petsc4py import PETSc
from scipy.linalg import lapack

from .spectral import Slabs, X, Y, transform, velocity_fields


def _pivot(first, phi):
    """sinh((first + 1) phi) / sinh(first phi), without overflow."""
    return np.exp(phi) * np.expm1(-2 * (first + 1) * phi) / np.expm1(-2 * first * phi)


class Window:
    """R A0^{-1} R^T, with R the restriction to some faces.  Collective.

    Parameters
    ----------
    grid : Grid
    a, b : float
        A0 = a - b Laplacian.
    faces : list of (ndarray, ndarray)
        Rows and columns of the faces of u and of v, on rank 0 (empty elsewhere); on no wall.

    Attributes
    ----------
    vector : PETSc.Vec
        Over these faces, u before v, all on rank 0.
    """

    def __init__(self, grid, a, b, faces):
        self._fields = velocity_fields(grid)
        cells, spacing = (grid.n, grid.m), (grid.dy, grid.dx)
        given = [[basis.given for basis in field.bases] for field in self._fields]
        points = [np.stack(part) - np.array(g)[:, None] for part, g in zip(faces, given)]
        bounds = None
        if grid.comm.rank == 0:
            bounds = np.array([(part.min(axis=1), part.max(axis=1) + 1) for part in points])
        bounds = grid.comm.tompi4py().bcast(bounds)  # by field, start and end, and direction
        share = (bounds[:, 1] - bounds[:, 0]).max(axis=0) / cells
        self._along = Y if share[X] <= share[Y] else X  # the transforms' direction
        across = 1 - self._along
        for part, (start, _) in zip(points, bounds):
            part[across] -= start[across]

        shapes = np.array(cells) - given
        shapes[:, across] = (bounds[:, 1] - bounds[:, 0])[:, across]
        # LAPACK wants neighbours across the lines side by side, so the lines are columns.
        if self._along == X:
            shapes, points = shapes[:, ::-1], [part[::-1] for part in points]
        shapes = [tuple(shape) for shape in shapes.tolist()]
        self._begin = self._turned = Slabs(grid.comm, shapes, Y)
        self._turn = None
        if grid.comm.size > 1:
            self._turned = Slabs(grid.comm, shapes, X)
            self._turn = self._turned.scatter_from(self._begin.vector, self._begin.numbers)
        self._scatter_faces(grid.comm, points)
        self._factor(a, b, cells, spacing, bounds)

    def _scatter_faces(self, comm, points):
        count = sum(part.shape[1] for part in points)
        self.vector = PETSc.Vec().createMPI((count, PETSc.DETERMINE), comm=comm)
        start = self.vector.getOwnershipRange()[0]
        places = [table[tuple(part)] for table, part in zip(self._begin.numbers, points)]
        self._fetch = PETSc.Scatter().create(
            self.vector,
            PETSc.IS().createStride(count, start, 1, comm=PETSc.COMM_SELF),
            self._begin.vector,
            PETSc.IS().createGeneral(np.concatenate(places), comm=PETSc.COMM_SELF),
        )

    def _factor(self, a, b, cells, spacing, bounds):
        """Factor the tridiagonal systems of all wave numbers as one."""
        along, across = self._along, 1 - self._along
        weight = b / spacing[across] ** 2
        diagonal, centres = self._turned.allocate(1.0)
        beside, links = self._turned.allocate(0.0)
        parts = zip(self._fields, self._turned.boxes, bounds, centres, links)
        for field, (waves, _), (start, end), centre, link in parts:
            basis = field.bases[across]
            excess = a + b * field.bases[along].eigenvalues(cells[along], spacing[along])[waves]
            phi = 2 * np.arcsinh(np.sqrt(excess / weight) / 2)
            plain = 2 * weight + excess
            before = start[across]
            after = cells[across] - basis.given - end[across]
            centre[:] = plain[:, None]
            for side, outside in ((0, before), (-1, after)):
                centre[:, side] += weight * _pivot(outside + basis.first, phi) - plain
            link[:, :-1] = -weight
        self._factors = lapack.dpttrf(diagonal, beside[:-1])[:2]

    def solve(self):
        """Replace the vector's values, forces on the faces, by the velocities there."""
        forward, reverse = PETSc.ScatterMode.FORWARD, PETSc.ScatterMode.REVERSE
        begin, turned = self._begin, self._turned
        begin.values[:] = 0.0
        self._fetch.scatter(self.vector, begin.vector, mode=forward)
        transform([field.bases[self._along].forward for field in self._fields], Y, begin)
        if self._turn is not None:
            self._turn.scatter(begin.vector, turned.vector, mode=forward)
        if turned.values.size:
            turned.values[:] = lapack.dpttrs(*self._factors, turned.values)[0]
        if self._turn is not None:
            self._turn.scatter(turned.vector, begin.vector, mode=reverse)
        transform([field.bases[self._along].inverse for field in self._fields], Y, begin)
        self._fetch.scatter(begin.vector, self.vector, mode=reverse)

    def destroy(self):
        """Free vectors and scatters.  Collective."""
        self._fetch.destroy()
        self.vector.destroy()
        self._begin.vector.destroy()
        if self._turn is not None:
            self._turn.destroy()
            self._turned.vector.destroy()
