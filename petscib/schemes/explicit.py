"""The explicit scheme: membrane force at the old time, implicit viscosity, projection."""

from ..events import phase
from .projection import ProjectionScheme


class Explicit(ProjectionScheme):
    """EP, the paper's comparison (Hu & Lai, section 4.2).

    Parameters
    ----------
    problem : Problem
    solvers : Solvers
    """

    advice = (
        "the explicit scheme needs a time step that falls as 1 / sqrt(sigma0): try a smaller "
        "-ts_dt or an implicit scheme such as -scheme mbe"
    )

    def __init__(self, problem, solvers):
        super().__init__(problem, 1.0, solvers, acts=False)

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        problem, stage = self.problem, self.begin(state, dt)
        operators = problem.operators_at(state.markers)
        self.add_load(stage, operators)

        # rho (u* - u^n) / dt = mu Laplacian u* + F[f^n]
        if problem.acted_on:
            with phase("forces"):
                stage.stress = problem.stress(state)
                operators.spread_add(operators.force(stage.stress), self._rhs)
        with phase("momentum solve"):
            iterations = {"momentum": self.system.solve(self._rhs, stage, dt)}

        velocity = stage.velocity.copy()
        phi, iterations["poisson"] = self.projection.apply(
            velocity, dt, self.theta, stage.pressure)

        # X^{n+1} = X^n + dt (J u^{n+1} + K f^n)
        motion = None
        if operators is not None:
            motion = operators.interpolate(velocity) + self.slip_velocity(stage, operators)
        return self.finish(
            state, dt, stage, operators, velocity, motion, projection=phi, iterations=iterations)
