"""One petscib run in a process of its own: its command, its time limit, and what came of it."""

import hashlib
import json
import math
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter

import numpy as np

from .. import __version__, launch
from ..output import tables
from ..output.files import write_text
from ..settings import text_of

FINISHED, FAILED, REFUSED, CRASHED, STOPPED = (
    "finished", "failed", "refused", "crashed", "time limit")
_BY_EXIT_STATUS = {0: FINISHED, 2: REFUSED, 3: FAILED}
NOT_STARTED = 127  # as a shell says it
GRACE = 10.0  # seconds between asking a run to stop and ending it
QUIET = {"monitor": "none", "plot": False}


@dataclass(frozen=True)
class Run:
    """A run to be made.

    Parameters
    ----------
    options : mapping of str to value
        petscib's options, without -output.
    ranks : int
    time_limit : float
        Seconds after which the run is stopped.
    """

    program = "petscib"  # the module that makes it

    options: Mapping
    ranks: int = 1
    time_limit: float = math.inf

    @cached_property
    def texts(self):
        """Option names to texts."""
        return {name: text_of(value) for name, value in {**self.options, **QUIET}.items()}

    @cached_property
    def key(self):
        """Short name that stands for the options, the ranks and the program's version."""
        identity = json.dumps([sorted(self.texts.items()), self.ranks, __version__])
        return hashlib.sha256(identity.encode()).hexdigest()[:12]

    def arguments(self, folder):
        """Words of the command line after the interpreter."""
        words = ["-m", self.program]
        for name, text in self.texts.items():
            words += ["-" + name, text]
        return [*words, "-output", folder]

    def command(self, folder):
        """The run as one types it."""
        return shlex.join(["mpiexec", "-n", str(self.ranks), "python", *self.arguments(folder)])


@dataclass(frozen=True)
class Outcome:
    """What came of a run; its files lie in `folder`.

    Attributes
    ----------
    run : Run
    folder : str
    status : str
        One of the words at the top of this module.
    reason : str
        petscib's last line when the run did not finish.
    seconds : float
        From start to end of the process.
    """

    run: Run
    folder: str
    status: str
    reason: str = ""
    seconds: float = 0.0
    command: str = field(default="", compare=False)

    @property
    def finished(self):
        """Whether the run reached its end."""
        return self.status == FINISHED

    @property
    def is_result(self):
        """Whether it says something of the method: also a failure does, unlike a crash."""
        return self.status in (FINISHED, FAILED, STOPPED)

    @cached_property
    def rows(self):
        """The columns of diagnostics.csv; empty when the run wrote none."""
        try:
            return tables.read(os.path.join(self.folder, "diagnostics.csv"))
        except FileNotFoundError:
            return {}

    def column(self, name):
        """A column without the rows where it does not apply."""
        values = self.rows.get(name, np.zeros(0))
        return values[np.isfinite(values)]

    def largest(self, name):
        """Largest value of a column over the run; None without any."""
        return max(self.column(name), default=None)

    def last(self, name):
        """Last value of a column; None without any."""
        values = self.column(name)
        return float(values[-1]) if len(values) else None

    def mean(self, name, window, back=0):
        """Mean of a column over a window of time, where it applies; None where it never does.

        Parameters
        ----------
        name : str
        window : float
        back : int
            How many windows before the end of the run the last of these is.
        """
        time, values = self.rows["time"], self.rows[name]
        end = time[-1] - back * window
        values = values[(time > end - window) & (time <= end) & np.isfinite(values)]
        return float(values.mean()) if len(values) else None

    @property
    def steps(self):
        """Number of accepted steps."""
        return int(self.last("step") or 0)

    @property
    def step_seconds(self):
        """Mean wall seconds of a step, set-up left out; None without steps."""
        walls = self.column("wall_seconds")
        return float(walls[-1] - walls[0]) / self.steps if len(walls) > 1 else None

    @cached_property
    def _summary(self):
        try:
            with open(os.path.join(self.folder, "summary.json")) as file:
                return json.load(file)
        except FileNotFoundError:
            return {}

    @property
    def cpu_seconds(self):
        """Processor seconds a rank, which other programs on the machine change little."""
        return self._summary["cpu_seconds"] / self.run.ranks if self._summary else None

    @property
    def step_cpu_seconds(self):
        """Those of a step, set-up left out; None without steps."""
        return self.step_seconds and (
            self.step_seconds * self.cpu_seconds / self._summary["total_seconds"])

    def final(self):
        """Arrays of final.h5: u, v, p and, with a vesicle, its markers X."""
        import h5py

        with h5py.File(os.path.join(self.folder, "final.h5"), "r") as file:
            found = {name: file[f"fluid/{name}"][...] for name in "uvp"}
            if "vesicle_0" in file:
                found["X"] = file["vesicle_0/X"][...]
        return found

    def curves(self):
        """Markers of each vesicle in final.h5."""
        import h5py

        with h5py.File(os.path.join(self.folder, "final.h5"), "r") as file:
            count = sum(name.startswith("vesicle_") for name in file)
            return [file[f"vesicle_{k}/X"][...] for k in range(count)]


