"""Vesicles of another viscosity inside: treading, tumbling, and the contrast in between.

Steady inclination and frequency over the contrast, with walls and without, the time of half a turn
beyond the critical contrast, that contrast by bisection, and who treads and who tumbles, by reduced
area and contrast.  All by gcn in shear flow of rate 1: from an upright start with yang's delta
function, and, where only the regime is asked for, from a level one with bspline43, which is nearer
to the truth there.  Without walls is where boxes of several sizes lead to, as the square of the
vesicle's size over the box's.
"""

import sys

import numpy as np

from ..membranes.shapes import ellipse_perimeter
from . import report
from .campaign import Campaign
from .ellipses import ellipse_axes, even_markers, reduced_area
from .reference import CONTRAST, CRITICAL, FREE, FREE_CRITICAL, TUMBLING

SHAPES = (0.25, 0.5), (0.1, 0.3)
CONTRASTS = {(0.25, 0.5): (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0),
             (0.1, 0.3): (0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 4.0)}
FREE_AXES = (0.1, 0.3)
TUMBLER, TUMBLING_CONTRAST = (0.1, 0.3), 15.0
STRAIN = 16.0  # after which an inclination is steady to 1e-4 at contrasts up to 5
CLOSE = 0.01  # relative width of a bracket around a critical contrast
PERIMETER = 1.4  # of the vesicles in the map
TREADS, TUMBLES = "treads", "tumbles"
LEVEL_STRAIN = 16.0  # of runs that start level, after which the membrane has found its shape
LEVEL = 0.05  # angle / pi at the start, below which a vesicle has started level
LOST = -0.1  # angle / pi past which a vesicle from a level start has tumbled
BELOW = -0.02  # angle / pi past which a vesicle from an upright start tumbles
STEADY = 2e-3  # turning speed of one at rest
COLUMNS = ("part", "rx", "ry", "reduced_area", "contrast", "cells", "box", "status", "regime",
           "inclination_over_pi", "inclination_truth", "frequency", "frequency_truth", "half_turn",
           "area_error", "ledger_residual", "iterations", "step_seconds")


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("contrast", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, curve=(24, 32), contrasts={SHAPES[0]: (0.2, 1.0, 5.0)}, free=(32, 48),
              free_contrasts=(1.0, 3.0), tumbling=(48,), critical=(32, 48), close=0.2,
              areas=(0.7, 0.9), mapped=(1.0, 16.0), map_cells=48, strain=8.0, time_limit=120)
    else:
        study(campaign, curve=(32, 48, 64), contrasts=CONTRASTS, free=(64, 96, 128),
              free_contrasts=tuple(FREE), tumbling=(64, 96), critical=(48, 72), close=CLOSE,
              areas=(0.5, 0.6, 0.7, 0.8, 0.9, 0.97), mapped=(1.0, 2.0, 4.0, 8.0, 16.0, 32.0),
              map_cells=48, strain=STRAIN, time_limit=3600)
    return campaign.exit_status


