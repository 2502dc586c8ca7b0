"""Error against run time, for every scheme over time step and grid.

A vesicle (0.2, 0.5) that relaxes, and one in shear flow, compared at the end with the scheme gcn
on a finer grid.  The errors of X are relative to the long half axis, those of u (the larger of
both components) to the largest speed of the reference's run; area and perimeter to their first
values.
"""

import sys

import numpy as np

from ..schemes.registry import SCHEMES
from . import compare, report
from .campaign import Campaign

LONG_AXIS = 0.5
VESICLE = dict(axes=(0.2, LONG_AXIS), bending=0.01, fft=True)
CASES = {
    "relaxation": dict(scene="relaxation", ts_max_time=0.125),
    "shear": dict(scene="tanktreading", shear_rate=1.0, ts_max_time=0.25),
}
STIFFNESSES = 1e5, 1e9
# ep is left out at 1e9: its stable step of about 1e-6 would need some 1e5 steps.
EXPLICIT_STIFFNESS = 1e5
QUANTITIES = {
    "X": "error of $X$", "u": "error of $u$", "area": "error of area",
    "perimeter": "error of perimeter",
}
TARGETS = 1e-2, 1e-3, 1e-4, 1e-5
COLUMNS = ("case", "sigma0", "scheme", "cells", "dt_over_h", "dt", "steps", "status", "reason",
           "seconds", *QUANTITIES, *(f"{name}_on_front" for name in QUANTITIES))


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("workprecision", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, (32, 64), 128, (0.25, 1), (1 / 512,), time_limit=120)
    else:
        study(campaign, (32, 64, 128), 256, (0.25, 1, 4), (1 / 512,), time_limit=1000)
    return campaign.exit_status


