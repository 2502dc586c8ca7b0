"""Runs that go wrong: each ends soon, on all ranks, with one line, and can be continued."""
import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import mpi_environment, start, stop
from runs import SMALL, assert_same_run, rows

from petscib.output import checkpoint

OPTIONS = [word for name, text in SMALL.items() for word in (f"-{name}", text)]
# Starts petscib with something broken: the production code has no hook for tests.
DRIVER = """
import sys
sys.argv[0] = "petscib"
from petscib.__main__ import main
import petsc4py
petsc4py.init(sys.argv)
from mpi4py import MPI
rank = MPI.COMM_WORLD.rank
{}
sys.exit(main())
"""


@pytest.fixture
def petscib(mpirun, tmp_path):
    """Run petscib on 2 ranks, broken by a piece of Python; its result, and the seconds taken."""

    def run(*arguments, broken="", ranks=2, timeout=60):
        (tmp_path / "driver.py").write_text(DRIVER.format(broken))
        return mpirun(ranks, "driver.py", *arguments, check=False, timeout=timeout)

    return run


def one_line(result, status):
    """The only line on standard error, with the status expected."""
    assert result.returncode == status, result.stderr
    lines = result.stderr.splitlines()
    assert len(lines) == 1 and lines[0].startswith("petscib: "), result.stderr
    return lines[0]


def assert_goes_on(mpirun, tmp_path, folder, *arguments, steps=8):
    """The last complete checkpoint restarts and the tables have every row once."""
    mpirun(2, "-m", "petscib", "-restart", "latest", "-output", folder, "-ts_max_steps", steps,
           *arguments)
    assert list(rows(tmp_path / folder)["step"]) == list(range(steps + 1))
    assert not list((tmp_path / folder).glob("*.part"))


def children(parent):
    """Processes that a process has started, by Linux's /proc."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            if int(path.read_text().rpartition(")")[2].split()[1]) == parent:
                found.append(int(path.parent.name))
    return found


def test_kill_9_at_any_moment(mpirun, tmp_path):
    """Killed again and again, also while it writes, a run ends as if nothing had happened."""
    words = [*OPTIONS, "-ts_max_steps", 30, "-checkpoint_every", 1, "-fft"]
    mpirun(2, "-m", "petscib", *words, "-output", "whole")
    random = np.random.default_rng(5)
    command = ["-m", "petscib", *words, "-output", "run"]
    for _ in range(3):
        checkpoints = set((tmp_path / "run").glob("checkpoint-*.h5"))
        process = start(2, command, cwd=tmp_path, env=mpi_environment(),
                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while process.poll() is None:  # until it has got somewhere
            if set((tmp_path / "run").glob("checkpoint-*.h5")) - checkpoints:
                break
            time.sleep(0.01)
        time.sleep(random.uniform(0, 0.15))
        for rank in children(process.pid):
            os.kill(rank, signal.SIGKILL)
        stop(process)
        for path in (tmp_path / "run").glob("*.h5"):
            checkpoint.read_header(str(path))
        command = ["-m", "petscib", "-restart", "latest", "-output", "run"]
    if not (tmp_path / "run" / "final.h5").exists():
        mpirun(2, *command)
    assert_same_run(tmp_path / "whole", tmp_path / "run")


@pytest.mark.parametrize("where", ["a dataset", "the renaming"])
def test_kill_9_inside_a_checkpoint(petscib, mpirun, tmp_path, where):
    broken = {
        "a dataset": "target, name = h5py.Dataset, '__setitem__'",
        "the renaming": "target, name = os, 'replace'",
    }[where] + """
whole = getattr(target, name)
def deadly(*arguments, **keywords):
    if rank == 0 and any("00000004.h5" in str(a) for a in (*arguments, getattr(
            getattr(arguments[0], "file", None), "filename", ""))):
        os.kill(os.getpid(), signal.SIGKILL)
    return whole(*arguments, **keywords)
setattr(target, name, deadly)
"""
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 8, "-checkpoint_every", 2,
                     broken="import os, signal, h5py\n" + broken)
    assert result.returncode != 0
    names = {path.name for path in (tmp_path / "run").glob("checkpoint-*")}
    assert names == {"checkpoint-00000002.h5", "checkpoint-00000004.h5.part"}
    assert_goes_on(mpirun, tmp_path, "run")


@pytest.mark.parametrize("kind, status", [("SIGINT", 130), ("SIGTERM", 143), ("SIGUSR1", 0)])
def test_signals_end_a_run_with_a_checkpoint(petscib, tmp_path, kind, status):
    """Sent by rank 1 to itself within its 3rd step; one rank having it is enough."""
    broken = f"""
import os, signal
from petscib import guard
check = guard.check
def signalled(problem, state):
    if rank == 1 and state.step == 3:
        os.kill(os.getpid(), signal.{kind})
    return check(problem, state)
