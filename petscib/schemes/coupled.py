"""The original schemes: velocity, pressure and stretching of the new time solved together."""

from ..events import phase
from ..solvers.saddle import CoupledSolver
from .stage import StageScheme


class Coupled(StageScheme):
    """Backward Euler and Crank-Nicolson (Hu & Lai, eqs. 3.3-3.9 and 3.10-3.16).

    Solved as one saddle-point system, whose energy law is exact on walls too.

    Parameters
    ----------
    problem : Problem
    theta : float
        1 for backward Euler, 1/2 for Crank-Nicolson.
    """

    def __init__(self, problem, theta):
        super().__init__(
            problem, theta, CoupledSolver(problem.operators, problem.rho, problem.mu)
        )

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        interpolation = self.problem.interpolation(state.markers)
        tangent = self.tangent(state)

        # rho (w - u^n) / (theta dt) + grad p = mu Laplacian w + F[force^n - theta dt W J w]
        # div w = 0
        self.set_equations(state, dt, interpolation, tangent)
        stage, pressure = self.problem.first_guess(state), state.pressure.copy()
        with phase("coupled solve"):
            iterations = {"coupled": self.solver.solve(self._rhs, stage, pressure)}

        # u^{n+1} = u^n + (w - u^n) / theta,  X^{n+1} = X^n + dt J w
        velocity = self.end_velocity(state, stage)
        return self.finish(
            state, dt, stage, velocity, pressure, interpolation, tangent, stage,
            iterations=iterations,
        )
