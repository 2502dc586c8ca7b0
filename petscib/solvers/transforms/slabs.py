"""Complete grid lines in one direction, shared out over the ranks, and their transforms."""

import numpy as np
from petsc4py import PETSc

from .bases import X

CACHE_LINE = 8  # numbers


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
