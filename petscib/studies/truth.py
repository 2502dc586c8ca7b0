"""What is computed against the right answers, by grid, with and without the kink correction.

Three problems whose answers other methods have given to four or five digits (`reference`):
vesicles that turn and tread in shear flow, over reduced area and time; one that relaxes, its shape
and bending energy over time; and the least bending energy of each reduced area.  The scheme is gcn,
density 1e-3, at which the flow is Stokes flow, and sigma0 1e7, at which the membrane is as good as
inextensible: with 1e5 the roundest of the treading vesicles is drawn out by 1e-4, which turns it by
as much.  Treading vesicles take dt = h, the others steps by -ts_rtol.

Methods: the kernel bspline43, and the paper's own, yang, both with kink correction and area kept;
and the paper's, yang with neither.  By that the treading vesicles run as in the paper, with mbe,
dt = h/4, sigma0 1e5 and density 1, which makes no difference to a steady motion (gcn does not bring
the thinnest of them to its end).
"""

import os
import sys

import numpy as np
from scipy.interpolate import CubicSpline

from ..membranes.geometry import perimeter
from ..output.style import BLUE, GREEN, VERMILLION
from . import compare, report
from .campaign import Campaign
from .ellipses import ellipse_axes, even_markers
from .records import power, select
from .reference import LEAST_ENERGY, RELAXATION, TREADING, TURNING
from .tanktreading import PERIMETER

BEST, YANG, PAPER = "bspline43, corrected", "yang, corrected", "yang, uncorrected"
METHODS = {
    BEST: dict(delta="bspline43"),
    YANG: dict(delta="yang"),
    PAPER: dict(delta="yang", kink_correction=False, conserve_area=False),
}
STYLES = {
    BEST: dict(color=BLUE, marker="o"), YANG: dict(color=GREEN, marker="s"),
    PAPER: dict(color=VERMILLION, marker="v"),
}
PAPERS = dict(scheme="mbe", rho=1.0, sigma0=1e5)  # of treading vesicles
COMMON = dict(scheme="gcn", fft=True, rho=1e-3, sigma0=1e7, bending=0.01)
LONG_AXIS = 0.5
RELAXING = (0.2, LONG_AXIS)
STRAIN = {0.1: 15.0, 0.25: 7.0, 0.4: 7.0}  # after which the inclination is steady to its digits
WINDOW = 1.0  # strain over which steady values are averaged, while markers cross cells
EQUILIBRIUM = 40.0  # time for it; the slowest mode of the thinnest vesicle decays in about 4
TOLERANCE = 1e-5
COLUMNS = ("problem", "case", "method", "cells", "time", "quantity", "value", "truth", "error",
           "relative_error")


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("truth", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, {BEST: (32, 64), YANG: (32, 64), PAPER: (32,)}, (0.25,), (0.125, 0.5),
              (0.9, 0.6), (32,), 300)
    else:
        fine = 32, 48, 64, 96, 128
        study(campaign, {BEST: fine, YANG: fine, PAPER: (32, 48, 64)}, tuple(TREADING),
              tuple(RELAXATION), (0.9, 0.8, 0.7, 0.6, 0.5), (32, 64, 128), 1800)
    return campaign.exit_status


