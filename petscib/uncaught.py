"""An exception that a script does not catch on one rank ends the job instead of hanging it."""

import atexit
import signal
import sys
import time
from contextlib import suppress

from .errors import Error
from .output import console

PATIENCE = 1.0  # seconds in which the first rank can say on behalf of all what all have met


def end_the_job(comm):
    """See to it, unless the script has a hook of its own.  Not collective.

    Errors of petscib are raised on all ranks alike: of several, the first one prints their line,
    and the exit status is the command line's.  Any other exception prints its traceback, but for
    that of a script whose printing nobody listens to any more, as under ``| head``: it ends
    quietly, as a shell expects it to.

    Parameters
    ----------
    comm : mpi4py communicator
    """
    if sys.excepthook is not sys.__excepthook__:
        return

    def hook(kind, error, traceback):
        status = getattr(error, "exit_status", 1)
        if isinstance(error, BrokenPipeError) and not console.is_heard(sys.stdout):
            status = 128 + signal.SIGPIPE
            if comm.size == 1:
                sys.exit(status)
        elif comm.size == 1 or not isinstance(error, Error):
            sys.__excepthook__(kind, error, traceback)
        elif comm.rank == 0:
            with suppress(OSError):
                print(f"petscib: {error}", file=sys.stderr, flush=True)
        else:
            time.sleep(PATIENCE)
        if comm.size > 1:
            comm.Abort(status)

    sys.excepthook = hook
    # What is printed last would be found unheard by Python only, which complains.
    atexit.register(lambda: console.is_heard(sys.stdout))
