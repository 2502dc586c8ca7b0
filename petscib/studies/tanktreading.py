"""Steady inclination and treading frequency in shear flow (Hu & Lai, Figs. 2 and 3).

An ellipse of the perimeter of (0.1, 0.5) and a given reduced area V = 4 pi A / L^2 starts upright
and runs, a stretch of strain at a time, until its inclination is steady.  All reduced areas have
the same membrane, deflated more or less.

Literal is the paper's method, its modified backward Euler with dt = h/4, shorter where the membrane
would otherwise turn by more than `STRAIN_STEP`; corrected is what petscib takes for the main job,
gcn with kink correction, area kept, and a composite B-spline.  The centred vesicle is an unstable
equilibrium, so grid and markers are point-symmetric and the centroid is watched.
"""

import os
import sys

import numpy as np

from ..membranes.shapes import ellipse_perimeter
from . import methods, report
from .campaign import Campaign
from .ellipses import ellipse_axes, even_markers
from .reference import TREADING

AXES = (0.1, 0.5)
PERIMETER = ellipse_perimeter(AXES)
REDUCED_AREAS = 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95, 0.99
SHEAR_RATES = 1.0, 5.0, 10.0
FIRST_STRAIN, NEXT_STRAIN, LAST_STRAIN = 6.0, 2.0, 24.0
WINDOW = 1.0  # strain over which inclination and frequency are averaged
STEADY = 1e-3  # change of the mean inclination / pi from one window to the next
OFF_CENTRE = 0.01  # distance of the centroid beyond which the frequency means nothing
STRAIN_STEP = 1 / 32
METHODS = {
    methods.LITERAL: dict(methods.OPTIONS[methods.LITERAL], scheme="mbe"),
    methods.CORRECTED: dict(methods.OPTIONS[methods.CORRECTED], scheme="gcn", delta="bspline43"),
}
COLUMNS = ("method", "shear_rate", "reduced_area", "cells", "rx", "ry", "status", "reason",
           "steady", "strain", "inclination_over_pi", "change", "treading_frequency", "area_error",
           "perimeter_error", "centroid_offset", "step_seconds")


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("tanktreading", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, campaign.grids(32, 64), (0.45, 0.7, 0.95), (1.0, 10.0), time_limit=300)
    else:
        study(campaign, campaign.grids(64, 128), REDUCED_AREAS, SHEAR_RATES, time_limit=3600)
    return campaign.exit_status


def study(campaign, cells, reduced_areas, shear_rates, time_limit, last_strain=LAST_STRAIN,
          first_strain=FIRST_STRAIN):
    """Make the runs and the results; returns the records."""
    cases = [(method, rate, reduced, count) for count in cells for method in METHODS
             for rate in shear_rates for reduced in reduced_areas]
    records = []
    for number, case in enumerate(cases, 1):
        outcome = _until_steady(campaign, case, f"{number}/{len(cases)}", time_limit,
                                first_strain, last_strain)
        records.append(_record(case, outcome))
    campaign.write_records(COLUMNS, records, _markdown(records))
    _draw(campaign.path("tanktreading.png"), records)
    return records


def declare(method, rate, reduced, cells, strain):
    """Options of one run from the start to a strain."""
    dt = STRAIN_STEP / rate
    if method == methods.LITERAL:
        dt = min(dt, 0.5 / cells)
    return dict(
        METHODS[method], scene="tanktreading", fft=True, stag_grid_x=cells, shear_rate=rate,
        axes=ellipse_axes(reduced, PERIMETER), markers=even_markers(AXES, cells), ts_dt=dt,
        ts_max_time=strain / rate)


def _until_steady(campaign, case, progress, time_limit, strain, last_strain):
    """Run a case stretch by stretch; the last Outcome, whose tables hold the whole history."""
    method, rate, reduced, cells = case
    outcome = None
    while outcome is None or (
            outcome.finished and strain <= last_strain and not is_steady(outcome, rate)):
        options = declare(*case, strain)
        if outcome is not None:
            options["restart"] = os.path.join(outcome.folder, "final.h5")
        outcome = campaign.run(
            f"{method} V {reduced:g} rate {rate:g} {cells}^2 to strain {strain:g}", options,
            time_limit, progress)
        strain += NEXT_STRAIN
    return outcome


def change(outcome, rate):
    """Change of the mean inclination / pi over the last windows."""
    last, before = (outcome.mean("inclination", WINDOW / rate, back) for back in (0, 1))
    return abs(last - before) / np.pi


def is_steady(outcome, rate):
    """Whether the inclination has settled."""
    return change(outcome, rate) < STEADY