def study(campaign, cells, axes, times, reduced_areas, energy_cells, time_limit):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    cells : dict of str to tuple of int
        Grids by method.
    axes : tuple of float
        Short half axes of the treading vesicles.
    times : tuple of float
        At which the relaxing one is looked at.
    reduced_areas : tuple of float
        Of which the least energy is sought.
    energy_cells : tuple of int
    time_limit : float
        Seconds a run.
    """
    records, shapes, drifts = [], {}, {}

    def run(title, options, method):
        outcome = campaign.run(title, options, time_limit)
        if outcome.finished:
            drifts.setdefault(method, []).append(
                [outcome.largest(f"{name}_error") for name in ("area", "perimeter")])
        return outcome

    for method, counts in cells.items():
        for count in counts:
            for short in axes:
                outcome = run(f"treading {short:g} {method} {count}^2",
                              declare_treading(short, method, count), method)
                records += _treading(short, method, count, outcome)
            before = None
            for time in times:
                options = declare_relaxing(RELAXING, method, count, time, before)
                before = run(f"relaxing {method} {count}^2 to {time:g}", options, method)
                if not before.finished:
                    break
                records += _relaxing(method, count, time, before)
                shapes[method, count, time] = before.final()["X"]
    for count in energy_cells:
        for reduced in reduced_areas:
            options = declare_relaxing(ellipse_axes(reduced, PERIMETER), BEST, count, EQUILIBRIUM)
            outcome = run(f"least energy {reduced:g} {count}^2", options, BEST)
            records += _least(reduced, count, outcome)
    for one in records:
        one["error"] = one["value"] - one["truth"]
        one["relative_error"] = one["error"] / one["truth"]
    campaign.write_records(COLUMNS, records, _markdown(records, shapes, drifts))
    _draw(campaign.path("truth.png"), records)
    return records


def declare_treading(short, method, cells):
    """Options of a run in shear flow."""
    axes, h = (short, LONG_AXIS), 2 / cells
    options = dict(COMMON, **METHODS[method], scene="tanktreading", axes=axes, stag_grid_x=cells,
                   markers=even_markers(axes, cells), ts_dt=h, ts_max_time=STRAIN[short])
    return {**options, **PAPERS, "ts_dt": h / 4} if method == PAPER else options


def declare_relaxing(axes, method, cells, time, before=None):
    """Options of a run in fluid at rest, from the start or from the end of another."""
    options = dict(COMMON, **METHODS[method], scene="relaxation", axes=axes, stag_grid_x=cells,
                   markers=even_markers(axes, cells), ts_rtol=TOLERANCE, ts_max_time=time)
    if before is not None:
        options["restart"] = os.path.join(before.folder, "final.h5")
    return options


def _treading(short, method, cells, outcome):
    """Records of a run in shear flow: steady values, and the inclination on the way."""
    if not outcome.finished:
        return []
    common = dict(problem="treading", case=short, method=method, cells=cells)
    time, angle = outcome.rows["time"], outcome.rows["inclination"] % np.pi / np.pi
    steady = time > time[-1] - WINDOW
    values = {"inclination": angle, "frequency": outcome.rows["treading_frequency"]}
    found = [dict(common, time=time[-1], quantity=name, value=float(values[name][steady].mean()),
                  truth=TREADING[short][name]) for name in values]
    turning = CubicSpline(time, angle)
    for at, truth in ({} if method == PAPER else TURNING.get(short, {})).items():
        found.append(dict(common, problem="turning", time=at, quantity="inclination",
                          value=float(turning(at)), truth=truth))
    return found


def _relaxing(method, cells, time, outcome):
    """Records of a relaxing vesicle at the end of a run."""
    markers = outcome.final()["X"]
    measured = {"energy": outcome.last("bending_energy"), **sizes(markers)}
    return [dict(problem="relaxation", case=RELAXING[0], method=method, cells=cells, time=time,
                 quantity=name, value=measured[name], truth=truth)
            for name, truth in RELAXATION[time].items()]


def sizes(markers):
    """Half width and height of a symmetric vesicle, and half its width on the x-axis.

    Between markers it is a periodic cubic spline.
    """
    closed = np.concatenate((markers, markers[:1]))
    curve = CubicSpline(np.arange(len(closed)), closed, bc_type="periodic")
    slopes = curve.derivative()

    def there(spline, axis, other):
        """Coordinate `other` of the curve where a component of a spline vanishes."""
        roots = CubicSpline(spline.x, spline(spline.x)[:, axis]).roots(extrapolate=False)
        return np.abs(curve(roots)[:, other]).max()

    return {"half_width": there(slopes, 0, 0), "half_height": there(slopes, 1, 1),
            "waist": there(curve, 1, 0)}


def _least(reduced, cells, outcome):
    """The record of an equilibrium."""
    if not outcome.finished:
        return []
    circle = 2 * np.pi**2 * COMMON["bending"] / perimeter(outcome.final()["X"])
    return [dict(problem="least energy", case=reduced, method=BEST, cells=cells, time=EQUILIBRIUM,
                 quantity="energy ratio", value=outcome.last("bending_energy") / circle,
                 truth=LEAST_ENERGY[reduced])]


def order(coarse, middle, fine):
    """Observed order of values on three grids, each twice as fine as the one before.

    None where they do not draw nearer to a limit from one side, and there is none to be seen.
    """
    ratio = (coarse - middle) / (middle - fine)
    return float(np.log2(ratio)) if ratio > 1 else None


def fitted_order(errors):
    """Power of h with which errors fall; None for fewer than two.

    Parameters
    ----------
    errors : dict of int to float
        By cells.
    """
    return power([1 / count for count in errors], errors.values())


def triples(grids):
    """Threes of grids each twice as fine as the one before."""
    return [(count, 2 * count, 4 * count) for count in sorted(grids)
            if {2 * count, 4 * count} <= set(grids)]


def _orders(among):
    """Of one quantity over the grids: by the finest three, and by its errors; as text."""
    values = {one["cells"]: one["value"] for one in among}
    found = triples(values)
    three = order(*(values[count] for count in found[-1])) if found else None
    fitted = fitted_order({one["cells"]: one["error"] for one in among})
    return [report.number(three, 2), report.number(fitted, 2)]


def _observed_shape(shapes, method, time):
    """Order of the markers' positions, likewise."""
    found = triples([count for name, count, at in shapes if (name, at) == (method, time)])
    if not found:
        return "-"
    coarse, middle, fine = (shapes[method, count, time] for count in found[-1])
    return report.number(float(np.log2(
        compare.marker_error(coarse, middle) / compare.marker_error(middle, fine))), 2)


