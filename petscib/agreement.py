"""What all ranks must know alike: once a step they learn whether one of them has failed."""

from time import monotonic, sleep

import numpy as np
from mpi4py import MPI

from .errors import Crash, InputError, SolveError, ours

SEVERITY = Crash, InputError, SolveError  # the first that any rank has is everybody's


def on_root(comm, action):
    """Run `action` on rank 0; its result, or its InputError or SolveError, on all.  Collective."""
    result = trouble = None
    if comm.rank == 0:
        try:
            result = action()
        except (InputError, SolveError) as error:
            trouble = ours(error)
    result, trouble = comm.bcast((result, trouble))
    if trouble is not None:
        raise trouble
    return result


def everywhere(comm, action):
    """Result of an action of all ranks; an InputError that any rank meets with, on all.

    Collective.
    """
    result = trouble = None
    try:
        result = action()
    except InputError as error:
        trouble = ours(error)
    trouble = next(filter(None, comm.allgather(trouble)), None)
    if trouble is not None:
        raise trouble
    return result


class Agreement:
    """Meetings of all ranks, to which a rank comes also when its work has failed.  Collective.

    The others may then never come: they wait, in a collective call of the work, for the rank that
    has failed.  So that rank does not wait for them longer than its patience lasts.

    Parameters
    ----------
    comm : mpi4py communicator
    """

    def __init__(self, comm):
        self.comm = comm.Dup()  # nothing else may match what is sent here

    def meet(self, numbers, patience=None):
        """The largest of each number over the ranks; None if some did not come in time.

        Parameters
        ----------
        numbers : list of float
            As many on each rank.
        patience : float, optional
            Seconds to wait; without end by default.
        """
        mine = np.array(numbers, dtype=float)
        largest = np.empty_like(mine)
        request = self.comm.Iallreduce(mine, largest, op=MPI.MAX)
        if patience is None:
            request.Wait()
            return largest.tolist()
        end = monotonic() + patience
        while not request.Test():
            if monotonic() > end:
                return None
            sleep(0.001)
        return largest.tolist()

    def common(self, trouble):
        """The error that all ranks shall raise, and the rank that had it first.  Collective.

        Parameters
        ----------
        trouble : InputError, SolveError or None
            This rank's; at least one rank has some.
        """
        troubles = self.comm.allgather(trouble)
        having = [rank for rank, one in enumerate(troubles) if one is not None]
        first = min(having, key=lambda rank: _severity(troubles[rank]))
        error = troubles[first]
        if isinstance(error, Crash) and len(having) < len(troubles):
            error = on_rank(error, first)
        return error, first

    def destroy(self):
        """Free the communicator.  Collective."""
        self.comm.Free()


def on_rank(error, rank):
    """The same error, saying on which rank it was raised."""
    return type(error)(f"{error} (on rank {rank})")


def _severity(error):
    return next(k for k, kind in enumerate(SEVERITY) if isinstance(error, kind))
