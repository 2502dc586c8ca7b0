"""The output folder of a run: tables, checkpoints, summary and pictures."""

import json
import os
import platform
import sys

import h5py
import mpi4py
import numpy as np
import petsc4py
from petsc4py import PETSc

from .. import __version__
from ..diagnostics import COLUMNS
from ..errors import InputError
from . import checkpoint, monitor, tables


def on_root(comm, action, error=RuntimeError):
    """Run `action` on rank 0; when it raises OSError, raise `error` on every rank.  Collective."""
    trouble = None
    if comm.rank == 0:
        try:
            action()
        except OSError as failure:
            trouble = f"{failure.filename or 'output'}: {failure.strerror or failure}"
    trouble = comm.bcast(trouble)
    if trouble:
        raise error(trouble)


class Results:
    """Writes what a run leaves behind.  Collective.

    Parameters
    ----------
    settings : Settings
    problem : Problem
    steps : int
        Estimated number of steps, for the interval between outlines.
    """

    def __init__(self, settings, problem, steps):
        self.settings = settings
        self.problem = problem
        self.folder = settings.output
        self.comm = problem.grid.comm.tompi4py()
        self.outline_every = settings.outline_every or max(1, round(steps / 100))
        self.monitor = monitor.create(
            settings.monitor if self.comm.rank == 0 else "none", sys.stderr
        )
        self.last_row = None
        on_root(self.comm, self._open, InputError)

    def _open(self):
        os.makedirs(self.folder, exist_ok=True)
        self.diagnostics = tables.Table(self.path("diagnostics.csv"), COLUMNS)
        self.outlines = None
        if self.problem.membrane is not None:
            count = len(self.problem.membrane.rest_stretch)
            self.outlines = tables.Table(
                self.path("outlines.csv"), tables.outline_columns(count)
            )

    def path(self, name):
        """Path of a file in the folder."""
        return os.path.join(self.folder, name)

    def record(self, row, state):
        """Append a row of diagnostics, an outline when it is due, and show progress."""
        self.last_row = row

        def write():
            self.diagnostics.write(row)
            if self.outlines is not None and state.step % self.outline_every == 0:
                count = len(state.markers)
                self.outlines.write(
                    tables.outline_row(state.step, state.time, 0, state.markers, count)
                )

        on_root(self.comm, write)
        self.monitor.update(row)

    def save(self, name, state, reference):
        """Write a checkpoint of the given name.  Returns its path."""
        path = self.path(name)
        checkpoint.save(path, self.problem, state, self.settings, reference)
        return path

    def summarise(self, steps, seconds, phases):
        """Write summary.json and return its content."""
        summary = {
            "versions": {
                "petscib": __version__,
                "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
                "petsc4py": petsc4py.__version__,
                "mpi4py": mpi4py.__version__,
                "numpy": np.__version__,
                "h5py": h5py.__version__,
                "python": platform.python_version(),
            },
            "ranks": self.comm.size,
            "options": self.settings.to_dict(),
            "petsc_options": PETSc.Options().getAll(),
            "output": self.folder,
            "steps": steps,
            "total_seconds": seconds,
            "phase_seconds": dict(phases),
            "last_row": self.last_row,
        }

        def write():
            with open(self.path("summary.json"), "w") as file:
                json.dump(summary, file, indent=2)
                file.write("\n")

        on_root(self.comm, write)
        return summary

    def draw(self):
        """Draw the pictures on rank 0; without matplotlib, say so and go on."""
        if self.comm.rank:
            return
        from . import plots

        try:
            plots.plot_all(self.folder)
        except ImportError as error:
            self.monitor.write(f"petscib: no pictures, {error.name} is not installed")

    def close(self):
        """Close the tables and the progress display."""
        self.monitor.close()
        if self.comm.rank == 0:
            self.diagnostics.close()
            if self.outlines is not None:
                self.outlines.close()
