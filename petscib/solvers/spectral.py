"""Fast direct solvers: sine and cosine transforms that diagonalise the constant operators.

On a uniform box each component's difference operator is a sum of two one-dimensional ones, whose
eigenvectors depend only on how the component's points lie to the walls.  So a solve is a transform
along each direction, a division by the eigenvalues, and the way back: exact to round-off, in
O(N log N) operations.  It is fastest when the cells have small prime factors.
"""

from functools import partial
from typing import Callable, NamedTuple

import numpy as np
from petsc4py import PETSc

from ..errors import InputError

try:
    from scipy import fft
except ImportError as error:
    raise InputError("the fast direct solvers (-fft) need scipy, which is missing") from error

Y, X = 0, 1
CACHE_LINE = 8  # numbers


class Basis(NamedTuple):
    """Eigenvectors of the second difference on a line of N cells between two sides.

    Attributes
    ----------
    forward, inverse : callable
        Transforms of real arrays, called with the array, axis and overwrite_x.
    lowest : int
        First wave number k; its eigenvalue is (2/h sin(k pi / 2N))^2.
    given : int
        Points at either end whose values are known; N - given are unknown.
    """

    forward: Callable
    inverse: Callable
    lowest: int
    given: int

    def eigenvalues(self, cells, spacing):
        """Eigenvalues of minus the second difference, in the order of the transform."""
        k = self.lowest + np.arange(cells - self.given)
        return (2 / spacing * np.sin(k * np.pi / (2 * cells))) ** 2

    @property
    def first(self):
        """Distance of the first unknown point from its side, in cells."""
        return (1 + self.given) / 2


WALL_AT_POINT = Basis(partial(fft.dst, type=1), partial(fft.idst, type=1), lowest=1, given=1)
WALL_BETWEEN = Basis(partial(fft.dst, type=2), partial(fft.idst, type=2), lowest=1, given=0)
NO_FLUX = Basis(partial(fft.dct, type=2), partial(fft.idct, type=2), lowest=0, given=0)


class Field(NamedTuple):
    """One component.

    Attributes
    ----------
    index : ndarray of int
        PETSc numbers of its points in natural order (see Grid).
    bases : (Basis, Basis)
        In y and x.
    """

    index: np.ndarray
    bases: tuple[Basis, Basis]

    @property
    def unknown(self):
        """The part of `index` that is to be solved for."""
        return self.index[self._inside]

    @property
    def given(self):
        """The other PETSc numbers."""
        outside = np.ones(self.index.shape, dtype=bool)
        outside[self._inside] = False
        return self.index[outside]

    @property
    def _inside(self):
        (rows, columns), (y, x) = self.index.shape, self.bases
        return slice(y.given, rows - y.given), slice(x.given, columns - x.given)


def given_places(fields, vector):
    """Places of the given points of some fields in this rank's part of a vector."""
    numbers = np.concatenate([field.given for field in fields])
    start, end = vector.getOwnershipRange()
    return numbers[(start <= numbers) & (numbers < end)] - start


