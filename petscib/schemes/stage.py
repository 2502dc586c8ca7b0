"""What the schemes share: they solve for a stage velocity, from which all else follows."""

import numpy as np

from ..events import phase
from ..pressure import JUMP, PLACE
from ..problem import State, Step
from ..solvers.system import ImplicitSystem, Stage
from .history import expected, remembered


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
    dt : float
        The usual time step.
    acts : bool
        Whether the membranes' forces are in the stage equations.
    """

    advice = "try a smaller -ts_dt"

    def __init__(self, problem, theta, fluid, dt, acts=True):
        self.problem = problem
        self.theta = theta
        self.system = ImplicitSystem(
            fluid, problem.membranes if acts else None, problem.kernel, problem.kink_correction,
            theta * dt)
        self._rhs, self._load = problem.grid.velocity_vector(), None
        if problem.loaded:
            self._load = problem.grid.velocity_vector()
        # With theta = 1/2 the transport is extrapolated to the middle of the step.
        self.extrapolates = problem.advection is not None and theta < 1

    def begin(self, state, dt, markers=None):
        """Set the right-hand side but for given forces, and the first guess.  Collective.

        Parameters
        ----------
        state : State
        dt : float
        markers : ndarray, shape (M, 2), optional
            Where the viscosity changes over the whole step; by default, at the step's start.

        Returns
        -------
        Stage
            Extrapolated from the last two steps.
        """
        problem = self.problem
        problem.place_viscosity(state.markers if markers is None else markers)
        ahead = self.theta * dt if self.theta < 1 else 0.0
        self._transport = problem.transport(state, ahead)
        problem.fluid_rhs(state, self.theta * dt, self._rhs, self._transport)
        history, time, load = state.history, self.time(state, dt), 0.0
        stress = problem.stress(state)
        if "stress" in history:
            fixed = expected(history, "stress", time, stress)
            stress = np.concatenate((fixed, stress[len(fixed) :]))
        if problem.loaded:
            load = problem.membranes.load(time)
            self._load.zeroEntries()
        velocity = expected(history, "stage", time, state.velocity)
        return Stage(velocity, state.pressure.copy(), stress, load)

    def add_load(self, stage, operators):
        """Add to the right-hand side the given forces on the markers.  Collective.

        Those that it holds already, of the pass before, it loses.
        """
        if self.problem.loaded:
            self._rhs.axpy(-1.0, self._load)
            self._load.zeroEntries()
            operators.spread_add(stage.load, self._load)
            self._rhs.axpy(1.0, self._load)

    def time(self, state, dt):
        """When the stage of a step takes place."""
        return state.time + self.theta * dt

    def free_stress(self, state, dt, stage, operators):
        """m0: the stresses at the stage but for theta dt C U, which the solve finds."""
        problem = self.problem
        stress = problem.stress(state)
        if problem.acted_on and problem.membranes.move:
            stress = stress + self.theta * problem.stress_drift(state, dt)
        if problem.loaded and operators.slip is not None:
            slip = operators.slip_velocity(stage.load)
            stress = stress + self.theta * dt * operators.rate(slip)
        return stress

    def marker_velocity(self, stage, operators):
        """U at the stage, after a solve: (M, 2) on rank 0, None without markers.  Collective."""
        velocity = self.system.marker_velocity()
        if self.problem.loaded:
            velocity = velocity + operators.slip_velocity(stage.load)
        return velocity

    def slip_velocity(self, stage, operators):
        """K f at the stage, all forces on the markers together; zero without the correction."""
        if not self.problem.acted_on or operators.slip is None:
            return 0.0
        return operators.slip_velocity(operators.force(stage.stress) + stage.load)

    def account(self, state, dt, stage, operators, motion):
        """Fields of the Step that the energy law asks for.  Collective."""
        power = 0.0
        if self.problem.loaded:
            power = self.problem.grid.cell_area * stage.velocity.dot(self._load)
        return self.problem.account(state, dt, self.theta, operators, stage, motion, power)

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
        known = {"stage": stage.velocity}
        if stage.stress is not None:
            known["stress"] = stage.stress[: problem.membranes.fixed]
        history = remembered(state.history, self.time(state, dt), **known)
        if operators is not None:
            with phase("marker motion"):
                markers = problem.keep_areas(markers + dt * motion)
                stretch = problem.next_stretch(state, dt, markers, rest.get("stress_rate"))
            operators.interpolation.destroy()
            if operators.projector is not None and stage.stress is not None:
                force = operators.force(stage.stress) + stage.load
                history[JUMP] = force - operators.project(force)
                history[PLACE] = operators.interpolation.markers
        if self.extrapolates:
            rate = velocity.copy()
            rate.axpby(-1 / dt, 1 / dt, state.velocity)
            history["velocity_rate"] = rate
        if problem.viscosity is not None:
            rest["viscous"] = problem.viscosity.powers(stage.velocity)
        end = State(state.step + 1, state.time + dt, velocity, stage.pressure, markers, stretch,
                    history)
        return Step(dt, self.theta, state, end, stage.velocity, marker_velocity=motion,
                    stress=stage.stress, transport=self._transport, **rest)

    def forget(self):
        """Drop what depends on earlier steps and is in no checkpoint.

        When this is called as one is written, a restart from it is the uninterrupted run.
        """
        self.system.forget()
        if self.problem.membranes is not None:
            self.problem.membranes.forget()

    def destroy(self):
        """Free the solver."""
        self.system.destroy()
        self._rhs.destroy()
        if self._load is not None:
            self._load.destroy()
