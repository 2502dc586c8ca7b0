"""Fast direct solvers: exact inverses of the assembled matrices, and how options put them in."""
import csv

import dense
import numpy as np
import pytest
from petsc4py import PETSc

from petscib.errors import InputError
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.walls import Walls
from petscib.solvers.momentum import FluidMatrix
from petscib.solvers.poisson import PoissonSolver

RHO, MU = 1.3, 0.7
NAME = "petscib.solvers.transforms."
# cells, box: even, odd and prime numbers, square cells and others, tall and wide boxes
CASES = [
    ((64, 64), (-1.0, 1.0, -1.0, 1.0)),
    ((65, 50), (-1.0, 2.0, 0.5, 1.5)),
    ((7, 13), (0.0, 1.0, 0.0, 1.0)),
    ((53, 8), (0.0, 1.0, 0.0, 1.0)),
]


@pytest.fixture(params=CASES, ids=lambda case: "x".join(map(str, case[0])))
def operators(request):
    grid = Grid(*request.param)
    return Operators(grid, Walls(grid, "rest", 0.0))


class Inverse:
    """A preconditioner made by name, as PETSc makes it from options."""

    def __init__(self, matrix, name):
        self.matrix = matrix
        self.pc = PETSc.PC().create(matrix.comm)
        self.pc.setOperators(matrix)
        self.pc.setType("python")
        self.pc.setPythonType(NAME + name)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.pc.destroy()

    def __call__(self, x):
        y = x.duplicate()
        y.set(np.nan)  # every entry must be set
        self.pc.setUp()
        self.pc.apply(x, y)
        return y


def fluid_matrix(operators, interval=0.01):
    fluid = FluidMatrix(operators, RHO, MU)
    fluid.update(interval)
    return fluid


def poisson_matrix(operators):
    return PoissonSolver(operators).matrix


def random_vector(matrix, seed=1, mean_zero=False):
    vector = matrix.createVecRight()
    values = np.random.default_rng(seed).standard_normal(vector.getSize())
    if mean_zero:
        values -= values.mean()
    vector.getArray()[:] = values[slice(*vector.getOwnershipRange())]
    return vector


def residual(matrix, x, y):
    """Norm of x - matrix y, relative to that of x."""
    result = matrix.createVecLeft()
    matrix.mult(y, result)
    result.aypx(-1.0, x)
    return result.norm() / x.norm()


def round_off(matrix, x, y):
    """What evaluating the residual itself can lose, relative to the norm of x."""
    return 50 * np.finfo(float).eps * (1 + matrix.norm(PETSc.NormType.INFINITY) * y.norm()
                                       / x.norm())


# ---------------------------------------------------------------- exact inverses


@pytest.mark.parallel([1, 2, 3])
def test_fluid_exact(operators):
    fluid = fluid_matrix(operators)
    with Inverse(fluid.matrix, "FluidTransform") as inverse:
        x = random_vector(fluid.matrix)
        y = inverse(x)
    assert residual(fluid.matrix, x, y) < 1e-12


@pytest.mark.parallel([1, 2, 3])
def test_fluid_follows_the_time_step(operators):
    fluid = fluid_matrix(operators)
    x = random_vector(fluid.matrix)
    with Inverse(fluid.matrix, "FluidTransform") as inverse:
        for interval in (1e-5, 1e3, 0.01):
            fluid.update(interval)
            y = inverse(x)
            assert residual(fluid.matrix, x, y) < round_off(fluid.matrix, x, y)


@pytest.mark.parallel([1, 2, 3])
def test_poisson_exact(operators):
    matrix = poisson_matrix(operators)
    x = random_vector(matrix, mean_zero=True)
    with Inverse(matrix, "PoissonTransform") as inverse:
        y = inverse(x)
    assert residual(matrix, x, y) < 1e-12
    assert abs(y.sum()) < 1e-13 * y.norm(PETSc.NormType.NORM_1)


