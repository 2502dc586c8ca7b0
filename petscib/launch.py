"""``python -m petscib.launch mpiexec ...``: start an MPI job that Ctrl-C ends in good order.

On Ctrl-C an MPI launcher kills its ranks within a second or two, which may be less than a time
step.  SIGUSR1 it passes on; petscib then finishes the step, saves a checkpoint and ends.  So the
launcher gets a process group of its own, out of the terminal's reach, and this program turns the
first SIGINT, SIGTERM or SIGHUP into SIGUSR1.  The second goes to the launcher as SIGTERM.
"""

import os
import signal
import subprocess
import sys

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main(command):
    """Run a command; its exit status, or 128 + the number of the signal that stopped it."""
    asked = []

    def stop(kind, frame):
        job.send_signal(signal.SIGTERM if asked else signal.SIGUSR1)
        asked.append(kind)

    job = subprocess.Popen(command, stdin=subprocess.DEVNULL, preexec_fn=os.setpgrp)
    for kind in SIGNALS:
        signal.signal(kind, stop)
    signal.signal(signal.SIGUSR1, lambda kind, frame: job.send_signal(kind))
    status = job.wait()
    if asked and status == 0:
        return 128 + asked[0]
    return status if status >= 0 else 128 - status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
