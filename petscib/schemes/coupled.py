"""The original schemes: velocity, pressure and stretching of the new time solved together."""

from ..events import phase
from ..problem import State, Step
from ..solvers.saddle import CoupledSolver


class Coupled:
    """Backward Euler and Crank-Nicolson (Hu & Lai, eqs. 3.3-3.9 and 3.10-3.16).

    Solved as one saddle-point system for the stage velocity w = theta u^{n+1} +
    (1 - theta) u^n, whose energy law is exact on walls too.

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
        self.coupled = CoupledSolver(problem.operators, problem.rho, problem.mu)
        self._rhs = problem.grid.velocity_vector()

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        problem, membrane, theta = self.problem, self.problem.membrane, self.theta
        interval = theta * dt
        interpolation = problem.interpolation(state.markers)

        # rho (w - u^n) / (theta dt) + grad p = mu Laplacian w + F[force^n - theta dt W J w]
        # div w = 0
        problem.fluid_rhs(state.velocity, interval, self._rhs)
        if problem.acted_on:
            tangent = membrane.tangent(state.markers)
            self.coupled.update(interval, interpolation, membrane.stiffness(tangent))
            problem.add_force(state, tangent, interpolation, self._rhs)
        else:
            tangent = None
            self.coupled.update(interval)
        stage, pressure = problem.first_guess(state), state.pressure.copy()
        with phase("coupled solve"):
            iterations = self.coupled.solve(self._rhs, stage, pressure)

        # u^{n+1} = u^n + (w - u^n) / theta,  X^{n+1} = X^n + dt J w
        velocity = stage.copy()
        velocity.axpby(1 - 1 / theta, 1 / theta, state.velocity)
        markers, stretch, stage_velocity, rate = state.markers, state.stretch, None, None
        if membrane:
            with phase("marker motion"):
                stage_velocity = interpolation.interpolate(stage)
                rate = membrane.stretch_rate(stage_velocity, tangent)
                markers = state.markers + dt * stage_velocity
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
            stretch_rate=rate,
            marker_velocity=stage_velocity,
            iterations={"coupled": iterations},
        )

    def destroy(self):
        """Free the solver."""
        self.coupled.destroy()
