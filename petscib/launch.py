"""``python -m petscib.launch -n 2 python -m petscib ...``: start an MPI job, and end it well.

The launcher is `$MPIEXEC`, by default the one that belongs to mpi4py's MPI, and it gets the
settings that our jobs want.  On Ctrl-C a launcher kills its ranks within a second or two, which may
be less than a time step.  SIGUSR1 it passes on; petscib then finishes the step, saves a checkpoint
and ends.  So the launcher gets a process group of its own, out of the terminal's reach, and this
program turns the first SIGINT, SIGTERM or SIGHUP into SIGUSR1.  The second goes to the launcher as
SIGTERM.  Open MPI's launcher also kills its ranks when nobody reads what they print any more, as in
``| head``.  So it writes to this program, which passes on what it can.
"""

import importlib.util
import os
import re
import select
import shlex
import shutil
import signal
import stat
import subprocess
import sys
from contextlib import suppress
from functools import lru_cache
from threading import Lock, Thread

from .errors import InputError
from .interrupt import heeded, say

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Names under which a machine with several MPIs has their launchers.
NAMES = "mpiexec", "mpiexec.openmpi", "mpiexec.mpich", "mpiexec.hydra", "mpirun", "orterun"
# More ranks than cores are fine; two jobs at a time must not be bound to the same core; our own
# message about what went wrong is enough (which versions 5 and 6 cannot be told).  Version 6 warns
# of the names that version 5 has.
_OPEN_MPI = {
    4: {
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "OMPI_MCA_hwloc_base_binding_policy": "none",
        "OMPI_MCA_orte_execute_quiet": "1",
    },
    5: {
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
        "PRTE_MCA_hwloc_default_binding_policy": "none",
    },
    6: {"PRTE_MCA_mapby": ":oversubscribe", "PRTE_MCA_bindto": "none"},
}
_LIBRARY = ("import mpi4py; mpi4py.rc.initialize = False; from mpi4py import MPI; "
            "print(MPI.Get_library_version())")


def launcher():
    """Words that start a launcher, to be followed by ``-n RANKS COMMAND``.

    `$MPIEXEC`, or the launcher of the MPI that this interpreter's mpi4py is linked to.

    Raises
    ------
    InputError
        There is none.
    """
    given = shlex.split(os.environ.get("MPIEXEC", ""))
    return given or [_find_launcher()]


@lru_cache
def _library():
    """What the MPI library under mpi4py says of itself; "" without mpi4py.

    Asked in another process: in this one the library must not be loaded before it is used.
    """
    return _output(sys.executable, "-c", _LIBRARY)


def _output(*command):
    """What a command prints; "" when it fails."""
    result = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                            env=dict(os.environ))
    return "" if result.returncode else result.stdout


def _is_open_mpi(version):
    """Whether a library or launcher is Open MPI's.  All others here start each other's ranks."""
    return "Open MPI" in version or "OpenRTE" in version


def _find_launcher():
    """Path of the launcher that belongs to mpi4py."""
    if not _library():
        raise InputError(f"{sys.executable} cannot import mpi4py")
    # PREFIX/lib/python3/site-packages/mpi4py/__init__.py: its MPI may be in the same PREFIX.
    prefix = importlib.util.find_spec("mpi4py").origin
    for _ in range(5):
        prefix = os.path.dirname(prefix)
    folders = os.path.join(prefix, "bin"), os.environ.get("PATH", os.defpath)
    for name in NAMES:
        path = shutil.which(name, path=os.pathsep.join(folders))
        if path and _is_open_mpi(_output(path, "--version")) == _is_open_mpi(_library()):
            return path
    kind = " ".join(_library().splitlines()[0].split(",")[0].split())
    raise InputError(f"no mpiexec of {kind}, which mpi4py uses, was found; MPIEXEC may name it")


def environment():
    """Environment for an MPI job: this process's, before which our own settings give way.

    It is Python's copy of it.  An MPI library in this process may have added to C's, and an MPI job
    does not start inside another's.
    """
    settings = {"OMP_NUM_THREADS": "1"}  # the ranks are the parallelism
    if _is_open_mpi(_library()):
        version = int(re.search(r"Open MPI v?(\d+)", _library())[1])
        # Ranks that wait give way to those that compute.  Main job on two busy cores, seconds a
        # step: 4 ranks 0.2 to 0.5 with it, 29 to 61 without; 2 ranks 0.08 to 0.16, 0.08 to 0.39.
        settings["OMPI_MCA_mpi_yield_when_idle"] = "1"
        settings.update(_OPEN_MPI[min(max(version, 4), 6)])
        if os.geteuid() == 0:
            settings.update(OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1")
    return {**settings, **os.environ}


class _Outlet:
    """Where a job writes: a file, or a pipe of which this program passes on what comes.

    Parameters
    ----------
    target : int
        The file descriptor where it shall go; a pipe may lose its reader.
    """

    def __init__(self, target):
        self.file = self._target = target
        self._thread = None
        if stat.S_ISFIFO(os.fstat(target).st_mode):
            self._source, self.file = os.pipe()
            os.set_blocking(self._source, False)
            self._passing = Lock()
            self._thread = Thread(target=self._pass_on, daemon=True)

    def _pass_on(self, patience=None):
        """Until nobody can write any more, or nothing comes for so many seconds."""
        while select.select([self._source], [], [], patience)[0]:
            with self._passing:
                try:
                    words = os.read(self._source, 1 << 16)
                except BlockingIOError:  # the other thread has them
                    continue
                if not words:
                    return
                with suppress(OSError):
                    while words:
                        # One that does not block refuses what it has no room for.
                        select.select([], [self._target], [])
                        words = words[os.write(self._target, words):]

    def begin(self):
        """Pass on, once the job has the other end."""
        if self._thread is not None:
            os.close(self.file)
            self._thread.start()

    def finish(self):
        """Pass on what is left.  A rank left behind may hold the other end for ever."""
        if self._thread is not None:
            self._pass_on(0)


def main(arguments):
    """Start a job; its exit status, or 128 + the number of the signal that stopped it.

    Parameters
    ----------
    arguments : list of str
        What follows the launcher: its options and the command.
    """
    asked = []

    def stop(kind, frame):
        asked.append(kind)  # first, as the next signal may come any time
        if asked == [signal.SIGINT]:
            say("petscib: told to end after this step; a second Ctrl-C ends it at once")
        job.send_signal(signal.SIGTERM if len(asked) > 1 else signal.SIGUSR1)

    outlets = [_Outlet(stream.fileno()) for stream in (sys.stdout, sys.stderr)]
    try:
        command = launcher()
        job = subprocess.Popen([*command, *arguments], stdin=subprocess.DEVNULL,
                               stdout=outlets[0].file, stderr=outlets[1].file,
                               env=environment(), preexec_fn=os.setpgrp)
    except InputError as error:
        print(f"petscib: {error}", file=sys.stderr)
        return error.exit_status
    except OSError as error:
        print(f"petscib: cannot start {command[0]}: {error.strerror}; MPIEXEC={command[0]} should "
              "name the launcher of mpi4py's MPI", file=sys.stderr)
        return InputError.exit_status
    for outlet in outlets:
        outlet.begin()
    for kind in heeded(SIGNALS):
        signal.signal(kind, stop)
    signal.signal(signal.SIGUSR1, lambda kind, frame: job.send_signal(kind))
    status = job.wait()
    for outlet in outlets:
        outlet.finish()
    if asked and (status == 0 or len(asked) > 1):  # of a job killed, the launcher's own says little
        return 128 + asked[0]
    return status if status >= 0 else 128 - status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