def _record(case, outcome):
    method, rate, reduced, cells = case
    rx, ry = ellipse_axes(reduced, PERIMETER)
    record = dict(method=method, shear_rate=rate, reduced_area=reduced, cells=cells, rx=rx, ry=ry,
                  status=outcome.status, reason=outcome.reason,
                  area_error=outcome.largest("area_error"),
                  perimeter_error=outcome.largest("perimeter_error"),
                  step_seconds=outcome.step_seconds)
    if not outcome.finished:
        return record
    offset = float(np.hypot(outcome.rows["centroid_x"], outcome.rows["centroid_y"]).max())
    record.update(strain=outcome.last("time") * rate, change=change(outcome, rate),
                  steady=int(is_steady(outcome, rate)), centroid_offset=offset,
                  inclination_over_pi=outcome.mean("inclination", WINDOW / rate) / np.pi)
    if offset <= OFF_CENTRE:
        record["treading_frequency"] = outcome.mean(
            "treading_frequency", WINDOW / rate)
    return record


def spread(records, method, rate, reduced, name):
    """Value on the finest grid, and the least and largest over all grids; None without any."""
    values = [one[name] for one in sorted(records, key=lambda one: one["cells"])
              if (one["method"], one["shear_rate"], one["reduced_area"]) == (method, rate, reduced)
              and one.get("steady") and one.get(name) is not None]
    return (values[-1], min(values), max(values)) if values else None


def _cases(records):
    """The lines of a picture, or columns of a table, and the reduced areas."""
    lines = [(method, rate) for rate in dict.fromkeys(one["shear_rate"] for one in records)
             for method in METHODS]
    return lines, list(dict.fromkeys(one["reduced_area"] for one in records))


def _markdown(records):
    lines, areas = _cases(records)
    cells = sorted({one["cells"] for one in records})
    grids = ", ".join(f"{count}^2" for count in cells)
    text = ("Steady inclination / pi and treading frequency: finest grid, and in brackets least "
            f"and largest over {grids}. " if len(cells) > 1 else
            f"Steady inclination / pi and treading frequency on {grids}. ")
    text += (f"Steady: the mean over a strain of {WINDOW:g} changes by less than {STEADY:g} pi "
             "from one to the next.\n")
    for name, title in (("inclination_over_pi", "inclination / pi"),
                        ("treading_frequency", "treading frequency")):
        rows = []
        for reduced in areas:
            found = [spread(records, *line, reduced, name) for line in lines]
            rows.append([f"{reduced:g}",
                         *(report.with_range(one, len(cells) > 1) for one in found)])
        header = ["reduced area", *(f"{title}, rate {rate:g}, {method}" for method, rate in lines)]
        text += "\n" + report.markdown_table(header, rows)
    trouble = [one for one in records if not one.get("steady")]
    if trouble:
        rows = [[one["method"], f"{one['reduced_area']:g}", f"{one['shear_rate']:g}",
                 f"{one['cells']}^2", one["status"], report.number(one.get("strain")),
                 report.number(one.get("change")), one["reason"]] for one in trouble]
        text += "\nNot steady, and left out above:\n\n" + report.markdown_table(
            ["method", "reduced area", "rate", "cells", "run", "strain", "change / pi", "reason"],
            rows)
    rows = []
    for method in METHODS:
        steady = [one for one in records if one["method"] == method and one.get("steady")]
        rows.append([method, *(report.number(max((one[name] for one in steady), default=None), 2)
                               for name in ("area_error", "perimeter_error", "centroid_offset"))])
    return text + ("\nThe largest of these:\n\n" + report.markdown_table(
        ["method", "area error", "perimeter error", "distance of the centroid from the centre"],
        rows))


def _draw(path, records):
    lines, areas = _cases(records)
    rates = list(dict.fromkeys(rate for _, rate in lines))
    with report.picture(path, 10, 4.2, columns=2) as (figure, axes):
        for axis, name, title, truth in (
                (axes[0, 0], "inclination_over_pi", r"inclination $\theta/\pi$", "inclination"),
                (axes[0, 1], "treading_frequency", "treading frequency $f$", "frequency")):
            for method, rate in lines:
                found = [(reduced, spread(records, method, rate, reduced, name))
                         for reduced in areas]
                found = [(reduced, one) for reduced, one in found if one]
                if not found:
                    continue
                value, low, high = np.array([one for _, one in found]).T
                k = rates.index(rate)
                axis.errorbar([reduced for reduced, _ in found], value, (value - low, high - value),
                              color=report.SERIES_COLOURS[k], marker="os^"[k % 3], capsize=3,
                              linestyle=":" if method == methods.LITERAL else "-",
                              markerfacecolor="none" if method == methods.LITERAL else None,
                              label=f"shear rate {rate:g}, {method}")
            axis.plot([one["reduced_area"] for one in TREADING.values()],
                      [one[truth] for one in TREADING.values()], "k_", markersize=16,
                      markeredgewidth=1.5, label="boundary integrals, shear rate 1")
            axis.set_xlabel("reduced area $V$")
            axis.set_ylabel(title)
        axes[0, 1].set_yscale("log")
        report.legend_below(figure, axes[0, 0], 4)


if __name__ == "__main__":
    sys.exit(main())
