"""The original schemes: velocity, pressure and stretching of the new time solved together."""

from ..events import phase
from .stage import StageScheme


class Coupled(StageScheme):
    """Backward Euler and Crank-Nicolson (Hu & Lai, eqs. 3.3-3.9 and 3.10-3.16).

    Solved as one saddle-point system, whose energy law is exact on walls too.

    Parameters
    ----------
    problem : Problem
    theta : float
        1 for backward Euler, 1/2 for Crank-Nicolson.
    solvers : Solvers
    """

    def __init__(self, problem, theta, solvers):
        super().__init__(problem, theta, solvers.stokes(), solvers.dt)

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        problem, stage = self.problem, self.begin(state, dt)
        operators = problem.operators_at(state.markers)
        self.add_load(stage, operators)
        stress = self.free_stress(state, dt, stage, operators)

        # rho (w - u^n) / (theta dt) + grad p = mu Laplacian w + F[f],  div w = 0,
        # f = - C^T m,  m = m0 + theta dt C U,  U = J w + K f
        with phase("coupled solve"):
            iterations = self.system.solve(self._rhs, stage, self.theta * dt, operators, stress)

        # u^{n+1} = u^n + (w - u^n) / theta,  X^{n+1} = X^n + dt U
        velocity, motion = self.end_velocity(state, stage), self.marker_velocity(stage, operators)
        return self.finish(
            state, dt, stage, operators, velocity, motion,
            **self.account(state, dt, stage, operators, motion), iterations={"coupled": iterations},
        )
