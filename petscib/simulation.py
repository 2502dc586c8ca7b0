"""A run from its settings: build, step until finished, leave the results."""

import gc
import math
import signal
import sys
import traceback
from contextlib import suppress
from time import perf_counter, process_time, sleep

from petsc4py import PETSc

from . import accuracy, energy, events, guard, schemes, solver_options, turning
from .agreement import Agreement, on_rank, on_root
from .diagnostics import Diagnostics
from .errors import Crash, CrossingError, InputError, OutputError, SolveError, WallError, ours
from .events import phase, stage
from .interrupt import Interrupt
from .localerror import LocalError
from .output import checkpoint
from .output.checkpoint import Progress
from .output.monitor import opening_line
from .output.rescue import Rescue
from .output.results import TRACEBACK, Results
from .pressure import ShownPressure
from .settings import text_of
from .solvers import krylov
from .start import build_problem
from .stepsize import StepSize

ROUND_OFF = 1e-6  # of a time step: what is left of a run when it counts as finished
PATIENCE = 5.0  # seconds that a rank which has failed waits for the others, or the longest attempt


def _controls(settings):
    return schemes.Controls(
        settings.startup, settings.picard_rtol, settings.picard_max_it, settings.fft,
        settings.ts_dt)


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
        self.missed = None, 1  # local error of the last step, and its order
        self.saved_in = None
        self.began = self.saved_at = perf_counter()
        self.cpu_began = process_time()
        self.longest_attempt = 0.0
        self.scheme = self.results = self.shown = None
        self.first_default = krylov.entered_defaults()
        self.traceback = ""
        self.writing = self.said_too_long = False
        comm = comm or PETSc.COMM_WORLD
        self.comm = comm.tompi4py()
        self.agreement = Agreement(self.comm)
        error = self._refusal(comm)
        if error is not None:
            self.destroy()
            raise error

    def _refusal(self, comm):
        """Build all; what stands in the way on any rank, or None.  Collective."""
        trouble = None
        try:
            self._build(self.settings, comm)
        except (InputError, PETSc.Error) as error:
            trouble = ours(error)
            # Python's own errors come in PETSc's clothes since 3.19; they are no bad input.
            if isinstance(trouble, Crash) and str(trouble).startswith("PETSc error"):
                trouble = InputError(f"PETSc cannot set this up: {trouble}")
        except BaseException:  # perhaps on this rank alone: nothing collective any more
            krylov.withdraw_defaults(self.first_default)
            raise
        agreed = self.agreement.meet([trouble is not None], PATIENCE if trouble else None)
        if agreed is None:
            print(f"petscib: {trouble}", file=sys.stderr, flush=True)
            self.comm.Abort(trouble.exit_status)
        return self.agreement.common(trouble)[0] if agreed[0] else None

    def _build(self, settings, comm):
        asked = solver_options.given()
        header = on_root(self.comm, self._header) if settings.restart is not None else None
        self.progress = header.progress if header else Progress()
        self.progress.solver_options = asked
        with stage("set-up"), phase("set-up"):
            self.remarks = []
            self.problem, self.state = build_problem(settings, comm, header, self.remarks)
            self.warning = ""
            if settings.ts_rtol is None:
                self.warning = accuracy.of_flow(
                    settings, self.state.markers, self.problem.curves)
            on_root(self.comm, lambda: self._check_start(header))
            self._make_scheme()
            if self.problem.membranes is not None:
                turning.begin(self.problem, self.state)
            self.diagnostics = Diagnostics(self.problem, self.progress.reference or None)
            self.local_error = None
            if settings.ts_rtol is not None:
                order = schemes.SCHEMES[settings.scheme].order
                self.local_error = LocalError(self.problem, order)
        changed = header and self.progress.dt != header.options["ts_dt"]
        self.step_size = StepSize(
            settings.ts_dt,
            settings.ts_adapt,
            self.progress.dt if changed else None,
            self.progress.good_steps,
            settings.ts_rtol,
        )
        self.first_step = self.state.step
        left = (settings.ts_max_time - self.state.time) / settings.ts_dt
        steps = self.first_step + math.ceil(left - ROUND_OFF)
        most = math.inf if settings.ts_max_steps is None else settings.ts_max_steps
        # Fixed steps are counted: the round-off in the sum of many must not add one.
        fixed = settings.ts_rtol is None and not settings.ts_adapt
        self.last_step = min(steps, most) if fixed else most
        self.wall_seconds_before = self.progress.wall_seconds
        self.rescue = Rescue(self.comm)
        # Nobody knows how many steps a tolerance takes, but that they are few.
        expected = min(steps, most) if settings.ts_rtol is None else 1
        self.results = Results(settings, self.problem, expected, header)
        self.shown = ShownPressure(self.problem, settings.fft)

    def _make_scheme(self):
        """The scheme with its solvers, once more after a failure.  Collective."""
        settings = self.settings
        self.scheme = schemes.create(settings.scheme, self.problem, _controls(settings))

    def _header(self):
        """Header of the file to continue from.  Rank 0 only."""
        settings = self.settings
        header = checkpoint.read_header(settings.restart)
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

    def _check_start(self, header):
        """Refuse to go on where the delta function now reaches a wall.  Rank 0 only."""
        try:
            guard.check_markers(self.problem, self.state.markers)
        except SolveError as error:
            raise InputError(
                f"-delta {self.settings.delta}: {error}; allowed: one that reaches less far than "
                f"the vesicle of {header.path} is from the walls"
            ) from None

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
        InputError, SolveError
            A step failed; the state before it has been saved.
        OutputError
            Results could not be written.
        """
        trouble = None
        try:
            try:
                return self._run(after_step)
            except (InputError, SolveError, OutputError):  # on which all ranks agree
                raise
            except Exception as error:
                trouble = self._trouble(error)
            raise self._failure(self._meet(trouble))
        except OutputError as error:
            last = f"; the last checkpoint is {self.saved_in}" if self.saved_in else ""
            raise OutputError(f"results could not be written: {error}{last}") from None
        finally:
            self.results.release()

    def _run(self, after_step):
        results, settings = self.results, self.settings
        first = self.first_step
        last = self.last_step if self.last_step < math.inf else None
        results.monitor.start(first, self.state.time, settings.ts_max_time, last)
        self.close = guard.near(self.problem, self.state.markers)
        if settings.monitor != "none":
            self.remarks.insert(0, opening_line(settings, self.last_step - first))
        for remark in filter(None, [*self.remarks, self.warning, self.close]):
            results.say(f"petscib: {remark}")
        with stage("stepping"):
            if settings.restart is None:  # else the row of the first state is there already
                self._record(None)
                self._write_fields()
            self._keep()
            self.interrupt.at_once = self._save_at_once
            while not self._is_last(self.state) and not self.signal:
                self._advance()
                self._save_when_due()
                if self.state.step == first + 1:
                    self._warn_of_unread_options()
                if after_step is not None:
                    after_step()
        self.interrupt.at_once = None
        if not self.signal:
            self._save("final.h5")
        results.close()
        ended = signal.Signals(self.signal).name if self.signal else "finished"
        seconds = perf_counter() - self.began, process_time() - self.cpu_began
        with stage("output"), phase("output"):
            summary = results.summarise(self.state.step - first, *seconds, events.seconds, ended)
            if settings.plot and not self.signal:
                results.draw()
        return summary

    def _is_last(self, state):
        left = self.settings.ts_max_time - state.time
        return state.step >= self.last_step or left <= ROUND_OFF * self.settings.ts_dt

    def _has_row(self, state):
        """Whether a row of diagnostics is due."""
        return state.step % self.settings.diagnostics_every == 0 or self._is_last(state)

    def _next_dt(self):
        """The time step, shortened to end on time but for round-off."""
        dt, left = self.step_size.dt, self.settings.ts_max_time - self.state.time
        if left < (1 - ROUND_OFF) * dt:
            return left
        # Of steps that vary, two may share what is left, so that none is very short.
        shared = self.settings.ts_rtol is not None and (1 + ROUND_OFF) * dt < left < 2 * dt
        return left / 2 if shared else dt

    def _advance(self):
        """Take a step, with -ts_adapt or -ts_rtol in as many attempts as it needs.  Collective."""
        self._heed_advection()
        while True:
            dt = self._next_dt()
            step, error = self._attempt(dt)
            if error is None:
                if self.step_size.allows(self.missed[0]):
                    break
                if not self.step_size.repeat(dt, *self.missed):
                    raise self._failure(SolveError(
                        f"its local error, {self.missed[0]:.1e}, is above -ts_rtol "
                        f"{self.settings.ts_rtol:g}, and smaller time steps are not allowed"))
                step.undo()
                continue
            retry = isinstance(error, SolveError) and not isinstance(error, Crash)
            if not (retry and self.step_size.reject(dt)):
                raise self._failure(error)
            self.results.say(
                f"petscib: step {self.state.step + 1} with dt = {dt:.3g} failed: {error}; "
                f"trying {self.step_size.dt:.3g}"
            )
            # What a failed solve has left in PETSc's objects is not fit for another.
            self.scheme.destroy()
            self._make_scheme()
            # Python's objects on several ranks are freed only together.
            gc.collect()
            PETSc.garbage_cleanup()
        self.step_size.accept(*self.missed)
        self.state = step.end
        self._warn_of_long_steps(step)
        self._warn_of_narrow_gaps()
        if self.keeping:
            self._keep()
        if self._has_row(self.state):
            self._record(step)
        self._write_fields()
        step.discard()

    def _heed_advection(self):
        """Keep to the limit of explicit advection, or say once that the step is beyond it."""
        advection = self.problem.advection
        if advection is None or advection.implicit:
            return
        longest = advection.longest_step(self.state.velocity, self.problem.least_mu)
        self.step_size.limit(longest)
        dt = self._next_dt()
        if dt > longest and not self.said_too_long:
            self.said_too_long = True
            self.results.say(
                f"petscib: explicit advection may be unstable with time steps above {longest:.3g} "
                f"at this speed, and this one is {dt:.3g}; try -advection implicit or -ts_adapt")

    def _attempt(self, dt):
        """The step and None, or None and the error that all ranks agree upon.  Collective."""
        begin = perf_counter()
        step, error = self._agreed(self._checked_step, dt)
        asked = self.settings.ledger
        good = error is None and self.step_size.allows(self.missed[0])
        if good and asked != "none" and (asked != "record" or self._has_row(step.end)):
            with phase("ledger"):
                _, error = self._agreed(self._check_ledger, step)
        self.longest_attempt = max(self.longest_attempt, perf_counter() - begin)
        return step, error

    def _agreed(self, work, *arguments):
        """Result and None, or None and the error that any rank met with.  Collective."""
        result = trouble = None
        try:
            result = work(*arguments)
        except Exception as error:
            trouble = self._trouble(error)
        return result, self._meet(trouble)

    def _trouble(self, error):
        """What an exception amounts to; where it was raised is noted.  Not collective."""
        trouble = ours(error)
        if isinstance(trouble, Crash):
            self.traceback = traceback.format_exc()
        return trouble

    def _meet(self, trouble):
        """Agree on what has failed on any rank, what signals ask for, and what is due.

        Collective, but for a rank in trouble whose others do not come: it ends the job.
        """
        minutes = self.settings.checkpoint_minutes
        late = minutes and perf_counter() - self.saved_at >= 60 * minutes
        root, caught = self.comm.rank == 0, self.interrupt.caught
        agreed = self.agreement.meet(
            [trouble is not None, caught, root and late, root and self.rescue.is_due],
            max(PATIENCE, self.longest_attempt) if trouble else None,
        )
        if agreed is None:
            self._abandon(trouble)
        failed, self.signal, self.late, self.keeping = map(int, agreed)
        if not failed:
            return None
        error, first = self.agreement.common(trouble)
        if self.traceback and self.comm.rank == first:
            self.results.keep_traceback(self.traceback)
        return error

    def _checked_step(self, dt):
        step = self.scheme.step(self.state, dt)
        with phase("checks"):
            guard.check(self.problem, step.end)
            turning.follow(self.problem, step)
            if self.local_error is not None:
                self.missed = self.local_error.measure(step)
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
            # After a failure no solver is to be trusted.
            saved = f"the state before it is in {self._save(with_jumps=False)}"
        except OutputError as failure:
            saved = f"the state before it could not be saved ({failure})"
        return self._last_words(error, saved)

    def _last_words(self, error, saved):
        advice = self.scheme.advice
        if isinstance(error, WallError):
            advice = "a larger -domain leaves it room"
        elif isinstance(error, CrossingError):
            advice = "a finer grid, a smaller -ts_dt or -contact keeps them apart"
        elif isinstance(error, Crash):
            advice = f"{self.results.path(TRACEBACK)} says where"
        elif isinstance(error, InputError):
            advice = "-help names what is allowed"
        return type(error)(
            f"step {self.state.step + 1} from time {self.state.time:.6g} failed: {error}; "
            f"{advice}; {saved}"
        )

    def _warn_of_long_steps(self, step):
        """Say once when a step has carried the membrane too far; rank 0 has the markers."""
        if not self.warning and self.local_error is None:
            self.warning = accuracy.of_step(
                self.settings, step.start.markers, step.end.markers, step.dt,
                self.problem.curves)
            if self.warning:
                self.results.say(f"petscib: {self.warning}")

    def _warn_of_narrow_gaps(self):
        """Say once when two membranes have come too near each other."""
        if not self.close:
            self.close = guard.near(self.problem, self.state.markers)
            if self.close:
                self.results.say(f"petscib: {self.close}")

    def _abandon(self, trouble):
        """End the job: the others wait for what this rank cannot do any more.  Not collective."""
        while not self.rescue.claim():
            sleep(60)  # another rank is ending it
        if self.traceback:
            self.results.keep_traceback(self.traceback)
        try:
            path = self.rescue.save(self.results.folder, self.problem, self.settings)
            saved = f"the newest state within its reach is in {path}"
        except Exception as failure:
            last = f"; the last checkpoint is {self.saved_in}" if self.saved_in else ""
            saved = f"the state before it could not be saved ({ours(failure)}){last}"
        error = self._last_words(on_rank(trouble, self.comm.rank), saved)
        self.results.monitor.write(f"petscib: {error}")
        self.comm.Abort(error.exit_status)

    def _record(self, step):
        largest = self.progress.largest_energy
        with phase("diagnostics"):
            row = self.diagnostics.row(self.state, step, self.ledger, largest)
        self.progress.largest_energy = max(largest, row["energy"])
        row["local_error"], row["wall_seconds"] = self.missed[0], self._wall_seconds()
        self._output(self.results.record, row, self.state)

    def _write_fields(self):
        every = self.settings.xdmf_every
        if every and self.state.step % every == 0:
            self._output(lambda: self.results.write_fields(self.shown.state(self.state)))

    def _save_when_due(self):
        """Do what signals, the clock and the step's number ask for.  Collective."""
        every = self.settings.checkpoint_every
        if (self.signal or self.late or every and self.state.step % every == 0) and not (
            self._is_last(self.state) and not self.signal
        ):
            self._save()

    def _save(self, name=None, with_jumps=True):
        """Write a checkpoint, as a rule with the pressure's jumps.  Returns its path."""
        self.saved_at = perf_counter()

        def write():
            state = self.shown.state(self.state) if with_jumps else self.state
            return self.results.save(state, self._reached(), name)

        self.saved_in = self._output(write)
        if self.shown.trouble:
            self.results.say(
                f"petscib: the pressure in {self.saved_in} is without its jumps across the "
                f"membranes: {self.shown.trouble}")
        if self.scheme is not None:
            self.scheme.forget()
        return self.saved_in

    def _save_at_once(self):
        """Save the newest state that all ranks have kept, in the middle of a step.  Any rank."""
        if self.comm.rank == 0 and not self.writing:
            with suppress(Exception):  # the orderly end may still come
                if self.comm.size == 1:
                    self._save()
                else:
                    self.rescue.save(self.results.folder, self.problem, self.settings)

    def _keep(self):
        """Keep the state for the case that this or another rank fails alone.  Not collective."""
        if self.rescue.wanted:
            with phase("rescue copies"):
                self.rescue.keep(self.state, self._reached())

    def _reached(self):
        """The progress up to the present state."""
        progress = self.progress
        progress.dt, progress.good_steps = self.step_size.dt, self.step_size.good_steps
        progress.wall_seconds = self._wall_seconds()
        progress.reference = self.diagnostics.reference or {}
        return progress

    def _wall_seconds(self):
        return self.wall_seconds_before + perf_counter() - self.began

    def _output(self, write, *arguments):
        self.writing = True
        try:
            with stage("output"), phase("output"):
                return write(*arguments)
        finally:
            self.writing = False

    def _warn_of_unread_options(self):
        """Name options for the solvers that no solver has read, once all have been set up."""
        # The tube's solver need not live on every rank.
        for name in solver_options.unread(self.progress.solver_options):
            self.results.say(f"petscib: no solver has read -{name}")

    def destroy(self):
        """Free the solvers, before PETSc goes, and forget their defaults."""
        if self.scheme is not None:
            self.scheme.destroy()
        if self.shown is not None:
            self.shown.destroy()
        if self.results is not None:
            self.results.release()
        if self.agreement is not None:
            self.agreement.destroy()
            self.agreement = None
        krylov.withdraw_defaults(self.first_default)
