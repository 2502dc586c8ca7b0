"""Plumbing for tests that need several ranks.

Two ways, both from one ordinary ``python -m pytest``:

- ``@pytest.mark.parallel([1, 2, 3])`` on a test (or ``pytestmark = pytest.mark.parallel(2)`` for a
  module) runs the test's body on that many ranks. It passes when it passes on every rank. All such
  tests of a module that ask for the same number of ranks share one MPI job, since starting one
  takes a second; a test that fails ends its job, and the rest continue in a new one. With 1 rank
  the test runs in place. `tmp_path` is one folder for all ranks, `ranks` is their number.
- The fixture ``mpirun(ranks, *args)`` runs ``python *args`` on that many ranks, for example
  ``mpirun(2, "-m", "petscib", "-ts_max_steps", "3")``.

Nothing waits for ever: a job in which no rank finishes a test for `timeout` seconds is stopped, and
the report names the ranks that had not finished.
"""
import json
import os
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile
import time

import pytest
from hypothesis import settings

from petscib import launch

os.environ.setdefault("OMP_NUM_THREADS", "1")  # for tests in this process; numpy is not there yet
# Open MPI 5 complains of networks that it will not need: all ranks are on this machine.
os.environ.setdefault("OMPI_MCA_btl", "^tcp")
ROOT = pathlib.Path(__file__).resolve().parents[1]
TIMEOUT = 120.0
JOB = os.environ.get("PETSCIB_TEST_JOB")  # set inside an MPI job: the folder of its results
WORLD_SIZE = int(os.environ.get("OMPI_COMM_WORLD_SIZE") or os.environ.get("PMI_SIZE") or 0)
GRACE = 2.0  # seconds that a failing rank leaves the others to report on the same test
REPORTS = pytest.StashKey[list]()

# The same examples on every rank and in every run.
settings.register_profile("petscib", derandomize=True, database=None, deadline=None)
settings.load_profile("petscib")


# ---------------------------------------------------------------- starting MPI jobs


def mpi_environment(**extra):
    """Environment for MPI jobs, in which this petscib is found."""
    environment = launch.environment()
    search = [str(ROOT), *filter(None, [environment.get("PYTHONPATH")])]
    environment.update(PYTHONPATH=os.pathsep.join(search), **extra)
    return environment


def start(ranks, args, **keywords):
    """Start ``python *args`` on `ranks` ranks; the process leads a session of its own."""
    command = [*launch.launcher(), "-n", str(ranks), sys.executable, *map(str, args)]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True, **keywords)


# What launchers say of their own accord: Open MPI's boxes and remarks, Hydra's banner.
NOISE = re.compile("|".join((
    r"^-{50,}\n(?:(?!-{50,}\n).*\n)*?(?!-{50,}\n).*"
    r"(?:prterun|mpirun|mpiexec|MPI_ABORT|Deprecated variable|Primary job).*\n(?:.*\n)*?-{50,}\n",
    r"^(?:\[\S+\] )?\d+ more process.* sent help message .*\n",
    r"^\[\S+:\d+\] PMIX ERROR: .*\n",  # of a launcher whose ranks end while it stops them
    r"^(?:\[\S+\] )?Set .*(?:AGGREGATE_HELP|help_aggregate).*\n",
    r"^\0+\n?",  # Open MPI 5 after a rank has aborted the job
    r"^=+\n= +BAD TERMINATION .*\n(?:=.*\n)+(?:YOUR APPLICATION .*\n)?(?:(?:This|Please) .*\n)*",
)), re.M)


def without_noise(text):
    """What a job has printed, without what its launcher has."""
    return NOISE.sub("", text)


