"""The modified schemes: stretching advanced by the intermediate velocity, then projection."""

from ..events import phase
from .projection import ProjectionScheme


class Modified(ProjectionScheme):
    """Modified backward Euler and Crank-Nicolson (Hu & Lai, eqs. 3.19-3.24 and 3.25-3.30).

    The stage velocity is made of the intermediate one, w = theta u* + (1 - theta) u^n.

    Parameters
    ----------
    problem : Problem
    theta : float
        1 for backward Euler, 1/2 for Crank-Nicolson.
    solvers : Solvers
    """

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        problem, stage = self.problem, self.begin(state, dt)
        operators = problem.operators_at(state.markers)
        self.add_load(stage, operators)
        stress = self.free_stress(state, dt, stage, operators)

        # rho (w - u^n) / (theta dt) = mu Laplacian w + F[f],
        # f = - C^T m,  m = m0 + theta dt C U,  U = J w + K f
        with phase("momentum solve"):
            iterations = {
                "momentum": self.system.solve(
                    self._rhs, stage, self.theta * dt, operators, stress)
            }

        # u* = u^n + (w - u^n) / theta, made divergence-free
        velocity = self.end_velocity(state, stage)
        phi, iterations["poisson"] = self.projection.apply(
            velocity, dt, self.theta, stage.pressure)

        # X^{n+1} = X^n + dt (J (theta u^{n+1} + (1 - theta) u^n) + K f)
        account, motion = {}, None
        if problem.membranes is not None:
            account = self.account(
                state, dt, stage, operators, self.marker_velocity(stage, operators))
            carrier = velocity
            if self.theta < 1:
                carrier = velocity.copy()
                carrier.axpby(1 - self.theta, self.theta, state.velocity)
            motion = operators.interpolate(carrier) + self.slip_velocity(stage, operators)
        return self.finish(
            state, dt, stage, operators, velocity, motion, **account,
            projection=phi, iterations=iterations,
        )
