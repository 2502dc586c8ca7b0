"""What the schemes share: a stage velocity is solved for, and all else follows from it."""

from ..events import phase
from ..problem import State, Step


class StageScheme:
    """A scheme that solves for the stage velocity w = theta u^{n+1} + (1 - theta) u^n.

    With theta = 1 this is backward Euler; with theta = 1/2 it is the implicit midpoint rule, hence
    Crank-Nicolson, with the matrix of backward Euler for half the time step.

    Parameters
    ----------
    problem : Problem
    theta : float
    solver : MomentumSolver or CoupledSolver
        Of the stage equations.
    """

    advice = "try a smaller -ts_dt"
    implicit = True  # whether the tension acts at the stage

    def __init__(self, problem, theta, solver):
        self.problem = problem
        self.theta = theta
        self.solver = solver
        self._rhs = problem.grid.velocity_vector()

    def tangent(self, state):
        """Unit tangent of the membrane; None where nothing asks for it."""
        return self.problem.membrane.tangent(state.markers) if self.problem.acted_on else None

    def set_equations(self, state, dt, interpolation, tangent):
        """Set matrix and right-hand side of the stage equations.  Collective.

        rho (w - u^n) / (theta dt) = mu Laplacian w + F[force^n - theta dt W J w], to which the
        coupled schemes add the pressure gradient and div w = 0.
        """
        problem, interval = self.problem, self.theta * dt
        problem.fluid_rhs(state.velocity, interval, self._rhs)
        if problem.acted_on:
            stiffness = problem.membrane.stiffness(tangent, state.history.get("stretch_reset"))
            self.solver.update(interval, interpolation, stiffness)
            problem.add_force(state, tangent, interpolation, self._rhs)
        else:
            self.solver.update(interval)

    def end_velocity(self, state, stage):
        """u^n + (w - u^n) / theta, a new vector."""
        velocity = stage.copy()
        velocity.axpby(1 - 1 / self.theta, 1 / self.theta, state.velocity)
        return velocity

    def finish(self, state, dt, stage, velocity, pressure, interpolation, tangent, carrier, **rest):
        """Move the markers and put the step together.  Collective.

        Parameters
        ----------
        state : State
        dt : float
        stage, velocity, pressure : PETSc.Vec
            Stage velocity, and velocity and pressure of the new state.
        interpolation : Interpolation or None
            Freed here.
        tangent : ndarray or None
        carrier : PETSc.Vec
            The velocity that carries the markers over the step.
        **rest
            Further fields of the Step.

        Returns
        -------
        Step
        """
        problem, membrane = self.problem, self.problem.membrane
        markers, stretch, stage_velocity, rate = state.markers, state.stretch, None, None
        if membrane:
            with phase("marker motion"):
                stage_velocity = step_velocity = interpolation.interpolate(stage)
                if carrier is not stage:
                    step_velocity = interpolation.interpolate(carrier)
                rate = membrane.stretch_rate(stage_velocity, tangent)
                markers = state.markers + dt * step_velocity
                stretch = problem.next_stretch(state.stretch, rate, dt, markers)
            interpolation.destroy()
        history = problem.next_history(state, stage)
        if self.implicit and rate is not None and not problem.evolve:
            # What the next step's tension starts from is not what this one's was, at the stage.
            history["stretch_reset"] = state.stretch + self.theta * dt * rate - stretch
        end = State(
            state.step + 1, state.time + dt, velocity, pressure, markers, stretch, history
        )
        return Step(
            dt,
            self.theta,
            state,
            end,
            stage,
            stretch_rate=rate,
            marker_velocity=stage_velocity,
            **rest,
        )

    def destroy(self):
        """Free the solver."""
        self.solver.destroy()
