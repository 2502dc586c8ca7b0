"""The projection of an intermediate velocity onto divergence-free fields."""

from ..solvers.poisson import PoissonSolver


class Projection:
    """u = u* - dt grad phi with Laplacian phi = div u* / dt (Hu & Lai, eqs. 3.20-3.22).

    Parameters
    ----------
    problem : Problem
    theta : float
        1 for backward Euler, 1/2 for Crank-Nicolson: where the pressure stands.
    """

    def __init__(self, problem, theta):
        self.problem = problem
        self.theta = theta
        self.poisson = PoissonSolver(problem.operators)
        self._divergence = problem.grid.pressure_vector()

    def apply(self, intermediate, dt, guess):
        """Project.  Collective.

        Parameters
        ----------
        intermediate : PETSc.Vec
            u*.
        dt : float
        guess : PETSc.Vec
            The last pressure.

        Returns
        -------
        velocity, pressure, phi : PETSc.Vec
        iterations : int
        """
        operators, rho, mu = self.problem.operators, self.problem.rho, self.problem.mu
        divergence = self._divergence
        operators.divergence.mult(intermediate, divergence)
        divergence.scale(1 / dt)
        phi = guess.copy()
        phi.scale(1 / rho)
        iterations = self.poisson.solve(divergence, phi)

        velocity = intermediate.duplicate()
        operators.gradient.mult(phi, velocity)
        velocity.aypx(-dt, intermediate)
        pressure = phi.copy()
        pressure.scale(rho)
        pressure.axpy(-self.theta * mu * dt, divergence)
        return velocity, pressure, phi, iterations

    def destroy(self):
        """Free the solver."""
        self.poisson.destroy()
