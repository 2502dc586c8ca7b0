"""Why a result is not to be trusted, from the rows of a run."""
import dense
import pytest

from petscib import options
from petscib.doubts import Doubts
from petscib.output.rows import entry

WORDS = {"flow": "rest", "stag_grid_x": "24", "vesicles": "2", "axes": "0.2,0.3", "scheme": "gcn",
         "vesicle_0_center": "-0.5,0", "vesicle_1_center": "0.5,0", "ledger": "record"}


def found(*rows):
    """What is doubted after some rows."""
    problem, state = dense.problem(**WORDS)
    doubts = Doubts(options.read(WORDS), problem)
    for row in rows:
        doubts.note(row)
    doubts.end(state)
    return doubts.found


GOOD = {"area_error_0": 1e-3, "area_error_1": 2e-3, "perimeter_error_0": 1e-3,
        "perimeter_error_1": None, "cfl": 0.1, "ledger_residual": 1e-9}


def test_nothing_is_doubted_without_a_reason():
    assert found() == found(GOOD) == found(GOOD, GOOD) == []


@pytest.mark.parametrize("name, value, text", [
    ("area_error_0", 0.03, "area off by 3.0%"), ("area_error_1", 0.02, "area off by 2.0%"),
    ("perimeter_error_1", 0.04, "perimeter off by 4.0%"),
    ("ledger_residual", 2e-3, "energy ledger off by 2.0e-03"),
    ("area_error_0", float("nan"), "area off by nan%"),
    ("perimeter_error_0", float("nan"), "perimeter off by nan%"),
    ("ledger_residual", float("nan"), "energy ledger off by nan")])
def test_the_worst_of_all_rows_and_vesicles(name, value, text):
    """A NaN is worse than any number, wherever it stands."""
    bad = {**GOOD, name: value}
    for rows in ((bad,), (GOOD, bad), (bad, GOOD)):
        doubt, = found(*rows)
        assert doubt.startswith(text)


def test_the_entry_of_several_vesicles():
    nan = float("nan")
    assert entry({"a_0": -3.0, "a_1": 2.0, "a_2": None}, "a") == -3.0
    assert entry({"a_0": 5.0, "a_1": nan, "a_2": 7.0}, "a") is nan
    assert entry({"a": 1.0, "a_0": 2.0}, "a") == 1.0 and entry({"b": 1.0}, "a") is None
