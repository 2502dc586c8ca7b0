"""The examples run, in small, and draw what they say."""

import runpy
import sys
from pathlib import Path

import pytest

import petscib

pytest.importorskip("matplotlib")
FOLDER = Path(__file__).parents[1] / "examples"
COARSE = "-stag_grid_x 24 -ts_max_time 0.2 -ts_dt 0.05".split()
SMALL = {
    "shear": COARSE, "relaxation": [*COARSE, "-axes", "0.25,0.5"], "own_flow": COARSE,
    "own_force": COARSE, "sweep": COARSE, "restart": COARSE,
    "pair": "-stag_grid_x 40 -markers 40 -ts_max_time 0.2 -ts_dt 0.1".split(),
    "tumbling": "-stag_grid_x 32 -ts_max_time 0.2 -ts_dt 0.1".split(),
}


def test_all_are_tried():
    assert {path.stem for path in FOLDER.glob("*.py")} == set(SMALL)


@pytest.mark.parametrize("name", SMALL)
def test_an_example(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *SMALL[name]])
    names = runpy.run_path(str(FOLDER / f"{name}.py"))
    for simulation in (one for one in names.values() if isinstance(one, petscib.Simulation)):
        simulation.close()
    where = tmp_path / "out" / "examples"
    drawn = where / "shear" / "outlines.png" if name == "shear" else where / f"{name}.png"
    assert drawn.stat().st_size > 5000
    said = capsys.readouterr().out
    assert ".png" in said
    if name == "restart":
        assert "to the last digit: True" in said
    if name == "own_force":
        assert float(said.split(" to ")[1].split(";")[0]) < 1e-8
