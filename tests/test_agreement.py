"""What all ranks come to know alike, and how a job ends that they cannot go on with."""
import sys
import time
from types import SimpleNamespace

import pytest
from runs import comm

from petscib import uncaught
from petscib.agreement import Agreement, everywhere, on_root
from petscib.errors import Crash, InputError, SolveError

parallel = pytest.mark.parallel([1, 3])


@parallel
def test_the_largest_of_each_number():
    agreement = Agreement(comm)
    assert agreement.meet([comm.rank, -comm.rank]) == [comm.size - 1, 0]
    if comm.rank == 0:
        time.sleep(0.1)  # within the patience of the others
    assert agreement.meet([comm.rank == 0], patience=30.0) == [1]
    agreement.destroy()


@pytest.mark.parallel(2)
def test_who_does_not_come_is_not_waited_for():
    agreement = Agreement(comm)
    if comm.rank == 0:
        assert agreement.meet([1], patience=0.05) is None
    comm.Barrier()
    if comm.rank == 1:  # in the end it does
        assert agreement.meet([0]) == [1]


@parallel
@pytest.mark.parametrize("troubles, message, kind", [
    ([None, SolveError("a"), SolveError("b")], "a", SolveError),
    ([SolveError("a"), InputError("b"), None], "b", InputError),
    ([InputError("a"), None, Crash("b")], "b (on rank 2)", Crash),
    ([Crash("a"), Crash("a"), Crash("a")], "a", Crash)])
def test_the_worst_trouble_is_everybodys(troubles, message, kind):
    if comm.size == 1:
        troubles = [one for one in troubles if one is not None][:1]
        message, kind = str(troubles[0]), type(troubles[0])
    agreement = Agreement(comm)
    error, _ = agreement.common(troubles[comm.rank])
    assert str(error) == message and type(error) is kind
    agreement.destroy()


@parallel
def test_an_error_of_one_rank_is_raised_on_all():
    def refuse(rank):
        if comm.rank == rank:
            raise InputError("no")
        return comm.rank

    with pytest.raises(InputError, match="^no$"):
        on_root(comm, lambda: refuse(0))
    with pytest.raises(InputError, match="^no$"):
        everywhere(comm, lambda: refuse(comm.size - 1))
    assert on_root(comm, lambda: refuse(None)) == 0  # only there
    assert everywhere(comm, lambda: refuse(None)) == comm.rank


@pytest.mark.parametrize("error, status", [(InputError("no"), 2), (ValueError("mine"), 1)])
@pytest.mark.parametrize("rank", [0, 1])
def test_an_uncaught_exception_ends_the_job(monkeypatch, capsys, error, status, rank):
    """Petscib's own are one line, of the first rank; others have their traceback on each."""
    ended = []
    monkeypatch.setattr(sys, "excepthook", sys.__excepthook__)
    monkeypatch.setattr(uncaught, "PATIENCE", 0.0)
    uncaught.end_the_job(SimpleNamespace(size=2, rank=rank, Abort=ended.append))
    sys.excepthook(type(error), error, None)
    said = capsys.readouterr().err
    assert ended == [status]
    assert said == {(2, 0): "petscib: no\n", (2, 1): ""}.get((status, rank), "ValueError: mine\n")


def test_a_hook_of_the_scripts_is_left_alone(monkeypatch):
    def hook(*arguments):
        pass

    monkeypatch.setattr(sys, "excepthook", hook)
    uncaught.end_the_job(SimpleNamespace(size=2))
    assert sys.excepthook is hook


def test_a_script_on_one_rank_has_its_traceback(monkeypatch, capsys):
    monkeypatch.setattr(sys, "excepthook", sys.__excepthook__)
    uncaught.end_the_job(SimpleNamespace(size=1))
    sys.excepthook(InputError, InputError("no"), None)
    assert capsys.readouterr().err.endswith("InputError: no\n")