class Slabs:
    """A vector of complete grid lines in one direction, shared out evenly.  Collective.

    Parameters
    ----------
    comm : PETSc.Comm
    shapes : list of (int, int)
        Rows and columns of each field.
    axis : int
        Direction of the lines.

    Attributes
    ----------
    vector : PETSc.Vec
    boxes : list of (slice, slice)
        Rows and columns of each field that this rank has.
    values : ndarray
        This rank's part of the vector; between the fields' lines it has unused places.
    arrays : list of ndarray
        Views of each field's values there.
    numbers : list of ndarray
        Position in the vector of each point of each field in natural order.
    """

    def __init__(self, comm, shapes, axis):
        self.numbers = [np.empty(shape, dtype=PETSc.IntType) for shape in shapes]
        end = 0
        for rank in range(comm.size):
            start, boxes, pieces = end, [], []
            for shape, numbers in zip(shapes, self.numbers):
                lines = shape[1 - axis]
                part = slice(lines * rank // comm.size, lines * (rank + 1) // comm.size)
                box = (part, slice(None)) if axis == X else (slice(None), part)
                rows, columns = numbers[box].shape
                # At a distance of a power of two between rows, transforms across them would take
                # thrice as long; so it is an odd number of cache lines.
                pitch = CACHE_LINE * (-(-columns // CACHE_LINE) | 1)
                numbers[box] = end + pitch * np.arange(rows)[:, None] + np.arange(columns)
                boxes.append(box)
                pieces.append((end - start, rows, pitch, columns))
                end += rows * pitch
            if rank == comm.rank:
                self.boxes = boxes
                self._size, self._pieces = end - start, pieces
        self.values, self.arrays = self.allocate()
        self.vector = PETSc.Vec().createWithArray(self.values, comm=comm)

    def allocate(self, fill=0.0):
        """New values of this rank, all the same: as one array, and views of each field's."""
        values = np.full(self._size, fill)
        return values, [
            values[first : first + rows * pitch].reshape(rows, pitch)[:, :columns]
            for first, rows, pitch, columns in self._pieces
        ]

    def scatter_from(self, vector, numbers):
        """New scatter to here from a vector with these numbers of the same points."""
        source, target = (
            np.concatenate([table[box].ravel() for table, box in zip(tables, self.boxes)])
            for tables in (numbers, self.numbers)
        )
        return PETSc.Scatter().create(
            vector,
            PETSc.IS().createGeneral(source, comm=PETSc.COMM_SELF),
            self.vector,
            PETSc.IS().createGeneral(target, comm=PETSc.COMM_SELF),
        )


def transform(functions, axis, slabs):
    """Transform each field's lines in place."""
    for function, work in zip(functions, slabs.arrays):
        if work.size:
            answer = function(work, axis=axis, overwrite_x=True)
            if not np.may_share_memory(answer, work):  # as a rule scipy leaves it where it was
                work[...] = answer


def velocity_fields(grid):
    """Both components of the velocity."""
    return [
        Field(grid.u_index, (WALL_BETWEEN, WALL_AT_POINT)),
        Field(grid.v_index, (WALL_AT_POINT, WALL_BETWEEN)),
    ]


class SpectralSolver:
    """Solves a x - b Laplacian(x) = r for each of some fields, exactly.  Collective.

    Parameters
    ----------
    grid : Grid
    fields : list of Field
    vector : PETSc.Vec
        Any vector of their layout.
    """

    def __init__(self, grid, fields, vector):
        self._fields = fields
        self._eigenvalues = [
            (y.eigenvalues(grid.n, grid.dy), x.eigenvalues(grid.m, grid.dx))
            for y, x in (field.bases for field in fields)
        ]
        unknown = [field.unknown for field in fields]
        shapes = [numbers.shape for numbers in unknown]
        # First along the lines that ranks hold already, where they do.
        self._first, self._second = (Y, X) if grid.dm.getProcSizes()[1] == 1 else (X, Y)
        self._begin = self._turned = Slabs(grid.comm, shapes, self._first)
        self._fetch, self._turn = self._begin.scatter_from(vector, unknown), None
        if grid.comm.size > 1:
            self._turned = Slabs(grid.comm, shapes, self._second)
            self._turn = self._turned.scatter_from(self._begin.vector, self._begin.numbers)
        self._factors = self._turned.allocate()[1]

    def set_operator(self, a, b):
        """Set the coefficients.  With a = 0 a constant part of r is left out."""
        parts = zip(self._eigenvalues, self._turned.boxes, self._factors)
        for (along_y, along_x), (rows, columns), factors in parts:
            np.add.outer(a + b * along_y[rows], b * along_x[columns], out=factors)
            np.divide(1, factors, out=factors, where=factors != 0)

    def solve(self, source, target):
        """Solve; given points of the target keep their values."""
        forward, reverse = PETSc.ScatterMode.FORWARD, PETSc.ScatterMode.REVERSE
        begin, turned = self._begin, self._turned
        self._fetch.scatter(source, begin.vector, mode=forward)
        self._transform("forward", self._first, begin)
        if self._turn is not None:
            self._turn.scatter(begin.vector, turned.vector, mode=forward)
        self._transform("forward", self._second, turned)
        for work, factors in zip(turned.arrays, self._factors):
            work *= factors
        self._transform("inverse", self._second, turned)
        if self._turn is not None:
            self._turn.scatter(turned.vector, begin.vector, mode=reverse)
        self._transform("inverse", self._first, begin)
        self._fetch.scatter(begin.vector, target, mode=reverse)

    def _transform(self, way, axis, slabs):
        transform([getattr(field.bases[axis], way) for field in self._fields], axis, slabs)

    def destroy(self):
        """Free vectors and scatters.  Collective."""
        for slabs, scatter in ((self._begin, self._fetch), (self._turned, self._turn)):
            slabs.vector.destroy()
            if scatter is not None:
                scatter.destroy()
