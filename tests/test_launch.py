"""Jobs are started by the launcher of mpi4py's MPI, with settings that its version knows."""
import os
import signal
import subprocess
import sys

import pytest
from conftest import mpi_environment, without_noise

from petscib import launch
from petscib.errors import InputError

VERSIONS = {  # what Get_library_version says
    "Open MPI v4.1.4, package: Debian OpenMPI, ident: 4.1.4, repo rev: v4.1.4, May 26, 2022": 4,
    "Open MPI v5.0.7, package: Debian OpenMPI, ident: 5.0.7, repo rev: v5.0.7, Feb 14, 2025": 5,
    "Open MPI v6.0.0rc2, package: Debian OpenMPI, ident: 6.0.0rc2, Unreleased developer copy": 6,
}
MPICH = "MPICH Version:      4.2.1\nMPICH Release date: Wed Apr 17 15:30:02 CDT 2024"


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Pretend that mpi4py uses an MPI, and that these launchers are on the path."""

    def pretend(library, **launchers):
        monkeypatch.delenv("MPIEXEC", raising=False)
        monkeypatch.setattr(launch, "_library", lambda: library)
        monkeypatch.setattr(launch.importlib.util, "find_spec", lambda name: spec)
        spec = type("Spec", (), {"origin": str(tmp_path / "lib/p/site-packages/mpi4py/x.py")})
        for name, version in launchers.items():
            path = tmp_path / name.replace("__", "/").replace("_", ".")
            path.parent.mkdir(exist_ok=True)
            path.write_text(f"#!/bin/sh\necho '{version}'\n")
            path.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path}/path:/usr/bin:/bin")

    return pretend


def found(tmp_path):
    return os.path.relpath(launch.launcher()[0], tmp_path)


OPEN_RTE, HYDRA = "mpiexec (OpenRTE) 4.1.4", "HYDRA build details:"


@pytest.mark.parametrize("library", [*VERSIONS, MPICH])
def test_launcher_of_the_same_mpi(machine, tmp_path, library):
    ours, other, kind = OPEN_RTE, HYDRA, "openmpi"
    if library == MPICH:
        ours, other, kind = HYDRA, OPEN_RTE, "mpich"
    machine(library, path__mpiexec=ours)
    assert found(tmp_path) == "path/mpiexec"
    machine(library, path__mpiexec=other, **{f"path__mpiexec_{kind}": ours})
    assert found(tmp_path) == f"path/mpiexec.{kind}"
    machine(library, bin__mpiexec=ours)  # in the prefix of mpi4py
    assert found(tmp_path) == "bin/mpiexec"


def test_no_launcher_of_the_same_mpi(machine, tmp_path, monkeypatch):
    machine(MPICH, path__mpiexec=OPEN_RTE)
    monkeypatch.setattr(launch, "NAMES", ("mpiexec",))
    with pytest.raises(InputError, match="no mpiexec of MPICH Version: 4.2.1, which mpi4py uses"):
        launch.launcher()
    monkeypatch.setenv("MPIEXEC", "srun --mpi=pmi2")
    assert launch.launcher() == ["srun", "--mpi=pmi2"]


@pytest.mark.parametrize("library, version", VERSIONS.items())
def test_settings_that_the_version_knows(monkeypatch, library, version):
    monkeypatch.setattr(launch, "_library", lambda: library)
    monkeypatch.setattr(os, "environ", {"OMP_NUM_THREADS": "3"})
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    settings = launch.environment()
    assert settings["OMP_NUM_THREADS"] == "3"  # the user's wins
    assert settings["OMPI_ALLOW_RUN_AS_ROOT"] == settings["OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"] == "1"
    assert settings["OMPI_MCA_mpi_yield_when_idle"] == "1"
    assert ("OMPI_MCA_rmaps_base_oversubscribe" in settings) == (version == 4)
    assert ("PRTE_MCA_rmaps_default_mapping_policy" in settings) == (version == 5)
    assert ("PRTE_MCA_mapby" in settings) == (version == 6)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert not any("ROOT" in name for name in launch.environment())
    monkeypatch.setattr(launch, "_library", lambda: MPICH)
    assert launch.environment() == {"OMP_NUM_THREADS": "3"}


def test_settings_are_enough_for_more_ranks_than_cores(mpirun):
    script = "from mpi4py.MPI import COMM_WORLD as comm; comm.rank or print(comm.size)"
    ranks = 2 * os.cpu_count() + 1
    result = mpirun(ranks, "-c", script)
    assert result.stdout == f"{ranks}\n" and result.stderr == ""


def test_a_launcher_that_is_not_there(tmp_path):
    for words in ("nosuchlauncher --fast", str(tmp_path)):
        result = subprocess.run(
            [sys.executable, "-m", "petscib.launch", "-n", "2", "true"],
            env=mpi_environment(MPIEXEC=words), capture_output=True, text=True)
        assert result.returncode == 2 and result.stdout == ""
        line, = result.stderr.splitlines()
        assert line.startswith(f"petscib: cannot start {words.split()[0]}: ") and "MPIEXEC" in line


def test_ctrl_c_is_turned_into_a_request():
    script = ("import signal, sys, time; signal.signal(signal.SIGUSR1, lambda *a: sys.exit(0)); "
              "print('ready', flush=True); time.sleep(30)")
    process = subprocess.Popen([sys.executable, "-m", "petscib.launch", "-c", script],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               env=mpi_environment(MPIEXEC=sys.executable))
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    line, = process.communicate(timeout=10)[1].splitlines()
    assert process.returncode == 130 and line.endswith("; a second Ctrl-C ends it at once")


def test_a_second_ctrl_c_ends_the_job():
    script = ("import os, signal, time; signal.signal(signal.SIGUSR1, lambda *a: os.write(1, "
              "b'asked\\n')); os.write(1, b'ready\\n'); time.sleep(30)")
    process = subprocess.Popen([sys.executable, "-m", "petscib.launch", "-c", script],
                               stdout=subprocess.PIPE, env=mpi_environment(MPIEXEC=sys.executable))
    for _ in range(2):
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
    assert process.wait(timeout=10) == 130


def test_a_job_under_nohup_goes_on_when_its_terminal_goes():
    script = ("import os, time; os.write(1, b'ready\\n'); time.sleep(1); os.write(1, b'done\\n')")
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", "petscib.launch", "-c", script], stdout=subprocess.PIPE,
            env=mpi_environment(MPIEXEC=sys.executable))
    finally:
        signal.signal(signal.SIGHUP, before)
    process.stdout.readline()
    process.send_signal(signal.SIGHUP)
    assert process.communicate(timeout=10)[0] == b"done\n" and process.returncode == 0


NOISES = {
    "5": """\