def _markdown(records, shapes, drifts):
    methods = list(dict.fromkeys(one["method"] for one in records))
    grids = sorted({one["cells"] for one in records})
    parts = ["Against boundary integrals (Stokes flow, shear rate 1, c_b = 0.01); scheme gcn "
             "(treading uncorrected: mbe). Orders: by three grids, each twice as fine as the one "
             "before, which needs no truth (a dash where they do not draw nearer to a limit from "
             "one side); and of the errors over all grids, by a fit.\n"]

    def table(title, rows):
        if rows:
            parts.append(f"**{title}**\n\n" + report.markdown_table(
                ["case", "truth", "method", *(f"{count}^2" for count in grids), "order: three",
                 "fit"], rows))

    def row(label, truth, method, among, name):
        found = {one["cells"]: one[name] for one in among}
        return [label, report.number(truth, 5), method,
                *(report.number(found.get(count), 2) for count in grids), *_orders(among)]

    for quantity, name, title in (
            ("inclination", "error", "Error of the steady inclination / pi"),
            ("frequency", "relative_error", "Relative error of the treading frequency")):
        table(title, [
            row(f"axes ({short:g}, {LONG_AXIS:g})", truth[quantity], method, among, name)
            for short, truth in TREADING.items() for method in methods
            if (among := select(records, problem="treading", case=short, method=method,
                                 quantity=quantity))])
    rows = []
    for short in TURNING:
        for method in methods:
            found = {}
            for one in select(records, problem="turning", case=short, method=method):
                found[one["cells"]] = max(found.get(one["cells"], 0.0), abs(one["error"]))
            if found:
                rows.append([f"axes ({short:g}, {LONG_AXIS:g})", "-", method,
                             *(report.number(found.get(count), 2) for count in grids), "-",
                             report.number(fitted_order(found), 2)])
    table("Largest error of the inclination / pi on the way there", rows)
    for quantity in ("energy", "half_width", "half_height", "waist"):
        table(f"Relaxation: relative error of the {quantity.replace('_', ' ')}", [
            row(f"t = {time:g}", truth[quantity], method, among, "relative_error")
            for time, truth in RELAXATION.items() for method in methods
            if (among := select(records, problem="relaxation", method=method, time=time,
                                 quantity=quantity))])
    rows = [[method, f"{time:g}", _observed_shape(shapes, method, time)]
            for method, time in dict.fromkeys((name, at) for name, _, at in shapes)
            if triples([count for name, count, at in shapes if (name, at) == (method, time)])]
    if rows:
        parts.append("**Relaxation: order of the markers' positions, by three grids**\n\n"
                     + report.markdown_table(["method", "time", "order"], rows))
    table("Least bending energy over that of the circle of the same length: relative error", [
        row(f"reduced area {reduced:g}", truth, BEST, among, "relative_error")
        for reduced, truth in LEAST_ENERGY.items()
        if (among := select(records, problem="least energy", case=reduced))])
    parts.append("**Largest errors of area and perimeter, at any step of any of these runs**\n\n"
                 + report.markdown_table(["method", "area", "perimeter"], [
                     [method, *(report.number(value, 2) for value in np.max(found, axis=0))]
                     for method, found in drifts.items()]))
    return "\n".join(parts)


