"""The force iteration: against dense solves of the same operators."""
import dense
import pytest
from test_solvers import Case, assert_close, momentum_options

TRANSFORM = {
    "pc_type": "python",
    "pc_python_type": "petscib.solvers.transform_pcs.FluidTransform",
    "ksp_rtol": 1e-12,
}

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
