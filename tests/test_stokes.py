"""The projection method as the preconditioner of velocity and pressure together."""
import dense
import numpy as np
import pytest

from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides
from petscib.schemes.projection import Projection
from petscib.solvers.poisson import PoissonSolver
from petscib.solvers.stokes import Stokes

RHO, MU, INTERVAL = 1.3, 0.7, 0.05
TIGHT = {f"coupled_{name}_ksp_{key}": value for name in ("velocity", "poisson")
         for key, value in (("type", "cg"), ("rtol", 1e-13), ("max_it", 200))}
pytestmark = pytest.mark.parallel([1, 3])


class Case:
    """The coupled system on 14 x 11 cells, and random unknowns, the pressures of zero mean."""

    def __init__(self, periodic):
        self.grid = Grid((14, 11), (-1.5, 1.5, -1.0, 1.0), periodic=periodic)
        self.operators = Operators(self.grid, Sides(self.grid))
        self.velocity, self.pressure = self.grid.velocity_vector(), self.grid.pressure_vector()
        random = np.random.default_rng(3)
        inner = dense.inner_faces(self.grid)
        dense.set_velocity(self.grid, self.velocity, random.standard_normal(len(inner)) * inner)
        values = random.standard_normal(self.grid.p_index.shape)
        self.grid.set_pressure(self.pressure, (values - values.mean())[self.grid.p_box])

    def system(self):
        stokes = Stokes(self.operators, RHO, MU)
        stokes.update(INTERVAL)
        return stokes


def test_without_walls_it_is_the_inverse():
    case = Case((True, True))
    unknowns = [case.velocity, case.pressure]
    with dense.petsc_options(**TIGHT):
        stokes = case.system()
        product, answer = stokes.blocks(), stokes.blocks()
        stokes.mult(unknowns, product)
        stokes.precondition(product, answer)
        stokes.destroy()
    for one, other in zip(answer, unknowns):
        one.axpy(-1.0, other)
        assert one.norm() <= 1e-10 * other.norm()


@pytest.mark.parametrize("periodic", [(False, False), (True, False)])
def test_between_walls_its_velocity_has_the_divergence_that_is_asked_for(periodic):
    case = Case(periodic)
    with dense.petsc_options(**TIGHT):
        stokes = case.system()
        (velocity, pressure), divergence = stokes.blocks(), case.grid.pressure_vector()
        stokes.precondition([case.velocity, case.pressure], [velocity, pressure])
        case.operators.gradient.multTranspose(velocity, divergence)
        divergence.scale(stokes.scale)
        stokes.destroy()
    divergence.axpy(-1.0, case.pressure)
    assert divergence.norm() <= 1e-10 * case.pressure.norm()


@pytest.mark.parametrize("theta", [1.0, 0.5])
def test_projection_takes_a_gradient_and_leaves_no_divergence(theta):
    """And the pressure is rho phi less theta mu dt div u* / dt (eq. 3.22)."""
    case, dt = Case((False, False)), 0.1
    star = dense.velocity(case.grid, case.velocity)
    problem = type("Problem", (), dict(
        operators=case.operators, rho=RHO, mu=MU, viscosity=None, grid=case.grid))
    with dense.petsc_options(poisson_ksp_rtol=1e-13):
        projection = Projection(problem, PoissonSolver(case.operators))
        phi, _ = projection.apply(case.velocity, dt, theta, case.pressure)
        projection.destroy()
    found, phi = dense.velocity(case.grid, case.velocity), dense.pressure(case.grid, phi)
    div, gradient = dense.divergence(case.grid), dense.gradient(case.grid)
    assert np.abs(div @ found).max() <= 1e-9 * np.abs(div @ star).max()
    np.testing.assert_allclose(star - found, dt * gradient @ phi, atol=1e-9)
    np.testing.assert_allclose(dense.pressure(case.grid, case.pressure),
                               RHO * phi - theta * MU * (div @ star), atol=1e-9)
