"""The largest stable time step of each scheme (Hu & Lai, Table 2).

A time step counts as stable when the run finishes with the relative errors of area and perimeter
within 1 percent: at every step, or, as the paper may have meant it, at the end.  (The perimeter
error of mbe peaks early and falls again.)  Implicit schemes run to T = 1 with at most dt = 64 h.
The explicit scheme would need up to millions of steps for that, so it only has to hold for a
number of steps from rest, which the table names: its limit here is an upper bound of the true one.
A step so long that the run has few may hold where a shorter one does not, so that the limit is the
largest step below which none fails: every octave is tried at which a run has fewer than `FEW`
steps; below, and with the explicit scheme, the first that holds stands for all shorter ones.

The paper's literal method comes first, and beside it the corrected one.
"""

import sys

import numpy as np

from ..schemes.registry import SCHEMES
from . import methods, report, runs
from .campaign import Campaign

STIFFNESSES = 1e7, 1e8, 1e9
END = 1.0
# With mbe corrected, 128^2 and sigma0 = 1e7 one step to T holds, 2 to 16 do not, and 23 do.
FEW = 64
TOLERANCE = 0.01
LARGEST = 64.0  # in units of h
SMALLEST = 1 / 16
EXPLICIT_SPAN = 16.0  # the search goes this factor up and down from the paper's value
# Hu & Lai's Table 2: by cells and sigma0, the steps of EP, of modified BE and of modified CN.
PAPER = {
    (128, 1e7): (2.22e-5, 1.56e-2, 1.56e-2),
    (128, 1e8): (4.36e-6, 1.56e-2, 1.56e-2),
    (128, 1e9): (1.02e-6, 1.56e-2, 1.56e-2),
    (256, 1e7): (1.03e-5, 7.81e-3, 7.81e-3),
    (256, 1e8): (1.74e-6, 7.81e-3, 7.81e-3),
    (256, 1e9): (3.81e-7, 7.81e-3, 7.81e-3),
    (512, 1e7): (4.74e-6, 3.91e-3, 3.91e-3),
    (512, 1e8): (7.44e-7, 3.91e-3, 3.91e-3),
    (512, 1e9): (1.53e-7, 3.91e-3, 3.91e-3),
}
PAPER_SCHEMES = "ep", "mbe", "mcn"
COLUMNS = ("scheme", "method", "sigma0", "cells", "criterion", "relation", "dt", "dt_over_h",
           "above_it", "paper_dt")
EQUAL, AT_LEAST, BELOW, UNKNOWN = "=", ">=", "<", "no result"
ALWAYS, AT_END = "at every step", "at the end"


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("maxstep", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, campaign.grids(64, 128), (1e7, 1e9), explicit_steps=200, octave=2,
              time_limit=300)
    else:
        study(campaign, campaign.grids(128, 256, 512), STIFFNESSES, explicit_steps=1000, octave=2,
              time_limit=3600)
    return campaign.exit_status


