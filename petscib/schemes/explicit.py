"""The explicit scheme: membrane force at the old time, implicit viscosity, projection."""

from ..events import phase
from ..problem import State, Step
from ..solvers.momentum import MomentumSolver
from .projection import Projection


class Explicit:
    """EP, the paper's comparison (Hu & Lai, section 4.2).

    Parameters
    ----------
    problem : Problem
    """

    theta = 1.0
    advice = (
        "the explicit scheme needs a time step that falls as 1 / sqrt(sigma0): try a smaller "
        "-ts_dt or an implicit scheme such as -scheme mbe"
    )

    def __init__(self, problem):
        self.problem = problem
        self.momentum = MomentumSolver(problem.operators, problem.rho, problem.mu)
        self.projection = Projection(problem)
        self._rhs = problem.grid.velocity_vector()

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        problem, membrane = self.problem, self.problem.membrane
        interpolation = problem.interpolation(state.markers)

        # rho (u* - u^n) / dt = mu Laplacian u* + F[force(X^n)]
        self.momentum.update(dt)
        problem.fluid_rhs(state.velocity, dt, self._rhs)
        tangent = None
        if problem.acted_on:
            tangent = membrane.tangent(state.markers)
            problem.add_force(state, tangent, interpolation, self._rhs)
        intermediate = problem.first_guess(state)
        with phase("momentum solve"):
            momentum_iterations = self.momentum.solve(self._rhs, intermediate)

        velocity = intermediate.copy()
        pressure, phi, poisson_iterations = self.projection.apply(
            velocity, dt, self.theta, state.pressure
        )

        # X^{n+1} = X^n + dt J u^{n+1}
        markers, stretch, step_velocity, rate = state.markers, state.stretch, None, None
        if membrane:
            with phase("marker motion"):
                step_velocity = interpolation.interpolate(velocity)
                rate = membrane.stretch_rate(step_velocity, tangent)
                markers = state.markers + dt * step_velocity
                stretch = problem.next_stretch(state.stretch, rate, dt, markers)
            interpolation.destroy()
        history = problem.next_history(state, intermediate)
        end = State(
            state.step + 1, state.time + dt, velocity, pressure, markers, stretch, history
        )
        return Step(
            dt,
            self.theta,
            state,
            end,
            intermediate,
            phi,
            rate,
            step_velocity,
            {"momentum": momentum_iterations, "poisson": poisson_iterations},
        )

    def destroy(self):
        """Free the solvers."""
        self.momentum.destroy()
        self.projection.destroy()
