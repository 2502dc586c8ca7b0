"""Error against run time, for every scheme over time step and grid, corrected and not.

A vesicle (0.2, 0.5) that relaxes as in the paper's section 4.1 is compared with gcn on a finer grid
and with steps of a small tolerance: the errors of X are relative to the long half axis, those of u
(the larger of both components) to the largest speed of the reference's run.  One (0.25, 0.5) in
shear flow is compared with the truth of boundary integrals (`reference`) when its motion is steady
and inertia makes no difference: relative errors of inclination and treading frequency, averaged
over a unit of strain.  Area and perimeter are compared with their first values.

Uncorrected is the paper's literal method, of the schemes of its tables (without the corrections the
coupled ones are factored whole in every step); corrected runs take the kernel bspline43, whose
errors are the least with the corrections.  Time is that of the processor.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..schemes.registry import SCHEMES
from . import compare, methods, report
from .campaign import Campaign
from .records import select
from .reference import TREADING

LONG_AXIS = 0.5
TREADING_AXIS = 0.25
WINDOW = 1.0  # strain over which steady values are averaged
OPTIONS = {
    methods.LITERAL: methods.OPTIONS[methods.LITERAL],
    methods.CORRECTED: dict(methods.OPTIONS[methods.CORRECTED], delta="bspline43"),
}
TITLES = {
    "X": "$X$", "u": "$u$", "inclination": r"$\theta$", "frequency": "$f$", "area": "area",
    "perimeter": "perimeter",
}


@dataclass(frozen=True)
class Case:
    """One motion.

    Parameters
    ----------
    options : mapping
    quantities : tuple of str
        Whose errors are looked at.
    """

    options: Mapping
    quantities: tuple


CASES = {
    "relaxation": Case(
        dict(scene="relaxation", axes=(0.2, LONG_AXIS), bending=0.01, ts_max_time=0.125),
        ("X", "u", "area", "perimeter")),
    "treading": Case(
        dict(scene="tanktreading", axes=(TREADING_AXIS, LONG_AXIS), bending=0.01, ts_max_time=7.0),
        ("inclination", "frequency", "area", "perimeter")),
}
STIFFNESSES = 1e5, 1e9
TARGETS = 1e-2, 1e-3, 1e-4, 1e-5
REFERENCE_TOLERANCE = 1e-6
# Left out from the start: runs of more cells times steps (ten seconds with most schemes), and those
# of ep at 1e9, whose stable step of about 1e-6 would need some 1e5 of them.
MOST_WORK = 2e6
EXPLICIT_STIFFNESS = 1e5
COLUMNS = ("case", "sigma0", "scheme", "method", "cells", "dt_over_h", "rtol", "steps", "status",
           "reason", "seconds", *TITLES, *(f"{name}_on_front" for name in TITLES))


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("workprecision", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, campaign.grids(32, 64), 128, (1, 4), (1 / 512,), (1e-4,), time_limit=60)
    else:
        study(campaign, campaign.grids(32, 64, 128, 256), 512, (0.25, 1, 4), (1 / 512,),
              (1e-3, 1e-4), time_limit=100)
    return campaign.exit_status


def study(campaign, cells, finest, implicit_steps, explicit_steps, tolerances, time_limit,
          schemes=SCHEMES, stiffnesses=STIFFNESSES, most_work=MOST_WORK):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    cells : tuple of int
    finest : int
        Cells of the reference.
    implicit_steps, explicit_steps : tuple of float
        Time steps in units of h.
    tolerances : tuple of float
        Of steps by the local error instead, for gcn.
    time_limit : float
        Seconds a run; the references have five times as many.
    schemes : sequence of str
    stiffnesses : tuple of float
    most_work : float
        Cells times steps of a run with fixed steps beyond which it is left out.
    """
    declared, references, left_out = {}, {}, []
    for case, described in CASES.items():
        end = described.options["ts_max_time"]
        for sigma0 in stiffnesses:
            if "X" in described.quantities:
                references[case, sigma0] = declare(
                    case, sigma0, "gcn", methods.CORRECTED, finest, None, REFERENCE_TOLERANCE)
            for scheme, method in methods.series(schemes):
                explicit = not SCHEMES[scheme].implicit
                if explicit and sigma0 > EXPLICIT_STIFFNESS:
                    continue
                ways = [(ratio, None) for ratio in (explicit_steps if explicit else implicit_steps)]
                if scheme == "gcn" and method == methods.CORRECTED:
                    ways += [(None, rtol) for rtol in tolerances]
                for label in ((case, sigma0, scheme, method, count, *way) for count in cells
                              for way in ways):
                    dt = 2 / label[4] * (label[5] or 0.0)
                    if dt and end / dt * label[4] ** 2 > most_work:
                        left_out.append(label)
                    elif dt <= end / 2:
                        declared[label] = declare(*label)
    outcomes = campaign.run_all(declared, time_limit)
    references = campaign.run_all(references, 5 * time_limit)

    records = [_record(label, outcome, references.get(label[:2]))
               for label, outcome in outcomes.items()]
    for case, sigma0 in dict.fromkeys(label[:2] for label in declared):
        among = select(records, case=case, sigma0=sigma0)
        for name in CASES[case].quantities:
            for one in front(among, name):
                one[f"{name}_on_front"] = 1
    campaign.write_records(COLUMNS, records, _markdown(records, left_out, finest))
    _draw(campaign.path("workprecision.png"), records, stiffnesses)
    return records


