"""What is printed when nobody reads it any more: nothing is lost but the words."""
import os
import signal
import subprocess
import sys

import pytest
from conftest import mpi_environment
from mpi4py import MPI

from petscib import interrupt, uncaught
from petscib.output import console

SCRIPT = """
import petscib
with petscib.Simulation(flow="rest", stag_grid_x=24, axes=(0.25, 0.4), ts_dt=0.05, ts_max_steps=2,
                        fft=True, monitor="none", plot=False{}) as simulation:
    for row in simulation:
        print(row["time"], flush={})
open("end", "w").close()
"""


@pytest.fixture
def unheard(tmp_path):
    """Run ``python *args`` with a standard output whose reader has gone."""

    def run(*args, **environment):
        read, write = os.pipe()
        os.close(read)
        try:
            return subprocess.run(
                [sys.executable, *map(str, args)], cwd=tmp_path, stdout=write,
                stderr=subprocess.PIPE, text=True,
                env={**mpi_environment(PYTHONUNBUFFERED=""), **environment})
        finally:
            os.close(write)

    return run


@pytest.mark.parametrize("flush, output, status, ends", [
    (True, "", 141, False),  # where a shell's program would be killed by SIGPIPE, 128 + 13
    (False, "", 0, True),  # found out at the end of the program
    (True, ", output='run'", 0, True),  # a run that leaves files goes on
])
def test_a_script_that_nobody_listens_to(unheard, tmp_path, flush, output, status, ends):
    done = unheard("-c", SCRIPT.format(output, flush))
    assert done.stderr == "" and done.returncode == status
    assert (tmp_path / "end").exists() == ends
    assert (tmp_path / "run" / "final.h5").exists() == bool(output)


def test_another_broken_pipe_is_an_error_like_any(monkeypatch, capsys):
    monkeypatch.setattr(sys, "excepthook", sys.__excepthook__)
    uncaught.end_the_job(MPI.COMM_SELF)
    sys.excepthook(BrokenPipeError, BrokenPipeError("mine"), None)
    assert capsys.readouterr().err == "BrokenPipeError: mine\n"


def test_help_of_petscs_that_nobody_reads(unheard):
    done = unheard("-m", "petscib", "-help", "petsc")
    assert done.stderr == "" and done.returncode == 0


def test_a_job_that_nobody_listens_to_goes_on(unheard, tmp_path):
    """A launcher stops at a broken pipe; here it is Python itself."""
    job = "for k in range(3): print('words', flush=True)\nopen('end', 'w').close()"
    assert unheard("-c", job).returncode != 0
    done = unheard("-m", "petscib.launch", "-c", job, MPIEXEC=sys.executable)
    assert done.stderr == "" and done.returncode == 0 and (tmp_path / "end").exists()


@pytest.mark.parametrize("blocking", [True, False])
def test_a_job_is_heard_to_its_last_word(blocking):
    """Also by a slow reader: a pipe holds 64 KiB, and one that does not block takes no more."""
    job = "import sys; print('x' * 100_000); sys.exit(3)"
    ours, theirs = os.pipe()
    os.set_blocking(theirs, blocking)
    process = subprocess.Popen(
        [sys.executable, "-m", "petscib.launch", "-c", job], stdout=theirs,
        stderr=subprocess.DEVNULL, env=mpi_environment(MPIEXEC=sys.executable))
    os.close(theirs)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.5)
    with open(ours) as heard:
        assert heard.read() == "x" * 100_000 + "\n"
    assert process.wait() == 3


@pytest.mark.parametrize("words", [
    ("-m", "petscib", "-help"), ("-m", "petscib.launch", "-c", "print('words')")])
def test_a_standard_output_that_was_closed(tmp_path, words):
    done = subprocess.run(
        ["sh", "-c", 'exec "$@" >&-', "sh", sys.executable, *words], cwd=tmp_path, text=True,
        stderr=subprocess.PIPE, env=mpi_environment(MPIEXEC=sys.executable))
    assert done.stderr == "" and done.returncode == 0


def test_a_stream_whose_reader_has_gone_falls_silent():
    console.take_pipes_back()  # from PETSc, which other tests may have started
    read, write = os.pipe()
    with open(write, "w") as stream:
        quiet = console.Console(stream)
        quiet.write("heard")
        quiet.flush()
        assert os.read(read, 100) == b"heard" and console.is_heard(stream)
        os.close(read)
        for _ in range(2):
            quiet.write("not heard")
            quiet.flush()
        assert os.path.samestat(os.fstat(write), os.stat(os.devnull))
        assert quiet.writable()  # all else is the stream's


@pytest.mark.parametrize("ignored", [False, True])
def test_a_terminal_that_goes_ends_a_run_but_under_nohup(ignored):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)
    try:
        with interrupt.Interrupt() as stop:
            os.kill(os.getpid(), signal.SIGHUP)
        assert interrupt.exit_status(stop.caught) == (0 if ignored else 129)
        assert stop.caught == (0 if ignored else signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
