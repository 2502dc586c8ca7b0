"""The last good state, saved by one rank alone when the others can no longer help.

Ranks that wait in a collective call for one that has failed cannot save their parts of the state.
So each keeps a copy of its part in a file in memory, which the other ranks of the machine can
open, as long as it lives.  Keeping it may take a hundredth of the run's time.
"""

import fcntl
import os
import pickle
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from time import perf_counter, sleep

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..errors import OutputError
from . import checkpoint

SHARE = 0.01  # of the run's time that keeping copies may take, besides ...
ALLOWANCE = 0.1  # ... these seconds, in which a short run can keep every state
WAIT = 2.0  # seconds that a slower rank may need to keep the state that the others have kept
# A copy begins with 8-byte integers: step + 1, or 0 while it is written; how many pieces follow;
# and how long each is.
_INTEGER = np.dtype(np.int64)


class Rescue:
    """Copies of the ranks' parts of the state.

    Parameters
    ----------
    comm : mpi4py communicator

    Attributes
    ----------
    wanted : bool
        Whether there are other ranks, and files in memory.
    """

    def __init__(self, comm):
        self.wanted = comm.size > 1 and hasattr(os, "memfd_create")  # Linux
        self.spent = 0.0
        self.began = perf_counter()
        self._file, mine = None, ""
        if self.wanted:
            self._file = os.fdopen(os.memfd_create("petscib"), "w+b", 0)
            mine = f"/proc/{os.getpid()}/fd/{self._file.fileno()}"
        # A path on another machine would lead to another program's file, or nowhere.
        self._paths = comm.allgather((MPI.Get_processor_name(), mine))

    @property
    def is_due(self):
        """Whether there is time to keep the next state.  Not collective."""
        allowed = ALLOWANCE + SHARE * (perf_counter() - self.began)
        return self.wanted and self.spent < allowed

    def keep(self, state, progress):
        """Keep this rank's part of a state, if there is room.  Not collective."""
        begin = perf_counter()
        pieces = []
        parts = _each(_part, state)
        text = pickle.dumps((parts, progress), protocol=5, buffer_callback=pieces.append)
        pieces = [text, *(piece.raw() for piece in pieces)]
        lengths = np.array([len(pieces), *map(len, pieces)], _INTEGER)
        with suppress(OSError):
            self._write(0, np.zeros(1, _INTEGER))
            self._write(_INTEGER.itemsize, lengths, *pieces)
            self._write(0, np.array([state.step + 1], _INTEGER))
        self.spent += perf_counter() - begin

    def _write(self, position, *pieces):
        for piece in pieces:
            left = memoryview(piece).cast("B")
            while left:  # a call may write less than all
                written = os.pwrite(self._file.fileno(), left, position)
                position, left = position + written, left[written:]

    def save(self, folder, problem, settings):
        """Write a checkpoint of the state last kept.  One rank does, the others wait meanwhile.

        Returns
        -------
        str
            Its path.

        Raises
        ------
        OutputError
            On this rank: no such file can be written, or not all parts are within reach.
        """
        kept = self._collect()
        states, (progress, *_) = zip(*kept)
        state = _each(_whole, *states)
        whole = copy(problem)
        whole.grid = _WholeGrid(problem.grid)
        path = os.path.join(folder, checkpoint.name_of(state.step))
        checkpoint.save(path, whole, state, settings, progress)
        return path

    def claim(self):
        """Whether this rank is the first to want to end the job.  Not collective."""
        host, path = self._paths[0]
        if host != MPI.Get_processor_name():
            return True  # nobody can tell: better two lines than none
        try:
            with open(path, "rb") as file:
                self._claimed = os.dup(file.fileno())  # held until this rank ends
            fcntl.flock(self._claimed, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            pass
        return True

    def _collect(self):
        """What every rank has kept of the same state."""
        why = "the ranks are on several machines"
        if all(host == self._paths[0][0] and path for host, path in self._paths):
            why = "the ranks have kept different states"
            end = perf_counter() + WAIT
            while perf_counter() < end:
                try:
                    kept = [_read(path) for _, path in self._paths]
                except OSError as error:
                    raise OutputError(f"a rank cannot be reached: {error.strerror}") from None
                if None not in kept and len({state.step for state, _ in kept}) == 1:
                    return kept
                sleep(0.01)
        raise OutputError(why)


def _each(action, *states):
    """A state whose entries, those of its history too, are made of the given states' entries."""
    made = copy(states[0])
    for name, values in _entries(map(vars, states)):
        setattr(made, name, action(*values))
    made.history = {
        name: action(*values) for name, values in _entries(state.history for state in states)
    }
    return made


def _entries(mappings):
    first, *others = mappings
    return [(name, (value, *(other[name] for other in others))) for name, value in first.items()]


@dataclass
class _Part:
    """A rank's part of a vector."""

    values: np.ndarray


def _part(value):
    return _Part(value.getArray(readonly=True)) if isinstance(value, PETSc.Vec) else value


def _whole(first, *others):
    """What rank 0 has kept; of a vector, the sequential one that all ranks' parts make."""
    if not isinstance(first, _Part):
        return first
    values = np.concatenate([part.values for part in (first, *others)])
    return PETSc.Vec().createWithArray(values, comm=PETSc.COMM_SELF)


def _read(path):
    """What a rank has kept, or None if it is writing."""
    with open(path, "rb") as file:
        before = file.read(_INTEGER.itemsize)
        file.seek(0)
        content = memoryview(file.read())
        file.seek(0)
        after = file.read(_INTEGER.itemsize)
    if before != after or not any(before):
        return None
    count = int(np.frombuffer(content, _INTEGER, 2)[1])
    lengths = np.frombuffer(content, _INTEGER, 2 + count)[2:]
    ends = (2 + count) * _INTEGER.itemsize + np.cumsum([0, *lengths])
    text, *buffers = (content[begin:end] for begin, end in zip(ends[:-1], ends[1:]))
    return pickle.loads(text, buffers=buffers)


class _WholeGrid:
    """A grid as one rank sees it that holds everything."""

    def __init__(self, grid):
        self._grid = grid
        self.comm = PETSc.COMM_SELF
        self.u_box = self.v_box = self.p_box = ...

    def __getattr__(self, name):
        return getattr(self._grid, name)

    def velocity_blocks(self, vector):
        values = vector.getArray(readonly=True)
        return values[self.u_index], values[self.v_index]

    def pressure_block(self, vector):
        return vector.getArray(readonly=True)[self.p_index]
