"""Global error against -ts_rtol, and the time that it saves against fixed time steps.

A vesicle (0.2, 0.5) that relaxes, and the same one treading in shear flow, by gcn and mbe on one
grid.  Errors are those of the markers' positions over the whole run, not only at its end, where a
relaxing vesicle has forgotten much: the largest distance from a run of gcn with so small a
tolerance that its own error does not count, at the times of its steps, relative to the radius of
the circle of the vesicle's perimeter.
"""

import os
import sys
from functools import cached_property

import numpy as np

from ..membranes.shapes import ellipse_perimeter
from ..output import tables
from ..schemes.registry import SCHEMES
from . import report
from .campaign import Campaign
from .records import power, select

AXES = (0.2, 0.5)
SIZE = ellipse_perimeter(AXES) / (2 * np.pi)
CASES = {
    "relaxation": dict(scene="relaxation", ts_max_time=2.0),
    "treading": dict(scene="tanktreading", ts_max_time=2.0),
}
# The next decade would take mbe ten thousand steps.
TOLERANCES = {"gcn": (1e-3, 1e-4, 1e-5, 1e-6, 1e-7), "mbe": (1e-2, 1e-3, 1e-4, 1e-5)}
REFERENCE = 1e-9  # its error is some 30 times below the smallest of the others
FIXED = {"gcn": range(-2, 6), "mbe": range(0, 7)}  # time steps h / 2^k
COLUMNS = ("case", "scheme", "rtol", "dt", "status", "reason", "steps", "seconds", "error",
           "fixed_seconds", "saving")


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("tolerance", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        tolerances = {"gcn": TOLERANCES["gcn"][:4], "mbe": TOLERANCES["mbe"][:3]}
        study(campaign, 32, tolerances, {"gcn": range(-2, 4), "mbe": range(0, 5)}, 1e-7)
    else:
        study(campaign, 48, TOLERANCES, FIXED, REFERENCE)
    return campaign.exit_status


def study(campaign, cells, tolerances, fixed, reference, cases=CASES):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    cells : int
    tolerances : dict of str to sequence of float
        By scheme.
    fixed : dict of str to sequence of int
        Fixed time steps h / 2^k, by scheme.
    reference : float
        Tolerance of the run that the others are compared with.
    cases : dict
        Options by name.
    """
    declared, references = {}, {}
    for case in cases:
        references[case] = declare(cases[case], "gcn", cells, rtol=reference)
        for scheme in tolerances:
            for rtol in tolerances[scheme]:
                declared[case, scheme, rtol, None] = declare(cases[case], scheme, cells, rtol)
            for halvings in fixed[scheme]:
                dt = 2.0 ** (1 - halvings) / cells
                declared[case, scheme, None, dt] = declare(cases[case], scheme, cells, dt=dt)
    references = {case: Path(outcome)
                  for case, outcome in campaign.run_all(references).items()}
    outcomes = campaign.run_all(declared)
    records = [_record(label, outcome, references[label[0]])
               for label, outcome in outcomes.items()]
    for one in records:
        if one["rtol"] and "error" in one:
            one["fixed_seconds"] = fixed_seconds(
                [other for other in select(records, case=one["case"], scheme=one["scheme"])
                 if other["dt"]],
                one["error"])
            if one["fixed_seconds"]:
                one["saving"] = one["fixed_seconds"] / one["seconds"]
    campaign.write_records(COLUMNS, records, _markdown(records, cells))
    _draw(campaign.path("tolerance.png"), records, list(cases))
    return records


def declare(case, scheme, cells, rtol=None, dt=None):
    """Options of one run, by tolerance or by fixed time step."""
    steps = dict(ts_rtol=rtol) if rtol else dict(ts_dt=dt)
    return dict(case, axes=AXES, scheme=scheme, stag_grid_x=cells, fft=True, outline_every=1,
                **steps)


class Path:
    """The markers of a run over time."""

    def __init__(self, outcome):
        self.outcome = outcome

    @cached_property
    def _table(self):
        found = tables.read(os.path.join(self.outcome.folder, "outlines.csv"))
        names = [[name for name in found if name[0] == axis and name[1:].isdigit()]
                 for axis in "xy"]
        markers = np.stack([[found[name] for name in names[k]] for k in (0, 1)], axis=-1)
        return found["time"], np.moveaxis(markers, 0, 1)

    def __iter__(self):
        """Times and markers of the steps."""
        return zip(*self._table)

    @cached_property
    def at(self):
        """Markers at any time."""
        from scipy.interpolate import CubicSpline

        return CubicSpline(*self._table)


def path_error(path, reference):
    """Largest distance of a marker from where it is in the reference, over all steps."""
    return max(np.hypot(*(markers - reference.at(time)).T).max() for time, markers in path) / SIZE


def _record(label, outcome, reference):
    case, scheme, rtol, dt = label
    record = dict(case=case, scheme=scheme, rtol=rtol, dt=dt, status=outcome.status,
                  reason=outcome.reason, steps=outcome.steps)
    if outcome.finished and reference.outcome.finished:
        record.update(seconds=outcome.cpu_seconds,
                      error=path_error(Path(outcome), reference))
    return record


def fixed_seconds(records, error):
    """Seconds that fixed time steps take for an error, between those tried; None outside."""
    known = sorted((np.log(one["error"]), np.log(one["seconds"]))
                   for one in records if "error" in one)
    if not known or not known[0][0] <= np.log(error) <= known[-1][0]:
        return None
    return float(np.exp(np.interp(np.log(error), *zip(*known))))


def slope(records):
    """Power of the tolerance with which the error falls; None for fewer than two."""
    return power([one["rtol"] for one in records], [one.get("error") for one in records])


def _markdown(records, cells):
    text = (f"Errors of the markers' positions over the whole run, relative to the vesicle's size, "
            f"on {cells}^2; saving: processor seconds of fixed time steps of the same error "
            "(between those tried) over those by tolerance.\n")
    rows = [[one["case"], one["scheme"], report.number(one["rtol"], 1), str(one["steps"]),
             report.number(one.get("error")), report.number(one.get("seconds")),
             report.number(one.get("fixed_seconds")), report.number(one.get("saving"), 2)]
            for one in records if one["rtol"]]
    text += "\n" + report.markdown_table(
        ["case", "scheme", "-ts_rtol", "steps", "error", "seconds", "fixed: seconds", "saving"],
        rows)
    rows = []
    for case, scheme in dict.fromkeys((one["case"], one["scheme"]) for one in records):
        among = select(records, case=case, scheme=scheme)
        observed = slope([one for one in among if one["rtol"]])
        order = SCHEMES[scheme].order
        rows.append([case, scheme, report.number(observed, 2), f"{order}/{order + 1}"])
    return text + (
        "\nPower of the tolerance with which the error falls; p/(p + 1) for a scheme of order p "
        "whose steps all make an error of the tolerance:\n\n"
        + report.markdown_table(["case", "scheme", "observed", "p/(p + 1)"], rows))


def _draw(path, records, cases):
    with report.picture(path, 10, 3.8 * len(cases), rows=len(cases), columns=2) as (figure, axes):
        for (left, right), case in zip(axes, cases):
            among = [one for one in records if one["case"] == case and "error" in one]
            for scheme in dict.fromkeys(one["scheme"] for one in among):
                group = [one for one in among if one["scheme"] == scheme]
                _lines(left, right, group, scheme)
            left.set(title=case, xlabel="-ts_rtol", ylabel="error of the markers")
            right.set(title=case, xlabel="processor seconds")
        report.legend_below(figure, axes[0, 1], 4)


def _lines(left, right, group, scheme):
    style = SCHEMES[scheme].style
    free = [one for one in group if one["rtol"]]
    steady = [one for one in group if one["dt"]]
    errors = [one["error"] for one in free]
    left.loglog([one["rtol"] for one in free], errors, label=scheme, **style)
    right.loglog([one["seconds"] for one in free], errors, label=f"{scheme}, by tolerance", **style)
    right.loglog([one["seconds"] for one in steady], [one["error"] for one in steady],
                 label=f"{scheme}, fixed steps", linestyle=":", mfc="none", **style)


if __name__ == "__main__":
    sys.exit(main())
