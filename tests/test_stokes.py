"""The direct solver of the fluid's coupled system, and the coupled solver that is built on it."""
import dense
import numpy as np
import pytest
from petsc4py import PETSc
from test_solvers import assert_close
from test_transforms import CASES, MU, RHO, round_off

from petscib.errors import InputError
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.walls import Walls
from petscib.membranes import geometry
from petscib.solvers import krylov
from petscib.solvers.momentum import FluidMatrix
from petscib.solvers.pair import FluidPair, PairLayout
from petscib.solvers.saddle import CoupledSolver, ForceMethod
from petscib.solvers.stokes import StokesTransform

TRANSFORM = {
    "coupled_pc_type": "python",
    "coupled_pc_python_type": "petscib.solvers.stokes.StokesTransform",
}
INTERVAL = 0.02


class Stokes:
    """The coupled system of the fluid alone and its preconditioner, made as options make it."""

    def __init__(self, cells, box, **layout):
        with dense.petsc_options(**layout):
            self.grid = Grid(cells, box)
        operators = Operators(self.grid, Walls(self.grid))
        self.fluid = FluidMatrix(operators, RHO, MU)
        self.pair = FluidPair(operators, self.fluid, PairLayout(self.grid))
        self.operator = krylov.Operator(self.pair.layout.vector)
        self.operator.matrix.setAttr("pair", self.pair)
        self.pc = PETSc.PC().create(self.grid.comm)
        self.pc.setOperators(self.operator.matrix)
        self.pc.setType("python")
        self.pc.setPythonType("petscib.solvers.stokes.StokesTransform")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.pc.destroy()

    def update(self, interval):
        self.fluid.update(interval)
        self.operator.act_as(self.pair)
        self.pc.setUp()

    @property
    def context(self):
        return self.pc.getPythonContext()

    def random(self, seed):
        """A pair vector whose sources sum to zero, the same on any ranks."""
        layout, grid = self.pair.layout, self.grid
        pair, velocity, pressure = layout.joint()
        random = np.random.default_rng(seed)
        dense.set_velocity(
            grid, velocity, random.standard_normal(len(dense.velocity_numbers(grid))))
        values = random.standard_normal(grid.p_index.shape)
        grid.set_pressure(pressure, (values - values.mean())[grid.p_box])
        return pair

    def inverse(self, x):
        y = x.duplicate()
        y.set(np.nan)  # every entry must be set
        self.pc.apply(x, y)
        return y

    def defect(self, x, y):
        """Norm of x - K0 y, relative to that of x."""
        result = x.duplicate()
        self.pair.mult(y, result)
        result.aypx(-1.0, x)
        return result.norm() / x.norm()


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("case", CASES, ids=lambda case: "x".join(map(str, case[0])))
def test_exact_at_every_time_step(case):
    with Stokes(*case) as stokes:
        x = stokes.random(1)
        for interval in (1e-5, 0.01, 1.0, 1e3):
            stokes.update(interval)
            y = stokes.inverse(x)
            assert stokes.defect(x, y) < round_off(stokes.fluid.matrix, x, y)


