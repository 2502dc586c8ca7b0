"""Fast direct solvers: sine and cosine transforms that diagonalise the constant operators.

On a uniform box each component's difference operator is a sum of two one-dimensional ones, whose
eigenvectors depend only on how the component's points lie to the walls.  So a solve is a transform
along each direction, a division by the eigenvalues, and the way back: exact to round-off, in
O(N log N) operations.

In parallel the first transform is along lines that the ranks already hold as a rule, the second
across; in between the ranks exchange blocks.

`FluidTransform` and `PoissonTransform` are preconditioners that PETSc makes by name:
``-poisson_pc_type python
-poisson_pc_python_type petscib.solvers.transforms.PoissonTransform``.
"""

from functools import partial
from typing import Callable, NamedTuple

import numpy as np
from mpi4py import MPI
from numpy.lib.stride_tricks import as_strided

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


WALL_AT_POINT = Basis(partial(fft.dst, type=1), partial(fft.idst, type=1), lowest=1, given=1)
WALL_BETWEEN = Basis(partial(fft.dst, type=2), partial(fft.idst, type=2), lowest=1, given=0)
NO_FLUX = Basis(partial(fft.dct, type=2), partial(fft.idct, type=2), lowest=0, given=0)


class Field:
    """One component: its bases, and where its unknowns lie.  Collective.

    Parameters
    ----------
    grid : Grid
    index, box
        The component's table of PETSc numbers, and what this rank owns of it (see Grid).
    bases : (Basis, Basis)
        In y and x.
    vector : PETSc.Vec
        Any vector of its layout.

    Attributes
    ----------
    bases : (Basis, Basis)
    shape : (int, int)
        Rows and columns of unknowns.
    owned : list of (slice, slice)
        Rows and columns of the unknowns of each rank.
    eigenvalues : (ndarray, ndarray)
        Of minus the second differences in y and x.
    """

    def __init__(self, grid, index, box, bases, vector):
        self.bases = bases
        self.shape = tuple(size - 2 * b.given for size, b in zip(index.shape, bases))
        self.eigenvalues = tuple(
            basis.eigenvalues(cells, spacing)
            for basis, cells, spacing in zip(bases, (grid.n, grid.m), (grid.dy, grid.dx))
        )
        mine = tuple(
            slice(max(part.start - b.given, 0), min(part.stop - b.given, size))
            for part, b, size in zip(box, bases, self.shape)
        )
        self.owned = grid.comm.tompi4py().allgather(mine)
        inner = tuple(slice(p.start + b.given, p.stop + b.given) for p, b in zip(mine, bases))
        unknown = grid.local_positions(index, inner, vector)
        self._given = np.setdiff1d(grid.local_positions(index, box, vector), unknown)
        # DMStag stores what a rank owns cell by cell and row by row: at constant strides.
        self._block = unknown.shape
        self._first = unknown[0, 0] if unknown.size else 0
        self._strides = [
            np.ptp(line[:2]) if unknown.size else 0 for line in (unknown[:, :1], unknown[:1].T)
        ]

    def view(self, values):
        """View in natural order of this rank's unknowns in a vector's local array."""
        strides = [values.itemsize * stride for stride in self._strides]
        return as_strided(values[self._first :], self._block, strides)

    def divide_given(self, source, target, divisor):
        """Set the given points of a local array to those of another over `divisor`."""
        target[self._given] = source[self._given] / divisor


