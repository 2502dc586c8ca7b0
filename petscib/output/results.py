"""The output folder of a run: tables, checkpoints, fields, summary and pictures."""

import itertools
import json
import os
import resource
import shutil
import sys
from contextlib import suppress

import h5py
import numpy as np
from petsc4py import PETSc

from .. import installation
from ..agreement import on_root
from ..errors import InputError, ours
from . import checkpoint, files, lock, monitor, tables
from .files import by_root

PREVIOUS = "previous"  # subfolder for what a new run would otherwise overwrite
TABLES = ("diagnostics.csv", "outlines.csv")
SAVED = (*files.CHECKPOINTS, "fields-#.h5")
TRACEBACK = "traceback.txt"
PICTURES = (
    "outlines.png", "inclination.png", "conservation.png", "energy.png", "ledger.png", "fields.png",
    "tension.png", "animation.gif", "animation.mp4",
)
OTHERS = ("fields.xdmf", "vesicles.xdmf", "summary.json", TRACEBACK, *PICTURES)
OURS = (*TABLES, *SAVED, *OTHERS)  # all that a run writes; nothing else is touched


class Results:
    """Writes what a run leaves behind.  Collective.

    The folder holds one history: a new run, or a restart from an earlier step, first moves the
    files that it would write again into the subfolder ``previous``.  What that held already is kept
    as ``previous-1``, ``previous-2`` and so on.

    Parameters
    ----------
    settings : Settings
    problem : Problem
    steps : int
        Estimated number of steps, for the interval between outlines.
    columns : sequence of str
        Of the table of diagnostics.
    header : checkpoint.Header, optional
        Of the file that the run continues from.

    Raises
    ------
    InputError
        On all ranks, when the folder cannot be written to, or another run is writing there.
    """

    writes = True  # files

    def __init__(self, settings, problem, steps, columns, header=None):
        self.settings = settings
        self.problem = problem
        self.folder = settings.output
        self.comm = problem.grid.comm.tompi4py()
        self.outline_every = settings.outline_every or max(1, round(steps / 100))
        self.monitor = monitor.create(settings.monitor if self.comm.rank == 0 else "none")
        self.last_row = None
        self.diagnostics = self.outlines = self.lock = None
        try:
            on_root(self.comm, lambda: self._make_ready(columns, header))
        except InputError:
            self.release()
            raise
        self.series = None
        if settings.xdmf_every:
            from .xdmf import Series

            self.series = Series(self.folder, problem)

    def _make_ready(self, columns, header):
        try:
            self._open(columns, header)
        except OSError as failure:
            why = files.explain(failure, failure.filename or self.folder)
            raise InputError(f"-output {why}") from None

    def _open(self, columns, header):
        """Make the folder ready and open the tables.  Rank 0 only."""
        os.makedirs(self.folder, exist_ok=True)
        self._claim()
        for leftover in files.named(self.folder, *(name + files.PART for name in OURS)):
            os.unlink(leftover)
        source = header and (os.path.dirname(header.path) or ".")
        continues = source is not None and os.path.samefile(source, self.folder)
        if continues:
            self._set_aside(_later(self.folder, header.step))
        else:
            copies = [] if source is None else self._copy_tables(source)
            if self._set_aside(files.named(self.folder, *OURS)):
                self.say(f"petscib: results of an earlier run are now in {self.path(PREVIOUS)}")
            for copy in copies:
                os.replace(copy, copy[: -len(files.PART)])
        step = header.step if header else None
        self.diagnostics = self._table("diagnostics.csv", columns, step)
        if self.problem.membranes is not None:
            self.longest = int(np.diff(self.problem.curves.starts).max())
            columns = tables.outline_columns(self.longest)
            self.outlines = self._table("outlines.csv", columns, step)

    def _table(self, name, columns, step):
        if step is None:
            return tables.Table(self.path(name), columns)
        try:
            return tables.Table.resume(self.path(name), columns, step)
        except ValueError as error:
            raise OSError(f"cannot be continued: {error}") from None

    def _claim(self):
        """See to it that no other run writes here, nor where its results would be moved."""
        self.lock = lock.Lock(self.folder)
        if not self.lock.holds:
            self.say(f"petscib: other runs can write in {self.folder}, which cannot be locked")
        lock.check(self.path(PREVIOUS))

    def _copy_tables(self, source):
        """Copy the tables of another folder under temporary names, which are returned."""
        copies = []
        for path in files.named(source, *TABLES):
            copies.append(self.path(os.path.basename(path) + files.PART))
            shutil.copyfile(path, copies[-1])
        return copies

    def _set_aside(self, paths):
        """Move files into the subfolder for what is done again.  Returns the paths."""
        if not paths:
            return paths
        previous = self.path(PREVIOUS)
        if os.path.exists(previous):
            numbers = itertools.count(1)
            os.rename(previous, next(
                path for path in (f"{previous}-{k}" for k in numbers) if not os.path.exists(path)
            ))
        os.mkdir(previous)
        for path in paths:
            os.replace(path, os.path.join(previous, os.path.basename(path)))
        return paths

    def path(self, name):
        """Path of a file in the folder."""
        return os.path.join(self.folder, name)

    def say(self, line):
        """Print a line from rank 0, beside the progress display."""
        if self.comm.rank == 0:
            self.monitor.write(line)

    def record(self, row, state):
        """Append a row of diagnostics, an outline when it is due, and show progress.

        Raises
        ------
        OutputError
            On all ranks.
        """
        self.last_row = row

        def write():
            self.diagnostics.write(row)
            if self.outlines is not None and state.step % self.outline_every == 0:
                for number, markers in enumerate(self.problem.curves.parts(state.markers)):
                    self.outlines.write(tables.outline_row(
                        state.step, state.time, number, markers, self.longest))

        by_root(self.comm, write)
        self.monitor.update(row)

    def write_fields(self, state):
        """Write a frame for ParaView.  Raises OutputError on all ranks."""
        self.series.write(state)

    def save(self, state, progress, name=None):
        """Write a checkpoint, keeping the last few of those without a `name` of their own.

        Returns
        -------
        str
            Its path.

        Raises
        ------
        OutputError
            On all ranks.
        """
        path = self.path(name or checkpoint.name_of(state.step))
        by_root(self.comm, self._sync)
        checkpoint.save(path, self.problem, state, self.settings, progress)
        by_root(self.comm, self._prune)
        return path

    def _sync(self):
        # A checkpoint on the disk must find the rows before it there too.
        for table in (self.diagnostics, self.outlines):
            if table is not None:
                table.sync()

    def _prune(self):
        old = files.named(self.folder, files.CHECKPOINTS[0])[: -self.settings.checkpoint_keep]
        for path in old:
            os.unlink(path)

    def summarise(self, steps, seconds, cpu_seconds, phases, ended, doubts):
        """Write summary.json and return its content.  Raises OutputError on all ranks."""
        summary = {
            "versions": installation.versions(),
            "ranks": self.comm.size,
            "options": self.settings.to_dict(),
            "petsc_options": PETSc.Options().getAll(),
            "output": self.folder,
            "ended": ended,
            "doubts": doubts,
            "steps": steps,
            "total_seconds": seconds,
            "cpu_seconds": self.comm.allreduce(cpu_seconds),  # of all ranks together
            "phase_seconds": dict(phases),
            "peak_memory_bytes": peak_memory(self.comm),
            "last_row": {
                name: value if value is None or np.isfinite(value) else None  # JSON has no NaN
                for name, value in (self.last_row or {}).items()
            },
        }
        self._write_summary(summary)
        return summary

    def _write_summary(self, summary):
        text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
        by_root(self.comm, lambda: files.write_text(self.path("summary.json"), text))

    def draw(self):
        """Draw the pictures on rank 0; what cannot be drawn does not fail the run."""
        if self.comm.rank:
            return
        from . import plots

        try:
            plots.plot_all(self.folder)
        except ImportError as error:
            self.say(f"petscib: no pictures, {error.name} is not installed")
        except Exception as error:  # of whatever library beneath: the results are there
            why = error if isinstance(error, (OSError, ValueError)) else ours(error)
            self.say(f"petscib: not all pictures could be drawn: {why}")

    @property
    def traceback(self):
        """Where `keep_traceback` leaves it."""
        return self.path(TRACEBACK)

    def keep_traceback(self, text):
        """Leave where an exception was raised, for whoever mends it.  On any one rank."""
        with suppress(OSError):
            files.write_text(self.traceback, text)

    def close(self):
        """Close the tables and the progress display."""
        self.monitor.close()
        for table in (self.diagnostics, self.outlines):
            if table is not None:
                with suppress(OSError):  # a row that could not be written has been reported
                    table.close()

    def release(self):
        """Let other runs have the folder."""
        self.close()
        if self.lock is not None:
            self.lock.release()


def peak_memory(comm):
    """Most memory (bytes) that the ranks together have held so far.  Collective."""
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def _later(folder, step):
    """Checkpoints and frames in a folder that are later than a step, or cannot be read."""
    later = []
    for path in files.named(folder, *SAVED):
        try:
            with h5py.File(path, "r") as file:
                found = file.attrs["step"]
        except (OSError, RuntimeError, KeyError):
            found = np.inf
        if found > step:
            later.append(path)
    return later