--------------------------------------------------------------------------
prterun detected that one or more processes exited with non-zero status,
thus causing the job to be terminated. The first process to do so was:

   Process name: [prterun-host-24@1,0]
   Exit code:    3
--------------------------------------------------------------------------
[host:00167] PMIX ERROR: PMIX_ERR_UNREACH in file ../src/server/pmix_server.c at line 3184
""",
    "6": """\
--------------------------------------------------------------------------
A deprecated MCA variable value was specified in the environment or
on the command line.

  Deprecated variable: rmaps_default_mapping_policy
--------------------------------------------------------------------------
--------------------------------------------------------------------------

prterun noticed that process rank 1 with PID 71 on node host exited on
signal 9 (Killed).
--------------------------------------------------------------------------
2 more processes have sent help message help-mpi-api.txt / mpi-abort (job prterun-host-74@1)
Set the PMIX_AGGREGATE_HELP attribute to false when spawning the job to see all
""",
}
OURS = """\
petscib: one line
----------------------------------------------------------------------
a box of PETSc's
----------------------------------------------------------------------
[host:05253] *** Process received signal ***
"""


@pytest.mark.parametrize("name", NOISES)
def test_launchers_words_are_known(name):
    assert without_noise(NOISES[name] + OURS) == OURS
    assert without_noise(OURS + NOISES[name]) == OURS
