"""The Poisson solver against dense solves; its counts, options and failures; Krylov solvers."""
import dense
import numpy as np
import pytest
from petsc4py import PETSc

from petscib import entries
from petscib.errors import SolveError
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides
from petscib.solvers import krylov
from petscib.solvers.poisson import PoissonSolver

TIGHT = {"ksp_rtol": 1e-12}


def assert_close(found, expected, tolerance):
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


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
    entries.present().withdraw()


def test_the_norm_of_a_joint_right_hand_side_follows_its_parts():
    """PETSc remembers norms, and does not see that parts of a vector change."""
    parts = [PETSc.Vec().createMPI(8) for _ in range(4)]
    solution, rhs = krylov.join(parts[:2]), krylov.join(parts[2:])
    shell = krylov.Operator(solution, Doubling())
    ksp = krylov.create(shell.matrix, "joint_", {"ksp_type": "fgmres", "pc_type": "none",
                                                 "ksp_rtol": 1e-6})
    for size in (1.0, 1e-9):
        for part in parts[2:]:
            part.getArray()[:] = size * (1.0 + np.arange(len(part.getArray())))
        for part in parts[:2]:
            part.set(0.0)
        krylov.solve(ksp, rhs, solution, "test", "")
        for answer, part in zip(parts[:2], parts[2:]):
            assert np.allclose(2 * answer.getArray(), part.getArray(), rtol=1e-5, atol=0)
    ksp.destroy()
    entries.present().withdraw()


class Doubling:
    """A matrix that doubles."""

    what = "numbers"

    def mult(self, x, y):
        for source, target in zip(krylov.blocks_of(x), krylov.blocks_of(y)):
            target.getArray()[:] = 2 * source.getArray(readonly=True)
