"""Momentum and Poisson solvers against dense solves; iteration counts; options; failures."""
import dense
import numpy as np
import pytest
from petsc4py import PETSc

from petscib.errors import SolveError
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides
from petscib.membranes import geometry
from petscib.schemes import create
from petscib.solvers import krylov
from petscib.solvers.momentum import MomentumSolver
from petscib.solvers.poisson import PoissonSolver

TIGHT = {"ksp_rtol": 1e-12}
INTERVAL = 0.02  # theta dt


def momentum_options(**options):
    return dense.petsc_options(**{f"momentum_{name}": value for name, value in options.items()})


class Case:
    """A momentum system around an ellipse on a small grid, and the same densely."""

    def __init__(self, sigma0=1e5, membrane=True):
        self.problem, state = dense.problem(
            stag_grid_x=24, stag_grid_y=20, domain="-1.5,1.5,-1,1", axes="0.5,0.3", angle=15,
            sigma0=sigma0, rho=1.3, mu=0.7)
        self.grid = self.problem.grid
        self.interpolation = self.stiffness = None
        if membrane:
            self.place(state.markers)
        self.rhs, self.solution = self.grid.velocity_vector(), self.grid.velocity_vector()
        self.values = np.random.default_rng(1).standard_normal(
            len(dense.velocity_numbers(self.grid)))
        dense.set_velocity(self.grid, self.rhs, self.values)

    def place(self, markers):
        membrane = self.problem.membrane
        self.markers = self.grid.comm.tompi4py().bcast(markers)
        self.interpolation = self.problem.interpolation(markers)
        self.stiffness = membrane.stiffness(geometry.unit_tangent(markers, membrane.ds))

    def solver(self):
        """A solver under the options in force; inner ones read theirs when first used."""
        return MomentumSolver(self.problem.operators, self.problem.rho, self.problem.mu)

    def solve(self, interval=INTERVAL, **options):
        """The answer in natural order, and the iterations, under `options` without prefix."""
        with momentum_options(**options):
            solver = self.solver()
            solver.update(interval, self.interpolation, self.stiffness)
            self.solution.set(0.0)
            iterations = solver.solve(self.rhs, self.solution)
            solver.destroy()
        return dense.velocity(self.grid, self.solution), iterations

    def matrix(self, interval=INTERVAL):
        """The matrix of the momentum system, built densely in natural order."""
        problem, grid = self.problem, self.grid
        table = problem.rho / interval * np.eye(len(self.values))
        table -= problem.mu * dense.laplacian(grid)
        if self.interpolation is not None:
            membrane = problem.membrane
            ds = membrane.ds
            rate = dense.surface_divergence(geometry.unit_tangent(self.markers, ds), ds)
            stiffness = membrane.sigma0 * rate.T @ rate
            stiffness += membrane.bending * dense.fourth_difference(len(self.markers), ds)
            at_markers = dense.interpolation(grid, problem.kernel, self.markers)
            table += interval * ds / grid.cell_area * at_markers.T @ stiffness @ at_markers
        return table

    def exact(self, interval=INTERVAL):
        return np.linalg.solve(self.matrix(interval), self.values)


def assert_close(found, expected, tolerance):
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


# ---------------------------------------------------------------- momentum


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("sigma0", [1e2, 1e5, 1e9])
def test_momentum_answer_is_that_of_the_dense_matrix(sigma0):
    case = Case(sigma0)
    # Round-off in the dense solve itself grows with the stiffness.
    assert_close(case.solve(**TIGHT)[0], case.exact(), 1e-9 if sigma0 < 1e9 else 1e-7)


@pytest.mark.parallel([1, 2, 3])
def test_momentum_without_a_membrane(ranks):
    case = Case(membrane=False)
    assert_close(case.solve(**TIGHT)[0], case.exact(), 1e-10)


@pytest.mark.parallel([1, 2])
def test_one_solver_follows_the_time_step_and_the_membrane(ranks):
    """Nothing stale is kept: not the matrix, its preconditioner, the tube or its factor."""
    case = Case()
    start = case.markers
    with momentum_options(**TIGHT):
        solver = case.solver()
        for interval, shift in ((0.02, 0.0), (0.02, 0.05), (0.005, 0.05), (0.02, -0.2)):
            moved = start + (shift, -shift / 2)
            case.place(moved if case.grid.comm.rank == 0 else moved[:0])
            solver.update(interval, case.interpolation, case.stiffness)
            solver.solve(case.rhs, case.solution)
            answer = dense.velocity(case.grid, case.solution)
            assert_close(answer, case.exact(interval), 1e-9)
        solver.destroy()


@pytest.mark.parallel([1, 2])
def test_assembled_matrix_with_gamg_stays_selectable(ranks):
    case = Case(sigma0=1e4)
    answer, iterations = case.solve(condense="false", pc_type="gamg", **TIGHT)
    assert_close(answer, case.exact(), 1e-8)
    assert iterations > 2 * case.solve(**TIGHT)[1]


