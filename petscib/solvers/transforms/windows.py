"""Fast direct solves of A0 u = r where both the force and the solution are wanted in a window only.

Forces near a membrane, and the velocities that they cause there, need no transforms of the whole
box.  Along the direction in which the window is long compared with the box, lines are transformed
whole (see `bases`), but only those that cross the window.  For each wave number there remains

    (a + b lambda_k) y_j - b / h^2 (y_{j-1} - 2 y_j + y_{j+1}) = r_j

across them, up to the walls or once around.  Outside the window r = 0: there y_j is a combination
of exp(j phi) and exp(-j phi), 2 cosh(phi) = 2 + (a + b lambda_k) h^2 / b.

Towards a wall it is proportional to sinh((j + s) phi), s the distance of the first point from the
wall in cells.  Eliminating j = 0 .. i - 1 so leaves at i the pivot

    b / h^2 sinh((i + 1 + s) phi) / sinh((i + s) phi)

on the diagonal.  What is left is a tridiagonal system over the window, with no approximation.

Around a periodic side, eliminating the g points outside the window takes from the diagonal at both
of its ends b / h^2 sinh(g phi) / sinh((g + 1) phi), and couples them by
-b / h^2 sinh(phi) / sinh((g + 1) phi) = -c.  With z = (1, 0, ..., 0, -1) that is a tridiagonal
matrix, symmetric positive definite, plus c z z^T; the update is done by the formula of Sherman and
Morrison.
"""

import numpy as np
from petsc4py import PETSc
from scipy.linalg import lapack

from .bases import X, Y, velocity_fields
from .slabs import Slabs, transform


def extent(places, count, periodic):
    """The shortest stretch of a line that holds some of its places.  Not collective.

    Parameters
    ----------
    places : ndarray of int
        Between 0 and count - 1; at least one.
    count : int
        Places on the whole line.
    periodic : bool
        Whether the line is closed, so that the stretch may go over its end.

    Returns
    -------
    (int, int)
        First place, and number of places.
    """
    taken = np.zeros(count, dtype=bool)
    taken[places] = True
    places = np.flatnonzero(taken)
    if not periodic:
        return places[0], places[-1] - places[0] + 1
    gaps = np.diff(places, append=places[0] + count)
    widest = np.argmax(gaps)
    if gaps[widest] == 1:
        return 0, count
    return places[(widest + 1) % len(places)], count - gaps[widest] + 1


def _sinh_ratio(more, less, phi):
    """sinh(more phi) / sinh(less phi), without overflow."""
    return (
        np.exp((more - less) * phi) * np.expm1(-2 * more * phi) / np.expm1(-2 * less * phi)
    )


class HelmholtzWindow:
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
        counts = np.array([
            [basis.unknowns(count) for basis, count in zip(field.bases, cells)]
            for field in self._fields
        ])
        points = [
            np.stack(part) - np.array([[basis.given] for basis in field.bases])
            for part, field in zip(faces, self._fields)
        ]
        extents = None
        if grid.comm.rank == 0:
            extents = np.array([
                [extent(*line, wraps) for *line, wraps in zip(part, size, grid.periodic[::-1])]
                for part, size in zip(points, counts)
            ])
        extents = grid.comm.tompi4py().bcast(extents)  # by field, direction, start and length
        share = extents[:, :, 1].max(axis=0) / cells
        self._along = Y if share[X] <= share[Y] else X  # the transforms' direction
        across = 1 - self._along
        self._closed = grid.periodic[::-1][across]
        for part, size, stretch in zip(points, counts, extents):
            part[across] = (part[across] - stretch[across, 0]) % size[across]

        shapes = counts.copy()
        shapes[:, across] = extents[:, across, 1]
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
        self._factor(a, b, cells, spacing, extents[:, across])

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

    def _factor(self, a, b, cells, spacing, extents):
        """Factor the tridiagonal systems of all wave numbers as one."""
        along, across = self._along, 1 - self._along
        weight = b / spacing[across] ** 2
        diagonal, centres = self._turned.allocate(1.0)
        beside, links = self._turned.allocate(0.0)
        couplings = []
        parts = zip(self._fields, self._turned.boxes, extents, centres, links)
        for field, (waves, _), (start, length), centre, link in parts:
            basis = field.bases[across]
            excess = a + b * field.bases[along].eigenvalues(cells[along], spacing[along])[waves]
            phi = 2 * np.arcsinh(np.sqrt(excess / weight) / 2)
            plain = 2 * weight + excess
            outside = basis.unknowns(cells[across]) - length
            centre[:] = plain[:, None]
            link[:, :-1] = -weight
            if self._closed:
                coupling = weight * _sinh_ratio(1, outside + 1, phi)
                couplings.append(coupling)
                less = coupling + weight * _sinh_ratio(outside, outside + 1, phi)
                for side in (0, -1):
                    centre[:, side] -= less
            else:
                for side, beyond in ((0, start), (-1, outside - start)):
                    first = beyond + basis.first
                    centre[:, side] += weight * _sinh_ratio(first + 1, first, phi) - plain
        self._factors = lapack.dpttrf(diagonal, beside[:-1])[:2]
        if self._closed:
            self._close(couplings)

    def _close(self, couplings):
        """Prepare the coupling of each line's ends: T^{-1} z, and what it is to be scaled by."""
        values, answers = self._turned.allocate(0.0)
        for answer in answers:
            answer[:, 0] += 1.0
            answer[:, -1] -= 1.0
        if values.size:
            values[:] = lapack.dpttrs(*self._factors, values)[0]
        self._closings = [
            (answer, coupling / (1 + coupling * (answer[:, 0] - answer[:, -1])))
            for answer, coupling in zip(answers, couplings)
        ]

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
        if self._closed:
            for values, (answer, gain) in zip(turned.arrays, self._closings):
                values -= (gain * (values[:, 0] - values[:, -1]))[:, None] * answer
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
