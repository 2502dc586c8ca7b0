"""The projection of an intermediate velocity onto divergence-free fields."""

from ..events import phase
from ..solvers.momentum import MomentumSolver
from ..solvers.poisson import PoissonSolver
from .stage import StageScheme


class Projection:
    """u = u* - dt grad phi with Laplacian phi = div u* / dt (Hu & Lai, eqs. 3.20-3.22).

    Parameters
    ----------
    problem : Problem
    """

    def __init__(self, problem):
        self.problem = problem
        self.poisson = PoissonSolver(problem.operators)
        self._divergence = problem.grid.pressure_vector()
        self._gradient = problem.grid.velocity_vector()

    def apply(self, velocity, dt, theta, last_pressure):
        """Turn u* into u in place.  Collective.

        Parameters
        ----------
        velocity : PETSc.Vec
            u* on entry, u on return.
        dt : float
        theta : float
            1 for backward Euler, 1/2 for Crank-Nicolson: where the pressure stands.
        last_pressure : PETSc.Vec
            For the first guess.

        Returns
        -------
        pressure, phi : PETSc.Vec
            New vectors.
        iterations : int
        """
        operators, rho, mu = self.problem.operators, self.problem.rho, self.problem.mu
        divergence, gradient = self._divergence, self._gradient
        operators.divergence.mult(velocity, divergence)
        divergence.scale(1 / dt)
        phi = last_pressure.copy()
        phi.scale(1 / rho)
        with phase("Poisson solve"):
            iterations = self.poisson.solve(divergence, phi)

        operators.gradient.mult(phi, gradient)
        velocity.axpy(-dt, gradient)
        pressure = phi.copy()
        pressure.scale(rho)
        pressure.axpy(-theta * mu * dt, divergence)
        return pressure, phi, iterations

    def destroy(self):
        """Free the solver."""
        self.poisson.destroy()


class ProjectionScheme(StageScheme):
    """A scheme that solves for an intermediate velocity, which it then projects.

    Parameters
    ----------
    problem : Problem
    theta : float
    """

    def __init__(self, problem, theta):
        solver = MomentumSolver(problem.operators, problem.rho, problem.mu)
        super().__init__(problem, theta, solver)
        self.projection = Projection(problem)

    def destroy(self):
        """Free the solvers."""
        super().destroy()
        self.projection.destroy()
