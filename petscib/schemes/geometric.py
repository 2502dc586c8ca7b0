"""The geometric schemes: coupled, with a tangent for which the true stretching evolves exactly."""

import numpy as np

from ..errors import SolveError
from ..events import phase
from ..membrane import geometry
from ..solvers.anderson import Anderson
from ..solvers.saddle import CoupledSolver
from .stage import StageScheme

# Tolerance of a pass, relative to the change of the positions in the pass before ...
INNER_FRACTION = 0.005
# ... and at least, relative to that of the tangent iteration.  Were the last passes less accurate,
# the iteration would lose its way in their noise at large time steps.
LAST_FRACTION = 0.1
ANDERSON_DEPTH = 30


class Geometric(StageScheme):
    """Backward Euler and Crank-Nicolson with the averaged tangent.

    With tau = (D_s X^{n+1} + D_s X^n) / (|D_s X^{n+1}| + |D_s X^n|) the identity
    |D_s X^{n+1}| - |D_s X^n| = dt D_s U . tau holds, so that evolved and geometric stretching
    agree and the energy law is that of the true geometry.  Crank-Nicolson also interpolates and
    spreads at the mean position, which makes it second order in time.

    The tangent depends on the new positions: Picard iteration with Anderson acceleration,
    starting from the positions that the velocities of the last two steps let expect.

    Parameters
    ----------
    problem : Problem
        With a membrane.
    theta : float
        1 for backward Euler, 1/2 for Crank-Nicolson.
    controls : Controls
        picard_rtol: largest change of the positions in the last pass, relative to the largest
        displacement of the step; picard_max_it.
    """

    def __init__(self, problem, theta, controls):
        super().__init__(
            problem, theta, CoupledSolver(problem.operators, problem.rho, problem.mu)
        )
        self.controls = controls

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        problem, membrane, theta = self.problem, self.problem.membrane, self.theta
        stage, pressure = problem.first_guess(state), state.pressure.copy()
        guess = state.markers + dt * self._extrapolated(state.history)
        acceleration = Anderson(ANDERSON_DEPTH)
        interpolation = problem.interpolation(state.markers) if theta == 1 else None
        change, passes, iterations = 1.0, 0, 0
        least = min(LAST_FRACTION * self.controls.picard_rtol, self.solver.rtol)

        while change > self.controls.picard_rtol:
            if passes == self.controls.picard_max_it:
                raise SolveError(
                    f"the averaged tangent did not converge in {passes} passes (the markers "
                    f"still change by {change:.1e} of their displacement)"
                )
            with phase("tangent iteration"):
                if theta < 1:
                    interpolation = self._move(interpolation, (state.markers + guess) / 2)
                tangent = None
                if membrane.sigma0:
                    tangent = averaged_tangent(state.markers, guess, membrane.ds)
                # rho (w - u^n) / (theta dt) + grad p
                #     = mu Laplacian w + F[force^n - theta dt W J w],  div w = 0
                self.set_equations(state, dt, interpolation, tangent)
                with phase("coupled solve"):
                    if not passes:  # only now the solver knows of the membrane
                        self.solver.begin(stage, pressure)
                    rtol = max(INNER_FRACTION * change, least)
                    iterations += self.solver.iterate(self._rhs, stage, rtol)

                # X^{n+1} = X^n + dt J w
                marker_velocity = interpolation.interpolate(stage)
                markers = state.markers + dt * marker_velocity
                change = self._relative_change(guess, markers, state.markers)
                guess = acceleration.next(guess, markers)
            passes += 1

        with phase("coupled solve"):
            self.solver.finish(stage, pressure)
        # u^{n+1} = u^n + (w - u^n) / theta
        velocity = self.end_velocity(state, stage)
        step = self.finish(
            state, dt, stage, velocity, pressure, interpolation, tangent, stage,
            iterations={"coupled": iterations, "picard": passes},
        )
        history, before = step.end.history, state.history.get("marker_velocity")
        history["marker_velocity"] = step.marker_velocity
        if before is not None:
            history["marker_velocity_change"] = step.marker_velocity - before
        return step

    @staticmethod
    def _extrapolated(history):
        """Velocity of the markers to be expected from the last two steps."""
        change = history.get("marker_velocity_change", 0.0)
        return history.get("marker_velocity", 0.0) + change

    def _move(self, interpolation, markers):
        if interpolation is not None:
            interpolation.destroy()
        return self.problem.interpolation(markers)

    def _relative_change(self, before, after, start):
        """Largest change of a marker, relative to the largest displacement.  Collective."""
        change = None
        if len(after):
            moved = geometry.length(after - start).max()
            # Markers at rest have converged when they stay within round-off of the grid.
            floor = np.finfo(float).eps * min(self.problem.grid.dx, self.problem.grid.dy)
            change = geometry.length(after - before).max() / max(moved, floor)
        return self.problem.grid.comm.tompi4py().bcast(change)


def averaged_tangent(start, end, ds):
    """Mean of the edges of two curves over the mean of their lengths, at the half points."""
    before, after = geometry.to_half_points(start, ds), geometry.to_half_points(end, ds)
    return (after + before) / (geometry.length(after) + geometry.length(before))[:, None]
