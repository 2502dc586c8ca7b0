"""A run from its settings: build, step until finished, leave the results."""

import gc
import math
import signal
from time import perf_counter

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from . import accuracy, energy, events, guard, schemes, solver_options
from .diagnostics import Diagnostics
from .errors import InputError, OutputError, SolveError
from .events import phase, stage
from .interrupt import Interrupt
from .output import checkpoint
from .output.checkpoint import Progress
from .output.results import Results
from .settings import text_of
from .solvers import krylov
from .start import build_problem
from .stepsize import StepSize

ROUND_OFF = 1e-6  # of a time step: what is left of a run when it counts as finished


def _controls(settings):
    return schemes.Controls(
        settings.startup, settings.picard_rtol, settings.picard_max_it, settings.fft)


class Simulation:
    """One run.  Collective.

    Parameters
    ----------
    settings : Settings
        With `restart`, the run continues from that file.
    comm : PETSc.Comm, optional
    interrupt : Interrupt, optional
        Where signals that ask the run to stop are noted.

    Raises
    ------
    InputError
        On all ranks; nothing has been written.
    """

    def __init__(self, settings, comm=None, interrupt=None):
        events.forget()
        self.settings = settings
        self.interrupt = interrupt or Interrupt()
        self.signal = 0
        self.ledger = None
        self.saved_in = None
        self.began = self.saved_at = perf_counter()
        comm = comm or PETSc.COMM_WORLD
        self.comm = comm.tompi4py()
        asked = solver_options.given()
        header = self._header(settings) if settings.restart is not None else None
        self.progress = header.progress if header else Progress()
        self.progress.solver_options = asked
        with stage("set-up"), phase("set-up"):
            self.remarks = []
            self.problem, self.state = build_problem(settings, comm, header, self.remarks)
            self.warning = accuracy.of_flow(settings, self.state.markers)
            self.scheme = schemes.create(settings.scheme, self.problem, _controls(settings))
            self.diagnostics = Diagnostics(self.problem, self.progress.reference or None)
        reduced = header and self.progress.dt < header.options["ts_dt"]
        self.step_size = StepSize(
            settings.ts_dt,
            settings.ts_adapt,
            self.progress.dt if reduced else None,
            self.progress.good_steps,
        )
        self.first_step = self.state.step
        left = (settings.ts_max_time - self.state.time) / settings.ts_dt
        steps = self.first_step + math.ceil(left - ROUND_OFF)
        most = math.inf if settings.ts_max_steps is None else settings.ts_max_steps
        # Fixed steps are counted: the round-off in the sum of many must not add one.
        self.last_step = most if settings.ts_adapt else min(steps, most)
        self.wall_seconds_before = self.progress.wall_seconds
        try:
            self.results = Results(settings, self.problem, min(steps, most), header)
        except InputError:
            self.destroy()
            raise

    def _header(self, settings):
        """Header of the file to continue from.  Collective."""
        header, trouble = None, ""
        if self.comm.rank == 0:
            try:
                header = checkpoint.read_header(settings.restart)
            except InputError as error:
                trouble = str(error)
        header, trouble = self.comm.bcast((header, trouble))
        if trouble:
            raise InputError(trouble)
        slack = ROUND_OFF * settings.ts_dt
        for name, reached, least in (
            ("ts_max_time", header.time, header.time + slack),
            ("ts_max_steps", header.step, header.step),
        ):
            end = getattr(settings, name)
            if end is not None and end <= least:
                raise InputError(
                    f"-{name} {text_of(end)}: {header.path} has reached {text_of(reached)} "
                    "already; allowed: more than that"
                )
        return header

    def run(self, after_step=None):
        """Step until the end time, the last step or a signal; leave the results.

        Parameters
        ----------
        after_step : callable, optional
            Called after each step, without arguments.

        Returns
        -------
        dict
            The content of summary.json.

        Raises
        ------
        SolveError
            A step failed; the state before it has been saved.
        OutputError
            Results could not be written.
        """
        results, settings = self.results, self.settings
        first = self.first_step
        last = self.last_step if self.last_step < math.inf else None
        results.monitor.start(first, self.state.time, settings.ts_max_time, last)
        for remark in filter(None, [*self.remarks, self.warning]):
            results.say(f"petscib: {remark}")
        try:
            with stage("stepping"):
                if settings.restart is None:  # else the row of the first state is there already
                    self._record(None)
                    self._write_fields()
                while not self._is_last(self.state) and not self.signal:
                    self._advance()
                    self._save_when_due()
                    if self.state.step == first + 1:
                        self._warn_of_unread_options()
                    if after_step is not None:
                        after_step()
            if not self.signal:
                self._save("final.h5")
        except OutputError as error:
            last = f"; the last checkpoint is {self.saved_in}" if self.saved_in else ""
            raise OutputError(f"results could not be written: {error}{last}") from None
        finally:
            results.close()
        ended = signal.Signals(self.signal).name if self.signal else "finished"
        with stage("output"), phase("output"):
            if settings.plot and not self.signal:
                results.draw()
            seconds = perf_counter() - self.began
            return results.summarise(self.state.step - first, seconds, events.seconds, ended)

    def _is_last(self, state):
        left = self.settings.ts_max_time - state.time
        return state.step >= self.last_step or left <= ROUND_OFF * self.settings.ts_dt

    def _has_row(self, state):
        """Whether a row of diagnostics is due."""
        return state.step % self.settings.diagnostics_every == 0 or self._is_last(state)

    def _next_dt(self):
        """The time step, shortened to end on time but for round-off."""
        dt, left = self.step_size.dt, self.settings.ts_max_time - self.state.time
        return left if left < (1 - ROUND_OFF) * dt else dt

    def _advance(self):
        """Take a step, with -ts_adapt in as many attempts as it needs.  Collective."""
        while True:
            dt = self._next_dt()
            try:
                step = self._attempt(dt)
                break
            except SolveError as error:
                if not self.step_size.reject(dt):
                    raise self._failure(error) from None
                self.results.say(
                    f"petscib: step {self.state.step + 1} with dt = {dt:.3g} failed: {error}; "
                    f"trying {self.step_size.dt:.3g}"
                )
            # Python's objects on several ranks are freed only together.
            gc.collect()
            PETSc.garbage_cleanup()
        self.step_size.accept()
        self.state = step.end
        self._warn_of_long_steps(step)
        if self._has_row(self.state):
            self._record(step)
        self._write_fields()
        step.discard()

    def _attempt(self, dt):
        step = self.scheme.step(self.state, dt)
        with phase("checks"):
            guard.check(self.problem, step.end)
        asked = self.settings.ledger
        if asked != "none" and (asked != "record" or self._has_row(step.end)):
            with phase("ledger"):
                self._check_ledger(step)
        return step

    def _check_ledger(self, step):
        """Balance the energy of a step, and act on a defect as the options say.  Collective."""
        self.ledger = energy.balance(self.problem, step)
        reached = energy.measure(self.problem, step.end).total
        residual = self.ledger.residual(max(self.progress.largest_energy, reached))
        if residual > self.settings.ledger_tol and self.settings.ledger != "record":
            trouble = (
                f"the energy ledger of step {step.end.step} does not balance: residual "
                f"{residual:.1e}, allowed {self.settings.ledger_tol:.1e}"
            )
            if self.settings.ledger == "error":
                raise SolveError(f"{trouble}; tighter solver tolerances may help")
            self.results.say(f"petscib: {trouble}")

    def _failure(self, error):
        """What to raise when a step failed for good, after saving the state before it."""
        try:
            saved = f"the state before it is in {self._save()}"
        except OutputError as failure:
            saved = f"the state before it could not be saved ({failure})"
        return SolveError(
            f"step {self.state.step + 1} from time {self.state.time:.6g} failed: {error}; "
            f"{self.scheme.advice}; {saved}"
        )

    def _warn_of_long_steps(self, step):
        """Say once when a step has carried the membrane too far; rank 0 has the markers."""
        if not self.warning:
            self.warning = accuracy.of_step(step.start.markers, step.end.markers, step.dt)
            if self.warning:
                self.results.say(f"petscib: {self.warning}")

    def _record(self, step):
        largest = self.progress.largest_energy
        with phase("diagnostics"):
            row = self.diagnostics.row(self.state, step, self.ledger, largest)
        self.progress.largest_energy = max(largest, row["energy"])
        row["wall_seconds"] = self._wall_seconds()
        self._output(self.results.record, row, self.state)

    def _write_fields(self):
        every = self.settings.xdmf_every
        if every and self.state.step % every == 0:
            self._output(self.results.write_fields, self.state)

    def _save_when_due(self):
        """Agree on what signals and the clock ask for, and do it.  Collective."""
        minutes, every = self.settings.checkpoint_minutes, self.settings.checkpoint_every
        late = minutes and perf_counter() - self.saved_at >= 60 * minutes
        mine = np.array([self.interrupt.caught, bool(late and self.comm.rank == 0)])
        agreed = np.empty_like(mine)
        self.comm.Allreduce(mine, agreed, op=MPI.MAX)
        self.signal, late = agreed.tolist()
        if (self.signal or late or every and self.state.step % every == 0) and not (
            self._is_last(self.state) and not self.signal
        ):
            self._save()

    def _save(self, name=None):
        """Write a checkpoint.  Returns its path."""
        progress = self.progress
        progress.dt, progress.good_steps = self.step_size.dt, self.step_size.good_steps
        progress.wall_seconds = self._wall_seconds()
        progress.reference = self.diagnostics.reference or {}
        self.saved_at = perf_counter()
        self.saved_in = self._output(self.results.save, self.state, progress, name)
        return self.saved_in

    def _wall_seconds(self):
        return self.wall_seconds_before + perf_counter() - self.began

    def _output(self, write, *arguments):
        with stage("output"), phase("output"):
            return write(*arguments)

    def _warn_of_unread_options(self):
        """Name options for the solvers that no solver has read, once all have been set up."""
        # The tube's solver need not live on every rank.
        for name in solver_options.unread(self.progress.solver_options):
            self.results.say(f"petscib: no solver has read -{name}")

    def destroy(self):
        """Free the solvers, before PETSc goes, and forget their defaults."""
        self.scheme.destroy()
        krylov.withdraw_defaults()
