"""The coupled solver that is built on the direct solver of the fluid's coupled system."""
import dense
import numpy as np
import pytest
from petsc4py import PETSc
from test_solvers import assert_close

from petscib.errors import InputError
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides
from petscib.membranes import geometry
from petscib.solvers.saddle import CoupledSolver, ForceMethod
from petscib.solvers.transform_pcs import StokesTransform

TRANSFORM = {
    "coupled_pc_type": "python",
    "coupled_pc_python_type": "petscib.solvers.transform_pcs.StokesTransform",
}
INTERVAL = 0.02


def test_wrong_matrix_is_named():
    grid = Grid((24, 21), (-1.5, 1.5, -1.0, 1.0))
    pc = PETSc.PC().create(grid.comm)
    pc.setOperators(Operators(grid, Sides(grid)).laplacian)
    pc.setType("python")
    pc.setPythonContext(StokesTransform())
    with pytest.raises(InputError, match="StokesTransform for the coupled system"):
        pc.setUp()
    pc.destroy()


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