@pytest.mark.parallel([1, 2])
def test_poisson_drops_constants(operators):
    """A constant in the right-hand side changes nothing, and alone gives nothing."""
    matrix = poisson_matrix(operators)
    x, shifted, constant = (random_vector(matrix, mean_zero=True) for _ in range(3))
    shifted.shift(3.0)
    constant.set(3.0)
    with Inverse(matrix, "PoissonTransform") as inverse:
        difference = inverse(shifted)
        difference.axpy(-1.0, inverse(x))
        scale = inverse(x).norm()
        assert difference.norm() < 1e-12 * scale
        assert inverse(constant).norm() < 1e-12 * scale


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("name", ["FluidTransform", "PoissonTransform"])
def test_symmetric(operators, name):
    fluid = fluid_matrix(operators)
    matrix = fluid.matrix if name == "FluidTransform" else poisson_matrix(operators)
    x, y = random_vector(matrix, 1), random_vector(matrix, 2)
    with Inverse(matrix, name) as inverse:
        px, py = inverse(x), inverse(y)
    assert abs(x.dot(py) - y.dot(px)) < 1e-13 * x.norm() * py.norm()
    assert x.dot(px) > 0


@pytest.mark.parallel([4])
@pytest.mark.parametrize("ranks_x", [1, 2, 4])
def test_any_share_of_the_grid(ranks_x):
    """Ranks side by side, one above the other, and two by two."""
    with dense.petsc_options(stag_ranks_x=ranks_x, stag_ranks_y=4 // ranks_x):
        grid = Grid((19, 23), (-1.0, 2.0, 0.5, 1.5))
    assert grid.dm.getProcSizes() == (ranks_x, 4 // ranks_x)
    operators = Operators(grid, Walls(grid, "rest", 0.0))
    fluid = fluid_matrix(operators)
    for matrix, name in ((fluid.matrix, "FluidTransform"),
                         (poisson_matrix(operators), "PoissonTransform")):
        x = random_vector(matrix, mean_zero=True)
        with Inverse(matrix, name) as inverse:
            assert residual(matrix, x, inverse(x)) < 1e-12


def test_wrong_matrix_is_named(operators):
    with Inverse(operators.laplacian, "FluidTransform") as inverse:
        with pytest.raises(InputError, match="FluidTransform is only for"):
            inverse(random_vector(operators.laplacian))


# ---------------------------------------------------------------- put in by options

SHORT = ("-scene", "stiff", "-sigma0", "1e5", "-stag_grid_x", "32", "-ts_max_steps", "2",
         "-plot", "0", "-monitor", "none", "-output", "out", "-diagnostics_every", "1")
BY_NAME = [word for prefix, name in (("momentum", "FluidTransform"),
                                     ("poisson", "PoissonTransform"))
           for word in (f"-{prefix}_pc_type", "python", f"-{prefix}_pc_python_type", NAME + name)]
VIEWS = ("-momentum_ksp_view", "-poisson_ksp_view")


def rows(folder):
    with open(folder / "out" / "diagnostics.csv") as file:
        return list(csv.DictReader(file))


def last_energy(folder):
    return float(rows(folder)[-1]["energy"])


@pytest.mark.parametrize("ranks", [1, 2])
def test_same_run_with_each_solver(mpirun, tmp_path, ranks):
    tight = ("-momentum_ksp_rtol", "1e-12", "-poisson_ksp_rtol", "1e-12")
    mpirun(ranks, "-m", "petscib", *SHORT, *tight)
    energy = last_energy(tmp_path)
    for extra in (("-fft",), BY_NAME):
        result = mpirun(ranks, "-m", "petscib", *SHORT, *tight, *VIEWS, *extra)
        assert "exact, by sine transforms" in result.stdout
        assert "exact, by cosine transforms" in result.stdout
        assert last_energy(tmp_path) == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize("alone", [("-scheme", "ep", "-sigma0", "1")])
def test_one_iteration_without_implicit_force(mpirun, tmp_path, alone):
    mpirun(1, "-m", "petscib", *SHORT, "-fft", *alone)
    last = rows(tmp_path)[-1]
    assert (last["momentum_iterations"], last["poisson_iterations"]) == ("1", "1")


def test_user_options_win(mpirun, tmp_path):
    result = mpirun(1, "-m", "petscib", *SHORT, "-fft", "-poisson_pc_type", "gamg", *VIEWS)
    assert "exact, by sine transforms" in result.stdout
    assert "cosine" not in result.stdout
    assert "type: gamg" in result.stdout
    assert int(rows(tmp_path)[-1]["poisson_iterations"]) > 1  # a single cycle would be no solve


def test_misspelt_name(mpirun):
    result = mpirun(1, "-m", "petscib", *SHORT, "-poisson_pc_type", "python",
                    "-poisson_pc_python_type", NAME + "Poisson", check=False)
    assert result.returncode == 2
    assert "petscib: -poisson_pc_python_type" in result.stderr
