"""The explicit scheme: membrane force at the old time, implicit viscosity, projection."""

from ..events import phase
from .projection import ProjectionScheme


class Explicit(ProjectionScheme):
    """EP, the paper's comparison (Hu & Lai, section 4.2).

    Parameters
    ----------
    problem : Problem
    """

    advice = (
        "the explicit scheme needs a time step that falls as 1 / sqrt(sigma0): try a smaller "
        "-ts_dt or an implicit scheme such as -scheme mbe"
    )

    implicit = False

    def __init__(self, problem):
        super().__init__(problem, 1.0)

    def set_equations(self, state, dt, interpolation, tangent):
        """rho (u* - u^n) / dt = mu Laplacian u* + F[force^n].  Collective."""
        self.solver.update(dt)
        self.problem.fluid_rhs(state.velocity, dt, self._rhs)
        if self.problem.acted_on:
            self.problem.add_force(state, tangent, interpolation, self._rhs)

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        interpolation = self.problem.interpolation(state.markers)
        tangent = self.tangent(state)

        self.set_equations(state, dt, interpolation, tangent)
        intermediate = self.problem.first_guess(state)
        with phase("momentum solve"):
            iterations = {"momentum": self.solver.solve(self._rhs, intermediate)}

        velocity = intermediate.copy()
        pressure, phi, iterations["poisson"] = self.projection.apply(
            velocity, dt, self.theta, state.pressure
        )

        # X^{n+1} = X^n + dt J u^{n+1}
        return self.finish(
            state, dt, intermediate, velocity, pressure, interpolation, tangent, velocity,
            projection=phi, iterations=iterations,
        )