def study(campaign, curve, contrasts, free, free_contrasts, tumbling, critical, close, areas,
          mapped, map_cells, strain, time_limit):
    """Make the runs and the results; returns records and critical contrasts.

    Parameters
    ----------
    campaign : Campaign
    curve : sequence of int
        Cells of the runs over the contrast.
    contrasts : mapping of axes to sequence of float
    free : sequence of int
        Cells of the boxes that grow; the first is as large as the others' box.
    free_contrasts : sequence of float
    tumbling : sequence of int
        Cells of the runs that tumble.
    critical : sequence of int
        Cells of the bisections.
    close : float
        Relative width at which they end.
    areas, mapped : sequence of float
        Reduced areas and contrasts of the map.
    map_cells : int
    strain, time_limit : float
    """
    records = []

    def run(part, axes, contrast, cells, box=1.0, **more):
        title = f"{part} {axes[0]:.3g},{axes[1]:.3g} contrast {contrast:.4g} {cells}^2"
        outcome = campaign.run(title, declare(axes, contrast, cells, box, strain, **more),
                               time_limit)
        records.append(judge(part, axes, contrast, cells, box, outcome))
        return records[-1]

    for axes, values in contrasts.items():
        for cells in curve:
            for contrast in values:
                run("curve", axes, contrast, cells)
    for contrast in free_contrasts:
        for cells in free:
            run("free", FREE_AXES, contrast, cells, cells / free[0], bending=free_bending())
    for cells in tumbling:
        run("tumbling", TUMBLER, TUMBLING_CONTRAST, cells, ts_max_time=15.0)
    found, level = {}, dict(
        delta="bspline43", angle=-88.0, ts_max_time=min(strain, LEVEL_STRAIN))
    for axes in SHAPES:
        for cells in critical:
            found[axes, cells] = bisect(
                lambda contrast, axes=axes, cells=cells: run(
                    "critical", axes, contrast, cells, **level).get("regime"),
                CRITICAL[axes] * 0.75, CRITICAL[axes] * 1.5, close)
    for reduced in areas:
        for contrast in mapped:
            run("map", ellipse_axes(reduced, PERIMETER), contrast, map_cells, **level)
    campaign.write_records(COLUMNS, records, _markdown(records, found))
    _draw(campaign.path("contrast.png"), records)
    return records, found


def free_bending():
    """Bending rigidity of the vesicle without walls: 0.01 gamma R^3, R by its perimeter."""
    return 0.01 * (ellipse_perimeter(FREE_AXES) / (2 * np.pi)) ** 3


def declare(axes, contrast, cells, box, strain, **more):
    """Options of one run."""
    return dict(
        dict(scene="tanktreading", scheme="gcn", delta="yang", fft=True, stag_grid_x=cells,
             domain=(-box, box, -box, box), axes=axes, markers=even_markers(axes, cells, box),
             viscosity_contrast=contrast, ts_dt=0.1 if contrast >= 0.2 else 1 / 16,
             ts_max_time=strain, ledger="record"), **more)


def judge(part, axes, contrast, cells, box, outcome):
    """The record of one run."""
    truth = CONTRAST.get(axes, {}).get(contrast, (None, None)) if part == "curve" else (None, None)
    if part == "free":
        truth = FREE.get(contrast, np.nan) / np.pi, None
    record = dict(
        part=part, rx=axes[0], ry=axes[1], contrast=contrast, cells=cells, box=box,
        reduced_area=reduced_area(axes),
        status=outcome.status, inclination_truth=truth[0], frequency_truth=truth[1],
        area_error=outcome.largest("area_error"), step_seconds=outcome.step_seconds,
        ledger_residual=outcome.largest("ledger_residual"))
    if not outcome.finished:
        return record
    iterations = outcome.column("coupled_iterations") / outcome.column("picard_iterations")
    angle = 2 * outcome.rows["turns"]
    record.update(regime=regime(outcome.rows["time"], angle), half_turn=outcome.last("half_turn"),
                  iterations=float(iterations.mean()))
    if record["regime"] == TREADS and part in ("curve", "free"):
        record.update(inclination_over_pi=float(angle[-1]),
                      frequency=outcome.last("treading_frequency"))
    return record


def regime(time, angle):
    """Whether a vesicle treads or tumbles; None where that cannot be told yet.

    A vesicle of fixed shape turns as Keller & Skalak (1982) have it, in shear flow of rate gamma:
    d theta / dt = -gamma / 2 (1 - A cos 2 theta).  It comes to rest where A > 1, and A is known as
    soon as the membrane has found its shape, if it is about level.

    Parameters
    ----------
    time, angle : ndarray
        Angles counted on, over pi; the shear rate is 1.
    """
    late = time >= 0.75 * time[-1]
    speed = np.pi * (angle[-1] - angle[late][0]) / (time[-1] - time[late][0])
    if angle[0] < LEVEL and angle.min() > LOST:
        return TREADS if 1 + 2 * speed > np.cos(2 * np.pi * angle[late].mean()) else TUMBLES
    if angle.min() < BELOW:
        return TUMBLES
    return TREADS if abs(speed) < STEADY else None


