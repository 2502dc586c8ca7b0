"""Runs that go wrong: each ends soon, on all ranks, with one line, and can be continued."""
import errno
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import mpi_environment, start, stop
from petsc4py import PETSc
from runs import SMALL, arrays, assert_same_run, prepare, rows, run

from petscib import guard, options, schemes
from petscib.driver import Driver
from petscib.errors import Crash, InputError, SolveError, WallError, ours
from petscib.interrupt import Interrupt
from petscib.output import checkpoint, lock, plots
from petscib.solvers import krylov

OPTIONS = ["-scheme", "mbe"] + [
    word for name, text in SMALL.items() for word in (f"-{name}", text)]
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


def assert_goes_on(folder, steps=8, **solver):
    """The last complete checkpoint restarts, here, and the tables have every row once."""
    run(folder, restart="latest", ts_max_steps=str(steps), **solver)
    assert list(rows(folder)["step"]) == list(range(steps + 1))
    assert not list(folder.glob("*.part"))


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
def test_kill_9_inside_a_checkpoint(petscib, tmp_path, where):
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
    assert_goes_on(tmp_path / "run")


@pytest.mark.parametrize("kinds, status", [
    (["SIGINT"], 130), (["SIGUSR1"] * 3, 0), (["SIGTERM"] * 3, 143),
    (["SIGUSR1", "SIGTERM", "SIGUSR1", "SIGTERM"], 143)])
def test_signals_end_a_run_with_a_checkpoint(petscib, tmp_path, kinds, status):
    """Sent by rank 1 to itself within its 3rd step; one rank having them is enough."""
    broken = f"""
import os, signal
from petscib import guard
check = guard.check
def signalled(problem, state):
    if rank == 1 and state.step == 3:
        for kind in {kinds}:
            os.kill(os.getpid(), getattr(signal, kind))
    return check(problem, state)
guard.check = signalled
"""
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 500, broken=broken)
    assert result.returncode == status and result.stderr == ""
    assert "to go on: -restart latest -output run" in result.stdout
    assert [path.name for path in (tmp_path / "run").glob("*.h5")] == ["checkpoint-00000003.h5"]
    assert list(rows(tmp_path / "run")["step"]) == [0, 1, 2, 3]


@pytest.mark.parametrize("ranks", [1, 2])
def test_sigterm_saves_though_the_step_never_ends(petscib, tmp_path, ranks):
    """As a launcher does it: SIGTERM, and SIGKILL before the step is over."""
    broken = """
import os, signal
from petscib import guard
check = guard.check
def killed(problem, state):
    if rank == 0 and state.step == 4:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGKILL)
    return check(problem, state)
guard.check = killed
"""
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 500, broken=broken, ranks=ranks)
    assert result.returncode != 0
    assert [path.name for path in (tmp_path / "run").glob("*.h5")] == ["checkpoint-00000003.h5"]
    assert_goes_on(tmp_path / "run")


def ending(*kinds):
    """The signal that ends a program after it has got these, if any does."""
    from petscib.interrupt import Interrupt

    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # also where the tests run under nohup
        with Interrupt() as interrupt:
            for kind in kinds:
                os.kill(os.getpid(), kind)
                os._exit(1) if interrupt.caught != kind else None
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WTERMSIG(status)


def test_only_a_second_ctrl_c_ends_at_once():
    assert ending(signal.SIGINT) == 0
    assert ending(signal.SIGINT, signal.SIGINT) == signal.SIGINT
    assert ending(*[signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1] * 3, signal.SIGINT) == 0


def test_the_first_ctrl_c_says_what_follows(tmp_path, capfd):
    with Interrupt() as interrupt:
        simulation = prepare(tmp_path, ts_max_steps="9")
        simulation.interrupt = interrupt
        next(simulation.steps())
        os.kill(os.getpid(), signal.SIGINT)
        simulation.run()
        simulation.destroy()
    assert simulation.state.step == 2 and interrupt.notice == ""
    assert capfd.readouterr().err == ("petscib: finishing this step, and saving its state; "
                                      "a second Ctrl-C ends the run at once\n")


# --- the disk

SMALL_FILES = """
import resource
# Past the limit a write fails, as on a full disk but with other words.
resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))
"""


