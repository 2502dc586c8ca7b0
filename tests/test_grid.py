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
def cells(request):
    return request.param


@pytest.fixture(params=["walls", "x", "y", "xy"])
def grid(request, cells):
    return Grid(cells, DOMAIN, periodic=("x" in request.param, "y" in request.param))


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
        # PETSc's array has an empty line at the end where the box is periodic.
        whole = whole.reshape(grid.n + (kind == "v"), grid.m + (kind == "u"))
        table = getattr(grid, f"{kind}_index")
        assert np.array_equal(whole[: table.shape[0], : table.shape[1]], table)


def test_shapes(grid):
    lines_x, lines_y = grid.m + (not grid.periodic[0]), grid.n + (not grid.periodic[1])
    assert grid.u_index.shape == (grid.n, lines_x)
    assert grid.v_index.shape == (lines_y, grid.m)
    assert grid.p_index.shape == (grid.n, grid.m)


def test_points(grid):
    a, b, c, d = DOMAIN
    for kind in KINDS:
        x, y = getattr(grid, f"{kind}_points")()
        assert np.broadcast_shapes(x.shape, y.shape) == getattr(grid, f"{kind}_index").shape
        # Faces reach from side to side (the last one may be the first again), or stand half a
        # cell off.
        for values, cells, low, high, on_sides in (
                (x.ravel(), grid.m, a, b, kind == "u"), (y.ravel(), grid.n, c, d, kind == "v")):
            h = (high - low) / cells
            expected = low + h * np.arange(cells + 1) if on_sides else low + h * (
                np.arange(cells) + 0.5)
            assert np.allclose(values, expected[: len(values)])
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
