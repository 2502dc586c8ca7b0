"""Remarks at the start and in a step: points left out of a curve, time steps that are too long."""

import numpy as np
import pytest
import runs

from petscib import accuracy, options, scenes
from petscib.membranes import shapes

CIRCLE = shapes.ellipse((0.4, 0.4), (0.0, 0.0), 0.0, 100)


@pytest.mark.parametrize("words, part, advice", [
    (dict(ts_dt="0.1"), "", ""),
    (dict(ts_dt="0.11"), "turns and strains a vesicle by 0.11", "-ts_dt 0.1 "),
    (dict(shear_rate="-10", ts_dt="0.03125"), "turns and strains a vesicle by 0.31", "-ts_dt 0.01"),
    (dict(flow="extensional", ts_dt="0.2"), "turns and strains a vesicle by 0.2", "-ts_dt 0.1 "),
    (dict(flow="rest", ts_dt="100"), "", ""),
    (dict(scheme="gcn", ts_dt="0.5"), "", ""),
    (dict(scheme="gcn", ts_dt="0.6"), "turns and strains a vesicle by 0.6", "-ts_dt 0.5 "),
    # Away from the axis y = 0 a shear flow carries what it hardly turns.
    (dict(domain="-1,1,9,11", center="0,10", axes="0.4,0.4", ts_dt="0.02"),
     "moves by 0.52 of its radius", "-ts_dt 0.0096"),
])
def test_a_flow_that_does_too_much_in_a_step(words, part, advice):
    settings = options.read({"axes": "0.4,0.4", "scheme": "cn", **words})
    markers = shapes.ellipse(settings.axes, settings.center, 0.0, 100)
    warning = accuracy.of_flow(settings, markers)
    assert part in warning and advice in warning and bool(part) == bool(warning)
    assert accuracy.of_flow(settings, np.zeros((0, 2))) == ""
    advised = warning.partition("-ts_dt ")[2].split()
    if advised:
        shorter = options.read({"scheme": "cn", **words, "ts_dt": advised[0]})
        assert accuracy.of_flow(shorter, markers) == ""


def test_a_step_that_carries_a_vesicle_too_far():
    first, second = (options.read({"scheme": name}) for name in ("cn", "gcn"))
    assert accuracy.of_step(first, CIRCLE, CIRCLE + (0.09, 0.0), 0.5) == ""
    warning = accuracy.of_step(first, CIRCLE, CIRCLE + (0.2, 0.0), 0.5)
    assert "moves by 0.5 of its radius" in warning and "-ts_dt 0.25 " in warning
    assert accuracy.of_step(second, CIRCLE, CIRCLE + (0.2, 0.0), 0.5) == ""
    one = CIRCLE.copy()
    one[7] += 0.3
    assert accuracy.of_step(first, CIRCLE, one, 0.5)
    assert accuracy.of_step(first, np.zeros((0, 2)), np.zeros((0, 2)), 0.5) == ""


@pytest.mark.parametrize("scene", scenes.SCENES)
@pytest.mark.parametrize("cells", ["32", "64"])
def test_no_scene_warns_of_itself(scene, cells):
    settings = options.read({"scene": scene, "stag_grid_y": cells})
    markers = CIRCLE if settings.vesicles else CIRCLE[:0]
    if settings.axes is not None:
        markers = shapes.ellipse(settings.axes, settings.center, settings.angle, 200)
    assert accuracy.of_flow(settings, markers) == ""


def said(capsys, folder, **words):
    """Petscib's lines on standard error of a run."""
    runs.run(folder, **words)
    return [line for line in capsys.readouterr().err.splitlines() if line.startswith("petscib: ")]


def test_a_run_says_it_once(tmp_path, capsys):
    turning = dict(scheme="gbe", ts_dt="0.2", ts_max_time="0.6", fft="true")
    line, = said(capsys, tmp_path / "turning", **turning)
    assert "turns and strains a vesicle by 0.2" in line
    moving = dict(turning, scene="elastic", axes="0.2,0.5", ts_dt="0.6", ts_max_time="1.8")
    line, = said(capsys, tmp_path / "moving", **moving)
    assert "of its radius" in line
    assert said(capsys, tmp_path / "short", **dict(moving, ts_dt="0.125")) == []


def test_a_run_says_what_it_left_out_of_a_curve(tmp_path, capsys, monkeypatch):
    monkeypatch.delitem(runs.SMALL, "axes")
    path = tmp_path / "curve.txt"
    turn = np.linspace(0, 2 * np.pi, 101)
    np.savetxt(path, 0.4 * np.stack((np.cos(turn), np.sin(turn)), axis=1))
    line, = said(capsys, tmp_path / "out", marker_file=str(path), ts_max_steps="1")
    assert line == (f"petscib: -marker_file {path}: the point of line 101 all but repeats another, "
                    "and is left out")
