"""Plumbing for tests that need several ranks.

Two ways, both from one ordinary ``python -m pytest``:

- ``@pytest.mark.parallel([1, 2, 3])`` on a test (or ``pytestmark = pytest.mark.parallel(2)`` for a
  module) runs the test's body on that many ranks. It passes when it passes on every rank. All such
  tests that ask for the same number of ranks share one MPI job, since starting one takes seconds,
  and come last; a test that fails ends its job, and the rest continue in a new one. With 1 rank
  the test runs in place. `tmp_path` is one folder for all ranks, `ranks` is their number.
- The fixture ``mpirun(ranks, *args)`` runs ``python *args`` on that many ranks, for example
  ``mpirun(2, "-m", "petscib", "-ts_max_steps", "3")``.

Nothing waits for ever: a job in which no rank finishes a test for `timeout` seconds is stopped, and
the report names the ranks that had not finished.
"""
import functools
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


launcher = functools.cache(launch.launcher)  # looking for it takes a tenth of a second


def start(ranks, args, **keywords):
    """Start ``python *args`` on `ranks` ranks; the process leads a session of its own."""
    command = [*launcher(), "-n", str(ranks), sys.executable, *map(str, args)]
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


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """All tests of one MPI job go to one worker, and so do all cases of a test, for what it caches.

    Not whole modules: the longest of them would end long after the rest.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return "jobs" if re.search(r"\branks=[2-9]", nodeid) else nodeid.split("[")[0]

    return Scheduling(config, log)


@pytest.hookimpl(trylast=True)  # after -k and -m have had their say
def pytest_collection_modifyitems(config, items):
    if JOB:
        tests = {item.nodeid: item for item in items}
        items[:] = [tests[name] for name in json.loads((pathlib.Path(JOB) / "tests").read_text())]
    jobs = {}
    for index, item in enumerate(items):
        ranks = item.callspec.params["ranks"] if item.get_closest_marker("parallel") else 1
        if WORLD_SIZE:  # pytest itself runs under mpiexec, by our doing or the user's
            if ranks not in (1, WORLD_SIZE):
                item.add_marker(pytest.mark.skip(reason=f"needs {ranks} ranks"))
        elif ranks > 1:
            if ranks not in jobs:
                jobs[ranks] = Job(config, ranks)
                config.add_cleanup(jobs[ranks].end)
            items[index] = RemoteTest.from_parent(
                item.parent, name=item.name, test=item, job=jobs[ranks])
            jobs[ranks].tests.append(items[index])
    # One job at a time, and nothing of this process beside it.
    items.sort(key=lambda item: item.job.ranks if isinstance(item, RemoteTest) else 0)


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
    """The tests for one number of ranks, the MPI job that runs them, and the outcomes so far."""

    def __init__(self, config, ranks):
        self.config, self.ranks = config, ranks
        self.tests, self.outcomes = [], {}
        self.process = None

    def outcome_of(self, test):
        """Return ('passed' | 'failed' | 'skipped', text), waiting until it is known."""
        while test.nodeid not in self.outcomes:
            if self.process is None:
                self.begin([one for one in self.tests if one.nodeid not in self.outcomes])
            self.follow(test)
        return self.outcomes[test.nodeid]

    def begin(self, tests):
        """Start an MPI job that runs tests, up to and including the first that fails."""
        self.running = {test.nodeid: test.timeout for test in tests}
        self.folder = tempfile.TemporaryDirectory(prefix="petscib-")
        folder = pathlib.Path(self.folder.name)
        (folder / "tests").write_text(json.dumps(list(self.running)))
        self.records = [Records(folder, rank) for rank in range(self.ranks)]
        args = ["-m", "pytest", "-q", "--no-header", "--color=no", "--runxfail",
                "-p", "no:cacheprovider",
                # A rank that hangs shows where, before the job is stopped.
                "-o", f"faulthandler_timeout={0.8 * min(self.running.values())}",
                "-c", self.config.inipath or os.devnull, "--rootdir", self.config.rootpath,
                *dict.fromkeys(test.path for test in tests)]
        environment = mpi_environment(PETSCIB_TEST_JOB=str(folder),
                                      PYTEST_DEBUG_TEMPROOT=str(folder),
                                      OMPI_MCA_orte_execute_quiet="0")  # name dead ranks
        with (folder / "output").open("w") as output:
            self.process = start(self.ranks, args, cwd=self.config.rootpath, env=environment,
                                 stdout=output, stderr=subprocess.STDOUT)

    def follow(self, test):
        """Wait until a test has passed on all ranks or the job is over; note all outcomes."""
        end, finished, since = None, None, time.monotonic()
        while end is None:
            over = self.process.poll() is not None  # before reading: then nothing more is written
            for records in self.records:
                records.read()
            done = set.intersection(*(set(records.found) for records in self.records))
            failed = any(record["outcome"] == "failed" for records in self.records
                         for record in records.found.values())
            if test.nodeid in done and not failed:
                break
            count = sum(len(records.found) for records in self.records)
            if count != finished:
                finished, since = count, time.monotonic()
            waiting = [timeout for name, timeout in self.running.items() if name not in done]
            timeout = waiting[0] if waiting else TIMEOUT
            if over:
                end = f"ended with exit status {self.process.returncode}"
            elif time.monotonic() - since > timeout:
                end = f"stopped after {timeout:g} s without progress"
            else:
                time.sleep(0.02)
        if end is not None and self.process.poll() is None:
            stop(self.process)
        output = (pathlib.Path(self.folder.name) / "output").read_text(errors="replace")
        for name in [name for name in self.running if name not in self.outcomes]:
            reports = [records.found.get(name) for records in self.records]
            if end is None and not all(reports):
                break  # still to come
            self.outcomes[name] = self.judge(reports, end, output)
            if self.outcomes[name][0] == "failed":
                break
        if end is not None:
            self.end()

    def end(self):
        """Stop the MPI job, if there is one, and remove its folder."""
        if self.process is not None:
            if self.process.poll() is None:
                stop(self.process)
            self.process = None
            self.folder.cleanup()

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


class Records:
    """Reports of one rank, by test, as it writes them down."""

    def __init__(self, folder, rank):
        self.path, self.offset = pathlib.Path(folder) / f"rank-{rank}", 0
        self.found = {}

    def read(self):
        """Read on, but not a line that is not whole yet."""
        if not self.path.exists():
            return
        with self.path.open() as file:
            file.seek(self.offset)
            text = file.read()
        whole = text[: text.rfind("\n") + 1]
        self.offset += len(whole)  # JSON is written in ASCII
        for record in map(json.loads, whole.splitlines()):
            self.found[record["test"]] = record


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
    others = [Records(JOB, rank) for rank in range(comm.size)]
    while time.monotonic() < deadline and not all(test in records.found for records in others):
        time.sleep(0.05)
        for records in others:
            records.read()
    comm.Abort(1)


def text_of(report):
    """Return why a test was skipped, or how it failed and what it printed."""
    if report.outcome == "skipped":
        return report.longrepr[2].replace("Skipped: ", "", 1)
    sections = [f"--- {title}\n{content}" for title, content in report.sections]
    return "\n".join([report.longreprtext, *sections])