def _draw(path, records):
    with report.picture(path, 13, 7.6, rows=2, columns=3) as (figure, axes):
        _draw_steady(axes[0, 0], records, "inclination", r"steady inclination $\theta/\pi$")
        _draw_steady(axes[0, 1], records, "frequency", "treading frequency $f$")
        _draw_errors(axes[0, 2], records)
        _draw_turning(axes[1, 0], records)
        _draw_relaxing(axes[1, 1], records)
        _draw_least(axes[1, 2], records)
        report.legend_below(figure, axes[0, 0], 4)


def _draw_steady(axis, records, quantity, title):
    areas = [one["reduced_area"] for one in TREADING.values()]
    axis.plot(areas, [one[quantity] for one in TREADING.values()], "k_", markersize=22,
              markeredgewidth=1.5, label="boundary integrals")
    for method, style in STYLES.items():
        found = select(records, problem="treading", quantity=quantity, method=method)
        coarsest = min((one["cells"] for one in found), default=None)
        for one in found:
            fine = one["cells"] != coarsest
            axis.plot(TREADING[one["case"]]["reduced_area"], one["value"], linestyle="",
                      markersize=6 if fine else 9, markerfacecolor=None if fine else "none",
                      label=None if fine else method, **style)
    _once(axis)
    axis.set(xlabel="reduced area (hollow: coarsest grid)", ylabel=title)


def _once(axis):
    """Keep one entry a name for the legend."""
    seen = set()
    for line in axis.get_lines():
        if line.get_label() in seen:
            line.set_label(None)
        seen.add(line.get_label())


def _draw_errors(axis, records):
    for method, style in STYLES.items():
        for short, line in zip(TREADING, (":", "-", "--")):
            found = select(records, problem="treading", quantity="frequency", method=method,
                            case=short)
            axis.loglog([one["cells"] for one in found],
                        [abs(one["relative_error"]) for one in found], linestyle=line, **style)
    cells = sorted({one["cells"] for one in select(records, problem="treading")})
    if cells:
        lines = np.array(cells, float)
        for p in (1, 2):
            axis.loglog(lines, 0.05 * (lines[0] / lines) ** p, color="k", linewidth=0.8,
                        linestyle="-" if p == 1 else "--")
            axis.annotate(f" order {p}", (lines[-1], 0.05 * (lines[0] / lines[-1]) ** p),
                          fontsize=9, va="center")
        axis.set_xlim(cells[0] / 1.1, cells[-1] * 1.4)
        report.cells_axis(axis, cells)
    axis.set(xlabel="cells across (b = 0.1 dotted, 0.25 solid, 0.4 dashed)",
             ylabel="relative error of $f$")


def _finest(found):
    most = max((one["cells"] for one in found), default=None)
    return [one for one in found if one["cells"] == most]


def _draw_turning(axis, records):
    for short, truth in TURNING.items():
        axis.plot(list(truth), list(truth.values()), "k_", markersize=16, markeredgewidth=1.5)
        for method, style in STYLES.items():
            found = _finest(select(records, problem="turning", case=short, method=method))
            axis.plot([one["time"] for one in found], [one["value"] for one in found],
                      linestyle="", **style)
    axis.set(xlabel="time (finest grids)", ylabel=r"inclination $\theta/\pi$", xscale="log")


def _draw_relaxing(axis, records):
    axis.semilogx(list(RELAXATION), [one["energy"] for one in RELAXATION.values()], "k_",
                  markersize=22, markeredgewidth=1.5)
    for method, style in STYLES.items():
        found = _finest(select(records, problem="relaxation", quantity="energy", method=method))
        axis.semilogx([one["time"] for one in found], [one["value"] for one in found],
                      linestyle="", **style)
    axis.set(xlabel="time (finest grids)", ylabel="bending energy, relaxing")


def _draw_least(axis, records):
    axis.plot(list(LEAST_ENERGY), list(LEAST_ENERGY.values()), color="k", linewidth=0.8)
    found = _finest(select(records, problem="least energy"))
    axis.plot([one["case"] for one in found], [one["value"] for one in found], linestyle="",
              **STYLES[BEST])
    axis.set(xlabel="reduced area (finest grid)", ylabel="least bending energy / circle's")


if __name__ == "__main__":
    sys.exit(main())