def study(campaign, cells, stiffnesses, explicit_steps, octave, time_limit, schemes=SCHEMES,
          smallest=SMALLEST):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    cells : tuple of int
    stiffnesses : tuple of float
    explicit_steps : int
        Steps that ep must survive.
    octave : int
        How many time steps the search tells apart between one and its double.
    time_limit : float
        Seconds a run.
    schemes : sequence of str
    smallest : float
        Where the search for implicit schemes ends, in units of h.
    """
    records = []
    cases = [(count, sigma0, *one) for count in cells for sigma0 in stiffnesses
             for one in methods.series(schemes)]
    for number, (count, sigma0, scheme, method) in enumerate(cases, 1):
        h = 2 / count
        if not SCHEMES[scheme].implicit:
            middle = explicit_guess(count, sigma0)
            low, high = middle / EXPLICIT_SPAN, middle * EXPLICIT_SPAN
        else:
            low, high = smallest * h, min(LARGEST * h, END)

        def make(dt, number=number, count=count, sigma0=sigma0, scheme=scheme, method=method):
            end = END if SCHEMES[scheme].implicit else explicit_steps * dt
            return campaign.run(
                f"{methods.title(scheme, method)} sigma0 {sigma0:g} {count}^2 dt {dt:.3g}",
                declare(scheme, method, sigma0, count, dt, end), time_limit,
                f"{number}/{len(cases)}")

        # The few steps of ep have no end that would mean anything.
        for criterion in (ALWAYS, AT_END) if SCHEMES[scheme].implicit else (ALWAYS,):
            record = dict(scheme=scheme, method=method, sigma0=sigma0, cells=count,
                          criterion=criterion, paper_dt=paper(scheme, method, sigma0, count))
            try:
                relation, dt, above = search(
                    lambda dt, make=make, criterion=criterion: trouble(make(dt), criterion),
                    low, high, octave,
                    END / FEW if SCHEMES[scheme].implicit else high)
                record.update(relation=relation, dt=dt, dt_over_h=dt / h, above_it=above)
            except NoResultError:
                record["relation"] = UNKNOWN
            records.append(record)
    campaign.write_records(COLUMNS, records, _markdown(records, explicit_steps, octave))
    _draw(campaign.path("maxstep.png"), records, stiffnesses)
    return records


def declare(scheme, method, sigma0, cells, dt, end):
    """Options of one run."""
    return dict(scene="stiff", **methods.OPTIONS[method], scheme=scheme, sigma0=sigma0,
                stag_grid_x=cells, fft=True, ts_dt=dt, ts_max_time=end)


class NoResultError(Exception):
    """A run of a search has crashed or was refused: nothing is known of its time step."""


def trouble(outcome, criterion):
    """Why a run does not count as stable; an empty text when it does.

    Raises
    ------
    NoResultError
    """
    if not outcome.is_result:
        raise NoResultError
    if outcome.status == runs.FAILED:
        return f"fails at step {outcome.steps + 1}"
    if not outcome.finished:
        return outcome.status
    for name in ("area", "perimeter"):
        found = outcome.largest if criterion == ALWAYS else outcome.last
        error = found(f"{name}_error")
        if error > TOLERANCE:
            return f"{name} error {report.number(error, 2)}"
    return ""


def search(judge, low, high, octave, doubted):
    """The largest step below which none gives trouble: from long ones down, octave by octave.

    Parameters
    ----------
    judge : callable
        Of a step, the trouble it gives.
    low, high : float
    octave : int
        Steps told apart between one and its double.
    doubted : float
        A step without trouble that is longer says nothing of shorter ones.

    Returns
    -------
    relation, step, trouble
        "=" and the step, with the trouble of the next that was tried; ">=" and `high`, or "<" and
        `low`, when all or none are good.
    """
    count = max(1, round(octave * np.log2(high / low)))
    steps = high * 2.0 ** (-np.arange(count + 1)[::-1] / octave)  # steps[0] is about `low`
    good, bad, above = -1, count + 1, ""
    for index in range(count, -1, -octave):
        found = judge(float(steps[index]))
        if found:
            good, bad, above = -1, index, found
        elif good < 0:
            good = index
        if not found and steps[index] <= doubted:
            break
    if bad > count:
        return AT_LEAST, high, ""
    while bad - good > 1:
        middle = (good + bad) // 2
        found = judge(float(steps[middle]))
        if found:
            bad, above = middle, found
        else:
            good = middle
    return (EQUAL, float(steps[good]), above) if good >= 0 else (BELOW, float(steps[0]), above)


def explicit_guess(cells, sigma0):
    """About where the limit of ep lies: the paper's value, or its trend on other grids."""
    known = PAPER.get((cells, sigma0))
    return known[0] if known else 2.22e-5 * (128 / cells) * (1e7 / sigma0) ** 0.7


def paper(scheme, method, sigma0, cells):
    """The paper's entry, or None."""
    if method != methods.LITERAL:
        return None
    entries = dict(zip(PAPER_SCHEMES, PAPER.get((cells, sigma0), ())))
    return entries.get(scheme)


