"""Signals that ask a run to stop: noted when they come, acted upon between two steps."""

import os
import signal
from contextlib import suppress

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)


class Interrupt:
    """Notes SIGINT, SIGTERM, SIGHUP and SIGUSR1 inside a ``with`` block.  Not collective.

    However often they come, the step is finished and the state saved: a launcher and a batch
    system may each send theirs.  Only a second Ctrl-C (SIGINT) ends the program at once.

    Attributes
    ----------
    caught : int
        Number of the signal noted last; 0 when there was none.
    at_once : callable or None
        Called when SIGTERM comes, wherever the program is: its sender may not wait for the end of
        the step.
    notice : str
        Printed at the first Ctrl-C: the step may still take long.
    """

    def __init__(self):
        self.caught = 0
        self.at_once = None
        self.notice = ""
        self._before = {}

    def __enter__(self):
        self._before = {kind: signal.signal(kind, self._note) for kind in heeded(SIGNALS)}
        return self

    def __exit__(self, *error):
        for kind, handler in self._before.items():
            signal.signal(kind, handler)

    def _note(self, kind, frame):
        self.caught = kind
        if kind == signal.SIGTERM and self.at_once is not None:
            act, self.at_once = self.at_once, None
            act()
        if kind == signal.SIGINT:
            signal.signal(kind, signal.SIG_DFL)
            if self.notice:
                say(self.notice)


def say(line):
    """Print a line from within a signal's handler: `print` may be at work just now."""
    with suppress(OSError):
        start = "\n" if os.isatty(2) else ""  # where a progress bar and ^C are
        os.write(2, f"{start}{line}\n".encode())


def heeded(kinds):
    """Those of the signals to heed: SIGHUP, as a terminal goes, is ignored under ``nohup``."""
    return [kind for kind in kinds
            if kind != signal.SIGHUP or signal.getsignal(kind) != signal.SIG_IGN]


def exit_status(kind):
    """What a shell expects of a program that a signal stopped; SIGUSR1 is a plain request."""
    return 128 + kind if kind not in (0, signal.SIGUSR1) else 0