def execute(run, folder):
    """Make the run, wait for it, and return its Outcome, which `recall` finds later."""
    shutil.rmtree(folder, ignore_errors=True)  # half a run would look like this one's
    os.makedirs(folder)
    environment = launch.environment()
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    search = [root, *filter(None, [environment.get("PYTHONPATH")])]
    environment["PYTHONPATH"] = os.pathsep.join(search)
    command = [*launch.launcher(), "-n", str(run.ranks), sys.executable, *run.arguments(folder)]
    log = os.path.join(folder, "log.txt")
    began = perf_counter()
    # A file, not a pipe: a rank left behind would hold a pipe open.
    with open(log, "w") as output:
        try:
            job = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output,
                                   env=environment, stderr=subprocess.STDOUT,
                                   start_new_session=True)
        except OSError as error:
            output.write(f"cannot start {command[0]}: {error.strerror}\n")
            exit_status = NOT_STARTED
        else:
            exit_status = _wait(job, run.time_limit)
    seconds = perf_counter() - began
    status, reason = STOPPED, f"not finished after {run.time_limit:g} s"
    if exit_status is not None:
        status = _BY_EXIT_STATUS.get(exit_status, CRASHED)
        reason = "" if status == FINISHED else _reason(log, status, exit_status)
    outcome = Outcome(run, folder, status, reason, seconds, run.command(folder))
    _remember(outcome)
    return outcome


def _wait(job, time_limit):
    """Exit status of a job, or None when it had to be stopped."""
    try:
        return job.wait(None if math.isinf(time_limit) else time_limit)
    except subprocess.TimeoutExpired:
        job.terminate()  # the launcher takes its ranks with it
        return None
    finally:
        if job.poll() is None:
            job.terminate()
            try:
                job.wait(GRACE)
            except subprocess.TimeoutExpired:
                os.killpg(job.pid, signal.SIGKILL)
                job.wait()


def _reason(log, status, exit_status):
    """Petscib's own last words, or of a crash the line that tells most."""
    with open(log, errors="replace") as file:
        text = file.read()
    ours = [line for line in text.splitlines() if line.startswith("petscib: ")]
    if ours and status != CRASHED:
        return ours[-1].strip()
    # The exception is the first line after a traceback that is not indented. Without one, what
    # went wrong is said first (by MPI, PETSc or the system), and what came of it later.
    exception = re.search(
        r"^Traceback \(most recent call last\):\n(?:[ \t].*\n)*(\S.*)", text, re.M)
    said = re.findall(r"^(?:\[\d+\]PETSC ERROR:)?[ \t]*(?!petscib: )(\w\S* .*)", text, re.M)
    what = exception[1] if exception else said[0] if said else "no message"
    return f"{what.strip()} (exit status {exit_status})"


def _remember(outcome):
    """Leave the outcome in its folder, whole or not at all."""
    path = os.path.join(outcome.folder, "outcome.json")
    record = {
        "options": outcome.run.texts,
        "ranks": outcome.run.ranks,
        "command": outcome.command,
        "status": outcome.status,
        "reason": outcome.reason,
        "seconds": outcome.seconds,
        "time_limit": None if math.isinf(outcome.run.time_limit) else outcome.run.time_limit,
    }
    write_text(path, json.dumps(record, indent=2))


def recall(run, folder):
    """Outcome of an earlier execution in a folder; None when there is none that serves.

    Runs that crashed or were refused are made again, since that is for someone to mend; so is one
    that was stopped by its time limit, when it may take longer now.
    """
    try:
        with open(os.path.join(folder, "outcome.json")) as file:
            record = json.load(file)
    except FileNotFoundError:
        return None
    status = record["status"]
    if status in (CRASHED, REFUSED) or (
            status == STOPPED and run.time_limit > record["time_limit"]):
        return None
    return Outcome(run, folder, status, record["reason"], record["seconds"], record["command"])
