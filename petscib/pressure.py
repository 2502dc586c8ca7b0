"""The pressure as it is shown: with the jumps across membranes that keep their area.

The area projector takes from a membrane's force its uniform normal part c N, N the gradient of the
area, because it moves no fluid: it is the gradient of a pressure that jumps.  What is written gets
that pressure back,

    Laplacian phi = div F[c N],

phi = -c times the indicator of the membrane's inside, but for a constant and the smoothing: with F
and N of the stage, what the pressure of the same step would be without the projector.
"""

from dataclasses import replace

from .errors import SolveError
from .solvers.poisson import poisson_solver

# In a state's history, on rank 0: c N, the forces (M, 2) on the markers that the projector took and
# the places (M, 2) that they would have been spread from.  In files: the pressure without jumps.
JUMP, PLACE, BARE = "pressure_jump", "pressure_jump_place", "bare_pressure"


class ShownPressure:
    """Pressures with their jumps.  Collective.

    Parameters
    ----------
    problem : Problem
    fft : bool
        Whether transforms solve for the jumps, in place of multigrid.
    """

    def __init__(self, problem, fft):
        self.problem, self.fft = problem, fft
        self.trouble = ""
        self._poisson = None

    def state(self, state):
        """A state to write: the same one, or a copy with the pressure shown.

        The copy's history holds the pressure without jumps, from which a restart goes on; its
        pressure belongs to this object, and is good until the next call.  Where the jumps cannot
        be solved for, the state is written without them, and `trouble` says why.
        """
        self.trouble = ""
        if PLACE not in state.history:
            return state
        try:
            pressure = self._add_jumps(state)
        except SolveError as error:
            self.trouble = str(error)
            return state
        history = {**state.history, BARE: state.pressure}
        return replace(state, pressure=pressure, history=history)

    def _add_jumps(self, state):
        problem, grid = self.problem, self.problem.grid
        if self._poisson is None:
            self._poisson = poisson_solver(problem.operators, self.fft)
            self._force, self._source = grid.velocity_vector(), grid.pressure_vector()
            self._pressure = grid.pressure_vector()
        interpolation = problem.interpolation(state.history[PLACE])
        self._force.set(0.0)
        interpolation.spread_add(state.history[JUMP], self._force)
        interpolation.destroy()
        problem.operators.divergence.mult(self._force, self._source)
        self._pressure.set(0.0)
        self._poisson.solve(self._source, self._pressure)
        self._pressure.axpy(1.0, state.pressure)
        return self._pressure

    def destroy(self):
        """Free the solver.  Collective."""
        if self._poisson is not None:
            for part in (self._poisson, self._force, self._source, self._pressure):
                part.destroy()