@pytest.mark.parallel([4])
@pytest.mark.parametrize("ranks_x", [1, 2, 4])
def test_any_share_of_the_grid(ranks_x):
    layout = dict(stag_ranks_x=ranks_x, stag_ranks_y=4 // ranks_x)
    with Stokes((19, 23), (-1.0, 2.0, 0.5, 1.5), **layout) as stokes:
        assert stokes.grid.dm.getProcSizes() == (ranks_x, 4 // ranks_x)
        stokes.update(0.01)
        x = stokes.random(1)
        assert stokes.defect(x, stokes.inverse(x)) < 1e-12


@pytest.mark.parallel([1, 2])
def test_symmetric(ranks):
    with Stokes((20, 15), (-1.0, 1.0, -1.0, 1.0)) as stokes:
        stokes.update(0.01)
        x, y = stokes.random(1), stokes.random(2)
        px, py = stokes.inverse(x), stokes.inverse(y)
        assert abs(x.dot(py) - y.dot(px)) < 1e-12 * x.norm() * py.norm()


CELLS, BOX = (24, 21), (-1.5, 1.5, -1.0, 1.0)
# Rows and columns of cells: narrow in either direction, at each wall, one line wide, all.
PLACES = [(4, 17, 9, 12), (8, 11, 2, 22), (0, 5, 0, 3), (17, 21, 20, 24), (3, 9, 5, 6),
          (0, 21, 0, 24)]


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("place", PLACES)
def test_window_answer_is_that_of_the_whole_box(place):
    top, bottom, left, right = place
    u = np.mgrid[top:bottom, max(left, 1) : min(right + 1, CELLS[0])].reshape(2, -1)[:, ::2]
    v = np.mgrid[max(top, 1) : min(bottom + 1, CELLS[1]), left:right].reshape(2, -1)[:, ::2]
    with Stokes(CELLS, BOX) as stokes:
        grid = stokes.grid
        numbers = np.concatenate((grid.u_index[tuple(u)], grid.v_index[tuple(v)]))
        values = np.random.default_rng(3).standard_normal(len(numbers))
        here = slice(None) if grid.comm.rank == 0 else slice(0)
        window = None
        for interval in (1e-4, 10.0):
            stokes.update(interval)
            force, velocity = grid.velocity_vector(), grid.velocity_vector()
            if grid.comm.rank == 0:
                force.setValues(numbers, values)
            force.assemble()
            stokes.context.respond(force, velocity)
            natural = dense.velocity(grid, velocity)
            expected = natural[np.argsort(dense.velocity_numbers(grid))][numbers]
            if window is None:
                faces = [tuple(u[:, here]), tuple(v[:, here])]
                window = stokes.context.window(faces)  # and it follows the time step
            window.vector.getArray()[:] = values[here]
            window.solve()
            difference = np.abs(window.vector.getArray() - expected[here])
            assert difference.max(initial=0.0) <= 1e-12 * np.abs(expected).max()
        window.destroy()


def test_wrong_matrix_is_named():
    grid = Grid(CELLS, BOX)
    pc = PETSc.PC().create(grid.comm)
    pc.setOperators(Operators(grid, Walls(grid)).laplacian)
    pc.setType("python")
    pc.setPythonContext(StokesTransform())
    with pytest.raises(InputError, match="StokesTransform for the coupled system"):
        pc.setUp()
    pc.destroy()


# ---------------------------------------------------------------- with a membrane


class Case:
    """A coupled system: its parts in the order of a scheme's passes."""

    def __init__(self, sigma0, flow="extensional"):
        self.problem, state = dense.problem(
            stag_grid_x=24, stag_grid_y=20, domain="-1.5,1.5,-1,1", axes="0.5,0.3", angle=15,
            sigma0=sigma0, rho=1.3, mu=0.7, flow=flow)
        self.grid = self.problem.grid
        self.markers = self.grid.comm.tompi4py().bcast(state.markers)
        self.rhs = self.grid.velocity_vector()
        count = len(dense.velocity_numbers(self.grid))
        dense.set_velocity(self.grid, self.rhs, np.random.default_rng(5).standard_normal(count))

    def new_solver(self):
        return CoupledSolver(self.problem.operators, self.problem.rho, self.problem.mu)

    def guesses(self):
        return self.grid.velocity_vector(), self.grid.pressure_vector()

    def update(self, solver, shift=0.0, turn=0.0, place=None):
        """Set the markers, shifted, and the tangent, turned; returns the interpolation.

        `place` keeps the interpolation of an earlier call.
        """
        membrane, here = self.problem.membrane, self.grid.comm.rank == 0
        markers = (self.markers + shift)[: None if here else 0]
        place = place or self.problem.interpolation(markers)
        tangent = geometry.unit_tangent(markers, membrane.ds)
        tangent = np.cos(turn) * tangent + np.sin(turn) * tangent[:, ::-1] * (-1, 1)
        solver.update(INTERVAL, place, membrane.stiffness(tangent))
        return place

    def natural(self, velocity, pressure):
        return dense.velocity(self.grid, velocity), dense.pressure(self.grid, pressure)


def whole_iteration(case, **last):
    """Answer of the iteration on all unknowns for a pass alone."""
    with dense.petsc_options(coupled_ksp_rtol=1e-12):
        solver = case.new_solver()
        case.update(solver, **last)
        velocity, pressure = case.guesses()
        solver.solve(case.rhs, velocity, pressure)
        assert not isinstance(solver._method, ForceMethod)
        solver.destroy()
    return case.natural(velocity, pressure)


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("flow", ["rest", "extensional"])
@pytest.mark.parametrize("sigma0", [1e5, 1e9])
def test_passes_that_belong_together_end_at_the_answer_of_the_last(sigma0, flow):
    check_passes(sigma0, flow)


def check_passes(sigma0, flow):
    case = Case(sigma0, flow)
    last = dict(shift=0.11, turn=0.2)
    expected = whole_iteration(case, **last)
    with dense.petsc_options(coupled_ksp_rtol=1e-12, **TRANSFORM):
        solver = case.new_solver()
        velocity, pressure = case.guesses()
        for _ in range(2):  # and the same from there
            place = case.update(solver, turn=0.3)
            solver.begin(velocity, pressure)
            solver.iterate(case.rhs, velocity)
            case.update(solver, turn=0.1, place=place)  # the same place
            solver.iterate(case.rhs, velocity)
            case.update(solver, shift=1e-4)  # the same tube
            solver.iterate(case.rhs, velocity)
            case.update(solver, **last)
            solver.iterate(case.rhs, velocity)
            solver.finish(velocity, pressure)
            found = case.natural(velocity, pressure)
            for one, other in zip(found, expected):
                assert_close(one, other, 1e-8)
        solver.destroy()


@pytest.mark.parallel([1, 2])
def test_markers_can_be_asked_before_the_end(ranks):
    case = Case(1e7)
    with dense.petsc_options(coupled_ksp_rtol=1e-12, **TRANSFORM):
        solver = case.new_solver()
        velocity, pressure = case.guesses()
        place = case.update(solver)
        solver.begin(velocity, pressure)
        assert solver.iterate(case.rhs, velocity) > 1
        early = place.interpolate(velocity)
        solver.finish(velocity, pressure)
        late = place.interpolate(velocity)
        solver.destroy()
    assert np.abs(late - early).max(initial=0.0) <= 1e-9 * max(np.abs(early).max(initial=0), 1e-99)


def test_a_kept_factorisation_only_preconditions():
    """Tangents turned by little after the factorisation change the answer as they must."""
    case = Case(1e7)
    expected = whole_iteration(case, turn=0.008)[0]
    with dense.petsc_options(coupled_ksp_rtol=1e-12, **TRANSFORM):
        solver = case.new_solver()
        velocity, pressure = case.guesses()
        place = case.update(solver)
        solver.begin(velocity, pressure)
        solver.iterate(case.rhs, velocity)
        unturned = place.interpolate(velocity)
        direct = solver._method.forces.arcs.direct
        factor, direct.factor = direct.factor, None  # not called
        case.update(solver, turn=0.008, place=place)
        direct.factor = factor
        solver.iterate(case.rhs, velocity)
        turned = place.interpolate(velocity)
        solver.finish(velocity, pressure)
        solver.destroy()
    assert np.abs(turned - unturned).max() > 1e-4 * np.abs(turned).max()
    assert_close(dense.velocity(case.grid, velocity), expected, 1e-8)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("ksp_type", ["cg", "gmres", "fgmres"])
def test_any_krylov_method_serves(ksp_type):
    case = Case(1e5)
    expected = whole_iteration(case)
    with dense.petsc_options(coupled_ksp_rtol=1e-12, coupled_ksp_type=ksp_type, **TRANSFORM):
        solver = case.new_solver()
        velocity, pressure = case.guesses()
        case.update(solver)
        solver.solve(case.rhs, velocity, pressure)
        solver.destroy()
    for one, other in zip(case.natural(velocity, pressure), expected):
        assert_close(one, other, 1e-8)


@pytest.mark.parallel([1, 2])
def test_a_guess_much_too_fast_costs_no_accuracy(ranks):
    case = Case(1e5, "rest")
    expected = whole_iteration(case)
    with dense.petsc_options(coupled_ksp_rtol=1e-4, **TRANSFORM):
        solver = case.new_solver()
        case.update(solver)
        for factor in (1.0, 900.0):
            velocity, pressure = case.guesses()
            dense.set_velocity(case.grid, velocity, factor * expected[0])
            solver.solve(case.rhs, velocity, pressure)
            assert_close(dense.velocity(case.grid, velocity), expected[0], 1e-6)
        solver.destroy()


@pytest.mark.parallel([1, 2])
def test_each_solve_is_measured_by_its_own_right_hand_side(ranks):
    case = Case(1e5, "rest")
    with dense.petsc_options(coupled_ksp_rtol=1e-10):
        solver = case.new_solver()
        answers = []
        for factor in (1.0, 1e-6):
            rhs = case.rhs.copy()
            rhs.scale(factor)
            velocity, pressure = case.guesses()
            solver.update(INTERVAL)
            solver.solve(rhs, velocity, pressure)
            answers.append(dense.velocity(case.grid, velocity) / factor)
        solver.destroy()
    assert_close(answers[1], answers[0], 1e-7)


@pytest.mark.parallel([1, 2])
def test_without_a_membrane_one_application_solves(ranks):
    case = Case(1e5)
    with dense.petsc_options(coupled_ksp_type="preonly", **TRANSFORM):
        solver = case.new_solver()
        velocity, pressure = case.guesses()
        solver.update(INTERVAL)
        assert solver.solve(case.rhs, velocity, pressure) == 1
        divergence = case.grid.pressure_vector()
        case.problem.operators.gradient.multTranspose(velocity, divergence)
        divergence.axpy(-1.0, case.problem.operators.wall_flux)
        assert divergence.norm() <= 1e-12 * case.problem.operators.wall_flux.norm()
        solver.destroy()
