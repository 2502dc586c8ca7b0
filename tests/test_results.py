"""The output folder of a run, written by rank 0 for all."""
import json
import os
import pathlib
import re

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from petscib import options
from petscib.errors import InputError, OutputError
from petscib.output import checkpoint, plots, results, tables
from petscib.start import build_problem

comm = MPI.COMM_WORLD
COLUMNS = "step", "time", "energy"
both = pytest.mark.parallel([1, 2])


class Folder:
    """Results of a small problem in a folder, and a state whose step is set by hand."""

    def __init__(self, folder, steps=10, **words):
        words = {"stag_grid_x": "12", "flow": "rest", "axes": "0.3,0.3", "markers": "16",
                 "monitor": "none", "output": str(folder), "ts_dt": "0.1", **words}
        settings = options.read(words)
        problem, self.state = build_problem(settings, PETSc.COMM_WORLD)
        self.path = folder
        self.results = results.Results(settings, problem, steps, COLUMNS)

    def record(self, step, energy=1.0):
        self.state.step, self.state.time = step, step / 10
        self.results.record({"step": step, "time": step / 10, "energy": energy}, self.state)

    def save(self, step, name=None):
        self.state.step = step
        return self.results.save(self.state, checkpoint.Progress(dt=0.1), name)

    def summarise(self):
        return self.results.summarise(
            4, 2.0 + comm.rank, 1.0, {"stepping": 1.5 + comm.rank}, "finished", ["a doubt"])


@both
@pytest.mark.parametrize("steps, words, every", [
    (1000, {}, 10), (30, {}, 1), (1000, {"outline_every": "4"}, 4)])
def test_every_row_and_about_a_hundred_outlines(tmp_path, steps, words, every):
    folder = Folder(tmp_path, steps, **words)
    for step in range(21):
        folder.record(step, energy=0.5 * step)
    folder.results.release()
    table = tables.read(tmp_path / "diagnostics.csv")
    assert table["step"].tolist() == list(range(21))
    assert table["energy"].tolist() == [0.5 * step for step in range(21)]
    outlines = tables.read_outlines(tmp_path / "outlines.csv")
    assert [step for step, *_ in outlines] == list(range(0, 21, every))
    if comm.rank == 0:
        np.testing.assert_array_equal(outlines[-1][3], folder.state.markers)


@both
def test_only_the_last_checkpoints_are_kept(tmp_path):
    folder = Folder(tmp_path, checkpoint_keep="2")
    folder.save(0, "final.h5")  # which has a name of its own
    for step in (1, 2, 3, 4):
        assert folder.save(step) == f"{tmp_path}/checkpoint-0000000{step}.h5"
    folder.results.release()
    assert sorted(path.name for path in tmp_path.glob("*.h5")) == [
        "checkpoint-00000003.h5", "checkpoint-00000004.h5", "final.h5"]


@both
def test_the_summary_is_rank_0s(tmp_path):
    folder = Folder(tmp_path)
    folder.record(4, energy=2.5)
    summary = folder.summarise()
    folder.results.release()
    written = json.loads((tmp_path / "summary.json").read_text())
    assert comm.allgather(written) == [written] * comm.size
    if comm.rank == 0:
        assert summary == written
    assert written["last_row"] == {"step": 4, "time": 0.4, "energy": 2.5}
    assert written["ended"] == "finished" and written["doubts"] == ["a doubt"]
    assert written["ranks"] == comm.size and written["steps"] == 4


@both
def test_pictures_are_drawn_once_and_may_fail(tmp_path, monkeypatch, capfd):
    drawn = []
    monkeypatch.setattr(plots, "plot_all", drawn.append)
    folder = Folder(tmp_path)
    folder.results.draw()
    assert comm.allgather(drawn) == [[str(tmp_path)], *[[]] * (comm.size - 1)]

    def missing(folder):
        raise ModuleNotFoundError("no", name="matplotlib")

    monkeypatch.setattr(plots, "plot_all", missing)
    folder.results.draw()
    folder.results.release()
    said = capfd.readouterr().err
    assert said == "petscib: no pictures, matplotlib is not installed\n" * (comm.rank == 0)


@both
def test_what_rank_0_cannot_write_fails_on_all(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="file"):
        Folder(tmp_path / "file")
    folder = Folder(tmp_path / "run")
    comm.Barrier()
    if comm.rank == 0:
        (tmp_path / "run" / "summary.json.part").mkdir()
    with pytest.raises(OutputError, match="summary.json.part: Is a directory"):
        folder.summarise()
    folder.results.release()


def test_a_traceback_is_left_if_it_can_be(tmp_path):
    folder = Folder(tmp_path / "run")
    folder.results.keep_traceback("line 1")
    assert (tmp_path / "run" / "traceback.txt").read_text() == "line 1"
    folder.results.release()
    os.rename(tmp_path / "run", tmp_path / "gone")
    folder.results.keep_traceback("line 2")
    assert not (tmp_path / "run").exists()


@both
def test_peak_memory_is_in_bytes_and_of_all_ranks_together():
    status = pathlib.Path("/proc/self/status")
    if not status.exists():
        pytest.skip("no /proc here")
    kilobytes = int(re.search(r"VmHWM:\s*(\d+) kB", status.read_text())[1])
    assert results.peak_memory(comm) == pytest.approx(1024 * comm.allreduce(kilobytes), rel=0.02)