def stop(process):
    """End an MPI job. Asked nicely first, the launcher takes its ranks with it."""
    process.terminate()
    try:
        process.wait(timeout=5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@pytest.fixture
def mpirun(tmp_path):
    """Run ``python *args`` under mpiexec in the test's temporary folder.

    ``mpirun(ranks, *args, timeout=120, check=True, env={})`` returns a `CompletedProcess` with text
    in `stdout` and `stderr`, less what the launcher itself has said. With `check` a non-zero exit
    status fails the test; running out of time always does.
    """

    def run(ranks, *args, timeout=TIMEOUT, check=True, env=None):
        out, err = tmp_path / "mpirun.stdout", tmp_path / "mpirun.stderr"
        # Files, not pipes: a rank left behind would hold a pipe open, and reading it would hang.
        with out.open("w") as stdout, err.open("w") as stderr:
            process = start(ranks, args, cwd=tmp_path, env=mpi_environment(**(env or {})),
                            stdout=stdout, stderr=stderr)
            try:
                status = process.wait(timeout=timeout)
            except subprocess.TimeoutExpired:
                status = None
            finally:
                if process.poll() is None:
                    stop(process)
        result = subprocess.CompletedProcess(
            process.args, status,
            *(without_noise(file.read_text(errors="replace")) for file in (out, err)))
        if status is None or (check and status != 0):
            end = f"no end after {timeout:g} s" if status is None else f"exit status {status}"
            pytest.fail(f"{shlex.join(process.args)}: {end}\n--- stdout\n{result.stdout}"
                        f"--- stderr\n{result.stderr}", pytrace=False)
        return result

    return run


# ---------------------------------------------------------------- the mark, and collection


def pytest_configure(config):
    config.addinivalue_line("markers", "parallel(ranks, timeout=120): run the test on that many "
                            "MPI ranks, or on each number of a list")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config):
    """Two at most: each runs jobs of up to four ranks, and tests of signals keep an eye on time."""
    return min(2, os.cpu_count() or 1)


def pytest_generate_tests(metafunc):
    mark = metafunc.definition.get_closest_marker("parallel")
    if mark:
        ranks = mark.args[0]
        if "ranks" not in metafunc.fixturenames:
            metafunc.fixturenames.append("ranks")
        metafunc.parametrize("ranks", [ranks] if isinstance(ranks, int) else list(ranks),
                             ids=lambda n: f"ranks={n}")


@pytest.hookimpl(trylast=True)  # after -k and -m have had their say
def pytest_collection_modifyitems(config, items):
    jobs = {}
    for index, item in enumerate(items):
        ranks = item.callspec.params["ranks"] if item.get_closest_marker("parallel") else 1
        if WORLD_SIZE:  # pytest itself runs under mpiexec, by our doing or the user's
            if ranks not in (1, WORLD_SIZE):
                item.add_marker(pytest.mark.skip(reason=f"needs {ranks} ranks"))
        elif ranks > 1:
            job = jobs.setdefault((item.path, ranks), Job(config, ranks))
            items[index] = RemoteTest.from_parent(item.parent, name=item.name, test=item, job=job)
            job.tests.append(items[index])


class RemoteTest(pytest.Item):
    """Stands, in the process that the user started, for a test that runs in an MPI job."""

    def __init__(self, *, test, job, **keywords):
        super().__init__(**keywords)
        self.test, self.job = test, job
        self.own_markers = test.own_markers
        self.timeout = test.get_closest_marker("parallel").kwargs.get("timeout", TIMEOUT)

    def runtest(self):
        outcome, text = self.job.outcome_of(self)
        if outcome == "failed":
            raise FailedOnRanks(text)
        if outcome == "skipped":
            pytest.skip(text)

    def repr_failure(self, excinfo):
        if isinstance(excinfo.value, FailedOnRanks):
            return str(excinfo.value)
        return super().repr_failure(excinfo)

    def reportinfo(self):
        return self.test.reportinfo()


class FailedOnRanks(Exception):
    """A test failed on some ranks; the text is their reports."""


# ---------------------------------------------------------------- outside the job


