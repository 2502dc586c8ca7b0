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
    """

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        interpolation = self.problem.interpolation(state.markers)
        tangent = self.tangent(state)

        # rho (w - u^n) / (theta dt) = mu Laplacian w + F[force^n - theta dt W J w]
        self.set_equations(state, dt, interpolation, tangent)
        stage = self.problem.first_guess(state)
        with phase("momentum solve"):
            iterations = {"momentum": self.solver.solve(self._rhs, stage)}

        # u* = u^n + (w - u^n) / theta, made divergence-free
        velocity = self.end_velocity(state, stage)
        pressure, phi, iterations["poisson"] = self.projection.apply(
            velocity, dt, self.theta, state.pressure
        )

        # X^{n+1} = X^n + dt J (theta u^{n+1} + (1 - theta) u^n)
        carrier = velocity
        if self.theta < 1:
            carrier = velocity.copy()
            carrier.axpby(1 - self.theta, self.theta, state.velocity)
        return self.finish(
            state, dt, stage, velocity, pressure, interpolation, tangent, carrier,
            projection=phi, iterations=iterations,
        )
