"""The window solver and the force iteration: against whole solves of the same operators."""
import dense
import numpy as np
import pytest
from test_solvers import Case, assert_close, momentum_options

from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.walls import Walls
from petscib.solvers import krylov
from petscib.solvers.momentum import FluidMatrix
from petscib.solvers.window import Window

TRANSFORM = {
    "pc_type": "python",
    "pc_python_type": "petscib.solvers.transforms.FluidTransform",
    "ksp_rtol": 1e-12,
}
CELLS, BOX = (24, 21), (-1.5, 1.5, -1.0, 1.0)
# Rows and columns of cells: narrow in either direction, at each wall, one line wide, all.
PLACES = [
    (4, 17, 9, 12),
    (8, 11, 2, 22),
    (0, 5, 0, 3),
    (17, 21, 20, 24),
    (3, 9, 5, 6),
    (0, 21, 0, 24),
]


def faces_within(place):
    """Rows and columns of every other face, but those on walls."""
    top, bottom, left, right = place
    m, n = CELLS
    u = np.mgrid[top:bottom, max(left, 1) : min(right + 1, m)].reshape(2, -1)[:, ::2]
    v = np.mgrid[max(top, 1) : min(bottom + 1, n), left:right].reshape(2, -1)[:, ::2]
    return u, v


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("interval", [1e-4, 0.01, 10.0])
def test_window_answer_is_that_of_the_whole_box(place, interval):
    grid = Grid(CELLS, BOX)
    fluid = FluidMatrix(Operators(grid, Walls(grid)), 1.3, 0.7)
    fluid.update(interval)
    u, v = faces_within(place)
    numbers = np.concatenate((grid.u_index[tuple(u)], grid.v_index[tuple(v)]))
    values = np.random.default_rng(3).standard_normal(len(numbers))

    force, velocity = grid.velocity_vector(), grid.velocity_vector()
    if grid.comm.rank == 0:
        force.setValues(numbers, values)
    force.assemble()
    with dense.petsc_options(whole_ksp_type="cg", whole_pc_type="jacobi", whole_ksp_rtol=1e-14):
        ksp = krylov.create(fluid.matrix, "whole_", {})
        ksp.solve(force, velocity)
        ksp.destroy()
    natural = dense.velocity(grid, velocity)
    order = np.argsort(dense.velocity_numbers(grid))
    expected = natural[order][numbers]

    here = slice(None) if grid.comm.rank == 0 else slice(0)
    faces = [tuple(u[:, here]), tuple(v[:, here])]
    window = Window(grid, *fluid.matrix.getAttr("coefficients"), faces)
    for _ in range(2):
        window.vector.getArray()[:] = values[here]
        window.solve()
        difference = np.abs(window.vector.getArray() - expected[here])
        assert difference.max(initial=0.0) <= 1e-11 * np.abs(expected).max()
    window.destroy()


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("sigma0", [1e2, 1e5, 1e9])
def test_force_iteration_gives_the_answer_of_the_dense_matrix(sigma0):
    case = Case(sigma0)
    answer, iterations = case.solve(**TRANSFORM)
    assert 1 < iterations < 30
    assert_close(answer, case.exact(), 1e-9 if sigma0 < 1e9 else 1e-7)


def test_force_iteration_starts_from_the_guess():
    case = Case()
    with momentum_options(**TRANSFORM):
        solver = case.solver()
        solver.update(0.02, case.interpolation, case.stiffness)
        solver.solve(case.rhs, case.solution)
        solver.force_solver.ksp.setTolerances(rtol=1e-8)
        assert solver.solve(case.rhs, case.solution) == 0
        solver.destroy()


@pytest.mark.parallel([1, 2])
def test_force_iteration_follows_the_time_step_and_the_membrane(ranks):
    case = Case()
    start = case.markers
    with momentum_options(**TRANSFORM):
        solver = case.solver()
        for interval, shift in ((0.02, 0.0), (0.02, 0.05), (0.005, 0.05), (0.02, -0.2)):
            moved = start + (shift, -shift / 2)
            case.place(moved if case.grid.comm.rank == 0 else moved[:0])
            solver.update(interval, case.interpolation, case.stiffness)
            solver.solve(case.rhs, case.solution)
            assert_close(dense.velocity(case.grid, case.solution), case.exact(interval), 1e-9)
        solver.destroy()
