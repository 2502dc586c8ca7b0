"""A run from its settings: build, step until finished, leave the results."""

import math
from time import perf_counter

import numpy as np
from petsc4py import PETSc

from . import events, guard
from .coupling.kernels import KERNELS
from .diagnostics import Diagnostics
from .errors import SolveError
from .events import phase
from .fluid.grid import Grid
from .fluid.operators import Operators
from .fluid.walls import Walls
from .membrane import geometry, shapes
from .membrane.forces import Membrane
from .output.results import Results
from .problem import Problem, State
from .schemes import SCHEMES

ROUND_OFF = 1e-9  # of a time step: what is left of a run when it counts as finished


def build_problem(settings, comm):
    """Problem and initial state.  Collective."""
    grid = Grid((settings.stag_grid_x, settings.stag_grid_y), settings.domain, comm)
    walls = Walls(grid, settings.flow, settings.shear_rate)
    operators = Operators(grid, walls)
    membrane, markers, stretch = None, np.zeros((0, 2)), np.zeros(0)
    if settings.vesicles:
        markers, ds = _markers(settings, grid)
        stretch = geometry.stretching(markers, ds)
        rest = stretch
        if settings.rest_length is not None:
            rest = np.full_like(stretch, settings.rest_length)
        membrane = Membrane(ds, settings.sigma0, settings.bending, rest)
    problem = Problem(
        grid,
        operators,
        settings.rho,
        settings.mu,
        membrane,
        KERNELS[settings.delta],
        settings.stretch == "evolve",
    )
    velocity, pressure = grid.velocity_vector(), grid.pressure_vector()
    walls.fill(velocity)
    return problem, State(0, 0.0, velocity, pressure, markers, stretch)


def _markers(settings, grid):
    """Initial markers on rank 0, none elsewhere, and the parameter step."""
    length = shapes.ellipse_perimeter(settings.axes)
    count = settings.markers or round(length / (0.5 * min(grid.dx, grid.dy)))
    markers = np.zeros((0, 2))
    if grid.comm.rank == 0:
        markers = shapes.ellipse(settings.axes, settings.center, settings.angle, count)
    return markers, length / count


class Simulation:
    """One run.  Collective.

    Parameters
    ----------
    settings : Settings
    comm : PETSc.Comm, optional
    """

    def __init__(self, settings, comm=None):
        self.settings = settings
        self.began = perf_counter()
        with phase("set-up"):
            self.problem, self.state = build_problem(settings, comm or PETSc.COMM_WORLD)
            self.scheme = SCHEMES[settings.scheme](self.problem)
            self.diagnostics = Diagnostics(self.problem)
        steps = math.ceil(settings.ts_max_time / settings.ts_dt - ROUND_OFF)
        self.last_step = min(steps, settings.ts_max_steps or steps)
        self.results = Results(settings, self.problem, self.last_step)
        self.largest_energy = 0.0

    def run(self):
        """Step until the end time or the last step; leave the results.

        Returns
        -------
        dict
            The content of summary.json.

        Raises
        ------
        SolveError
            A step failed; the state before it has been saved.
        """
        results, settings = self.results, self.settings
        first = self.state.step
        results.monitor.start(first, self.state.time, settings.ts_max_time, self.last_step)
        self._record(None)
        try:
            while not self._finished():
                self._advance()
        finally:
            results.close()
        with phase("output"):
            results.save("final.h5", self.state, self.diagnostics.reference)
            if settings.plot:
                results.draw()
        seconds = perf_counter() - self.began
        return results.summarise(self.state.step - first, seconds, events.seconds)

    def _finished(self):
        left = self.settings.ts_max_time - self.state.time
        return self.state.step >= self.last_step or left <= ROUND_OFF * self.settings.ts_dt

    def _next_dt(self):
        """The time step, shortened to end on time but for round-off."""
        dt, left = self.settings.ts_dt, self.settings.ts_max_time - self.state.time
        return left if left < (1 - ROUND_OFF) * dt else dt

    def _advance(self):
        try:
            step = self.scheme.step(self.state, self._next_dt())
            guard.check(self.problem, step.end)
        except SolveError as error:
            saved = self.results.save(
                f"checkpoint-{self.state.step:08d}.h5", self.state, self.diagnostics.reference
            )
            raise SolveError(
                f"step {self.state.step + 1} from time {self.state.time:.6g} failed: {error}; "
                f"{self.scheme.advice}; the state before it is in {saved}"
            ) from None
        self.state = step.end
        if self.state.step % self.settings.diagnostics_every == 0 or self._finished():
            self._record(step)
        step.discard()

    def _record(self, step):
        with phase("diagnostics"):
            row = self.diagnostics.row(self.state, step)
        row["wall_seconds"] = perf_counter() - self.began
        with phase("output"):
            self.results.record(row, self.state)

    def destroy(self):
        """Free the solvers, before PETSc goes."""
        self.scheme.destroy()
