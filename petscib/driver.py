"""Drives a run from its settings: build, step until finished, leave the results."""

import gc
import math
import signal
import sys
import traceback
from collections import Counter
from time import perf_counter, process_time, sleep

from petsc4py import PETSc

from . import energy, events, guard, schemes, solver_options, turning
from .agreement import Agreement, on_rank, on_root
from .alerts import GAP, TIME_STEP, Alerts
from .diagnostics import Diagnostics
from .doubts import Doubts
from .entries import Entries
from .errors import Crash, CrossingError, InputError, OutputError, SolveError, WallError, ours
from .events import phase, stage
from .interrupt import Interrupt
from .localerror import LocalError
from .output import checkpoint
from .output.checkpoint import Progress
from .output.memory import Memory
from .output.results import Results
from .output.words import FINISHED, opening_line
from .settings import NOWHERE, text_of
from .start import build_problem
from .stepsize import StepSize
from .writing import Writing

ROUND_OFF = 1e-6  # of a time step: what is left of a run when it counts as finished
PATIENCE = 5.0  # seconds that a rank which has failed waits for the others, or the longest attempt


def _controls(settings):
    return schemes.Controls(
        settings.startup, settings.picard_rtol, settings.picard_max_it, settings.fft,
        settings.ts_dt)


class Driver:
    """One run.  Collective.

    Parameters
    ----------
    settings : Settings
        With `restart`, the run continues from that file.  With `output` NOWHERE, no file is
        written.
    comm : PETSc.Comm, optional
    interrupt : Interrupt, optional
        Where signals that ask the run to stop are noted.
    laws : sequence of callables, optional
        Each makes a law of the membranes' forces, see `start.build_problem`.
    measures : dict of str to callable, optional
        Columns of the diagnostics to add: each gives, without arguments, a number on rank 0.
    note : callable, optional
        Is given each row of diagnostics.
    entries : Entries, optional
        What the user of this run alone has told PETSc.

    Attributes
    ----------
    problem : Problem
    state : State
        The present one.
    results : Results
    writing : Writing
    doubts : Doubts
        Why the results may not be trusted.
    summary : dict or None
        The content of summary.json, once the run has ended.

    Raises
    ------
    InputError
        On all ranks; nothing has been written.
    """

    def __init__(self, settings, comm=None, interrupt=None, laws=(), measures=None,
                 note=None, entries=None):
        self.settings, self.laws, self.measures = settings, laws, measures or {}
        self.note = note or (lambda row: None)
        self.interrupt = interrupt or Interrupt()
        self.signal = 0
        self.ledger = self.summary = None
        self.begun = False
        self.missed = None, 1  # local error of the last step, and its order
        self.began, self.cpu_began = perf_counter(), process_time()
        self.longest_attempt = 0.0
        self.scheme = self.results = self.writing = None
        self.entries, self.counters = entries or Entries(), (Counter(), Counter())
        self._take_over()
        self.traceback = ""
        comm = comm or PETSc.COMM_WORLD
        self.comm = comm.tompi4py()
        self.agreement = Agreement(self.comm)
        error = self._refusal(comm)
        if error is not None:
            self.destroy()
            raise error

    def _take_over(self):
        """Have this run's options in PETSc's database, and its phases counted."""
        self.entries.use()
        events.count(*self.counters)

    def _refusal(self, comm):
        """Build all; what stands in the way on any rank, or None.  Collective."""
        trouble = None
        try:
            self._build(self.settings, comm)
        except (InputError, PETSc.Error) as error:
            trouble = self._ours(error)
            # Since 3.19 petsc4py wraps errors of Python's in its own; those are no bad input.
            if isinstance(trouble, Crash) and str(trouble).startswith("PETSc error"):
                trouble = InputError(f"PETSc cannot set this up: {trouble}")
        except BaseException:  # perhaps on this rank alone: nothing collective any more
            self.entries.withdraw()
            raise
        agreed = self.agreement.meet([trouble is not None], PATIENCE if trouble else None)
        if agreed is None:
            print(f"petscib: {trouble}", file=sys.stderr, flush=True)
            self.comm.Abort(trouble.exit_status)
        return self.agreement.common(trouble)[0] if agreed[0] else None

    def _ours(self, error):
        """The error of ours that an exception amounts to; an option's that PETSc refuses."""
        trouble = ours(error)
        option = solver_options.refused(str(trouble), self.asked)
        return InputError(f"{option}: {trouble}") if option else trouble

    def _build(self, settings, comm):
        self.asked = solver_options.given()
        header = on_root(self.comm, self._header) if settings.restart is not None else None
        self.progress = header.progress if header else Progress()
        self.progress.solver_options = self.asked
        self.wall_seconds_before = self.progress.wall_seconds
        with stage("set-up"), phase("set-up"):
            self.remarks = []
            self.problem, self.state = build_problem(
                settings, comm, header, self.remarks, self.laws)
            on_root(self.comm, lambda: self._check_start(header))
            self._make_scheme()
            if self.problem.membranes is not None:
                turning.begin(self.problem, self.state)
            self.diagnostics = Diagnostics(
                self.problem, self.progress.reference or None, self.measures)
            self.doubts = Doubts(settings, self.problem)
            self.local_error = None
            if settings.ts_rtol is not None:
                order = schemes.SCHEMES[settings.scheme].order
                self.local_error = LocalError(self.problem, order)
        expected = self._plan(header)
        kind = Results if settings.output != NOWHERE else Memory
        self.results = kind(settings, self.problem, expected, self.diagnostics.columns, header)
        self.alerts = Alerts(settings, self.problem, self.results)
        self.writing = Writing(settings, self.problem, self.results, self.reached)

    def _plan(self, header):
        """Decide the first time step and the last step; how many steps are to be expected."""
        settings = self.settings
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
        # Nobody knows how many steps a tolerance takes, but that they are few.
        return min(steps, most) if settings.ts_rtol is None else 1

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

    def run(self):
        """Step until the end time, the last step or a signal; leave the results.  Collective.

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
        for _ in self.steps():
            pass
        return self.summary

    def steps(self):
        """Take a step for each iteration, and leave the results after the last.  Collective.

        A loop that was left early goes on where another one begins.  Raises what `run` does.

        Yields
        ------
        dict
            The newest row of diagnostics.
        """
        if not self.begun:
            self._guarded(self._begin)
        while self.summary is None:
            if self._is_last(self.state) or self.signal:
                self._guarded(self._finish)
            else:
                self._guarded(self._next)
                yield self.results.last_row

    def _guarded(self, work):
        """Do a part of the run, in which one rank alone may fail.  Collective."""
        self._take_over()
        try:
            try:
                return work()
            except (InputError, SolveError, OutputError):  # on which all ranks agree
                raise
            except Exception as error:
                trouble = self._trouble(error)
            raise self._failure(self._meet(trouble))
        except BaseException as error:
            self.results.release()
            if not isinstance(error, OutputError):
                raise
            raise OutputError(
                f"results could not be written: {error}{self._last_checkpoint}") from None

    @property
    def _last_checkpoint(self):
        """The end of a message: where the last checkpoint is, if there is one."""
        path = self.writing.saved_in
        return f"; the last checkpoint is {path}" if path else ""

    def _begin(self):
        results, settings = self.results, self.settings
        self.begun = True
        last = self.last_step if self.last_step < math.inf else None
        opening = []
        if settings.restart is not None and results.writes:
            opening.append(f"continuing from {settings.restart}")
        if settings.monitor != "none":
            opening.append(opening_line(settings, self.last_step - self.first_step))
        for line in (*opening, *self.remarks):
            results.say(f"petscib: {line}")
        results.monitor.start(self.first_step, self.state.time, settings.ts_max_time, last)
        self.alerts.at_start(self.state)
        with stage("stepping"):
            if settings.restart is None:  # else the row of the first state is there already
                self._record(None)
                self.writing.fields(self.state)
            self.writing.keep(self.state)
        self.interrupt.at_once = lambda: self.writing.save_at_once(self.state)
        if self.comm.rank == 0:
            saving = ", and saving its state" if results.writes else ""
            self.interrupt.notice = (f"petscib: finishing this step{saving}; a second Ctrl-C ends "
                                     "the run at once")

    def _next(self):
        with stage("stepping"):
            self._advance()
            if self._save_is_due():
                self._save()
            if self.state.step == self.first_step + 1:
                self._warn_of_unread_options()

    def _finish(self):
        results = self.results
        self.interrupt.at_once, self.interrupt.notice = None, ""
        if not self.signal:
            self._save("final.h5")
        results.close()
        ended = signal.Signals(self.signal).name if self.signal else FINISHED
        seconds = perf_counter() - self.began, process_time() - self.cpu_began
        with stage("output"), phase("output"):
            said = [subject for subject in (TIME_STEP, GAP) if subject in self.alerts.said]
            self.doubts.end(self.state, said)
            summary = results.summarise(
                self.state.step - self.first_step, *seconds, events.seconds, ended,
                self.doubts.found)
            if self.settings.plot and not self.signal:
                results.draw()
        results.release()
        self.summary = summary

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
        self.alerts.after_step(step)
        if self.keeping:
            self.writing.keep(self.state)
        if self._has_row(self.state):
            self._record(step)
        self.writing.fields(self.state)
        step.discard()

    def _heed_advection(self):
        """Keep to the limit of explicit advection, or say once that the step is beyond it."""
        advection = self.problem.advection
        if advection is None or advection.implicit:
            return
        longest = advection.longest_step(self.state.velocity, self.problem.least_mu)
        self.step_size.limit(longest)
        self.alerts.before_step(self._next_dt(), longest)

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
        trouble = self._ours(error)
        if isinstance(trouble, Crash):
            self.traceback = traceback.format_exc()
        return trouble

    def _meet(self, trouble):
        """Agree on what has failed on any rank, what signals ask for, and what is due.

        Collective, but for a rank in trouble whose others do not come: it ends the job.
        """
        root, writing = self.comm.rank == 0, self.writing  # whose clock counts
        agreed = self.agreement.meet(
            [trouble is not None, self.interrupt.caught, root and writing.is_late,
             root and writing.rescue.is_due],
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
        if not residual <= self.settings.ledger_tol and self.settings.ledger != "record":
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
            path = self._save(with_jumps=False)
            saved = f"the state before it is {f'in {path}' if path else 'at hand'}"
        except OutputError as failure:
            saved = f"the state before it could not be saved ({failure})"
        return self._last_words(error, saved)

    def _last_words(self, error, saved):
        advice = f"; {self.scheme.advice}"
        if isinstance(error, WallError):
            advice = "; a larger -domain leaves it room"
        elif isinstance(error, CrossingError):
            advice = "; a finer grid, a smaller -ts_dt or -contact keeps them apart"
        elif isinstance(error, Crash):
            advice = f"; {self.results.traceback} says where"
        elif isinstance(error, InputError):
            advice = "; -help petsc names what is allowed" if "PETSc error" in str(error) else ""
        return type(error)(
            f"step {self.state.step + 1} from time {self.state.time:.6g} failed: {error}"
            f"{advice}; {saved}"
        )

    def _abandon(self, trouble):
        """End the job: the others wait for what this rank cannot do any more.  Not collective."""
        while not self.writing.rescue.claim():
            sleep(60)  # another rank is ending it
        if self.traceback:
            self.results.keep_traceback(self.traceback)
        try:
            if not self.results.writes:
                raise OutputError("there is no -output")
            saved = f"the newest state within its reach is in {self.writing.save_copies()}"
        except Exception as failure:
            saved = (f"the state before it could not be saved ({ours(failure)})"
                     f"{self._last_checkpoint}")
        error = self._last_words(on_rank(trouble, self.comm.rank), saved)
        self.results.monitor.write(f"petscib: {error}")
        self.comm.Abort(error.exit_status)

    def leave(self):
        """Save the newest state for a script that fails in the midst of the run.  Not collective.

        Of several ranks, which need not all have failed, the first one saves what all have kept.
        """
        if not self.begun or self.summary is not None or not self.results.writes:
            return
        if not self.writing.rescue.claim():
            sleep(PATIENCE)  # the script may end the job
            return
        try:
            path = self.writing.save_alone(self.state, with_jumps=False)
            self.results.monitor.write(f"petscib: a state to go on from is in {path}")
        except OutputError as failure:
            self.results.monitor.write(f"petscib: the state could not be saved ({failure})")

    def _record(self, step):
        largest = self.progress.largest_energy
        with phase("diagnostics"):
            row = self.diagnostics.row(self.state, step, self.ledger, largest)
        self.progress.largest_energy = max(largest, row["energy"])
        row["local_error"], row["wall_seconds"] = self.missed[0], self._wall_seconds()
        self.doubts.note(row)
        self.note(row)
        self.writing.row(row, self.state)

    def _save_is_due(self):
        """Whether a signal, the clock or the step's number asks for a checkpoint now."""
        if self._is_last(self.state) and not self.signal:  # final.h5 is about to come
            return False
        return self.signal or self.late or self.writing.is_due(self.state)

    def _save(self, name=None, with_jumps=True):
        """Write a checkpoint, see `Writing.save`.  Returns its path."""
        path = self.writing.save(self.state, name, with_jumps)
        if path is not None:
            self.scheme.forget()
        return path

    def shown_state(self):
        """The present state with the pressure as it is shown.  Collective."""
        self._take_over()
        return self.writing.shown.state(self.state)

    def save(self, path):
        """Write a checkpoint to any path.  Collective.

        Raises
        ------
        OutputError
            On all ranks.
        """
        checkpoint.save(
            path, self.problem, self.shown_state(), self.settings, self.reached())
        self.scheme.forget()  # as after every checkpoint: a restart is the uninterrupted run

    def reached(self):
        """The progress up to the present state."""
        progress = self.progress
        progress.dt, progress.good_steps = self.step_size.dt, self.step_size.good_steps
        progress.wall_seconds = self._wall_seconds()
        progress.reference = self.diagnostics.reference or {}
        return progress

    def _wall_seconds(self):
        return self.wall_seconds_before + perf_counter() - self.began

    def _warn_of_unread_options(self):
        """Name options for the solvers that no solver has read, once all have been set up."""
        # Rank 0's answer counts: what is solved along the membranes is solved there alone.
        for name in solver_options.unread(self.progress.solver_options):
            self.results.say(f"petscib: no solver has read -{name}")

    def destroy(self):
        """Free the solvers, before PETSc goes, and withdraw what PETSc was told for them."""
        if self.scheme is not None:
            self.scheme.destroy()
        if self.writing is not None:
            self.writing.destroy()
        if self.results is not None:
            self.results.release()
        if self.agreement is not None:
            self.agreement.destroy()
            self.agreement = None
        self.entries.withdraw()
