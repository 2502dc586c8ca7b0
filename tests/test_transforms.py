"""Fast direct solvers: exact inverses of the assembled operators, and windows of them."""
import csv

import dense
import numpy as np
import pytest
from petsc4py import PETSc
from runs import run

from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides
from petscib.solvers.transforms.diagonal import HelmholtzTransform, PoissonTransform
from petscib.solvers.transforms.saddle_point import StokesTransform

# cells, box: even, odd and prime numbers, square cells and others, tall and wide boxes
CASES = [
    ((64, 64), (-1.0, 1.0, -1.0, 1.0)),
    ((65, 50), (-1.0, 2.0, 0.5, 1.5)),
    ((7, 13), (0.0, 1.0, 0.0, 1.0)),
    ((53, 8), (0.0, 1.0, 0.0, 1.0)),
]
SIDES = {"walls": (False, False), "x": (True, False), "y": (False, True), "xy": (True, True)}
COEFFICIENTS = (130.0, 0.7), (1.3e5, 0.7), (1e-3, 0.7), (130.0, 1e-4)
EPS = np.finfo(float).eps

all_cases = pytest.mark.parametrize("case", CASES, ids=lambda case: "x".join(map(str, case[0])))
all_sides = pytest.mark.parametrize("sides", SIDES)


class Fluid:
    """A grid, its operators, and random vectors that are the same on any ranks."""

    def __init__(self, case, sides, **layout):
        with dense.petsc_options(**layout):
            self.grid = Grid(*case, periodic=SIDES[sides])
        self.operators = Operators(self.grid, Sides(self.grid))

    def velocity(self, seed=1):
        vector = self.grid.velocity_vector()
        count = len(dense.velocity_numbers(self.grid))
        dense.set_velocity(self.grid, vector, np.random.default_rng(seed).standard_normal(count))
        return vector

    def pressure(self, seed=1):
        """Of zero mean."""
        vector = self.grid.pressure_vector()
        values = np.random.default_rng(seed).standard_normal(self.grid.p_index.shape)
        self.grid.set_pressure(vector, (values - values.mean())[self.grid.p_box])
        return vector

    def helmholtz(self, velocity, a, b):
        """(a - b Laplacian) times a velocity, a new vector."""
        result = velocity.duplicate()
        self.operators.laplacian.mult(velocity, result)
        result.axpby(a, -b, velocity)
        return result

    def round_off(self, a, b, velocity, force):
        """What evaluating a residual can lose, relative to the force."""
        norm = a + 4 * b * (1 / self.grid.dx**2 + 1 / self.grid.dy**2)
        return 50 * EPS * (1 + norm * velocity.norm() / force.norm())


def unset(vector):
    """A vector like another in which every entry is still to be set."""
    result = vector.duplicate()
    result.set(np.nan)
    return result


# ---------------------------------------------------------------- exact inverses


def check_helmholtz(fluid):
    transform, rhs = HelmholtzTransform(fluid.grid), fluid.velocity()
    for a, b in COEFFICIENTS:
        transform.set_coefficients(a, b)
        answer = unset(rhs)
        transform.solve(rhs, answer)
        rest = fluid.helmholtz(answer, a, b)
        rest.aypx(-1.0, rhs)
        assert rest.norm() <= fluid.round_off(a, b, answer, rhs) * rhs.norm()
    same = rhs.copy()
    transform.solve(same, same)
    same.axpy(-1.0, answer)
    assert same.norm() == 0.0
    transform.destroy()


def check_poisson(fluid):
    transform, rhs = PoissonTransform(fluid.grid), fluid.pressure()
    answer, rest = unset(rhs), unset(rhs)
    transform.solve(rhs, answer)
    fluid.operators.pressure_laplacian.mult(answer, rest)
    rest.aypx(-1.0, rhs)
    assert rest.norm() <= 1e-12 * rhs.norm()
    assert abs(answer.sum()) <= 1e-12 * answer.norm(PETSc.NormType.NORM_1)
    # A constant in the source changes nothing.
    rhs.shift(3.0)
    transform.solve(rhs, rest)
    rest.axpy(-1.0, answer)
    assert rest.norm() <= 1e-12 * answer.norm()
    transform.destroy()


