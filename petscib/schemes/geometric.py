"""The geometric schemes: coupled, with a tangent for which the true stretching evolves exactly."""

import numpy as np

from ..errors import SolveError
from ..events import phase
from ..solvers.anderson import Anderson
from .history import expected, remembered
from .stage import StageScheme

MOTION = "marker_velocity"  # in the history: U, which carries the markers
# Tolerance of the solve in a pass, as a fraction of the positions' change in the pass before, but
# no less than the same fraction of the tangent iteration's own tolerance.  With 0.005 there are a
# tenth fewer iterations but up to a fifth more passes, in the same time or more, and gbe fails
# where it is stiffest (-scene stiff -fft -scheme gbe with mu = 0.01, or with dt = 256 h); with
# 0.0005 a tenth more and no fewer passes (gcn and gbe, 64^2, dt = h and 16 h).
FRACTION = 0.001
# Earlier passes that the acceleration uses.  There 5 to 30 take the same passes; without any, there
# are 1.2 to 1.6 times as many.
ANDERSON_DEPTH = 30
# Change of the positions, relative to the largest coordinate, that counts as none: near an
# equilibrium, where forces balance but for round-off, passes stall at up to 2e-13 (32^2, dt = 16 h,
# sigma0 1e3 to 1e7).
ROUND_OFF = 5e-13


class Geometric(StageScheme):
    """Backward Euler and Crank-Nicolson with the averaged tangent.

    With tau = (D_s X^{n+1} + D_s X^n) / (|D_s X^{n+1}| + |D_s X^n|) the identity
    |D_s X^{n+1}| - |D_s X^n| = dt D_s U . tau holds, so that evolved and geometric stretching
    agree and the energy law is that of the true geometry.  The area projector stands at the mean
    position, so that the area stays too.  Crank-Nicolson also interpolates and spreads there,
    which makes it second order in time.

    With implicit advection the transport is the stage velocity itself, as the pass before found it.

    All this depends on the new positions, which are found by Picard iteration with Anderson
    acceleration.  The first guess extrapolates the markers' velocities of the last two steps.

    Parameters
    ----------
    problem : Problem
        With membranes.
    theta : float
        1 for backward Euler, 1/2 for Crank-Nicolson.
    solvers : Solvers
    controls : Controls
        picard_rtol: largest change of the positions in the last pass, relative to the largest
        displacement of the step; picard_max_it.
    """

    def __init__(self, problem, theta, solvers, controls):
        super().__init__(problem, theta, solvers.stokes(), solvers.dt)
        self.controls = controls
        advection = problem.advection
        self._carried = None  # the transport of a pass
        if advection is not None and advection.implicit:
            self.extrapolates, self._carried = False, problem.grid.velocity_vector()

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        problem, system = self.problem, self.system
        time = self.time(state, dt)
        guess = state.markers + dt * expected(
            state.history, MOTION, time, np.zeros_like(state.markers))
        stage = self.begin(state, dt, state.markers + (1 - self.theta) * (guess - state.markers))
        acceleration = Anderson(ANDERSON_DEPTH)
        interpolation = problem.interpolation(state.markers) if self.theta == 1 else None
        change, passes, iterations = 1.0, 0, 0

        while change > self.controls.picard_rtol:
            if passes == self.controls.picard_max_it:
                raise SolveError(
                    f"the averaged tangent did not converge in {passes} passes (the markers "
                    f"still change by {change:.1e} of their displacement)"
                )
            with phase("tangent iteration"):
                # C between X^n and X^{n+1}, Pi and K at their mean; so is J with theta = 1/2
                if self.theta < 1:
                    interpolation = self._move(interpolation, (state.markers + guess) / 2)
                operators = problem.operators_between(state.markers, guess, interpolation)
                if self._carried is not None:
                    stage.velocity.copy(self._carried)
                    problem.advection.carry(self._carried)
                # rho (w - u^n) / (theta dt) + grad p = mu Laplacian w + F[f],  div w = 0,
                # f = - C^T m,  m = m0 + theta dt C U,  U = J w + K f
                if passes == 0 or problem.loaded:
                    self.add_load(stage, operators)
                    system.begin(self._rhs, stage)
                stress = self.free_stress(state, dt, stage, operators)
                with phase("coupled solve"):
                    system.update(self.theta * dt, operators, stress)
                    iterations += system.iterate(
                        FRACTION * max(change, self.controls.picard_rtol))

                # X^{n+1} = X^n + dt U
                motion = self.marker_velocity(stage, operators)
                markers = state.markers + dt * motion
                change = self._relative_change(guess, markers, state.markers)
                if self._carried is not None:
                    self._carried.axpy(-1.0, stage.velocity)
                    moved, speed = self._carried.norm(), stage.velocity.norm()
                    change = max(change, moved / speed if speed else float(moved > 0))
                guess = acceleration.next(guess, markers)
            passes += 1

        with phase("coupled solve"):
            system.finish()
        if self._carried is not None:
            self._transport.destroy()
            self._transport = stage.velocity
        # u^{n+1} = u^n + (w - u^n) / theta
        velocity = self.end_velocity(state, stage)
        step = self.finish(
            state, dt, stage, operators, velocity, motion,
            **self.account(state, dt, stage, operators, motion),
            iterations={"coupled": iterations, "picard": passes},
        )
        step.end.history.update(remembered(state.history, time, **{MOTION: motion}))
        return step

    def _move(self, interpolation, markers):
        if interpolation is not None:
            interpolation.destroy()
        return self.problem.interpolation(markers)

    def _relative_change(self, before, after, start):
        """Largest change of a marker, relative to the largest displacement.  Collective."""
        change = None
        if len(after):
            moved = np.hypot(*(after - start).T).max()
            # Markers that hardly move have converged when they stay within round-off.
            floor = ROUND_OFF * abs(after).max() / self.controls.picard_rtol
            change = np.hypot(*(after - before).T).max() / max(moved, floor)
        return self.problem.grid.comm.tompi4py().bcast(change)
