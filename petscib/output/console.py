"""Standard output and error of a run that does not depend on being heard.

A full disk behind ``2>``, or a pipe whose reader has gone, must not end a simulation: its results
are in its folder.
"""

import os
import signal
import sys
from contextlib import suppress


class Console:
    """A text stream that falls silent when nobody takes what is written to it.

    Parameters
    ----------
    stream : text stream
    """

    def __init__(self, stream):
        self._stream = stream

    def __getattr__(self, name):
        return getattr(self._stream, name)

    def write(self, text):
        """Write if that is possible."""
        return self._try(self._stream.write, text)

    def flush(self):
        """Flush if that is possible."""
        self._try(self._stream.flush)

    def _try(self, action, *arguments):
        try:
            return action(*arguments)
        except OSError:
            # What is left in the buffer goes nowhere too, else Python complains at its end.
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            return None


def replace_missing():
    """Let standard output or error that was closed, as by ``>&-``, lead nowhere.

    To Python they are None.  What opens a file before this may get their numbers instead.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))


def take_pipes_back():
    """Let writing to a pipe whose reader has gone be what it was to Python, an exception.

    PETSc, once started, ends the program there, and its whole job.
    """
    with suppress(ValueError):  # Python lets its main thread alone do this
        signal.signal(signal.SIGPIPE, signal.getsignal(signal.SIGPIPE))


def is_heard(stream):
    """Whether what has been written to a stream arrives; else it falls silent."""
    return Console(stream)._try(lambda: stream.flush() or True) is not None


def protect():
    """Let standard output and error be such streams."""
    take_pipes_back()
    sys.stdout, sys.stderr = (
        stream if isinstance(stream, Console) else Console(stream)
        for stream in (sys.stdout, sys.stderr)
    )