def check_stokes(fluid):
    transform = StokesTransform(fluid.grid, fluid.operators)
    gradient = fluid.operators.gradient
    for a, b in COEFFICIENTS:
        transform.set_coefficients(a, b)
        for source in (fluid.pressure(3), None):
            force = fluid.velocity()
            velocity, pressure = unset(force), unset(fluid.pressure())
            transform.solve(force, source, velocity, pressure)
            rest = fluid.helmholtz(velocity, a, b)
            gradient.multAdd(pressure, rest, rest)
            rest.aypx(-1.0, force)
            assert rest.norm() <= fluid.round_off(a, b, velocity, force) * force.norm()
            excess = pressure.duplicate()
            gradient.multTranspose(velocity, excess)
            if source is not None:
                excess.axpy(-1.0, source)
            width = min(fluid.grid.dx, fluid.grid.dy)
            assert excess.norm() <= 100 * EPS * velocity.norm() / width
            assert abs(pressure.sum()) <= 1e-11 * pressure.norm(PETSc.NormType.NORM_1)
        response = unset(force)
        transform.respond(force, response)
        response.axpy(-1.0, velocity)
        assert response.norm() <= 1e-13 * velocity.norm()
    transform.destroy()


CHECKS = check_helmholtz, check_poisson, check_stokes


@pytest.mark.parallel([1, 2, 3])
@all_cases
@all_sides
@pytest.mark.parametrize("check", CHECKS)
def test_exact(check, sides, case):
    check(Fluid(case, sides))