def split(size, parts):
    """Cut range(size) into contiguous slices of nearly equal lengths."""
    bounds = [size * k // parts for k in range(parts + 1)]
    return [slice(*ends) for ends in zip(bounds, bounds[1:])]


def line_box(axis, part, shape):
    """Box of the complete lines along `axis` that `part` counts."""
    complete = slice(0, shape[axis])
    return (part, complete) if axis == X else (complete, part)


def slabs(count, axis, shape):
    """Boxes of complete lines along `axis`, one for each of `count` ranks."""
    return [line_box(axis, part, shape) for part in split(shape[1 - axis], count)]


def lines(owned, axis, shape):
    """Boxes of complete lines along `axis`, each rank's from among the lines it owns parts of."""
    across = 1 - axis
    result = []
    for rank, box in enumerate(owned):
        sharers = [k for k, other in enumerate(owned) if other[across] == box[across]]
        start = box[across].start
        part = split(box[across].stop - start, len(sharers))[sharers.index(rank)]
        result.append(line_box(axis, slice(start + part.start, start + part.stop), shape))
    return result


def extent(box):
    """Rows and columns of a box."""
    return tuple(part.stop - part.start for part in box)


def work_array(shape):
    """Uninitialised array whose rows lie an odd number of cache lines apart.

    At a distance of a power of two, transforms across the rows would take thrice as long.
    """
    rows, columns = shape
    pitch = CACHE_LINE * (-(-columns // CACHE_LINE) | 1)
    return np.empty((rows, pitch))[:, :columns]


def overlap(box, other):
    """Rows and columns that two boxes share, counted from the first of `box`; may be empty."""
    starts = [max(a.start, b.start) for a, b in zip(box, other)]
    stops = [max(start, min(a.stop, b.stop)) for start, a, b in zip(starts, box, other)]
    return tuple(slice(start - a.start, stop - a.start)
                 for start, stop, a in zip(starts, stops, box))


class Message:
    """A buffer for what one rank exchanges with all others, and which parts of fields go in it.

    Parameters
    ----------
    mine : list of (slice, slice)
        This rank's box of each field.
    theirs : list of list of (slice, slice)
        The boxes of all ranks of each field, on the other side of the exchange.
    rank : int
        This rank; what stays on it is left out.
    """

    def __init__(self, mine, theirs, rank):
        parts = [
            [
                (field, overlap(box, others[peer]))
                for field, (box, others) in enumerate(zip(mine, theirs))
                if peer != rank
            ]
            for peer in range(len(theirs[0]))
        ]
        sizes = [[np.prod(extent(part)) for _, part in group] for group in parts]
        self.counts = [int(sum(group)) for group in sizes]
        self.buffer = np.empty(sum(self.counts))
        self._pieces, end = [], 0
        for group, group_sizes in zip(parts, sizes):
            for (field, part), size in zip(group, group_sizes):
                view = self.buffer[end : end + size].reshape(extent(part))
                self._pieces.append((field, part, view))
                end += size

    def pack(self, fields):
        """Fill the buffer from the arrays of the fields."""
        for field, part, view in self._pieces:
            view[...] = fields[field][part]

    def unpack(self, fields):
        """Fill the arrays of the fields from the buffer."""
        for field, part, view in self._pieces:
            fields[field][part] = view


class Exchange:
    """Moves fields from one distribution over the ranks to another.  Collective.

    Parameters
    ----------
    comm : MPI.Comm
    sources, targets : list of list of (slice, slice)
        For each field, the box of each rank.
    """

    def __init__(self, comm, sources, targets):
        rank = comm.rank
        come_from, go_to = [s[rank] for s in sources], [t[rank] for t in targets]
        self._comm = comm
        self._stay = [(overlap(s, t), overlap(t, s)) for s, t in zip(come_from, go_to)]
        self._sent = Message(come_from, targets, rank)
        self._received = Message(go_to, sources, rank)
        self._needed = comm.allreduce(len(self._sent.buffer)) > 0

    def move(self, sources, targets):
        """Copy this rank's arrays of the fields, and what comes from others, into `targets`."""
        for source, target, (here, there) in zip(sources, targets, self._stay):
            target[there] = source[here]
        if self._needed:
            self._sent.pack(sources)
            self._comm.Alltoallv(
                (self._sent.buffer, self._sent.counts),
                (self._received.buffer, self._received.counts),
            )
            self._received.unpack(targets)


class SpectralSolver:
    """Solves a x - b Laplacian(x) = r for each of some fields, exactly.  Collective.

    Parameters
    ----------
    comm : petsc4py.PETSc.Comm
    fields : list of Field
    """

    def __init__(self, comm, fields):
        comm = comm.tompi4py()
        self.fields = fields
        rows_complete = all(
            box[X] == slice(0, field.shape[X]) for field in fields for box in field.owned
        )
        self._first, self._second = (X, Y) if rows_complete else (Y, X)
        owned = [field.owned for field in fields]
        first = [lines(field.owned, self._first, field.shape) for field in fields]
        second = [slabs(comm.size, self._second, field.shape) for field in fields]
        self._boxes = [boxes[comm.rank] for boxes in second]
        self._begin, self._end = Exchange(comm, owned, first), Exchange(comm, first, owned)
        self._on_first = [work_array(extent(boxes[comm.rank])) for boxes in first]
        self._turned = comm.size > 1
        self._on_second = self._on_first
        if self._turned:
            self._turn, self._turn_back = (
                Exchange(comm, first, second),
                Exchange(comm, second, first),
            )
            self._on_second = [work_array(extent(box)) for box in self._boxes]
        self._factors = [work_array(work.shape) for work in self._on_second]

    def set_operator(self, a, b):
        """Set the coefficients.  With a = 0 the constants, if a field has them, map to zero."""
        for field, (rows, columns), factors in zip(self.fields, self._boxes, self._factors):
            along_y, along_x = field.eigenvalues
            np.add.outer(a + b * along_y[rows], b * along_x[columns], out=factors)
            np.divide(1, factors, out=factors, where=factors != 0)

    def solve(self, source, target):
        """Solve with local arrays of the fields' layout."""
        sources, targets = ([f.view(values) for f in self.fields] for values in (source, target))
        self._begin.move(sources, self._on_first)
        self._transform("forward", self._first, self._on_first)
        if self._turned:
            self._turn.move(self._on_first, self._on_second)
        self._transform("forward", self._second, self._on_second)
        for work, factors in zip(self._on_second, self._factors):
            work *= factors
        self._transform("inverse", self._second, self._on_second)
        if self._turned:
            self._turn_back.move(self._on_second, self._on_first)
        self._transform("inverse", self._first, self._on_first)
        self._end.move(self._on_first, targets)

    def _transform(self, way, axis, works):
        for field, work in zip(self.fields, works):
            if work.size:
                work[...] = getattr(field.bases[axis], way)(work, axis=axis, overwrite_x=True)


def attribute(matrix, name, preconditioner):
    """Python attribute of a PETSc matrix that a preconditioner cannot do without."""
    value = matrix.getAttr(name)
    if value is None:
        raise InputError(
            f"{type(preconditioner).__name__} was put under a matrix that it does not invert; "
            "with an implicit membrane force, FluidTransform goes under -momentum_outer_pc_type"
        )
    return value


class FluidTransform:
    """PETSc python PC: the inverse of rho / (theta dt) - mu Laplacian on the velocity layout.

    Its matrix must be that of a `FluidMatrix`, which carries the grid and the coefficients.
    """

    def __init__(self):
        self._solver = None
        self._coefficients = None

    def setUp(self, pc):
        """Take over the matrix's coefficients.  Collective."""
        matrix = pc.getOperators()[1]
        grid = attribute(matrix, "grid", self)
        if self._solver is None:
            vector = matrix.createVecRight()
            u = Field(grid, grid.u_index, grid.u_box, (WALL_BETWEEN, WALL_AT_POINT), vector)
            v = Field(grid, grid.v_index, grid.v_box, (WALL_AT_POINT, WALL_BETWEEN), vector)
            self._solver = SpectralSolver(grid.comm, [u, v])
            vector.destroy()
        coefficients = attribute(matrix, "coefficients", self)
        if coefficients != self._coefficients:
            self._coefficients = coefficients
            self._solver.set_operator(*coefficients)

    def apply(self, pc, x, y):
        """y = A0^{-1} x; on the faces of walls only the diagonal counts."""
        source, target = x.getArray(readonly=True), y.getArray()
        self._solver.solve(source, target)
        for field in self._solver.fields:
            field.divide_given(source, target, self._coefficients[0])

    def view(self, pc, viewer):
        """Say what it is."""
        viewer.printfASCII("  exact, by sine transforms\n")


class PoissonTransform:
    """PETSc python PC: pseudo-inverse of minus the Laplacian without flux through the walls.

    Its matrix must be the pressure Laplacian of `Operators`, which carries the grid.  Answers
    have zero mean.
    """

    def __init__(self):
        self._solver = None

    def setUp(self, pc):
        """Make the transforms, once.  Collective."""
        if self._solver is None:
            matrix = pc.getOperators()[1]
            grid = attribute(matrix, "grid", self)
            vector = matrix.createVecRight()
            p = Field(grid, grid.p_index, grid.p_box, (NO_FLUX, NO_FLUX), vector)
            self._solver = SpectralSolver(grid.comm, [p])
            self._solver.set_operator(0.0, 1.0)
            vector.destroy()

    def apply(self, pc, x, y):
        """y = pseudo-inverse of the matrix times x."""
        self._solver.solve(x.getArray(readonly=True), y.getArray())

    def view(self, pc, viewer):
        """Say what it is."""
        viewer.printfASCII("  exact, by cosine transforms\n")
