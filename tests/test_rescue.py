"""Copies of all ranks' parts of the state, of which one rank alone makes a checkpoint."""
import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from runs import arrays

from petscib import options
from petscib.errors import OutputError
from petscib.output import checkpoint, rescue
from petscib.start import build_problem

comm = MPI.COMM_WORLD
pytestmark = pytest.mark.parallel(3)
WORDS = {"stag_grid_x": "14", "stag_grid_y": "11", "flow": "rest", "axes": "0.2,0.3",
         "markers": "40"}


class Case:
    """A state of random numbers, with a history of every kind."""

    def __init__(self, folder):
        self.folder, self.settings = str(folder), options.read(WORDS)
        self.problem, self.state = build_problem(self.settings, PETSc.COMM_WORLD)
        self.progress = checkpoint.Progress(dt=0.25, reference={"area": [1.0], "perimeter": [2.0]})
        self.rescue = rescue.Rescue(comm)
        self.state.history.update(
            velocity_rate=self.state.velocity.duplicate(), bare_pressure=self.state.pressure.copy(),
            marker_rate=self.state.markers * 0.5, good=3.0)
        self.random = np.random.default_rng(comm.rank)

    def step_to(self, step):
        """A new state, as that of a step is."""
        state = self.state
        state.step, state.time = step, 0.1 * step
        for vector in (state.velocity, state.pressure, state.history["velocity_rate"]):
            local = vector.getArray()
            local[:] = self.random.standard_normal(len(local))
        state.markers = state.markers + 0.01 * step

    def keep(self):
        self.rescue.keep(self.state, self.progress)

    def save(self):
        """Rank 0 saves while the others wait; the path, on all."""
        path = None
        if comm.rank == 0:
            path = self.rescue.save(self.folder, self.problem, self.settings)
        return comm.bcast(path)


def test_what_was_kept_is_the_checkpoint_of_all_ranks(tmp_path):
    case = Case(tmp_path)
    assert case.rescue.wanted
    for step in (3, 4):
        case.step_to(step)
        case.keep()
    usual = str(tmp_path / "usual.h5")
    checkpoint.save(usual, case.problem, case.state, case.settings, case.progress)
    case.step_to(5)  # which fails: it is never kept
    path = case.save()
    if comm.rank:
        return
    assert path.endswith("checkpoint-00000004.h5")
    one, other = arrays(path), arrays(usual)
    assert one.keys() == other.keys() and sum("history" in name for name in one) == 4
    for name, values in other.items():
        np.testing.assert_array_equal(one[name], values, err_msg=name)
    found = checkpoint.read_header(path)
    assert (found.step, found.time, found.progress) == (4, 0.4, case.progress)


def test_states_of_different_steps_make_none(tmp_path, monkeypatch):
    monkeypatch.setattr(rescue, "WAIT", 0.05)
    case = Case(tmp_path)
    case.step_to(1)
    case.keep()
    comm.Barrier()
    case.state.step = 2
    if comm.rank == 1:
        case.keep()
    comm.Barrier()
    if comm.rank == 0:
        with pytest.raises(OutputError, match="the ranks have kept different states"):
            case.rescue.save(case.folder, case.problem, case.settings)
        assert not list(tmp_path.iterdir())
    comm.Barrier()


def test_a_copy_that_is_being_written_is_none(tmp_path, monkeypatch):
    monkeypatch.setattr(rescue, "WAIT", 0.05)
    case = Case(tmp_path)
    case.keep()
    if comm.rank == 2:  # as at the beginning of `keep`
        case.rescue._write(0, np.zeros(1, np.int64))
    comm.Barrier()
    if comm.rank == 0:
        with pytest.raises(OutputError, match="different states"):
            case.rescue.save(case.folder, case.problem, case.settings)
    comm.Barrier()


def test_keeping_may_take_its_share_of_the_time_only(tmp_path):
    kept = Case(tmp_path).rescue
    assert kept.is_due
    kept.spent = 1.0
    assert not kept.is_due
    kept.began -= 100.0  # a hundredth of which is a second
    assert kept.is_due
    assert not rescue.Rescue(MPI.COMM_SELF).is_due  # there is nobody to be rescued by


def test_one_rank_alone_ends_the_job(tmp_path):
    case = Case(tmp_path)
    claims = []
    for rank in range(comm.size):
        if comm.rank == rank:
            claims.append(case.rescue.claim())
        comm.Barrier()
    assert comm.allgather(claims) == [[True], [False], [False]]


def test_ranks_on_other_machines_are_out_of_reach(tmp_path):
    case = Case(tmp_path)
    case.keep()
    case.rescue._paths[2] = "another machine", case.rescue._paths[2][1]
    with pytest.raises(OutputError, match="the ranks are on several machines"):
        case.rescue.save(case.folder, case.problem, case.settings)
    comm.Barrier()