def declare(case, sigma0, scheme, method, cells, ratio, rtol):
    """Options of one run, with time steps of `ratio` h or by a tolerance."""
    steps = dict(ts_rtol=rtol) if ratio is None else dict(ts_dt=ratio * 2 / cells)
    return dict(CASES[case].options, **OPTIONS[method], sigma0=sigma0, scheme=scheme, fft=True,
                stag_grid_x=cells, **steps)


def _record(label, outcome, reference):
    record = dict(zip(COLUMNS, label), steps=outcome.steps, status=outcome.status,
                  reason=outcome.reason)
    if not outcome.finished or (reference and not reference.finished):
        return record
    record["seconds"] = outcome.cpu_seconds
    record.update({name: outcome.last(f"{name}_error") for name in ("area", "perimeter")})
    if reference:
        found = compare.errors(outcome, reference)
        speed = reference.largest("max_speed")
        record.update(X=found["X"] / LONG_AXIS, u=max(found["u"], found["v"]) / speed)
    else:
        truth = TREADING[TREADING_AXIS]
        angle, frequency = (outcome.mean(name, WINDOW)
                            for name in ("inclination", "treading_frequency"))
        record["inclination"] = abs(angle / np.pi / truth["inclination"] - 1)
        if frequency is not None:  # a membrane that does not turn has none
            record["frequency"] = abs(frequency / truth["frequency"] - 1)
    return record


def front(records, name):
    """Records that no other beats in both seconds and the error `name`, fastest first."""
    best, chosen = np.inf, []
    for record in sorted((one for one in records if name in one),
                         key=lambda one: (one["seconds"], one[name])):
        if record[name] < best:
            best = record[name]
            chosen.append(record)
    return chosen


def cheapest(records, name, target):
    """The fastest record whose error `name` is at most `target`; None if there is none."""
    good = [one for one in records if name in one and one[name] <= target]
    return min(good, key=lambda one: one["seconds"], default=None)