def test_momentum_iterations_do_not_grow_with_the_stiffness():
    counts = []
    for sigma0 in (1e5, 1e7, 1e9, 1e13):
        problem, state = dense.problem(stag_grid_x=64, axes="0.1,0.5", sigma0=sigma0)
        with momentum_options(ksp_rtol=1e-6):
            scheme = create("mbe", problem)
            largest = 0
            for _ in range(3):
                step = scheme.step(state, problem.grid.dx)
                largest = max(largest, step.iterations["momentum"])
                state = step.end
            scheme.destroy()
        counts.append(largest)
    assert max(counts) <= 12
    assert max(counts) <= counts[0] + 1


def test_options_of_the_inner_solvers_act():
    case = Case()
    plain, iterations = case.solve(**TIGHT)
    jacobi, more = case.solve(pc_type="jacobi", **TIGHT)
    assert more > 2 * iterations
    assert_close(jacobi, plain, 1e-9)

    for package in ("mumps", "petsc"):
        answer, _ = case.solve(tube_pc_factor_mat_solver_type=package, **TIGHT)
        assert_close(answer, plain, 1e-9)
    wrong, _ = case.solve(tube_pc_type="jacobi", **TIGHT)
    assert np.abs(wrong - plain).max() > 1e-3 * np.abs(plain).max()


@pytest.mark.parallel([1, 2, 3])
def test_failed_momentum_solve_raises_on_every_rank(ranks):
    case = Case()
    with pytest.raises(SolveError, match="momentum solve failed: DIVERGED_(MAX_)?ITS? after 1 it"):
        case.solve(ksp_max_it=1, **TIGHT)


# ---------------------------------------------------------------- Poisson


class PoissonCase:
    def __init__(self):
        self.grid = Grid((17, 14), (-1.5, 1.5, -1, 1))
        self.operators = Operators(self.grid, Sides(self.grid))
        self.source, self.solution = self.grid.pressure_vector(), self.grid.pressure_vector()
        random = np.random.default_rng(2)
        self.values = random.standard_normal(self.grid.p_index.shape) + 3.0
        self.grid.set_pressure(self.source, self.values[self.grid.p_box])

    def solve(self, **options):
        with dense.petsc_options(**{f"poisson_{name}": value for name, value in options.items()}):
            solver = PoissonSolver(self.operators)
            iterations = solver.solve(self.source, self.solution)
            solver.destroy()
        return dense.pressure(self.grid, self.solution), iterations


@pytest.mark.parallel([1, 2, 3])
def test_poisson_answer_is_the_one_of_zero_mean(ranks):
    case = PoissonCase()
    case.solution.set(7.0)
    answer, _ = case.solve(**TIGHT)
    table = dense.divergence(case.grid) @ dense.gradient(case.grid)
    projected = (case.values - case.values.mean()).ravel()
    assert_close(answer, np.linalg.pinv(table) @ projected, 1e-10)
    assert abs(answer.mean()) <= 1e-12 * np.abs(answer).max()
    assert case.operators.pressure_laplacian.getNullSpace().test(
        case.operators.pressure_laplacian)


@pytest.mark.parallel([1, 2])
def test_poisson_options_act(ranks):
    case = PoissonCase()
    answer, iterations = case.solve(**TIGHT)
    case.solution.set(0.0)
    jacobi, more = case.solve(pc_type="jacobi", **TIGHT)
    assert more > 2 * iterations
    assert_close(jacobi, answer, 1e-9)


def test_poisson_starts_from_the_guess():
    case = PoissonCase()
    case.solve(**TIGHT)
    assert case.solve(ksp_rtol=1e-8)[1] == 0


@pytest.mark.parallel([1, 2, 3])
def test_failed_poisson_solve_raises_on_every_rank(ranks):
    with pytest.raises(SolveError, match="Poisson solve failed: DIVERGED_(MAX_)?ITS? after 1 it"):
        PoissonCase().solve(ksp_max_it=1, **TIGHT)


@pytest.mark.parallel([1, 2])
def test_poisson_iterations_hardly_grow_with_the_grid(ranks):
    counts = []
    for size in (32, 128):
        grid = Grid((size, size), (-1, 1, -1, 1))
        source, solution = grid.pressure_vector(), grid.pressure_vector()
        x, y = grid.p_points(grid.p_box)
        grid.set_pressure(source, np.sin(7 * x) * np.cos(5 * y) + x * y)
        with dense.petsc_options(poisson_ksp_rtol=1e-8):
            solver = PoissonSolver(Operators(grid, Sides(grid)))
            counts.append(solver.solve(source, solution))
            solver.destroy()
    assert max(counts) <= 25


def test_a_first_guess_many_orders_too_large_is_dropped():
    diagonal = PETSc.Vec().createMPI(20)
    diagonal.setArray(1.0 + np.arange(*diagonal.getOwnershipRange()))
    matrix = PETSc.Mat().createAIJ((diagonal.getSizes(),) * 2, nnz=1)
    matrix.setDiagonal(diagonal)
    matrix.assemble()
    ksp = krylov.create(matrix, "guess_", {"ksp_type": "fgmres", "pc_type": "none"})
    rhs, solution = matrix.createVecs()
    rhs.set(1e-9)
    solution.set(1e9)
    krylov.solve(ksp, rhs, solution, "test", "")
    solution.pointwiseMult(solution, diagonal)
    assert np.allclose(solution.getArray(), 1e-9, rtol=1e-4, atol=0)
    ksp.destroy()
    krylov.withdraw_defaults()
