"""What petscib runs on: it says the versions, and refuses what does not fit together."""
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import mpi_environment
from petsc4py import PETSc

import petscib
from petscib import installation
from petscib.errors import InputError

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("word, ranks", [("-version", 2), ("--version", 1)])
def test_version(mpirun, tmp_path, word, ranks):
    result = mpirun(ranks, "-m", "petscib", word, "-output", "run", "-ts_max_steps", 1)
    versions = dict(line.split(" ", 1) for line in result.stdout.splitlines())
    assert versions["petscib"] == petscib.__version__ and result.stderr == ""
    assert {"petsc", "petsc4py", "mpi", "mpi4py", "h5py", "numpy", "scipy"} < set(versions)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("number, message", [
    (np.complex128, "this PETSc computes with complex128; needed: "),
    (np.float32, "this PETSc computes with float32; needed: ")])
def test_other_numbers_are_refused(monkeypatch, number, message):
    monkeypatch.setattr(PETSc, "ScalarType", number)
    with pytest.raises(InputError, match=message):
        installation.check()


@pytest.mark.parametrize("name, count", [("OMPI_COMM_WORLD_SIZE", "2"), ("PMI_SIZE", "4")])
def test_another_mpis_launcher_is_refused(monkeypatch, name, count):
    """Like Open MPI's, and like MPICH's."""
    for known in installation._WORLD_SIZES:
        monkeypatch.delenv(known, raising=False)
    monkeypatch.setenv(name, count)
    with pytest.raises(InputError, match=f"started {count} ranks, but each sees itself alone"):
        installation.check()
    monkeypatch.setenv(name, "1")
    installation.check()


def test_what_does_not_fit_ends_the_program(mpirun, tmp_path):
    (tmp_path / "driver.py").write_text(
        "import sys; import numpy as np; import petsc4py; petsc4py.init(['petscib'])\n"
        "from petsc4py import PETSc; PETSc.ScalarType = np.complex128\n"
        "from petscib.__main__ import main\nsys.exit(main(['-output', 'run']))\n")
    result = mpirun(1, "driver.py", check=False)
    assert result.returncode == 2 and not (tmp_path / "run").exists()
    line, = result.stderr.splitlines()
    assert line.startswith("petscib: this PETSc computes with complex128; needed: ")


def test_options_that_nothing_has_read_are_not_listed_by_petsc(mpirun):
    words = ["-m", "petscib", "-output", "run", "-stag_grid_x", 24, "-axes", "0.25,0.4",
             "-ts_max_steps", 1, "-monitor", "none", "-plot", "no", "-poisson_ksp_rtol", 0.1]
    result = mpirun(1, *words)
    assert result.stderr == "petscib: no solver has read -poisson_ksp_rtol\n"
    assert "left" not in result.stdout and "poisson_ksp_rtol" not in result.stdout
    listed = mpirun(1, *words, "-options_left", "-momentum_ksp_typo", 1).stdout  # if asked for
    left = listed.rpartition("unused database option")[2]
    assert "momentum_ksp_typo" in left and "stag_grid" not in left and "-plot" not in left


# --- .ci/setup


@pytest.fixture
def set_up(tmp_path):
    """Source .ci/setup in a project's folder of its own, where apt-get and pip find nothing."""
    (tmp_path / "project" / ".ci").mkdir(parents=True)
    shutil.copy(ROOT / ".ci" / "setup", tmp_path / "project" / ".ci")
    (tmp_path / "bin").mkdir()
    for name in ("apt-get", "sudo"):
        (tmp_path / "bin" / name).write_text("#!/bin/sh\nexit 1\n")
        (tmp_path / "bin" / name).chmod(0o755)

    def run(python, needs="", wants=""):
        script = f'set -e; root=$PWD needs="{needs}" wants="{wants}"; . .ci/setup; echo "$python"'
        environment = mpi_environment(PYTHON=str(python), PIP_NO_INDEX="1", PIP_FIND_LINKS="",
                                      PIP_CONFIG_FILE=os.devnull)
        environment["PATH"] = f"{tmp_path}/bin:{environment['PATH']}"
        environment.pop("PYTHONPATH")
        return subprocess.run(["sh", "-c", script], cwd=tmp_path / "project", env=environment,
                              capture_output=True, text=True, timeout=60)

    return run


@pytest.fixture
def own(tmp_path):
    """A virtual environment on the interpreter of these tests that sees what this one sees."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "own"], check=True)
    folder, = (tmp_path / "own").glob("lib/python*/site-packages")
    (folder / "all.pth").write_text("\n".join(filter(os.path.isdir, sys.path)))
    return tmp_path / "own" / "bin" / "python"


def test_an_environment_of_ones_own_is_used_as_it_is(set_up, own, tmp_path):
    result = set_up(own, "pytest")
    assert (result.stdout, result.stderr) == (f"{own}\n", "")
    assert not (tmp_path / "project" / ".venv").exists()


def test_what_it_lacks_goes_into_a_venv_made_for_it(set_up, own, tmp_path):
    """Which it replaces when it was made for another interpreter; .pth files count."""
    venv = tmp_path / "project" / ".venv"
    first = set_up(own, wants="petscib_wants_this")
    assert first.stdout == f"{venv}/bin/python\n" and "doing without petsc" in first.stderr
    assert (venv / "made-for").read_text() == f"{own}\n"
    script = "import petsc4py, sys; print(sys.prefix)"
    inside = subprocess.run([venv / "bin" / "python", "-c", script], capture_output=True, text=True)
    assert inside.stdout == f"{venv}\n"
    (venv / "made-for").write_text("/another/python\n")
    folder, = venv.glob("lib/python*/site-packages")
    (folder / "petscib_wants_this.py").write_text("")
    assert "doing without petscib_wants_this" in set_up(own, wants="petscib_wants_this").stderr
    assert (venv / "made-for").read_text() == f"{own}\n"
    folder, = venv.glob("lib/python*/site-packages")
    (folder / "petscib_wants_this.py").write_text("")
    assert set_up(own, wants="petscib_wants_this").stdout == f"{venv}/bin/python\n"


def test_a_folder_without_modules_is_no_package(set_up, own, tmp_path):
    (tmp_path / "own").joinpath("empty", "h5py").mkdir(parents=True)
    folder, = (tmp_path / "own").glob("lib/python*/site-packages")
    paths = [path for path in sys.path if os.path.isdir(path)
             and not os.path.isdir(os.path.join(path, "h5py"))]
    (folder / "all.pth").write_text("\n".join([str(tmp_path / "own" / "empty"), *paths]))
    assert f"{own} lacks" in set_up(own).stderr and " h5py" in set_up(own).stderr


def test_a_python_that_is_not_there(set_up):
    result = set_up("/no/such/python")
    assert result.returncode == 1 and result.stdout == ""
    assert result.stderr == "petscib: PYTHON=/no/such/python: no such program\n"


def test_a_venv_of_the_users_is_left_alone(set_up, own, tmp_path):
    venv = tmp_path / "project" / ".venv"
    (venv / "bin").mkdir(parents=True)
    result = set_up(own, needs="petscib_needs_this")
    assert result.returncode == 1 and "is yours, not made here" in result.stderr
    assert set_up(own, wants="petscib_wants_this").returncode == 0
    assert list(venv.iterdir()) == [venv / "bin"]