def _markdown(records, explicit_steps, octave):
    text = (f"Largest stable time step, to a factor of {2 ** (1 / octave):.2f}: area and perimeter "
            f"within 1 percent up to T = {END:g} (ep: over {explicit_steps} steps from rest), "
            f"ellipse (0.1, 0.5), c_b = 0.01, at most {LARGEST:g} h and T: the paper's literal "
            "method, then with kink correction and area kept. In brackets dt/h, in square brackets "
            "the paper's dt. `<` means that no step down to this one holds.\n")
    for criterion in (ALWAYS, AT_END):
        among = [one for one in records if one["criterion"] == criterion]
        if among:
            text += f"\n**Within 1 percent {criterion}**\n\n{_limits(among)}"
    rows = [[one["criterion"], f"{one['cells']}^2", report.number(one["sigma0"], 1), _series(one),
             one["above_it"]] for one in records if one.get("above_it")]
    return text + "\nWhat goes wrong just above:\n\n" + report.markdown_table(
        ["criterion", "cells", "sigma0", "scheme", "trouble"], rows)


def _series(record):
    return methods.title(record["scheme"], record["method"])


def _limits(records):
    schemes = list(dict.fromkeys(map(_series, records)))
    entries = {(one["cells"], one["sigma0"], _series(one)): one for one in records}
    rows = []
    for count, sigma0 in dict.fromkeys((one["cells"], one["sigma0"]) for one in records):
        row = [f"{count}^2", report.number(sigma0, 1)]
        for scheme in schemes:
            one = entries[count, sigma0, scheme]
            entry = UNKNOWN
            if one["relation"] != UNKNOWN:
                relation = "" if one["relation"] == EQUAL else one["relation"] + " "
                entry = f"{relation}{report.number(one['dt'])} ({report.number(one['dt_over_h'])})"
            if one["paper_dt"]:
                entry += f" [{report.number(one['paper_dt'])}]"
            row.append(entry)
        rows.append(row)
    return report.markdown_table(["cells", "sigma0", *schemes], rows)


def _draw(path, records, stiffnesses):
    size = dict(width=4.2 * len(stiffnesses), height=4.2)
    with report.picture(path, **size, columns=len(stiffnesses), sharey=True) as (figure, axes):
        for axis, sigma0 in zip(axes[0], stiffnesses):
            _draw_panel(axis, [one for one in records if one["sigma0"] == sigma0])
            axis.set_title(f"$\\sigma_0$ = {report.number(sigma0, 1)}")
        axes[0, 0].set_ylabel(r"largest stable $\Delta t$")
        report.legend_below(figure, axes[0, 0], 5)


def _draw_panel(axis, records):
    """Limits at every step; dotted with hollow symbols the paper's, dashed the corrected."""
    records = [one for one in records if one["criterion"] == ALWAYS]
    cells = sorted({one["cells"] for one in records})
    series = list(dict.fromkeys((one["scheme"], one["method"]) for one in records))
    for k, (scheme, method) in enumerate(series):
        style = SCHEMES[scheme].style
        group = [one for one in records if (one["scheme"], one["method"]) == (scheme, method)]
        # Side by side, since several schemes share the same limit.
        places = np.array([one["cells"] for one in group]) * 1.03 ** (k - len(series) / 2)
        axis.loglog(places, [one.get("dt", np.nan) for one in group],
                    linestyle="-" if method == methods.LITERAL else "--",
                    label=methods.title(scheme, method), **style)
        known = [one for one in group if one["paper_dt"]]
        if known:
            axis.loglog([one["cells"] for one in known], [one["paper_dt"] for one in known],
                        linestyle=":", markersize=10, markerfacecolor="none",
                        label=f"{scheme}, Hu & Lai", **style)
    ends = np.array([cells[0] / 1.3, cells[-1] * 1.3])
    for ratio, line in ((1.0, "--"), (LARGEST, "-.")):
        label = f"$\\Delta t$ = {ratio:g} $h$" if ratio > 1 else r"$\Delta t = h$"
        axis.loglog(ends, 2 / ends * ratio, color="k", linewidth=0.8, linestyle=line, label=label)
    axis.set_xlim(ends)
    report.cells_axis(axis, cells)


if __name__ == "__main__":
    sys.exit(main())
