"""Results of a run that writes no files."""
import dense
import pytest
from mpi4py import MPI

from petscib import options
from petscib.output.memory import Memory
from petscib.settings import NOWHERE

comm = MPI.COMM_WORLD


@pytest.mark.parallel([1, 2])
def test_rows_and_summary_without_a_file(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    words = {"stag_grid_x": "12", "flow": "rest", "axes": "0.3,0.3", "monitor": "log",
             "plot": "no"}
    settings = options.read(words, writes=False)
    assert settings.output == NOWHERE
    problem, state = dense.problem(**words)
    results = Memory(settings, problem, 10, ("step",))
    assert not results.writes
    results.monitor.start(0, 0.0, 1.0, 10)
    row = {"step": 3, "time": 0.5, "energy": 2.0}
    results.record(row, state)
    assert results.last_row == row
    summary = results.summarise(3, 1.0, 1.0, {}, "finished", [])
    assert summary["last_row"] == row and summary["ended"] == "finished"
    results.keep_traceback("Traceback\n  line 1\n")
    results.release()
    comm.Barrier()
    assert not list(tmp_path.iterdir())
    said = capfd.readouterr().err
    assert "Traceback\n  line 1\n" in said
    assert ("     3       0.5" in said) == (comm.rank == 0)  # progress is rank 0's
