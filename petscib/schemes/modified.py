"""The modified schemes: stretching advanced by the intermediate velocity, then projection."""

from ..events import phase
from ..problem import State, Step
from ..solvers.momentum import MomentumSolver
from .projection import Projection


class Modified:
    """Modified backward Euler and Crank-Nicolson (Hu & Lai, eqs. 3.19-3.24 and 3.25-3.30).

    Both solve for the stage velocity w = theta u* + (1 - theta) u^n, which makes the second the
    implicit midpoint rule with the matrix of the first for half the time step.

    Parameters
    ----------
    problem : Problem
    theta : float
        1 for backward Euler, 1/2 for Crank-Nicolson.
    """

    advice = "try a smaller -ts_dt"

    def __init__(self, problem, theta):
        self.problem = problem
        self.theta = theta
        self.momentum = MomentumSolver(problem.operators, problem.rho, problem.mu)
        self.projection = Projection(problem)
        self._rhs = problem.grid.velocity_vector()

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        problem, membrane, theta = self.problem, self.problem.membrane, self.theta
        interval = theta * dt
        interpolation = problem.interpolation(state.markers)

        # rho (w - u^n) / (theta dt) = mu Laplacian w + F[force^n - theta dt W J w]
        problem.fluid_rhs(state.velocity, interval, self._rhs)
        if problem.acted_on:
            tangent = membrane.tangent(state.markers)
            self.momentum.update(interval, interpolation, membrane.stiffness(tangent))
            problem.add_force(state, tangent, interpolation, self._rhs)
        else:
            tangent = None
            self.momentum.update(interval)
        stage = problem.first_guess(state)
        with phase("momentum solve"):
            momentum_iterations = self.momentum.solve(self._rhs, stage)

        # u* = u^n + (w - u^n) / theta, made divergence-free
        velocity = stage.copy()
        velocity.axpby(1 - 1 / theta, 1 / theta, state.velocity)
        pressure, phi, poisson_iterations = self.projection.apply(
            velocity, dt, theta, state.pressure
        )

        # X^{n+1} = X^n + dt J (theta u^{n+1} + (1 - theta) u^n)
        markers, stretch, stage_velocity, rate = state.markers, state.stretch, None, None
        if membrane:
            with phase("marker motion"):
                stage_velocity = interpolation.interpolate(stage)
                rate = membrane.stretch_rate(stage_velocity, tangent)
                step_velocity = theta * interpolation.interpolate(velocity)
                if theta < 1:
                    step_velocity += (1 - theta) * interpolation.interpolate(state.velocity)
                markers = state.markers + dt * step_velocity
                stretch = problem.next_stretch(state.stretch, rate, dt, markers)
            interpolation.destroy()
        history = problem.next_history(state, stage)
        end = State(
            state.step + 1, state.time + dt, velocity, pressure, markers, stretch, history
        )
        return Step(
            dt,
            theta,
            state,
            end,
            stage,
            phi,
            rate,
            stage_velocity,
            {"momentum": momentum_iterations, "poisson": poisson_iterations},
        )

    def destroy(self):
        """Free the solvers."""
        self.momentum.destroy()
        self.projection.destroy()