def _markdown(records, left_out, finest):
    text = ("Cheapest setting for a given error: scheme, cells across, time step or tolerance, "
            "processor seconds; `*` without the corrections. X and u against gcn on "
            f"{finest}^2 with -ts_rtol {REFERENCE_TOLERANCE:g}, inclination and frequency against "
            "boundary integrals.\n")
    header = ["case", "sigma0", "error of", *(report.number(target) for target in TARGETS)]
    rows = []
    for case, sigma0 in dict.fromkeys((one["case"], one["sigma0"]) for one in records):
        among = select(records, case=case, sigma0=sigma0)
        for name in CASES[case].quantities:
            found = [cheapest(among, name, target) for target in TARGETS]
            rows.append([case, report.number(sigma0, 1), name, *map(_setting, found)])
    text += "\n" + report.markdown_table(header, rows)
    rows = []
    for case, sigma0 in dict.fromkeys((one["case"], one["sigma0"]) for one in records):
        for method in OPTIONS:
            among = select(records, case=case, sigma0=sigma0, method=method)
            rows.append([case, report.number(sigma0, 1), method, *(
                report.number(min((one[name] for one in among if name in one), default=None), 2)
                for name in TITLES)])
    text += "\nLeast error of any run:\n\n" + report.markdown_table(
        ["case", "sigma0", "method", *TITLES], rows)
    lost = [one for one in records if "seconds" not in one]
    if lost:
        text += "\nRuns without a result:\n\n" + report.markdown_table(
            ["case", "sigma0", "setting", "status", "reason"],
            [[one["case"], report.number(one["sigma0"], 1), _name(one), one["status"],
              one["reason"]] for one in lost])
    if left_out:
        grids = sorted({f"{cells}^2 with dt = {_length(ratio)}, {case}"
                        for case, _, _, _, cells, ratio, _ in left_out})
        text += f"\nLeft out for the work they would be: {'; '.join(grids)}.\n"
    return text


def _length(ratio):
    return f"{ratio:g} h" if ratio > 1 else "h" if ratio == 1 else f"h/{1 / ratio:g}"


def _name(record):
    """A setting in words."""
    star = "*" if record["method"] == methods.LITERAL else ""
    steps = (f"rtol {report.number(record['rtol'], 1)}" if record["dt_over_h"] is None
             else _length(record["dt_over_h"]))
    return f"{record['scheme']}{star} {record['cells']}, {steps}"


def _setting(record):
    return "none" if record is None else f"{_name(record)}: {record['seconds']:.2g} s"


def _draw(path, records, stiffnesses):
    panels = [(case, sigma0) for case in CASES for sigma0 in stiffnesses]
    drawn = {name: [one for one in case.quantities if one != "area"]  # which is kept, or is not
             for name, case in CASES.items()}
    columns = max(map(len, drawn.values()))
    with report.picture(path, 3.4 * columns, 3.2 * len(panels), rows=len(panels),
                        columns=columns) as (figure, axes):
        for row, (case, sigma0) in zip(axes, panels):
            among = select(records, case=case, sigma0=sigma0)
            for axis, name in zip(row, drawn[case]):
                _draw_panel(axis, among, name)
                axis.set_title(f"{case}: error of {TITLES[name]}, $\\sigma_0$ = "
                               f"{report.number(sigma0, 1)}", fontsize=10)
                axis.set_xlabel("processor seconds")
        report.legend_below(figure, max(axes[:, 0], key=_entries), 5)


def _entries(axis):
    return len(axis.get_legend_handles_labels()[1])


def _draw_panel(axis, records, name):
    best = [one for one in front(records, name) if one[name] > 0]
    if best:
        axis.loglog([one["seconds"] for one in best], [one[name] for one in best], color="k",
                    linewidth=5, alpha=0.2, solid_capstyle="round", label="Pareto front")
    sizes = sorted({one["cells"] for one in records})
    lines = {}
    for one in records:
        if one.get(name):
            key = one["scheme"], one["method"], one["cells"], one["rtol"] is not None
            lines.setdefault(key, []).append(one)
    seen = set()
    for (scheme, method, size, by_tolerance), group in lines.items():
        group.sort(key=lambda one: one["seconds"])
        corrected = method == methods.CORRECTED
        label = methods.title(scheme, method) + (", by tolerance" if by_tolerance else "")
        # The finer the grid, the larger its symbols.
        axis.loglog([one["seconds"] for one in group], [one[name] for one in group],
                    linewidth=0.8, markersize=4 + 2 * sizes.index(size),
                    linestyle="--" if by_tolerance else "-" if corrected else ":",
                    markerfacecolor=None if corrected else "none",
                    label=None if label in seen else label, **SCHEMES[scheme].style)
        seen.add(label)


if __name__ == "__main__":
    sys.exit(main())
