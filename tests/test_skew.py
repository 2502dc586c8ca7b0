"""Generalised conjugate gradients for implicit advection against dense solves of A0 + rho N."""
import dense
import numpy as np
import pytest
from test_system import INTERVAL, MU, RHO, Case, close

from petscib.errors import SolveError
from petscib.fluid.advection import Advection
from petscib.solvers.skew import Skew
from petscib.solvers.system import ImplicitSystem

SPEED = 30.0  # of the transport: a CFL number of some 10
every_fluid = pytest.mark.parametrize("equations", ["momentum", "coupled"])


class Advected(Case):
    """With a transport that is nothing but noise, and zero on walls, so that N is skew."""

    def __init__(self):
        super().__init__(flow="rest")
        grid, self.inner = self.grid, dense.inner_faces(self.grid)
        self.advection = self.problem.advection = Advection(self.problem.operators, RHO, True)
        noise = SPEED * self.inner * np.random.default_rng(6).standard_normal(len(self.inner))
        transport = grid.velocity_vector()
        dense.set_velocity(grid, transport, noise)
        self.problem.fluid_rhs(self.state, INTERVAL, self.rhs, transport)
        # Walls are at rest, and what is on their faces does not matter.
        self.matrix = np.stack([self.image(unit) for unit in np.diag(1.0 * self.inner)], axis=1)

    def image(self, values):
        """rho N(U) w in natural order."""
        velocity, image = self.grid.velocity_vector(), self.grid.velocity_vector()
        dense.set_velocity(self.grid, velocity, values)
        self.advection.add(velocity, image)
        return dense.velocity(self.grid, image)

    def fluid_matrix(self):
        """A0 + rho N."""
        return (RHO / INTERVAL * np.eye(len(self.matrix)) - MU * dense.laplacian(self.grid)
                + self.matrix)

    def fluid_alone(self, equations):
        """The system without membranes, which is skewed all the same."""
        return ImplicitSystem(self.fluid(equations, True), None, None, True, INTERVAL)

    def exact_alone(self, equations):
        """w and p of the fluid alone by one dense solve."""
        none = np.zeros((0, 0))
        walls = np.zeros((~self.inner).sum())
        return dense.stage(
            self.grid, RHO / INTERVAL, MU, dense.velocity(self.grid, self.rhs), walls,
            np.zeros((0, len(self.inner))), none, none, np.zeros(0), equations == "coupled",
            self.matrix)[:2]


@pytest.fixture(scope="module")
def case():
    return Advected()


def options(equations, rtol, **more):
    return dense.petsc_options(**{f"{equations}_ksp_rtol": 1e-13,
                                  f"{equations}_advection_ksp_rtol": rtol, **more})


def test_it_is_skew_and_outweighs_the_rest(case):
    """So that a plain iteration, omega = 1, would diverge."""
    assert np.abs(case.matrix + case.matrix.T).max() <= 1e-12 * np.abs(case.matrix).max()
    rest = case.fluid_matrix() - case.matrix
    assert np.abs(np.linalg.eigvals(np.linalg.solve(rest, case.matrix))).max() > 2.0


@every_fluid
def test_the_fluid_alone(case, equations):
    with options(equations, 1e-11):
        system, stage = case.fluid_alone(equations), case.new_stage()
        assert isinstance(system._iteration, Skew)
        solves = system.solve(case.rhs, stage, INTERVAL)
        system.destroy()
    assert 10 < solves < 100
    found = (dense.velocity(case.grid, stage.velocity),
             dense.pressure(case.grid, stage.pressure))
    expected = case.exact_alone(equations)
    assert close(found[: 1 + (equations == "coupled")], expected, 1e-9)


@every_fluid
def test_with_membranes(case, equations):
    with options(equations, 1e-11):
        system, stage, operators = case.system(equations, True), case.new_stage(), case.operators()
        system.solve(case.rhs, stage, INTERVAL, operators, case.stress)
        motion = system.marker_velocity()
        system.destroy()
    w, p, U, f = case.found(stage, operators, motion)
    expected = case.exact(equations, advection=case.matrix)
    # Projection has no pressure among its unknowns.
    assert close((w, p if equations == "coupled" else expected[1], U, f), expected, 1e-7)


@pytest.mark.parametrize("rtol, near", [(1e-3, False), (0.1, True)])
def test_the_residual_that_is_left_has_no_power(case, rtol, near):
    """However loose the tolerance is, the energy law holds; also where one solve would do.

    From zero it would have none anyway: the residuals are orthogonal to all iterates.
    """
    guess = dense.velocity(case.grid, case.state.velocity)
    if near:
        guess = case.exact_alone("momentum")[0] + 1e-3 * guess
    with options("momentum", rtol):
        system, stage = case.fluid_alone("momentum"), case.new_stage()
        dense.set_velocity(case.grid, stage.velocity, guess)
        system.solve(case.rhs, stage, INTERVAL)
        system.destroy()
    w = dense.velocity(case.grid, stage.velocity)
    residual = dense.velocity(case.grid, case.rhs) - case.fluid_matrix() @ w
    size = INTERVAL / RHO * np.linalg.norm(residual) / np.linalg.norm(w)
    assert 1e-6 < size < rtol
    assert abs(w @ residual) <= 1e-9 * np.linalg.norm(w) * np.linalg.norm(residual)


def test_too_few_solves_are_a_failure(case):
    with options("momentum", 1e-11, momentum_advection_ksp_max_it=4):
        system = case.fluid_alone("momentum")
        with pytest.raises(SolveError, match="did not converge in 4 solves .*_ksp_max_it allows"):
            system.solve(case.rhs, case.new_stage(), INTERVAL)
        system.destroy()