def bisect(ask, low, high, close):
    """The contrast between treading and tumbling; None where it is not within the bracket.

    Parameters
    ----------
    ask : callable
        From a contrast to the regime, or None.
    low, high : float
    close : float
        Relative width at which it ends.
    """
    if ask(low) != TREADS or ask(high) != TUMBLES:
        return None
    while high / low > 1 + close:
        middle = np.sqrt(low * high)
        if ask(middle) == TUMBLES:
            high = middle
        else:
            low = middle
    return float(np.sqrt(low * high))


def extrapolated(sizes, values, power=2):
    """Where values lead to as sizes**power vanish, by the two smallest sizes; None without two."""
    known = sorted((size, value) for size, value in zip(sizes, values) if value is not None)
    if len(known) < 2:
        return None
    (first, one), (second, two) = known[:2]
    ratio = (second / first) ** power
    return (ratio * one - two) / (ratio - 1)


def _of(records, part, axes=None):
    return [one for one in records
            if one["part"] == part and (axes is None or (one["rx"], one["ry"]) == axes)]


def _contrasts(records):
    """Records by contrast, from the least on."""
    found = {}
    for one in sorted(records, key=lambda one: one["contrast"]):
        found.setdefault(one["contrast"], []).append(one)
    return found


def _limit(records):
    """Where the inclination leads to as boxes grow."""
    return extrapolated([1 / one["box"] for one in records],
                        [one.get("inclination_over_pi") for one in records])


def _markdown(records, found):
    worst = max((one["ledger_residual"] for one in records if one["ledger_residual"] is not None),
                default=None)
    parts = [_curve_table(axes, _of(records, "curve", axes)) for axes in SHAPES]
    parts += [_free_table(_of(records, "free")), _tumbling_table(_of(records, "tumbling")),
              _critical_table(found),
              f"Largest ledger residual of all runs: {report.number(worst, 2)}.\n"]
    return "\n".join(filter(None, parts))


def _curve_table(axes, records):
    """Inclination and frequency over the contrast, beside the truth."""
    if not records:
        return ""
    cells, rows = sorted({one["cells"] for one in records}), []
    for contrast, group in _contrasts(records).items():
        each = {one["cells"]: one for one in group}
        coarsest = each[cells[0]]
        row = [f"{contrast:g}"]
        for name, reference in (("inclination_over_pi", "inclination_truth"),
                                ("frequency", "frequency_truth")):
            row += [report.number(each[count].get(name), 4) for count in cells]
            row.append(report.number(coarsest[reference], 4))
        row.append(report.number(_order(cells, each, coarsest["inclination_truth"]), 2))
        row.append(report.number(max(one.get("iterations") or 0 for one in group), 3))
        rows.append(row)
    header = ["contrast", *(f"theta/pi, {count}^2" for count in cells), "truth",
              *(f"f, {count}^2" for count in cells), "truth", "order of theta",
              "iterations a pass"]
    return f"Axes {axes}:\n\n" + report.markdown_table(header, rows)


def _order(cells, records, truth):
    """Observed order of the inclination from the coarsest to the finest grid; None without any."""
    if truth is None or len(cells) < 2:
        return None
    first, last = (abs(records[count].get("inclination_over_pi", np.nan) - truth)
                   for count in (cells[0], cells[-1]))
    with np.errstate(divide="ignore"):
        return np.log(first / last) / np.log(cells[-1] / cells[0])


def _free_table(records):
    """Inclination in boxes that grow, beside what is published without walls."""
    if not records:
        return ""
    rows = []
    for contrast, group in _contrasts(records).items():
        values = [one.get("inclination_over_pi") for one in group]
        rows.append([f"{contrast:g}", *(report.number(value, 4) for value in values),
                     report.number(_limit(group), 4),
                     report.number(group[0]["inclination_truth"], 4)])
    header = ["contrast", *(f"box {one['box']:g}" for one in group), "extrapolated", "published"]
    return ("Ellipse 1:3, theta/pi in boxes of these half widths:\n\n"
            + report.markdown_table(header, rows))


