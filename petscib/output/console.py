"""Standard output and error of a run that does not depend on being heard.

A full disk behind ``2>``, or a pipe whose reader has gone, must not end a simulation: its results
are in its folder.
"""

import os
import signal
import sys


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


def protect():
    """Let standard output and error be such streams."""
    # PETSc, once started, would end the program at a pipe whose reader has gone.
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    sys.stdout, sys.stderr = (
        stream if isinstance(stream, Console) else Console(stream)
        for stream in (sys.stdout, sys.stderr)
    )
