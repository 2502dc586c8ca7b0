"""Progress display, on a text stream and with a clock that the tests turn."""

import builtins
import io

import numpy as np
import pytest

from petscib import options
from petscib.output import monitor
from petscib.output.words import closing_lines, opening_line


class Clock:
    """Stands in for time.monotonic."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(monitor, "monotonic", clock)
    return clock


class Terminal(io.StringIO):
    def isatty(self):
        return True


def row(step, dt=0.01, **more):
    return {
        "step": step, "time": step * dt, "dt": dt, "cfl": 0.64, "max_speed": 1.02,
        "max_divergence": 3e-13, "area_error": -1.2e-4, "perimeter_error": 3.4e-8,
        "momentum_iterations": 6, "poisson_iterations": 9, "coupled_iterations": None, **more,
    }


def run(name, clock, steps, seconds_per_step, first=0, end_time=None, max_steps=None, every=1):
    """Let a monitor watch a run; return its lines."""
    stream = io.StringIO()
    display = monitor.create(name, stream)
    display.start(first, 0.01 * first, end_time, max_steps)
    for step in range(first + 1, steps + 1):
        clock.now += seconds_per_step
        display.update(row(step))
    display.close()
    display.close()
    return stream.getvalue().splitlines()


def steps_in(lines):
    return [int(line.split()[0]) for line in lines if line.split()[0].isdigit()]


def test_log_of_a_fast_run_has_twenty_parts(clock):
    lines = run("log", clock, 1000, 1e-4, end_time=10.0)
    assert steps_in(lines) == [1, *range(50, 1001, 50)]


def test_log_of_a_slow_run_has_a_line_every_two_seconds(clock):
    lines = run("log", clock, 105, 0.5, max_steps=10**6)
    assert steps_in(lines) == [*range(1, 105, 4), 105]


def test_log_of_a_day_long_run_stays_readable(clock):
    lines = run("log", clock, 20_000, 5.0, max_steps=20_000)
    assert 500 < len(steps_in(lines)) < 3000


def test_log_repeats_its_header_and_stays_aligned(clock):
    lines = run("log", clock, 50, 3.0, end_time=0.5)
    headers = [k for k, line in enumerate(lines) if "max speed" in line]
    assert headers == [0, 26]
    assert len({len(line) for line in lines}) == 1
    assert len(lines[0]) <= 120
    cells = lines[1].split()
    assert cells == (
        "1 0.01 1.00e-02 0.64 1.02 3.0e-13 -1.2e-04 3.4e-08 6 9 - 2% 02:27".split()
    )
    assert lines[-1].split()[-2:] == ["100%", "00:00"]


def test_log_prints_the_last_step_once(clock):
    assert steps_in(run("log", clock, 3, 1e-3, max_steps=1000)) == [1, 3]
    assert steps_in(run("log", clock, 1, 1e-3, max_steps=1)) == [1]
    assert run("log", clock, 0, 1.0, max_steps=0) == []


def test_log_of_a_restart_says_where_it_began(clock):
    lines = run("log", clock, 30, 10.0, first=20, end_time=0.4, max_steps=None)
    assert lines[0] == "restarted at step 20, time 0.2 (50%)"
    # 10 steps in 100 s since the restart, 10 to go: the time before it does not count.
    assert lines[-1].split()[-2:] == ["75%", "01:40"]


def test_whichever_end_comes_first_counts(clock):
    assert run("log", clock, 10, 1.0, end_time=0.2, max_steps=1000)[-1].split()[-2] == "50%"
    assert run("log", clock, 10, 1.0, end_time=100.0, max_steps=40)[-1].split()[-2] == "25%"
    lines = run("log", clock, 10, 1.0, end_time=float("inf"), max_steps=None)
    assert lines[-1].split()[-2:] == ["0%", "--:--"]


def test_several_vesicles_show_the_largest_error(clock):
    stream = io.StringIO()
    display = monitor.create("log", stream)
    display.start(0, 0.0, 1.0, None)
    errors = row(1, area_error_0=1e-5, area_error_1=-2e-3, perimeter_error_0=float("nan"),
                 perimeter_error_1=1.0)
    del errors["area_error"], errors["perimeter_error"]
    display.update(errors)
    cells = stream.getvalue().splitlines()[1].split()
    assert cells[6:8] == ["-2.0e-03", "nan"]


def test_run_without_vesicle_shows_dashes(clock):
    stream = io.StringIO()
    display = monitor.create("log", stream)
    display.start(0, 0.0, 1.0, None)
    display.update({"step": 1, "time": 0.5})
    assert stream.getvalue().splitlines()[1].split() == [
        "1", "0.5", *["-"] * 9, "50%", "00:00"
    ]


def test_silent_monitor_only_passes_warnings_on(clock):
    stream = io.StringIO()
    display = monitor.create("none", stream)
    display.start(0, 0.0, 1.0, None)
    display.update(row(1))
    display.write("warning: the membrane is near a wall")
    display.close()
    assert stream.getvalue() == "warning: the membrane is near a wall\n"


def test_bar_shows_progress_and_iterations(clock):
    pytest.importorskip("tqdm")
    text = "\n".join(run("bar", clock, 40, 1.0, end_time=0.8))
    assert " 50%|" in text
    assert "t 0.4/0.8 step 40 iter m6 p9 [" in text


def test_bar_of_a_restart_says_where_it_began(clock):
    pytest.importorskip("tqdm")
    text = "\n".join(run("bar", clock, 30, 1.0, first=20, max_steps=40))
    assert "restarted at 50%" in text and " 75%|" in text


def test_bar_is_redrawn_seldom(clock):
    pytest.importorskip("tqdm")
    stream = Terminal()
    display = monitor.create(None, stream)
    display.start(0, 0.0, None, 10_000)
    for step in range(1, 10_001):
        clock.now += 1e-4
        display.update(row(step))
    display.close()
    draws = stream.getvalue().count("\r")
    assert 10 <= draws <= 20
    assert "100%|" in stream.getvalue().split("\r")[-1]


def test_warning_stands_above_the_bar(clock):
    pytest.importorskip("tqdm")
    stream = io.StringIO()
    display = monitor.create("bar", stream)
    display.start(0, 0.0, None, 10)
    clock.now += 1.0
    display.update(row(5))
    display.write("warning: cfl above 1")
    after = stream.getvalue().split("warning: cfl above 1\n")[1]
    display.close()
    # The bar is wiped before the line, which begins at the left edge, and drawn again after it.
    assert "\rwarning: cfl above 1\n" in stream.getvalue()
    assert " 50%|" in after


def test_default_is_a_bar_on_a_terminal_only():
    pytest.importorskip("tqdm")
    assert isinstance(monitor.create(None, Terminal()), monitor.BarMonitor)
    assert isinstance(monitor.create(None, io.StringIO()), monitor.LogMonitor)


def test_without_tqdm_the_bar_becomes_a_log(monkeypatch):
    genuine = builtins.__import__

    def refuse(name, *rest, **more):
        if name == "tqdm":
            raise ImportError
        return genuine(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)
    stream = io.StringIO()
    assert isinstance(monitor.create("bar", stream), monitor.LogMonitor)
    assert "tqdm" in stream.getvalue()


@pytest.mark.parametrize("name", ["none", "log", "bar"])
def test_a_monitor_that_never_began_can_warn_and_close(name):
    stream = io.StringIO()
    display = monitor.create(name, stream)
    display.write("petscib: something")
    display.close()
    assert stream.getvalue() == "petscib: something\n"


def test_unknown_monitor_is_refused():
    with pytest.raises(ValueError, match="bar, log or none"):
        monitor.create("loud")


@pytest.mark.parametrize("steps, words, told", [
    (1, {"ts_max_steps": "1"}, "mbe with dt = 0.5, 1 step; transforms and CG ("),
    (2.0, {}, "mbe with dt = 0.5, 2 steps to t = 1; transforms"),
    (np.inf, {"ts_rtol": "1e-3"}, "mbe with dt by -ts_rtol 0.001, to t = 1; transforms")])
def test_the_opening_line_says_what_is_to_come(steps, words, told):
    settings = options.read({
        "scene": "relaxation", "scheme": "mbe", "ts_dt": "0.5", "ts_max_time": "1", "fft": "yes",
        **words})
    assert opening_line(settings, steps).startswith(f"relaxation, 64 x 64 cells, {told}")


def test_closing_lines():
    summary = {
        "last_row": row(200, inclination=0.39269908, treading_frequency=0.15034),
        "steps": 100, "total_seconds": 2.8, "output": "out/none",
        "phase_seconds": {"set-up": 0.3, "diagnostics": 0.2},
        "options": {"flow": "shear", "shear_rate": 1.0},
    }
    assert closing_lines(summary) == [
        "inclination / pi    0.125",
        "treading frequency  0.15034",
        "area error          -1.200e-04",
        "perimeter error     3.400e-08",
        "seconds per step    0.025 (100 steps in 2.5 s, after 0.3 s of set-up)",
        "results in          out/none",
        "look at             out/none/diagnostics.csv",
    ]
    summary["options"]["flow"] = "rest"
    assert closing_lines(summary)[0].startswith("area error")


def test_closing_lines_without_vesicle_or_steps():
    last_row = {"step": 0, "area_error": None, "inclination": None, "treading_frequency": None}
    summary = {"last_row": last_row, "steps": 0, "total_seconds": 0.1, "output": "out/none"}
    assert closing_lines(summary) == [
        "results in          out/none", "look at             out/none/diagnostics.csv"]
    assert closing_lines({}) == []


@pytest.mark.parametrize("time, most, words", [
    (5.0, None, "-ts_max_time 10"), (5.0, 3, "-ts_max_time 10 -ts_max_steps 6"),
    (2.0, 3, "-ts_max_steps 6"), (0.0, 0, "-ts_max_steps 1")])
def test_what_to_type_next_is_beyond_the_limits_reached(time, most, words):
    options = {"ts_max_time": 5.0, "ts_max_steps": most, "given": ["scene"]}
    summary = {"output": "out/pair", "ended": "finished", "options": options,
               "last_row": {"time": time}}
    assert closing_lines(summary)[-1] == (
        f"to go on            -restart latest -output out/pair {words}")


def test_closing_lines_of_several_vesicles():
    last_row = {"inclination_0": 0.0, "inclination_1": 1.5707963267948966,
                "treading_frequency_0": None, "treading_frequency_1": float("nan")}
    assert closing_lines({"last_row": last_row}) == ["inclination / pi    0, 0.5"]


def test_closing_lines_of_one_that_treads_and_one_that_tumbles():
    last_row = {"inclination_0": 0.0, "inclination_1": 0.0,
                "half_turn_0": None, "half_turn_1": 13.2,
                "treading_frequency_0": 0.4, "treading_frequency_1": 0.2}
    assert closing_lines({"last_row": last_row})[1:] == [
        "treading frequency  0.4", "half-turn period    13.2"]
