"""The iteration on the skeleton: what projection leaves over, and the answers."""
import dense
import numpy as np
import pytest
from test_solvers import assert_close

from petscib.membrane import geometry
from petscib.solvers.saddle import CoupledSolver
from petscib.solvers.skeleton import slip_faces

TRANSFORMS = {
    "coupled_velocity_pc_type": "python",
    "coupled_velocity_pc_python_type": "petscib.solvers.transforms.FluidTransform",
    "coupled_poisson_pc_type": "python",
    "coupled_poisson_pc_python_type": "petscib.solvers.transforms.PoissonTransform",
}
INTERVAL = 0.02


def problem(sigma0=1e5, flow="extensional"):
    return dense.problem(
        stag_grid_x=24, stag_grid_y=20, domain="-1.5,1.5,-1,1", axes="0.5,0.3", angle=15,
        sigma0=sigma0, rho=1.3, mu=0.7, flow=flow)


class Case:
    """A coupled system: its parts in the order of a scheme's passes."""

    def __init__(self, sigma0):
        self.problem, state = problem(sigma0)
        self.grid = self.problem.grid
        self.markers = self.grid.comm.tompi4py().bcast(state.markers)
        self.rhs = self.grid.velocity_vector()
        count = len(dense.velocity_numbers(self.grid))
        dense.set_velocity(self.grid, self.rhs, np.random.default_rng(5).standard_normal(count))

    def new_solver(self):
        return CoupledSolver(self.problem.operators, self.problem.rho, self.problem.mu)

    def guesses(self):
        return self.grid.velocity_vector(), self.grid.pressure_vector()

    def take_pass(self, solver, velocity, shift=0.0, turn=0.0, place=None):
        """One pass with the markers shifted and the tangent turned; the velocity at the markers.

        `place` keeps the interpolation of an earlier pass.
        """
        membrane, here = self.problem.membrane, self.grid.comm.rank == 0
        markers = (self.markers + shift)[: None if here else 0]
        place = place or self.problem.interpolation(markers)
        tangent = geometry.unit_tangent(markers, membrane.ds)
        tangent = np.cos(turn) * tangent + np.sin(turn) * tangent[:, ::-1] * (-1, 1)
        solver.update(INTERVAL, place, membrane.stiffness(tangent))
        iterations = solver.iterate(self.rhs, velocity)
        return place, place.interpolate(velocity), iterations

    def natural(self, velocity, pressure):
        return dense.velocity(self.grid, velocity), pressure.norm()


def whole_iteration(case, **last):
    """Answer of the iteration on all unknowns for a pass alone."""
    with dense.petsc_options(coupled_ksp_rtol=1e-12):
        solver = case.new_solver()
        assert solver.skeleton is None
        velocity, pressure = case.guesses()
        solver.begin(velocity, pressure)
        case.take_pass(solver, velocity, **last)
        solver.finish(velocity, pressure)
        solver.destroy()
    return case.natural(velocity, pressure)


@pytest.mark.parallel([1, 2, 3])
def test_projection_leaves_a_slip_along_the_walls_only(ranks):
    with dense.petsc_options(**TRANSFORMS):
        solver = CoupledSolver(problem()[0].operators, 1.3, 0.7)
        solver.update(INTERVAL)
        layout, projection = solver.layout, solver.skeleton.projection
        given, force, source = layout.joint()
        answer, velocity, pressure = layout.joint()
        product = layout.vector.duplicate()
        rng = np.random.default_rng(7 + layout.comm.rank)
        for part in (force, source):
            part.getArray()[:] = rng.standard_normal(part.getLocalSize())
        source.shift(-source.sum() / source.getSize())
        projection.project(force, source, velocity, pressure)
        solver.pair.mult(answer, product)
        product.axpy(-1.0, given)
        faces, weights = slip_faces(solver.operators, layout)
        slip = 0.7 * weights * projection.slope.getArray(readonly=True)[faces]
        size = product.norm()
        assert size > 0.1
        product.getArray()[faces] -= slip
        assert product.norm() <= 1e-11 * size
        solver.destroy()


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("sigma0", [1e5, 1e9])
def test_passes_that_belong_together_end_at_the_answer_of_the_last(sigma0):
    case = Case(sigma0)
    last = dict(shift=0.11, turn=0.2)
    expected = whole_iteration(case, **last)
    with dense.petsc_options(coupled_ksp_rtol=1e-12, **TRANSFORMS):
        solver = case.new_solver()
        velocity, pressure = case.guesses()
        for _ in range(2):  # and the same from there
            solver.begin(velocity, pressure)
            place, _, _ = case.take_pass(solver, velocity, turn=0.3)
            case.take_pass(solver, velocity, turn=0.1, place=place)  # the same place
            case.take_pass(solver, velocity, shift=1e-4)  # the same tube
            case.take_pass(solver, velocity, **last)
            solver.finish(velocity, pressure)
            found = case.natural(velocity, pressure)
            assert_close(found[0], expected[0], 1e-8)
            assert found[1] == pytest.approx(expected[1], rel=1e-6)
        solver.destroy()


@pytest.mark.parallel([1, 2])
def test_markers_can_be_asked_before_the_end(ranks):
    case = Case(1e7)
    with dense.petsc_options(coupled_ksp_rtol=1e-12, **TRANSFORMS):
        solver = case.new_solver()
        velocity, pressure = case.guesses()
        solver.begin(velocity, pressure)
        place, early, iterations = case.take_pass(solver, velocity)
        assert iterations > 1
        solver.finish(velocity, pressure)
        late = place.interpolate(velocity)
        solver.destroy()
    assert np.abs(late - early).max(initial=0.0) <= 1e-9 * max(np.abs(early).max(initial=0), 1e-99)
