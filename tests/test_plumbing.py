"""The plumbing of conftest.py: a fault on any one rank is reported, and nothing hangs."""
import pathlib
import shutil
import subprocess
import sys
import time

import pytest
from conftest import mpi_environment

CASES = '''
import os, time
import pytest
from mpi4py import MPI

comm = MPI.COMM_WORLD


@pytest.mark.parallel([1, 3])
def test_size_and_shared_folder(ranks, tmp_path):
    assert comm.size == ranks
    assert comm.allgather(str(tmp_path)) == [str(tmp_path)] * ranks


@pytest.mark.parallel(2)
def test_assert_on_rank_1():
    assert comm.rank != 1, "only here"


@pytest.mark.parallel(2)
def test_assert_on_rank_1_before_a_collective():
    assert comm.rank != 1
    comm.Barrier()


@pytest.mark.parallel(2)
def test_rank_1_dies():
    if comm.rank == 1:
        os._exit(3)
    comm.Barrier()


@pytest.mark.parallel(2, timeout=2)
def test_rank_1_hangs():
    if comm.rank == 1:
        time.sleep(1000)


@pytest.mark.parallel(2)
def test_skipped():
    pytest.skip("for a reason")


@pytest.mark.parallel(2)
@pytest.mark.xfail(strict=True)
def test_expected_failure():
    assert False


@pytest.mark.parallel(2)
def test_after_all_these():
    pass
'''


OUTCOMES = {
    "size_and_shared_folder[ranks=1]": "PASSED",
    "size_and_shared_folder[ranks=3]": "PASSED",
    "assert_on_rank_1[ranks=2]": "FAILED",
    "assert_on_rank_1_before_a_collective[ranks=2]": "FAILED",
    "rank_1_dies[ranks=2]": "FAILED",
    "rank_1_hangs[ranks=2]": "FAILED",
    "skipped[ranks=2]": "SKIPPED",
    "expected_failure[ranks=2]": "XFAIL",
    "after_all_these[ranks=2]": "PASSED",
}


def test_outcomes(tmp_path):
    """Pytest's report of the cases above, run in a folder of their own."""
    shutil.copy(pathlib.Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / "test_cases.py").write_text(CASES)
    begin = time.monotonic()
    # Without `env` the child would inherit what MPI, once initialised here, adds to the environment
    # behind Python's back, and take itself for a rank of this process's job.
    report = subprocess.run(
        [sys.executable, "-m", "pytest", "-rA", "-v", "-p", "no:cacheprovider", "test_cases.py"],
        cwd=tmp_path, env=mpi_environment(), stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, timeout=100).stdout
    assert time.monotonic() - begin < 60, report
    for name, outcome in OUTCOMES.items():
        assert f"test_cases.py::test_{name} {outcome}" in report
    assert "rank 1 failed" in report and "only here" in report
    assert "rank 0 did not finish" in report
    assert "stopped after 2 s without progress" in report


def test_mpirun(mpirun):
    script = "from mpi4py.MPI import COMM_WORLD as comm; comm.rank or print('size', comm.size)"
    assert mpirun(3, "-c", script).stdout == "size 3\n"
    assert mpirun(2, "-c", "raise SystemExit(5)", check=False).returncode == 5
    with pytest.raises(pytest.fail.Exception, match="exit status 5"):
        mpirun(2, "-c", "raise SystemExit(5)")
    with pytest.raises(pytest.fail.Exception, match="no end after 1 s"):
        mpirun(2, "-c", "import time; time.sleep(1000)", timeout=1)
