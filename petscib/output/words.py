"""What a run says first, and what it says last."""

import itertools
import math
import os

from ..schemes.registry import SCHEMES
from .rows import entries, entry, is_number

FINISHED = "finished"  # how a run has ended, unless a signal has stopped it


def opening_line(settings, steps):
    """What a run is going to do, and on which solvers: its first line.

    Parameters
    ----------
    settings : Settings
    steps : int or float
        Those to come; infinite when nobody knows.
    """
    if settings.fft:
        method = " and FGMRES" if settings.has_contrast else " and CG" if settings.vesicles else ""
        solvers = "transforms" + method
        others = "without -fft: multigrid"
    elif SCHEMES[settings.scheme].coupled:
        solvers = "FGMRES with GAMG for velocity and pressure together"
        others = "-fft: transforms, -scheme mcn: CG with GAMG for velocity, then for pressure"
    else:
        solvers = "CG with GAMG for velocity, then for pressure"
        others = "-fft: transforms"
    count = [_count(steps)] if math.isfinite(steps) else []
    if settings.ts_max_steps is None:
        count.append(f"to t = {settings.ts_max_time:g}")
    dt = (f"dt = {settings.ts_dt:.4g}" if settings.ts_rtol is None
          else f"dt by -ts_rtol {settings.ts_rtol:g}")
    return (
        f"{settings.scene}, {settings.stag_grid_x} x {settings.stag_grid_y} cells, "
        f"{settings.scheme} with {dt}, {' '.join(count)}; {solvers} ({others})"
    )


def closing_lines(summary):
    """The last lines of a run.

    Parameters
    ----------
    summary : dict
        The content of ``summary.json``; read are ``last_row`` (the last row of the diagnostics
        table), ``steps`` (number done by this run), ``total_seconds``, ``output`` (the folder),
        ``phase_seconds`` (of which the set-up counts), ``ended``, ``doubts`` and, in ``options``,
        ``flow``, ``shear_rate``, ``tether``, ``ts_max_time``, ``ts_max_steps`` and ``given``. What
        is missing is left out.

    Returns
    -------
    list of str
        Vesicles that tread have their frequency, those that tumble the time of their last half
        turn.  Without a flow there is no line for either, without a vesicle none for errors.
        Several vesicles share a line; of their errors the largest is given.
    """
    row, options = summary.get("last_row") or {}, summary.get("options", {})
    lines = [*_motion(row, options), *_errors(row), *_speed(summary)]
    if summary.get("output"):
        lines += [_line("results in", summary["output"]), *_what_next(summary, options)]
    if summary.get("doubts"):
        lines.append("not to be trusted without a look at")
        lines += [f"  {doubt}" for doubt in summary["doubts"]]
    if summary.get("ended", FINISHED) != FINISHED:
        lines.append(f"stopped early; to go on: -restart latest -output {summary['output']}")
    return lines


def _count(steps):
    return f"{steps:.0f} step" if steps == 1 else f"{steps:.0f} steps"


def _line(title, text):
    return f"{title:<20}{text}"


def _motion(row, options):
    """How vesicles have moved in a flow, and what holds those that are held."""
    found = []
    if options.get("flow") != "rest" and options.get("shear_rate") != 0:
        halves = entries(row, "half_turn")
        # Of one that tumbles a frequency of treading means nothing.
        treads = [value for value, half in itertools.zip_longest(
            entries(row, "treading_frequency"), halves) if half is None]
        found += [("inclination / pi", entries(row, "inclination"), math.pi),
                  ("treading frequency", treads, 1.0), ("half-turn period", halves, 1.0)]
    if options.get("tether"):
        found += [(name, entries(row, name), 1.0) for name in ("drag", "lift")]
    lines = []
    for title, values, unit in found:
        texts = [f"{value / unit:.5g}" for value in values if is_number(value)]
        if texts:
            lines.append(_line(title, ", ".join(texts)))
    return lines


def _errors(row):
    names = ("area error", "area_error"), ("perimeter error", "perimeter_error")
    return [_line(title, f"{entry(row, name):.3e}") for title, name in names
            if is_number(entry(row, name))]


def _speed(summary):
    """Seconds of a step."""
    steps, seconds = summary.get("steps"), summary.get("total_seconds")
    if not steps or not is_number(seconds):
        return []
    set_up = summary.get("phase_seconds", {}).get("set-up", 0.0)
    seconds -= set_up
    return [_line("seconds per step", f"{seconds / steps:.3g} ({_count(steps)} in {seconds:.3g} s, "
                                      f"after {set_up:.2g} s of set-up)")]


def _what_next(summary, options):
    """Lines for who sees their first results."""
    folder = summary["output"]
    pictures = [name for name in ("outlines.png", "fields.png")
                if os.path.exists(os.path.join(folder, name))]
    look = pictures or ["diagnostics.csv"]
    lines = [_line("look at", ", ".join(os.path.join(folder, name) for name in look))]
    end = options.get("ts_max_time")
    if end is not None and summary.get("ended") == FINISHED:
        # A restart refuses the limit that it has reached.
        most, time = options.get("ts_max_steps"), (summary.get("last_row") or {}).get("time")
        more = [] if most is None else [f"-ts_max_steps {max(2 * most, 1)}"]
        if most is None or time is None or time > (1 - 1e-6) * end:
            more.insert(0, f"-ts_max_time {2 * end:g}")
        lines.append(_line("to go on", " ".join(["-restart latest -output", folder, *more])))
        if not options.get("given"):
            lines.append(_line("something else", "-scene list, -help, -stag_grid_x 128 -fft"))
    return lines