@pytest.mark.parametrize("limit, file", [(30_000, "checkpoint-00000002.h5.part"),
                                         (9_000, "outlines.csv")])
def test_files_that_cannot_grow(petscib, tmp_path, limit, file):
    every = 2 if file.startswith("checkpoint") else 50
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 8, "-checkpoint_every", every,
                     "-outline_every", 1, broken=SMALL_FILES.format(limit))
    line = one_line(result, 3)
    assert f"results could not be written: run/{file}: File too large" in line
    assert not list((tmp_path / "run").glob("*.h5*"))


def test_a_full_disk(petscib, tmp_path):
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
        assert_goes_on(disk / "run", steps=12)
        with suppress(OSError), open(disk / "filler", "wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))
        (disk / "full").mkdir()
        line = one_line(petscib(*OPTIONS, "-output", "disk/full"), 2)
        assert line == "petscib: -output disk/full: No space left on device"
        assert not os.listdir(disk / "full")
    finally:
        subprocess.run(["umount", disk], check=True)


# --- the physics and the solvers

def test_a_solver_that_diverges(petscib, tmp_path):
    wrong = ["-momentum_ksp_max_it", 1, "-momentum_ksp_rtol", 1e-14]
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 4, *wrong)
    line = one_line(result, 3)
    for part in ("step 1 from time 0 failed: momentum solve failed: DIVERGED_MAX_IT",
                 "-momentum_ksp_max_it", "a smaller -ts_dt",
                 "the state before it is in run/checkpoint-00000000.h5"):
        assert part in line
    assert_goes_on(tmp_path / "run", steps=3, momentum_ksp_max_it="100")
    result = petscib(*OPTIONS, "-output", "other", "-ts_max_steps", 4, "-ts_adapt", *wrong)
    *attempts, line = result.stderr.splitlines()
    assert result.returncode == 3 and len(attempts) == 9
    assert "with dt = 0.0833 failed" in attempts[0] and "trying 0.0417" in attempts[0]
    assert "the state before it is in other/" in line


def test_an_option_that_petsc_refuses_within_a_step(petscib, tmp_path):
    """Where the solver that it is for is made when it is first used."""
    result = petscib(*OPTIONS, "-scheme", "be", "-output", "run", "-ts_max_steps", 4,
                     "-coupled_velocity_pc_type", "foo")
    line = one_line(result, 2)
    assert "failed: -coupled_velocity_pc_type foo: PETSc error 86: " in line
    assert "in run/checkp" in line
    assert_goes_on(tmp_path / "run", steps=1, coupled_velocity_pc_type="gamg")


def test_a_state_that_is_not_finite(petscib, tmp_path):
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
    assert_goes_on(tmp_path / "run")


BUGS = {
    # where the others are meanwhile: at the agreement, in the step, in the next output, nowhere
    "checks": """
from petscib import guard
whole, rank_of_it = guard.check, 1
def broken(problem, state):
    if state.step == 3 and rank == 1:
        raise ZeroDivisionError("a bug\\nin two lines")
    return whole(problem, state)
guard.check = broken
""",
    "the step": """
from petscib import driver
driver.PATIENCE = 1.0  # seconds: the others never come
import numpy as np
from petscib.problem import Problem
whole, calls = Problem.interpolation, []
def broken(self, markers):
    calls.append(None)
    if rank == 0 and len(calls) == 3:
        np.linalg.inv(np.zeros((2, 2)))
    return whole(self, markers)
Problem.interpolation = broken
""",
    "PETSc": """
from petscib import driver
driver.PATIENCE = 1.0  # seconds: the others never come
from petsc4py import PETSc
from petscib.problem import Problem
whole, calls = Problem.interpolation, []
def broken(self, markers):
    calls.append(None)
    if rank == 1 and len(calls) == 3:
        matrix = PETSc.Mat().createDense((3, 3), comm=PETSc.COMM_SELF)
        matrix.mult(*matrix.createVecs())
    return whole(self, markers)
Problem.interpolation = broken
""",
    "the diagnostics": """
from petscib import driver
driver.PATIENCE = 1.0  # seconds: the others never come
from petscib.diagnostics import Diagnostics
whole = Diagnostics.row
def broken(self, state, *arguments):
    if state.step == 2 and rank == 0:
        raise IndexError("beyond the end")
    return whole(self, state, *arguments)
Diagnostics.row = broken
""",
}
TEXTS = {
    "checks": "ZeroDivisionError: a bug in two lines (on rank 1)",
    "the step": "LinAlgError: Singular matrix (on rank 0)",
    "PETSc": "PETSc error 73: Not for unassembled matrix (on rank 1)",
    "the diagnostics": "IndexError: beyond the end (on rank 0)",
}


