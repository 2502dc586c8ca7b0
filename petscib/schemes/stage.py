"""What the schemes share: a stage velocity is solved for, and all else follows from it."""

from ..events import phase
from ..pressure import JUMP
from ..problem import State, Step
from ..solvers.system import ImplicitSystem, Stage


class StageScheme:
    """A scheme that solves for the stage velocity w = theta u^{n+1} + (1 - theta) u^n.

    With theta = 1 this is backward Euler; with theta = 1/2 it is the implicit midpoint rule, hence
    Crank-Nicolson, with the matrix of backward Euler for half the time step.  The stage equations
    of the implicit schemes are

        rho (w - u^n) / (theta dt) + grad p = mu Laplacian w + F[f],    div w = 0,
        f = - C^T m,    m = m0 + theta dt C U,    U = Pi J w + K f,

    without grad p and div w = 0 in the modified schemes, and with advection rho N(U) w on the left,
    or rho N(U) U on the right; m are the membranes' stresses (see
    `petscib.membranes.laws`), C U = sqrt(sigma0 ds) T U for the tension.

    Parameters
    ----------
    problem : Problem
    theta : float
    fluid : Momentum or Stokes
    acts : bool
        Whether the membranes' forces are in the stage equations.
    """

    advice = "try a smaller -ts_dt"

    def __init__(self, problem, theta, fluid, acts=True):
        self.problem = problem
        self.theta = theta
        self.system = ImplicitSystem(
            fluid, problem.membranes if acts else None, problem.kernel, problem.kink_correction)
        self._rhs = problem.grid.velocity_vector()
        # Where the stage lies ahead of the start, the transport is that of a stage to come.
        self.extrapolates = problem.advection is not None and theta < 1

    def begin(self, state, dt):
        """Set the fluid's part of the right-hand side, and the first guess.  Collective.

        Returns
        -------
        Stage
            Extrapolated from the last two steps.
        """
        ahead = self.theta * dt if self.theta < 1 else 0.0
        self._transport = self.problem.transport(state, ahead)
        self.problem.fluid_rhs(state, self.theta * dt, self._rhs, self._transport)
        stress = self.problem.stress(state)
        guess = state.history.get("stress", stress)
        if "stress_change" in state.history:
            guess = guess + state.history["stress_change"]
        return Stage(self.problem.first_guess(state), state.pressure.copy(), guess)

    def end_velocity(self, state, stage):
        """u^n + (w - u^n) / theta, a new vector."""
        velocity = stage.velocity.copy()
        velocity.axpby(1 - 1 / self.theta, 1 / self.theta, state.velocity)
        return velocity

    def finish(self, state, dt, stage, operators, velocity, motion, **rest):
        """Move the markers and put the step together.  Collective.

        Parameters
        ----------
        state : State
        dt : float
        stage : Stage
        operators : MarkerOperators or None
            Freed here.
        velocity : PETSc.Vec
            Of the new state.
        motion : ndarray, shape (M, 2)
            Velocity U that carries the markers over the step.
        **rest
            Further fields of the Step.

        Returns
        -------
        Step
        """
        problem = self.problem
        markers, stretch = state.markers, state.stretch
        history = problem.next_history(state, stage)
        if operators is not None:
            with phase("marker motion"):
                markers = problem.keep_areas(markers + dt * motion)
                stretch = problem.next_stretch(state, dt, markers, rest.get("stress_rate"))
            operators.interpolation.destroy()
            if operators.projector is not None and stage.stress is not None:
                force = operators.force(stage.stress)
                history[JUMP] = operators.projector.component(force)
        if self.extrapolates:
            rate = velocity.copy()
            rate.axpby(-1 / dt, 1 / dt, state.velocity)
            history["velocity_rate"] = rate
        end = State(state.step + 1, state.time + dt, velocity, stage.pressure, markers, stretch,
                    history)
        return Step(dt, self.theta, state, end, stage.velocity, marker_velocity=motion,
                    transport=self._transport, **rest)

    def destroy(self):
        """Free the solver."""
        self.system.destroy()
        self._rhs.destroy()