@pytest.mark.parallel([4])
@pytest.mark.parametrize("ranks_x", [1, 2, 4])
@all_sides
@pytest.mark.parametrize("check", CHECKS)
def test_exact_for_any_share_of_the_grid(check, sides, ranks_x):
    """Ranks side by side, one above the other, and two by two."""
    layout = dict(stag_ranks_x=ranks_x, stag_ranks_y=4 // ranks_x)
    fluid = Fluid(((19, 23), (-1.0, 2.0, 0.5, 1.5)), sides, **layout)
    assert fluid.grid.dm.getProcSizes() == (ranks_x, 4 // ranks_x)
    check(fluid)


@pytest.mark.parallel([1, 2])
@all_sides
def test_symmetric(sides):
    fluid = Fluid(CASES[1], sides)
    x, y = fluid.velocity(1), fluid.velocity(2)
    px, py = unset(x), unset(y)
    helmholtz = HelmholtzTransform(fluid.grid)
    stokes = StokesTransform(fluid.grid, fluid.operators)
    for transform, solve in ((helmholtz, helmholtz.solve), (stokes, stokes.respond)):
        transform.set_coefficients(130.0, 0.7)
        solve(x, px)
        solve(y, py)
        assert abs(x.dot(py) - y.dot(px)) <= 1e-13 * x.norm() * py.norm()
        assert x.dot(px) > 0
        transform.destroy()


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("sides", ["x", "xy"])
def test_a_uniform_force_drives_a_flow_and_no_pressure(sides):
    """Along a periodic direction: between walls a channel's, else ever faster as a whole."""
    fluid = Fluid(CASES[1], sides)
    transform = StokesTransform(fluid.grid, fluid.operators)
    a, b = 1e-3, 0.7
    transform.set_coefficients(a, b)
    force, velocity, pressure = fluid.velocity(), fluid.velocity(), fluid.pressure()
    count = fluid.grid.u_index.size
    values = np.zeros(len(dense.velocity_numbers(fluid.grid)))
    values[:count] = 2.0
    dense.set_velocity(fluid.grid, force, values)
    transform.solve(force, None, velocity, pressure)
    found = dense.velocity(fluid.grid, velocity)
    u = found[:count].reshape(fluid.grid.u_index.shape)
    rows, h = fluid.grid.n, fluid.grid.dy
    table = dense.second_difference(rows, h, "wall between" if sides == "x" else "periodic")
    expected = np.linalg.solve(a * np.eye(rows) - b * table, np.full(rows, 2.0))
    assert np.allclose(u, expected[:, None], rtol=1e-9, atol=0)
    assert np.abs(found[count:]).max() <= 1e-9 * np.abs(u).max()
    assert pressure.norm() <= 1e-11 * force.norm()
    transform.destroy()


# ---------------------------------------------------------------- windows

CELLS, BOX = (24, 21), (-1.5, 1.5, -1.0, 1.0)
# Rows and columns of cells: narrow in either direction, at each wall, one line wide, all.  Beyond
# the last one they go on from the first where the box is periodic.
PLACES = [(4, 17, 9, 12), (8, 11, 2, 22), (0, 5, 0, 3), (17, 21, 20, 24), (3, 9, 5, 6),
          (0, 21, 0, 24)]
CROSSING = {"x": [(5, 9, 21, 28), (2, 18, 22, 25)], "y": [(18, 25, 3, 9), (19, 23, 2, 20)],
            "xy": [(18, 25, 20, 27), (3, 6, 21, 40), (20, 38, 23, 25)]}
PLACES_BY_SIDES = [(sides, place) for sides in SIDES for place in PLACES + CROSSING.get(sides, [])]


def faces_within(grid, place, step):
    """Rows and columns of every `step`-th face, but those on walls."""
    top, bottom, left, right = place
    u, v = np.mgrid[top:bottom, left : right + 1], np.mgrid[top : bottom + 1, left:right]
    parts = []
    for part, own, cells in ((u, 1, grid.m), (v, 0, grid.n)):
        periodic = grid.periodic[1 - own]
        along, across = part[own].ravel(), part[1 - own].ravel()
        inner = np.full(along.size, True) if periodic else (along > 0) & (along < cells)
        rows, columns = (across, along) if own else (along, across)
        parts.append(np.stack((rows[inner] % grid.n, columns[inner] % grid.m)))
    # A box all around has its first faces twice.
    return [np.unique(part, axis=1)[:, ::step] for part in parts]


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("sides, place", PLACES_BY_SIDES)
@pytest.mark.parametrize("kind", ["helmholtz", "stokes"])
def test_window_answer_is_that_of_the_whole_box(kind, sides, place):
    fluid = Fluid((CELLS, BOX), sides)
    grid = fluid.grid
    u, v = faces_within(grid, place, 2)
    numbers = np.concatenate((grid.u_index[tuple(u)], grid.v_index[tuple(v)]))
    values = np.random.default_rng(3).standard_normal(len(numbers))
    here = slice(None) if grid.comm.rank == 0 else slice(0)
    faces = [tuple(part[:, here]) for part in (u, v)]
    force, velocity = grid.velocity_vector(), grid.velocity_vector()
    if grid.comm.rank == 0:
        force.setValues(numbers, values)
    force.assemble()
    if kind == "helmholtz":
        transform = HelmholtzTransform(grid)
        solve = transform.solve
    else:
        transform = StokesTransform(grid, fluid.operators)
        solve = transform.respond
    window = None
    for a, b in ((1.3e4, 0.7), (130.0, 0.7), (0.13, 0.7), (130.0, 1e-5)):
        transform.set_coefficients(a, b)
        solve(force, velocity)
        natural = dense.velocity(grid, velocity)
        expected = natural[np.argsort(dense.velocity_numbers(grid))][numbers]
        if kind == "helmholtz" or window is None:  # the other one follows the coefficients
            window = transform.window(faces)
        for _ in range(2):
            window.vector.getArray()[:] = values[here]
            window.solve()
            difference = np.abs(window.vector.getArray() - expected[here])
            assert difference.max(initial=0.0) <= 1e-11 * np.abs(expected).max()
        if kind == "helmholtz":
            window.destroy()
    if kind == "stokes":
        window.destroy()
    transform.destroy()


# ---------------------------------------------------------------- put in by options

SHORT = ("-scene", "stiff", "-scheme", "mbe", "-sigma0", "1e5", "-stag_grid_x", "32",
         "-ts_max_steps", "2", "-plot", "0", "-monitor", "none", "-output", "out",
         "-diagnostics_every", "1")
VIEWS = ("-momentum_ksp_view", "-poisson_ksp_view")


def rows(folder):
    with open(folder / "out" / "diagnostics.csv") as file:
        return list(csv.DictReader(file))


def last_energy(folder):
    return float(rows(folder)[-1]["energy"])


def test_same_run_with_each_solver(mpirun, tmp_path):
    tight = ("-momentum_ksp_rtol", "1e-12", "-poisson_ksp_rtol", "1e-12")
    mpirun(2, "-m", "petscib", *SHORT, *tight)
    energy = last_energy(tmp_path)
    result = mpirun(2, "-m", "petscib", *SHORT, *tight[:2], *VIEWS[:1], "-fft")
    assert "exact, by sine" in result.stdout
    assert last_energy(tmp_path) == pytest.approx(energy, rel=1e-9)


def test_one_iteration_without_implicit_force(tmp_path):
    run(tmp_path / "out", scheme="ep", sigma0="1", fft="yes", ts_max_steps="2")
    last = rows(tmp_path)[-1]
    assert (last["momentum_iterations"], last["poisson_iterations"]) == ("1", "1")


def test_user_options_win(mpirun, tmp_path):
    result = mpirun(1, "-m", "petscib", *SHORT, "-fft", "-poisson_pc_type", "gamg", *VIEWS)
    assert "exact, by sine" in result.stdout and "type: gamg" in result.stdout
    assert int(rows(tmp_path)[-1]["poisson_iterations"]) > 1  # a single cycle would be no solve