@pytest.mark.parametrize("where", BUGS)
def test_one_rank_alone_fails(petscib, tmp_path, where):
    """Whatever the others do: one line, the last good state saved, and where it was raised."""
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 8, "-ts_adapt",
                     broken=BUGS[where])
    line = one_line(result, 3)
    for part in ("petscib: step 3 from time 0.166", f"failed: {TEXTS[where]}",
                 "run/checkpoint-00000002.h5", "run/traceback.txt says where"):
        assert part in line
    assert "in broken" in (tmp_path / "run" / "traceback.txt").read_text()
    if where == "the diagnostics":  # then there is no row of that step
        run(tmp_path / "run", restart="latest")
    else:
        assert_goes_on(tmp_path / "run")


def test_all_ranks_fail_alike(petscib, tmp_path):
    broken = BUGS["checks"].replace(" and rank == 1", "")
    line = one_line(petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 8, broken=broken), 3)
    assert "a bug in two lines; run/traceback.txt" in line
    assert "the state before it is in run/checkpoint-00000002.h5" in line


def test_a_rescued_state_is_the_saved_one(petscib, tmp_path):
    """What one rank has put together of all ranks' copies, byte for byte, history included."""
    words = [*OPTIONS, "-scheme", "gcn", "-stag_grid_y", 31, "-fft", "-ts_max_steps", 3]
    broken = BUGS["the diagnostics"].replace("step == 2", "step == 3")
    assert petscib(*words, "-output", "whole", "-checkpoint_every", 3, "-ts_max_steps", 4,
                   ranks=3).returncode == 0
    one_line(petscib(*words, "-output", "rescued", broken=broken, ranks=3), 3)
    first, second = (arrays(tmp_path / name / "checkpoint-00000003.h5")
                     for name in ("whole", "rescued"))
    # One rank alone cannot solve for the pressure's jumps.
    first["fluid/p"] = first.pop("history/bare_pressure/p")
    assert first.keys() == second.keys() and any("history" in name for name in first)
    for name, values in first.items():
        np.testing.assert_array_equal(second[name], values, err_msg=name)


# --- Python code that PETSc calls

PRECONDITIONERS = """
class Slow:
    def apply(self, pc, x, y):
        x.copy(y)

class Wrong(Slow):
    def apply(self, pc, x, y):
        self.nothing

class Unmade(Slow):
    def __init__(self):
        self.nothing

class Failing(Slow):
    def apply(self, pc, x, y):
        from petscib.errors import SolveError
        raise SolveError("the inner solve failed")
"""


@pytest.mark.parametrize("name, part", [
    ("Wrong", "AttributeError: 'Wrong' object has no attribute 'nothing'"),
    ("Failing", "the inner solve failed; try a smaller")])
def test_preconditioners_of_the_user(petscib, tmp_path, name, part):
    (tmp_path / "preconditioners.py").write_text(PRECONDITIONERS)
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 2, "-poisson_pc_type", "python",
                     "-poisson_pc_python_type", f"preconditioners.{name}")
    line = one_line(result, 3)
    assert part in line and "checkpoint-" in line
    assert (tmp_path / "run" / "checkpoint-00000000.h5").exists()


def test_a_preconditioner_that_cannot_be_made_is_no_bad_input(petscib, tmp_path):
    (tmp_path / "preconditioners.py").write_text(PRECONDITIONERS)
    result = petscib(*OPTIONS, "-output", "run", "-poisson_pc_type", "python",
                     "-poisson_pc_python_type", "preconditioners.Unmade")
    # A traceback up to PETSc 3.18, which hands Python's errors through as they are; then one line.
    assert result.returncode in (1, 3) and "has no attribute 'nothing'" in result.stderr