class Job:
    """The tests of one module for one number of ranks, and their outcomes once run."""

    def __init__(self, config, ranks):
        self.config, self.ranks = config, ranks
        self.tests, self.outcomes = [], {}

    def outcome_of(self, test):
        """Return ('passed' | 'failed' | 'skipped', text), running MPI jobs until it is known."""
        if test.nodeid not in self.outcomes:
            self.run([other for other in self.tests if other.nodeid not in self.outcomes])
        return self.outcomes[test.nodeid]

    def run(self, tests):
        """Run tests in one MPI job, up to and including the first that fails."""
        with tempfile.TemporaryDirectory(prefix="petscib-") as folder:
            folder = pathlib.Path(folder)
            args = ["-m", "pytest", "-q", "--no-header", "--color=no", "--runxfail",
                    "-p", "no:cacheprovider",
                    # A rank that hangs shows where, before the job is stopped.
                    "-o", f"faulthandler_timeout={0.8 * min(test.timeout for test in tests)}",
                    "-c", self.config.inipath or os.devnull, "--rootdir", self.config.rootpath,
                    *(test.nodeid for test in tests)]
            environment = mpi_environment(PETSCIB_TEST_JOB=str(folder),
                                          PYTEST_DEBUG_TEMPROOT=str(folder),
                                          OMPI_MCA_orte_execute_quiet="0")  # name dead ranks
            with (folder / "output").open("w") as output:
                process = start(self.ranks, args, cwd=self.config.rootpath, env=environment,
                                stdout=output, stderr=subprocess.STDOUT)
                try:
                    end = self.wait(process, folder, {test.nodeid: test.timeout for test in tests})
                finally:
                    if process.poll() is None:
                        stop(process)
            records = [read_records(folder, rank) for rank in range(self.ranks)]
            output = (folder / "output").read_text(errors="replace")
        for test in tests:
            outcome = self.judge([record.get(test.nodeid) for record in records], end, output)
            self.outcomes[test.nodeid] = outcome
            if outcome[0] == "failed":
                break

    def wait(self, process, folder, timeouts):
        """Wait for the job's end, or until no rank has finished a test for too long.

        Returns what ended it, in words.
        """
        finished, since = None, time.monotonic()
        while process.poll() is None:
            time.sleep(0.05)
            records = [read_records(folder, rank) for rank in range(self.ranks)]
            done_everywhere = set.intersection(*map(set, records))
            waiting = [name for name in timeouts if name not in done_everywhere]
            if finished != sum(map(len, records)):
                finished, since = sum(map(len, records)), time.monotonic()
            timeout = timeouts[waiting[0]] if waiting else TIMEOUT
            if time.monotonic() - since > timeout:
                return f"stopped after {timeout:g} s without progress"
        return f"ended with exit status {process.returncode}"

    @staticmethod
    def judge(reports, end, output):
        """Combine one test's reports, one a rank or None, into an outcome and its text."""
        failed = [(rank, report["text"]) for rank, report in enumerate(reports)
                  if report and report["outcome"] == "failed"]
        missing = [rank for rank, report in enumerate(reports) if not report]
        texts = [f"--- rank {rank} failed\n{text}" for rank, text in failed]
        if missing:
            ranks = ", ".join(map(str, missing))
            texts.append(f"--- rank {ranks} did not finish" +
                         ("" if failed else f" (the job {end}); the job's output:\n{output}"))
        if texts:
            return "failed", "\n".join(texts)
        skipped = [report["text"] for report in reports if report["outcome"] == "skipped"]
        return ("skipped", skipped[0]) if skipped else ("passed", "")


def read_records(folder, rank):
    """Reports of one rank, by test: the finished ones, a torn last line left out."""
    path = folder / f"rank-{rank}"
    lines = path.read_text().split("\n")[:-1] if path.exists() else []
    return {record["test"]: record for record in map(json.loads, lines)}


# ---------------------------------------------------------------- inside the job


@pytest.fixture
def tmp_path(tmp_path):
    """Pytest's temporary folder; inside an MPI job, that of rank 0 on all ranks. Collective."""
    if not WORLD_SIZE:
        return tmp_path
    from mpi4py import MPI
    return MPI.COMM_WORLD.bcast(tmp_path)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item):
    report = (yield).get_result()
    item.stash.setdefault(REPORTS, []).append(report)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    yield
    if JOB:
        record_and_wait(item.nodeid, item.stash[REPORTS])


def record_and_wait(test, reports):
    """Write down this rank's outcome of a test, then wait for the others. Collective.

    The rank where a test has failed ends the job: the others may be stuck in a call it left out.
    """
    from mpi4py import MPI
    comm = MPI.COMM_WORLD
    outcomes = [report.outcome for report in reports]
    outcome = next((o for o in ("failed", "skipped") if o in outcomes), "passed")
    texts = [text_of(report) for report in reports if report.outcome == outcome != "passed"]
    record = {"test": test, "outcome": outcome, "text": "\n".join(texts)}
    with open(os.path.join(JOB, f"rank-{comm.rank}"), "a") as file:
        file.write(json.dumps(record) + "\n")
    if outcome != "failed":
        comm.Barrier()
        return
    deadline = time.monotonic() + GRACE
    while time.monotonic() < deadline and not all(
            test in read_records(pathlib.Path(JOB), rank) for rank in range(comm.size)):
        time.sleep(0.05)
    comm.Abort(1)


def text_of(report):
    """Return why a test was skipped, or how it failed and what it printed."""
    if report.outcome == "skipped":
        return report.longrepr[2].replace("Skipped: ", "", 1)
    sections = [f"--- {title}\n{content}" for title, content in report.sections]
    return "\n".join([report.longreprtext, *sections])
