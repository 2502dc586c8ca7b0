"""The projection of an intermediate velocity onto divergence-free fields."""

from ..events import phase
from .stage import StageScheme


class Projection:
    """u = u* - dt grad phi with Laplacian phi = div u* / dt (Hu & Lai, eqs. 3.20-3.22).

    Parameters
    ----------
    problem : Problem
    poisson : PoissonSolver
        Owned by the projection.
    """

    def __init__(self, problem, poisson):
        self.problem = problem
        self.poisson = poisson
        self._divergence = problem.grid.pressure_vector()
        self._gradient = problem.grid.velocity_vector()

    def apply(self, velocity, dt, theta, pressure):
        """Turn u* into u in place.  Collective.

        Parameters
        ----------
        velocity : PETSc.Vec
            u* on entry, u on return.
        dt : float
        theta : float
            1 for backward Euler, 1/2 for Crank-Nicolson: where the pressure stands.
        pressure : PETSc.Vec
            The last one on entry, for the first guess; the new one on return.

        Returns
        -------
        phi : PETSc.Vec
            A new vector.
        iterations : int
        """
        operators, rho, mu = self.problem.operators, self.problem.rho, self.problem.mu
        viscosity = self.problem.viscosity
        divergence, gradient = self._divergence, self._gradient
        operators.divergence.mult(velocity, divergence)
        divergence.scale(1 / dt)
        phi = pressure.copy()
        phi.scale(1 / rho)
        with phase("Poisson solve"):
            iterations = self.poisson.solve(divergence, phi)

        operators.gradient.mult(phi, gradient)
        velocity.axpy(-dt, gradient)
        phi.copy(pressure)
        pressure.scale(rho)
        if viscosity is not None:
            divergence.pointwiseMult(divergence, viscosity.cells)
            mu = 1.0
        pressure.axpy(-theta * mu * dt, divergence)
        if viscosity is not None:  # which weights the divergence, whose mean alone is zero
            pressure.shift(-pressure.sum() / pressure.getSize())
        return phi, iterations

    def destroy(self):
        """Free the solver.  Collective."""
        for part in (self.poisson, self._divergence, self._gradient):
            part.destroy()


class ProjectionScheme(StageScheme):
    """A scheme that solves for an intermediate velocity, which it then projects.

    Parameters
    ----------
    problem : Problem
    theta : float
    solvers : Solvers
    acts : bool
        Whether the membranes' forces are in the stage equations.
    """

    def __init__(self, problem, theta, solvers, acts=True):
        super().__init__(problem, theta, solvers.momentum(), solvers.dt, acts)
        self.projection = Projection(problem, solvers.poisson())

    def destroy(self):
        """Free the solvers."""
        super().destroy()
        self.projection.destroy()
