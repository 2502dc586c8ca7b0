"""The staggered grid: every face and cell has one PETSc number, one owner and one place."""
import dense
import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from petscib.fluid.grid import Grid

DOMAIN = (-1.0, 2.0, 0.5, 1.5)
CELLS = [(7, 5), (65, 50)]
KINDS = ("u", "v", "p")

pytestmark = pytest.mark.parallel([1, 2, 3])


@pytest.fixture(params=CELLS, ids=lambda cells: f"{cells[0]}x{cells[1]}")
def grid(request):
    return Grid(request.param, DOMAIN)


def test_every_unknown_has_one_number(grid):
    faces = dense.velocity_numbers(grid)
    assert np.array_equal(np.sort(faces), np.arange(grid.velocity_vector().getSize()))
    assert np.array_equal(np.sort(grid.p_index.ravel()), np.arange(grid.m * grid.n))


def test_boxes_tile_the_arrays_and_hold_this_ranks_numbers(grid):
    for kind in KINDS:
        index, box = getattr(grid, f"{kind}_index"), getattr(grid, f"{kind}_box")
        owners = np.zeros(index.shape, dtype=int)
        owners[box] = 1
        MPI.COMM_WORLD.Allreduce(MPI.IN_PLACE, owners)
        assert (owners == 1).all()
        vector = grid.pressure_vector() if kind == "p" else grid.velocity_vector()
        first, end = vector.getOwnershipRange()
        assert ((first <= index[box]) & (index[box] < end)).all()


def test_numbers_stand_where_petsc_puts_them(grid):
    """PETSc's own way from a DMStag location to a natural-order array gives the same places."""
    where = PETSc.DMStag.StencilLocation
    for kind, dm, location in (("u", grid.velocity_dm, where.LEFT),
                               ("v", grid.velocity_dm, where.DOWN),
                               ("p", grid.pressure_dm, where.ELEMENT)):
        vector = dm.createGlobalVec()
        first, end = vector.getOwnershipRange()
        vector.getArray()[:] = np.arange(first, end)
        array, values = dm.VecSplitToDMDA(vector, location, 0)
        natural = array.createNaturalVec()
        array.globalToNatural(values, natural)
        whole = np.concatenate(MPI.COMM_WORLD.allgather(natural.getArray()))
        assert np.array_equal(whole, getattr(grid, f"{kind}_index").ravel())


def test_points(grid):
    a, b, c, d = DOMAIN
    for kind, rows, columns in (("u", grid.n, grid.m + 1), ("v", grid.n + 1, grid.m),
                                ("p", grid.n, grid.m)):
        x, y = getattr(grid, f"{kind}_points")()
        assert x.shape == (1, columns) and y.shape == (rows, 1)
        # Faces reach from wall to wall, or stand half a cell off.
        for values, cells, low, high in ((x.ravel(), grid.m, a, b), (y.ravel(), grid.n, c, d)):
            h = (high - low) / cells
            offset = 0.0 if len(values) == cells + 1 else h / 2
            assert np.allclose(values, np.linspace(low + offset, high - offset, len(values)))
    box = (slice(1, 3), slice(2, 4))
    assert np.array_equal(grid.u_points(box)[0], grid.u_points()[0][:, 2:4])
    assert np.array_equal(grid.u_points(box)[1], grid.u_points()[1][1:3])


def test_fields_come_back(grid):
    random = np.random.default_rng(1)
    values, cells = random.standard_normal(len(dense.velocity_numbers(grid))), \
        random.standard_normal(grid.p_index.shape)
    vector, scalar = grid.velocity_vector(), grid.pressure_vector()
    dense.set_velocity(grid, vector, values)
    grid.set_pressure(scalar, cells[grid.p_box])
    assert np.array_equal(dense.velocity(grid, vector), values)
    assert np.array_equal(dense.pressure(grid, scalar), cells.ravel())
    u, v = grid.velocity_blocks(vector)
    split = grid.u_index.size
    assert np.array_equal(u, values[:split].reshape(grid.u_index.shape)[grid.u_box])
    assert np.array_equal(v, values[split:].reshape(grid.v_index.shape)[grid.v_box])
    assert np.array_equal(grid.pressure_block(scalar), cells[grid.p_box])