class PetscError(RuntimeError):
    """As petsc4py's: a code, and C's stack as text."""

    ierr = 101

    def __str__(self):
        return "error code 101\n[0] KSPSolve() at ksp.c:1\n[0] PCApply() at pc.c:2\n[0] a cause"


@pytest.mark.parametrize("inner, kind, text", [
    (SolveError("no"), SolveError, "no"),
    (InputError("no"), InputError, "no"),
    (AttributeError("no x"), Crash, "AttributeError: no x"),
    (None, Crash, "PETSc error 101: a cause"),
])
def test_what_newer_petsc4py_wraps(inner, kind, text):
    """Since 3.19 the cause comes inside an error of PETSc's, perhaps several deep."""
    error = PetscError()
    if inner is not None:
        error.__cause__ = PetscError()
        error.__cause__.__cause__ = inner
    found = ours(error)
    assert type(found) is kind and str(found) == text
    assert found.__cause__ is None and found.__context__ is None


def test_a_solve_that_failed_within_another_can_be_tried_again(petscib, tmp_path):
    """PETSc lets nobody into a preconditioner whose Python code has raised twice."""
    (tmp_path / "preconditioners.py").write_text(PRECONDITIONERS)
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 2, "-ts_adapt",
                     "-poisson_pc_type", "python", "-poisson_pc_python_type",
                     "preconditioners.Failing")
    *attempts, line = result.stderr.splitlines()
    assert result.returncode == 3 and len(attempts) == 9
    assert all("failed: the inner solve failed; trying" in attempt for attempt in attempts)
    assert "run/checkpoint-00000000.h5" in line


# --- the walls

def test_a_vesicle_that_is_carried_to_the_outlet(tmp_path):
    with pytest.raises(WallError) as caught:
        run(tmp_path, scene="poiseuille", scheme="gcn", stag_grid_x="64", axes="0.2,0.3",
            ts_dt="0.25", ts_max_time="20", fft="yes")
    line = str(caught.value)
    assert "the vesicle has come to the wall x = 3, where the box ends: marker " in line
    assert "a larger -domain" in line and "-ts_dt" not in line


def test_a_guess_beyond_the_walls_is_a_failed_step(tmp_path, capfd):
    words = dict(scheme="gcn", axes="0.2,0.3", flow="extensional", shear_rate="20",
                 center="0.2,0", ts_dt="0.06", ts_max_time="1")
    with pytest.raises(SolveError, match=" from time 0 failed: "):
        run(tmp_path / "fixed", **words)
    assert "-ts_dt 0.025 is advised" in capfd.readouterr().err
    with pytest.raises(SolveError, match="from time 0.0.*is in .*/run/checkpoint-"):
        run(tmp_path / "run", ts_adapt="yes", **words)
    attempts = [one for one in capfd.readouterr().err.splitlines() if "failed" in one]
    assert attempts and all("; trying " in one for one in attempts)


def test_thrown_markers_are_told_from_those_that_arrive(tmp_path):
    simulation = prepare(tmp_path / "run")
    markers = simulation.state.markers
    simulation.destroy()
    guard.check_markers(simulation.problem, markers)
    with pytest.raises(WallError, match="the wall y = -1, where the box ends"):
        guard.check_markers(simulation.problem, markers - (0, 0.6))
    for moved in (markers + (3, 0), 30 * markers):
        with pytest.raises(SolveError, match="was thrown to") as caught:
            guard.check_markers(simulation.problem, moved)
        assert not isinstance(caught.value, WallError)
    with pytest.raises(SolveError, match="no longer finite"):
        guard.check_markers(simulation.problem, markers * np.nan)


@pytest.mark.parametrize("second", [6, 7])
def test_markers_that_fall_together_leave_the_membrane_without_a_tangent(tmp_path, second):
    simulation = prepare(tmp_path / "run")
    markers = simulation.state.markers.copy()
    simulation.destroy()
    markers[second] = markers[5]
    with pytest.raises(SolveError, match=f"markers 5 and {second} have come to the same place"):
        guard.check_markers(simulation.problem, markers)


# --- outputs that fail

