"""An exception that a script does not catch on one rank ends the job instead of hanging it."""

import sys
import time

from .errors import Error

PATIENCE = 1.0  # seconds in which the first rank can say on behalf of all what all have met


def end_the_job(comm):
    """See to it, on several ranks, unless the script has a hook of its own.  Not collective.

    Errors of petscib are raised on all ranks alike: the first one prints their line, and the exit
    status is the command line's.  Any other exception prints its traceback.

    Parameters
    ----------
    comm : mpi4py communicator
    """
    if comm.size == 1 or sys.excepthook is not sys.__excepthook__:
        return

    def hook(kind, error, traceback):
        if not isinstance(error, Error):
            sys.__excepthook__(kind, error, traceback)
        elif comm.rank == 0:
            print(f"petscib: {error}", file=sys.stderr)
        else:
            time.sleep(PATIENCE)
        sys.stderr.flush()
        comm.Abort(getattr(error, "exit_status", 1))

    sys.excepthook = hook