def _tumbling_table(records):
    """The time of half a turn, by grid."""
    rows = [[f"{one['cells']}^2", one.get("regime") or one["status"],
             report.number(one.get("half_turn"), 5), report.number(TUMBLING["half_turn"], 5)]
            for one in records]
    return (f"Axes {TUMBLER}, contrast {TUMBLING_CONTRAST:g}, time of the first half turn:\n\n"
            + report.markdown_table(["grid", "regime", "half turn", "truth"], rows))


def _critical_table(found):
    """The contrast between treading and tumbling, by shape and grid."""
    rows = []
    for axes in SHAPES:
        each = {cells: value for (shape, cells), value in found.items() if shape == axes}
        limit = extrapolated([1 / cells for cells in each], list(each.values()))
        rows.append([str(axes), *(report.number(value, 4) for value in each.values()),
                     report.number(limit, 4), report.number(CRITICAL[axes], 5)])
    return "Critical contrast:\n\n" + report.markdown_table(
        ["axes", *(f"{cells}^2" for cells in each), "extrapolated", "truth"], rows)


def _draw(path, records):
    with report.picture(path, 13, 4.2, columns=3) as (_, axes):
        tilt, turn, phases = axes[0]
        for colour, shape in zip(report.SERIES_COLOURS, SHAPES):
            _draw_curves(tilt, turn, shape, _of(records, "curve", shape), colour)
        _draw_free(tilt, _of(records, "free"))
        tilt.set(xscale="log", xlabel="viscosity contrast", ylabel=r"inclination $\theta/\pi$")
        turn.set(xscale="log", xlabel="viscosity contrast", ylabel="treading frequency $f$")
        tilt.legend(fontsize=8)
        _draw_regimes(phases, records)


def _draw_curves(tilt, turn, shape, records, colour):
    """Inclination and frequency on the finest grid; crosses are the truth."""
    finest = max((one["cells"] for one in records), default=None)
    steady = [one for one in records
              if one["cells"] == finest and one.get("inclination_over_pi") is not None]
    truth = sorted(CONTRAST[shape].items())
    for axis, name, column in ((tilt, "inclination_over_pi", 0), (turn, "frequency", 1)):
        axis.plot([one["contrast"] for one in steady], [one[name] for one in steady], "o-",
                  color=colour, label=f"axes {shape[0]:g}, {shape[1]:g}")
        axis.plot([contrast for contrast, _ in truth], [values[column] for _, values in truth],
                  "k+", markersize=10)
    tilt.plot([CRITICAL[shape]], [0], "k+", markersize=10)


def _draw_free(axis, records):
    """Where boxes that grow lead to; crosses are what is published."""
    limits = [(contrast, _limit(group)) for contrast, group in _contrasts(records).items()]
    limits = [(contrast, value) for contrast, value in limits if value is not None]
    if limits:
        axis.plot(*zip(*limits), "s-", color=report.SERIES_COLOURS[2], label="1:3 without walls")
    axis.plot([*FREE, FREE_CRITICAL], [*np.array(list(FREE.values())) / np.pi, 0], "kx")


def _draw_regimes(axis, records):
    """Who treads and who tumbles, over reduced area and contrast."""
    for kind, marker, colour in ((TREADS, "o", report.SERIES_COLOURS[0]),
                                 (TUMBLES, "x", report.SERIES_COLOURS[1])):
        some = [one for one in records if one.get("regime") == kind and one["part"] != "free"]
        axis.plot([one["reduced_area"] for one in some], [one["contrast"] for one in some], marker,
                  color=colour, alpha=0.6, label=kind, linestyle="none")
    for shape in SHAPES:
        axis.plot([reduced_area(shape)], [CRITICAL[shape]], "k_", markersize=24)
    axis.set(yscale="log", xlabel="reduced area", ylabel="viscosity contrast")
    axis.legend(fontsize=8)


if __name__ == "__main__":
    sys.exit(main())