def study(campaign, cells, finest, implicit_steps, explicit_steps, time_limit,
          schemes=SCHEMES, stiffnesses=STIFFNESSES):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    cells : tuple of int
    finest : int
        Cells of the reference, which takes time steps of h/4.
    implicit_steps, explicit_steps : tuple of float
        Time steps in units of h.
    time_limit : float
        Seconds a run; the references have five times as many.
    """
    declared, references = {}, {}
    for case, options in CASES.items():
        for sigma0 in stiffnesses:
            references[case, sigma0] = declare(case, sigma0, "gcn", finest, 0.25)
            for scheme in schemes:
                explicit = not SCHEMES[scheme].implicit
                if explicit and sigma0 > EXPLICIT_STIFFNESS:
                    continue
                for count in cells:
                    for ratio in explicit_steps if explicit else implicit_steps:
                        if ratio * 2 / count <= options["ts_max_time"] / 2:
                            label = case, sigma0, scheme, count, ratio
                            declared[label] = declare(*label)
    outcomes = campaign.run_all(declared, time_limit)
    references = campaign.run_all(references, 5 * time_limit)

    records = [_record(label, declared[label], outcome, references[label[:2]])
               for label, outcome in outcomes.items()]
    for name in QUANTITIES:
        for group in references:
            among = [one for one in records if (one["case"], one["sigma0"]) == group]
            for one in front(among, name):
                one[f"{name}_on_front"] = 1
    rows = [[one.get(column) for column in COLUMNS] for one in records]
    campaign.write(COLUMNS, rows, _markdown(records, list(references), finest))
    for case in CASES:
        _draw(campaign.path(f"workprecision-{case}.png"), records, case, stiffnesses)
    return records


def declare(case, sigma0, scheme, cells, ratio):
    """Options of one run; the time step is `ratio` h."""
    return dict(CASES[case], **VESICLE, sigma0=sigma0, scheme=scheme, stag_grid_x=cells,
                ts_dt=ratio * 2 / cells)


def _record(label, options, outcome, reference):
    record = dict(zip(COLUMNS, label), dt=options["ts_dt"], steps=outcome.steps,
                  status=outcome.status, reason=outcome.reason)
    if outcome.finished and reference.finished:
        found = compare.errors(outcome, reference)
        speed = reference.largest("max_speed")
        record.update(
            seconds=outcome.last("wall_seconds"), X=found["X"] / LONG_AXIS,
            u=max(found["u"], found["v"]) / speed, area=found["area"],
            perimeter=found["perimeter"])
    return record


def front(records, name):
    """Records that no other beats in both seconds and the error `name`, fastest first."""
    best, chosen = np.inf, []
    for record in sorted((one for one in records if "seconds" in one),
                         key=lambda one: (one["seconds"], one[name])):
        if record[name] < best:
            best = record[name]
            chosen.append(record)
    return chosen


def cheapest(records, name, target):
    """The fastest record whose error `name` is at most `target`; None if there is none."""
    good = [one for one in records if "seconds" in one and one[name] <= target]
    return min(good, key=lambda one: one["seconds"], default=None)


def _markdown(records, groups, finest):
    text = ("Cheapest setting for a given error: scheme, cells across, time step, wall seconds. "
            f"Reference: gcn on {finest}^2 with dt = h/4.\n")
    header = ["case", "sigma0", "error of", *(report.number(target) for target in TARGETS)]
    rows = []
    for case, sigma0 in groups:
        among = [one for one in records if (one["case"], one["sigma0"]) == (case, sigma0)]
        for name in QUANTITIES:
            found = [cheapest(among, name, target) for target in TARGETS]
            rows.append([case, report.number(sigma0, 1), name, *map(_setting, found)])
    lost = [one for one in records if "seconds" not in one]
    text += "\n" + report.markdown_table(header, rows)
    if lost:
        text += "\nRuns without a result:\n\n" + report.markdown_table(
            ["case", "sigma0", "scheme", "cells", "dt/h", "status", "reason"],
            [[one["case"], report.number(one["sigma0"], 1), one["scheme"], str(one["cells"]),
              report.number(one["dt_over_h"]), one["status"], one["reason"]] for one in lost])
    return text


def _setting(record):
    if record is None:
        return "none"
    ratio = record["dt_over_h"]
    step = f"{ratio:g} h" if ratio > 1 else "h" if ratio == 1 else f"h/{1 / ratio:g}"
    return f"{record['scheme']} {record['cells']}, {step}: {record['seconds']:.2g} s"


def _draw(path, records, case, stiffnesses):
    size = dict(width=13.5, height=3.4 * len(stiffnesses))
    with report.picture(path, **size, rows=len(stiffnesses), columns=len(QUANTITIES)) as (
            figure, axes):
        for row, sigma0 in zip(axes, stiffnesses):
            among = [one for one in records if (one["case"], one["sigma0"]) == (case, sigma0)]
            for axis, (name, title) in zip(row, QUANTITIES.items()):
                _draw_panel(axis, among, name)
                axis.set_title(f"{title}, $\\sigma_0$ = {report.number(sigma0, 1)}")
                axis.set_xlabel("wall seconds")
        report.legend_below(figure, max(axes[:, 0], key=_entries), 9)


def _entries(axis):
    return len(axis.get_legend_handles_labels()[1])


def _draw_panel(axis, records, name):
    best = front(records, name)
    axis.loglog([one["seconds"] for one in best], [one[name] for one in best], color="k",
                linewidth=5, alpha=0.2, solid_capstyle="round", label="Pareto front")
    sizes = sorted({one["cells"] for one in records})
    for scheme in SCHEMES:
        for size in sizes:
            group = [one for one in records
                     if (one["scheme"], one["cells"]) == (scheme, size) and "seconds" in one]
            group.sort(key=lambda one: one["dt"])
            # The finer the grid, the larger its symbols.
            axis.loglog([one["seconds"] for one in group], [one[name] for one in group],
                        linewidth=0.8, markersize=4 + 2 * sizes.index(size),
                        label=scheme if group and size == group[0]["cells"] == sizes[-1] else None,
                        **SCHEMES[scheme].style)


if __name__ == "__main__":
    sys.exit(main())
