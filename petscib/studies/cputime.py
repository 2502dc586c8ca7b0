"""Processor seconds a step and in total (Hu & Lai, Table 3).

The vesicle (0.1, 0.5) with sigma0 = 1e9, to T = 1 with the paper's dt = h: the paper's literal
method, and beside it the corrected one.  The explicit scheme takes the largest time step that
`maxstep` found for it, and only 100 of them.
"""

import sys

from ..schemes.registry import SCHEMES
from . import methods, report, runs
from .campaign import Campaign

END = 1.0
EXPLICIT_DT = {128: 5.1e-7, 256: 1.35e-7, 512: 5.4e-8}
# Hu & Lai's Table 3, by cells: time step of EP; seconds a step, and in total, of all.
PAPER_EXPLICIT_DT = {128: 1.02e-6, 256: 3.81e-7, 512: 1.53e-7}
PAPER = {
    128: {"ep": (0.07, 68627), "mbe": (0.13, 8), "mcn": (0.13, 8)},
    256: {"ep": (0.16, 419947), "mbe": (0.39, 50), "mcn": (0.43, 55)},
    512: {"ep": (0.45, 2941176), "mbe": (1.25, 320), "mcn": (1.45, 371)},
}
COLUMNS = ("cells", "scheme", "method", "dt", "steps", "step_seconds", "set_up_seconds",
           "total_seconds", "extrapolated", "status", "paper_step_seconds", "paper_total_seconds")


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("cputime", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, campaign.grids(128, 256), explicit_steps=100, implicit_steps=10,
              time_limit=120)
    else:
        study(campaign, campaign.grids(128, 256, 512), explicit_steps=100, implicit_steps=None,
              time_limit=7200)
    return campaign.exit_status


def study(campaign, cells, explicit_steps, implicit_steps, time_limit, schemes=SCHEMES):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    cells : tuple of int
    explicit_steps : int
        Steps of ep that are made.
    implicit_steps : int or None
        Steps of the others; None for all up to T = 1.
    time_limit : float
        Seconds a run.
    schemes : sequence of str
    """
    declared = {
        (count, scheme, method): declare(
            scheme, method, count, implicit_steps if SCHEMES[scheme].implicit else explicit_steps)
        for count in cells for scheme, method in methods.series(schemes)
    }
    outcomes = campaign.run_all(declared, time_limit)
    records = [_record(label, declared[label]["ts_dt"], outcome)
               for label, outcome in outcomes.items()]
    campaign.write_records(COLUMNS, records, _markdown(records, campaign.ranks))
    _draw(campaign.path("cputime.png"), records)
    return records


def declare(scheme, method, cells, steps):
    """Options of one run."""
    dt = 2 / cells
    if not SCHEMES[scheme].implicit:
        dt = EXPLICIT_DT.get(cells, EXPLICIT_DT[128] * (128 / cells) ** 1.6)
    end = END if steps is None else min(END, steps * dt)
    return dict(scene="stiff", **methods.OPTIONS[method], scheme=scheme, sigma0=1e9,
                stag_grid_x=cells, fft=True, ts_dt=dt, ts_max_time=end)


def _record(label, dt, outcome):
    cells, scheme, method = label
    known = PAPER.get(cells, {}) if method == methods.LITERAL else {}
    paper_step, paper_total = known.get(scheme, (None, None))
    record = dict(cells=cells, scheme=scheme, method=method, dt=dt, steps=outcome.steps,
                  status=outcome.status, paper_step_seconds=paper_step,
                  paper_total_seconds=paper_total)
    if outcome.finished:
        steps, step_seconds = round(END / dt), outcome.step_cpu_seconds
        set_up = outcome.cpu_seconds - outcome.steps * step_seconds
        record.update(
            step_seconds=step_seconds, set_up_seconds=set_up,
            total_seconds=set_up + steps * step_seconds,
            extrapolated=int(outcome.steps < steps))
    return record


def _markdown(records, ranks):
    text = (f"Processor seconds a step and in total to T = {END:g}, set-up included; {ranks} MPI "
            "rank(s); sigma0 = 1e9; the paper's literal method, and with kink correction and area "
            "kept. `*`: extrapolated from fewer steps. In brackets the paper's (a PC of 2013; its "
            "totals of ep at 256 and 512 are extrapolated too).\n")
    rows, entries = [], {(one["cells"], one["scheme"], one["method"]): one for one in records}
    order = {scheme: k for k, scheme in enumerate(SCHEMES)}
    for cells, scheme in sorted({(one["cells"], one["scheme"]) for one in records},
                                key=lambda pair: (pair[0], order[pair[1]])):
        literal, corrected = (entries.get((cells, scheme, method)) for method in methods.OPTIONS)
        dt, paper_dt = report.number((literal or corrected)["dt"]), PAPER_EXPLICIT_DT.get(cells)
        if not SCHEMES[scheme].implicit and paper_dt:
            dt += f" ({report.number(paper_dt)})"
        rows.append([f"{cells}^2", scheme, dt, *_seconds(literal), *_seconds(corrected)])
    header = ["cells", "scheme", "dt"]
    for method in methods.OPTIONS:
        header += [f"{method}: seconds a step", "total"]
    text += "\n" + report.markdown_table(header, rows)
    lost = [one for one in records if one["status"] != runs.FINISHED]
    if lost:
        text += "\nRuns without a result:\n\n" + report.markdown_table(
            ["cells", "scheme", "method", "run"],
            [[f"{one['cells']}^2", one["scheme"], one["method"], one["status"]] for one in lost])
    return text


def _seconds(one):
    """Seconds a step and in total, with the paper's."""
    if one is None:
        return "-", "-"
    step, total = (report.number(one.get(name)) for name in ("step_seconds", "total_seconds"))
    total += "*" if one.get("extrapolated") else ""
    if one["paper_step_seconds"]:
        step += f" ({one['paper_step_seconds']:g})"
        total += f" ({one['paper_total_seconds']})"
    return step, total


def _draw(path, records):
    cells = sorted({one["cells"] for one in records})
    with report.picture(path, 10, 4, columns=2) as (figure, axes):
        for axis, name, title in ((axes[0, 0], "step_seconds", "seconds a step"),
                                  (axes[0, 1], "total_seconds", "seconds to T = 1")):
            for scheme in dict.fromkeys(one["scheme"] for one in records):
                for method, line in zip(methods.OPTIONS, ("-", "--")):
                    group = [one for one in records
                             if (one["scheme"], one["method"]) == (scheme, method)]
                    _line(axis, group, name, methods.title(scheme, method), line)
                    _line(axis, group, "paper_" + name, f"{scheme}, Hu & Lai", ":", mfc="none")
            axis.set_title(title)
            report.cells_axis(axis, cells)
        report.legend_below(figure, axes[0, 0], 5)


def _line(axis, group, name, label, line, **style):
    known = [one for one in group if one.get(name)]
    if known:
        axis.loglog([one["cells"] for one in known], [one[name] for one in known], linestyle=line,
                    label=label, **SCHEMES[known[0]["scheme"]].style, **style)


if __name__ == "__main__":
    sys.exit(main())