guard.check = signalled
"""
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 500, broken=broken)
    assert result.returncode == status and result.stderr == ""
    assert "to go on: -restart latest -output run" in result.stdout
    assert [path.name for path in (tmp_path / "run").glob("*.h5")] == ["checkpoint-00000003.h5"]
    assert list(rows(tmp_path / "run")["step"]) == [0, 1, 2, 3]


def test_a_second_signal_ends_at_once(tmp_path):
    from petscib.interrupt import Interrupt

    child = os.fork()
    if child == 0:
        with Interrupt() as interrupt:
            os.kill(os.getpid(), signal.SIGINT)
            if interrupt.caught == signal.SIGINT:
                os.kill(os.getpid(), signal.SIGINT)
        os._exit(0)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGINT


# --- the disk

SMALL_FILES = """
import resource
# Past the limit a write fails, as on a full disk but with other words.
resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))
"""


@pytest.mark.parametrize("limit, file", [(30_000, "checkpoint-00000002.h5.part"),
                                         (9_000, "outlines.csv")])
def test_files_that_cannot_grow(petscib, mpirun, tmp_path, limit, file):
    every = 2 if file.startswith("checkpoint") else 50
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 8, "-checkpoint_every", every,
                     "-outline_every", 1, broken=SMALL_FILES.format(limit))
    line = one_line(result, 3)
    assert f"results could not be written: run/{file}: File too large" in line
    assert not list((tmp_path / "run").glob("*.h5*"))


def test_a_full_disk(petscib, mpirun, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", disk],
                          stderr=subprocess.DEVNULL)
    if made.returncode:
        pytest.skip("mounting a small disk needs more rights")
    try:
        result = petscib(*OPTIONS, "-output", "disk/run", "-ts_max_steps", 90,
                         "-checkpoint_every", 2, "-checkpoint_keep", 9)
        line = one_line(result, 3)
        assert "No space left on device; the last checkpoint is disk/run/checkpoint-" in line
        subprocess.run(["mount", "-o", "remount,size=9m", disk], check=True)
        assert_goes_on(mpirun, tmp_path, "disk/run", steps=12)
    finally:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.parametrize("folder", ["/proc/petscib", "file/below"])
def test_a_folder_that_cannot_be_made(petscib, tmp_path, folder):
    (tmp_path / "file").write_text("")
    line = one_line(petscib(*OPTIONS, "-output", folder, "-ts_max_steps", 1), 2)
    assert folder.split("/")[1 if folder[0] == "/" else 0] in line


# --- the physics and the solvers

def test_a_solver_that_diverges(petscib, mpirun, tmp_path):
    wrong = ["-momentum_ksp_max_it", 1, "-momentum_ksp_rtol", 1e-14]
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 4, *wrong)
    line = one_line(result, 3)
    for part in ("step 1 from time 0 failed: momentum solve failed: DIVERGED_MAX_IT",
                 "-momentum_ksp_max_it", "a smaller -ts_dt",
                 "the state before it is in run/checkpoint-00000000.h5"):
        assert part in line
    assert_goes_on(mpirun, tmp_path, "run", "-momentum_ksp_max_it", 100, steps=3)
    result = petscib(*OPTIONS, "-output", "other", "-ts_max_steps", 4, "-ts_adapt", *wrong)
    *attempts, line = result.stderr.splitlines()
    assert result.returncode == 3 and len(attempts) == 9
    assert "with dt = 0.0833 failed" in attempts[0] and "trying 0.0417" in attempts[0]
    assert "the state before it is in other/" in line


def test_a_state_that_is_not_finite(petscib, mpirun, tmp_path):
    """One rank gets a NaN; all of them end."""
    broken = """
from petscib import guard
check = guard.check
def poison(problem, state):
    if state.step == 3 and rank == 1:
        state.velocity.getArray()[5] = float("nan")
    return check(problem, state)
guard.check = poison
"""
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 8, broken=broken)
    line = one_line(result, 3)
    assert "step 3 from time" in line and "the velocity is no longer finite" in line
    with h5py.File(tmp_path / "run" / "checkpoint-00000002.h5") as file:
        assert np.isfinite(file["fluid/u"]).all()
    assert_goes_on(mpirun, tmp_path, "run")


def test_one_rank_raising_ends_the_job(petscib, mpirun, tmp_path):
    broken = """
from petscib import guard
check = guard.check
def fall(problem, state):
    if state.step == 3 and rank == 1:
        raise ZeroDivisionError("a bug")
    return check(problem, state)
guard.check = fall
"""
    begin = time.monotonic()
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 8, "-checkpoint_every", 1,
                     broken=broken)
    assert time.monotonic() - begin < 20
    assert result.returncode == 1 and result.stderr.count("Traceback") == 1
    assert "ZeroDivisionError: a bug" in result.stderr
    assert_goes_on(mpirun, tmp_path, "run")


def test_pictures_that_fail_are_a_warning(petscib, tmp_path):
    broken = """
from petscib.output import plots
def fail(folder):
    raise ValueError("no ink")
plots.plot_all = fail
"""
    result = petscib(*OPTIONS, "-plot", "yes", "-output", "run", "-ts_max_steps", 1,
                     broken=broken)
    assert one_line(result, 0) == "petscib: not all pictures could be drawn: no ink"
    assert (tmp_path / "run" / "summary.json").exists()


def test_options_that_no_solver_reads_are_named(petscib):
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 2, "-momentum_ksp_typo", 3,
                     "-coupled_ksp_rtol", 0.1, "-poisson_ksp_rtol", 1e-7)
    assert result.returncode == 0
    assert sorted(result.stderr.splitlines()) == [
        "petscib: no solver has read -coupled_ksp_rtol",
        "petscib: no solver has read -momentum_ksp_typo"]
