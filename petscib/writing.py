"""What a run writes on its way, and when: rows, fields, checkpoints, copies for a rescue."""

from contextlib import contextmanager, suppress
from time import perf_counter

from .events import phase, stage
from .output.rescue import Rescue
from .pressure import ShownPressure


class Writing:
    """Writes states and rows of a run when they are due.  Collective but where it says otherwise.

    Parameters
    ----------
    settings : Settings
    problem : Problem
    results : Results
    reached : callable
        Gives the `checkpoint.Progress` up to the present state.

    Attributes
    ----------
    shown : ShownPressure
    rescue : Rescue
    saved_in : str or None
        Path of the last checkpoint.
    """

    def __init__(self, settings, problem, results, reached):
        self.settings, self.problem, self.results = settings, problem, results
        self.reached = reached
        self.comm = problem.grid.comm.tompi4py()
        self.rescue = Rescue(self.comm)
        self.shown = ShownPressure(problem, settings.fft)
        self.saved_in = None
        self._saved_at = perf_counter()
        self._at_work = False

    @property
    def is_late(self):
        """Whether -checkpoint_minutes have passed since the last checkpoint.  Not collective."""
        minutes = self.settings.checkpoint_minutes
        return bool(minutes) and perf_counter() - self._saved_at >= 60 * minutes

    def is_due(self, state):
        """Whether the number of a state's step asks for a checkpoint."""
        every = self.settings.checkpoint_every
        return bool(every) and state.step % every == 0

    def row(self, row, state):
        """Write a row of diagnostics, and an outline when it is due."""
        with self._output():
            self.results.record(row, state)

    def fields(self, state):
        """Write a frame for ParaView, when it is due."""
        every = self.settings.xdmf_every
        if every and state.step % every == 0:
            with self._output():
                self.results.write_fields(self.shown.state(state))

    def save(self, state, name=None, with_jumps=True):
        """Write a checkpoint, unless the run writes no files.

        Parameters
        ----------
        state : State
        name : str, optional
            Of the file; by default that of the step.
        with_jumps : bool
            Whether the pressure gets its jumps across the membranes, for which is solved.

        Returns
        -------
        str or None
            Its path.

        Raises
        ------
        OutputError
            On all ranks.
        """
        self._saved_at = perf_counter()
        if not self.results.writes:
            return None
        with self._output():
            shown = self.shown.state(state) if with_jumps else state
            self.saved_in = self.results.save(shown, self.reached(), name)
        if self.shown.trouble:
            self.results.say(
                f"petscib: the pressure in {self.saved_in} is without its jumps across the "
                f"membranes: {self.shown.trouble}")
        return self.saved_in

    def save_at_once(self, state):
        """Save the newest state that all ranks have kept, in the middle of a step.

        Called by a signal's handler, on any rank.  On one rank, that is the given state.
        """
        if self.comm.rank == 0 and self.results.writes and not self._at_work:
            with suppress(Exception):  # the orderly end may still come
                self.save_alone(state)

    def save_alone(self, state, with_jumps=True):
        """Save without other ranks' help: on one rank a state, of several what all have kept.

        Returns its path.  Raises OutputError on this rank.
        """
        if self.comm.size == 1:
            return self.save(state, with_jumps=with_jumps)
        return self.save_copies()

    def save_copies(self):
        """Write a checkpoint of the newest state that all ranks have kept.  On one rank only.

        Returns
        -------
        str
            Its path.

        Raises
        ------
        OutputError
            On this rank.
        """
        return self.rescue.save(self.results.folder, self.problem, self.settings)

    def keep(self, state):
        """Keep the state for the case that this or another rank fails alone.  Not collective."""
        if self.rescue.wanted and self.results.writes:
            with phase("rescue copies"):
                self.rescue.keep(state, self.reached())

    @contextmanager
    def _output(self):
        """Attribute the time to the output, and let no signal's handler write meanwhile."""
        self._at_work = True
        try:
            with stage("output"), phase("output"):
                yield
        finally:
            self._at_work = False

    def destroy(self):
        """Free the solver for the pressure's jumps.  Collective."""
        self.shown.destroy()
