"""Complete lines of a grid, shared out over the ranks."""

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from scipy.fft import dst

from petscib.solvers.transforms.bases import X, Y
from petscib.solvers.transforms.slabs import Slabs, transform

SHAPES = [(7, 5), (6, 9)]
pytestmark = pytest.mark.parallel([1, 2, 3])


@pytest.mark.parametrize("axis", [X, Y])
def test_every_point_has_its_place_on_the_rank_of_its_line(axis):
    slabs = Slabs(PETSc.COMM_WORLD, SHAPES, axis)
    start, end = slabs.vector.getOwnershipRange()
    for shape, box, numbers, array in zip(SHAPES, slabs.boxes, slabs.numbers, slabs.arrays):
        assert len(np.unique(numbers)) == numbers.size
        mine = numbers[box]
        assert mine.shape == array.shape and mine.shape[axis] == shape[axis]
        assert ((start <= mine) & (mine < end)).all()
        others = np.setdiff1d(numbers, mine)
        assert not ((start <= others) & (others < end)).any()
        array[...] = mine
        np.testing.assert_array_equal(slabs.values[mine - start], mine)
    assert MPI.COMM_WORLD.allreduce(sum(array.size for array in slabs.arrays)) == 7 * 5 + 6 * 9


@pytest.mark.parametrize("axis", [X, Y])
def test_lines_arrive_and_are_transformed(axis):
    fields = [np.random.default_rng(k).random(shape) for k, shape in enumerate(SHAPES)]
    across = Slabs(PETSc.COMM_WORLD, SHAPES, 1 - axis)
    along = Slabs(PETSc.COMM_WORLD, SHAPES, axis)
    for field, box, array in zip(fields, across.boxes, across.arrays):
        array[...] = field[box]
    scatter = along.scatter_from(across.vector, across.numbers)
    scatter.scatter(across.vector, along.vector)
    transform([lambda work, **how: dst(work, type=1, **how)] * 2, axis, along)
    for field, box, array in zip(fields, along.boxes, along.arrays):
        np.testing.assert_allclose(array, dst(field, type=1, axis=axis)[box], rtol=1e-13)
    scatter.destroy()