@pytest.mark.parametrize("sink", ["a full disk", "a reader that has gone"])
def test_a_run_does_not_depend_on_being_heard(tmp_path, sink):
    if sink == "a full disk":
        if not os.path.exists("/dev/full"):
            pytest.skip("no /dev/full here")
        write = os.open("/dev/full", os.O_WRONLY)
    else:
        read, write = os.pipe()
        os.close(read)
    for monitor in ("log", "bar"):
        words = [*OPTIONS, "-monitor", monitor, "-output", monitor, "-ts_max_steps", 3]
        result = subprocess.run([sys.executable, "-m", "petscib", *map(str, words)], cwd=tmp_path,
                                env=mpi_environment(), stdout=write, stderr=write)
        assert result.returncode == 0
        assert (tmp_path / monitor / "summary.json").exists()
    os.close(write)


@pytest.mark.parametrize("error", [ValueError, RuntimeError, AssertionError])
def test_pictures_that_fail_are_a_warning(tmp_path, monkeypatch, capfd, error):
    def fail(folder):
        raise error("no ink")

    monkeypatch.setattr(plots, "plot_all", fail)
    run(tmp_path, plot="yes", ts_max_steps="1")
    line, = capfd.readouterr().err.splitlines()
    assert line.startswith("petscib: not all pictures could be drawn: ") and "no ink" in line
    assert (tmp_path / "summary.json").exists()


def test_a_scheme_that_cannot_be_built_leaves_no_options(tmp_path, monkeypatch):
    def fail(*arguments):
        krylov.set_defaults("momentum_", {"ksp_left_over": "1"})
        raise RuntimeError("no such thing")

    monkeypatch.setattr(schemes, "create", fail)
    with pytest.raises(RuntimeError, match="no such thing"):
        prepare(tmp_path / "run")
    assert not PETSc.Options().hasName("momentum_ksp_left_over")
    assert not (tmp_path / "run").exists()


# --- two runs, one folder

def test_a_folder_in_use_is_refused(tmp_path):
    first = prepare(tmp_path / "run", ts_max_steps="2")
    before = (tmp_path / "run" / "diagnostics.csv").read_bytes()
    given = {**SMALL, "output": str(tmp_path / "run")}
    with pytest.raises(InputError) as caught:
        Driver(options.read(given))
    told = f"-output {tmp_path}/run: in use by process {os.getpid()} on "
    assert str(caught.value).startswith(told)
    assert (tmp_path / "run" / "diagnostics.csv").read_bytes() == before
    first.run()
    first.destroy()
    run(tmp_path / "run", ts_max_steps="1")


def test_the_second_of_two_runs_is_refused_while_the_first_lives(petscib, mpirun, tmp_path):
    """And after kill -9 the next one is let in."""
    broken = """
from petscib import guard
def check(problem, state):
    if rank == 0 and state.step == 2:
        open("waiting", "w").close()
    while state.step == 2:
        pass
guard.check = check
"""
    (tmp_path / "driver.py").write_text(DRIVER.format(broken))
    words = [*OPTIONS, "-output", "run", "-ts_max_steps", 4]
    process = start(2, ["driver.py", *words], cwd=tmp_path, env=mpi_environment(),
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while not (tmp_path / "waiting").exists():
            assert process.poll() is None
            time.sleep(0.05)
        held = (tmp_path / "run" / "diagnostics.csv").read_bytes()
        second = mpirun(1, "-m", "petscib", *words, check=False)
        assert "run: in use by process " in one_line(second, 2)
        assert (tmp_path / "run" / "diagnostics.csv").read_bytes() == held
    finally:
        for rank in children(process.pid):
            os.kill(rank, signal.SIGKILL)
        stop(process)
    mpirun(1, "-m", "petscib", *words)


def test_a_file_system_without_locks_is_said(tmp_path, monkeypatch, capfd):
    def flock(file, how):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(lock.fcntl, "flock", flock)
    run(tmp_path / "run", ts_max_steps="1")
    assert "which cannot be locked" in capfd.readouterr().err


def test_options_that_no_solver_reads_are_named(petscib):
    result = petscib(*OPTIONS, "-output", "run", "-ts_max_steps", 2, "-momentum_ksp_typo", 3,
                     "-coupled_ksp_rtol", 0.1, "-poisson_ksp_rtol", 1e-7)
    assert result.returncode == 0
    assert sorted(result.stderr.splitlines()) == [
        "petscib: no solver has read -coupled_ksp_rtol",
        "petscib: no solver has read -momentum_ksp_typo"]
