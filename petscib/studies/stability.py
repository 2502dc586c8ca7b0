"""Stiff and extreme cases: what each scheme survives, and what it keeps of the energy law.

One property of a resting vesicle (0.1, 0.5) at a time is taken to its extremes, for every scheme:
those of the paper's tables by its literal method, and all with kink correction and area kept.
Further cases are further lines of `cases`.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..coupling.kernels import KERNELS
from ..schemes.registry import SCHEMES
from . import methods, report, runs
from .campaign import Campaign
from .ellipses import even_markers

CELLS = 64
H = 2 / CELLS
AXES = (0.1, 0.5)
BASE = dict(scene="stiff", fft=True, stag_grid_x=CELLS, axes=AXES, sigma0=1e5, bending=0.01,
            ts_dt=H)
# An energy may rise by this fraction of its largest value: the solvers' tolerances.
ROUND_OFF = 1e-8
DRIFT = 0.01  # of area or perimeter, as in Hu & Lai's Table 2
# Only record the residual: it is what is measured, and must not end the run.
LEDGER = dict(ledger="record")
COLUMNS = ("group", "case", "scheme", "method", "status", "reason", "steps", "energy_rise",
           "monotone", "ledger_residual", "area_drift", "perimeter_drift", "solver_iterations",
           "picard_iterations", "step_seconds", "verdict")
SOUND, RISES, DRIFTS, LOST, UNKNOWN = (
    "sound", "energy rises", "drifts", "does not finish", "no result")


@dataclass(frozen=True)
class Case:
    """An entry of the table: the options that differ from BASE."""

    group: str
    name: str
    options: Mapping
    quick: bool = False
    steps: int = 20

    @property
    def at_rest(self):
        """Whether the energy must fall."""
        return "flow" not in self.options


def cases():
    """The table, in order."""
    found = [Case("base", "sigma0 1e5, dt h, c_b 0.01, 64^2", {}, True)]
    for power, quick in ((7, False), (9, True), (11, False), (13, True)):
        found.append(Case("stiffness", f"sigma0 1e{power}", dict(sigma0=10.0**power), quick))
    for power, quick in ((5, False), (9, True)):
        found.append(Case("-stretch evolve", f"sigma0 1e{power}", dict(
            sigma0=10.0**power, stretch="evolve"), quick))
    for ratio, quick in ((0.25, False), (4, False), (16, True), (64, False), (256, False),
                         (1000, True)):
        found.append(Case("time step", f"dt {ratio:g} h", dict(ts_dt=ratio * H), quick))
    for bending, quick in ((1e-4, False), (0.1, False), (1.0, True)):
        found.append(Case("bending", f"c_b {bending:g}", dict(bending=bending), quick))
    # Without bending a vesicle at rest stays as it is: only a flow moves it.
    found.append(Case("bending", "c_b 0, shear rate 1", dict(bending=0.0, flow="shear"), True))
    for aspect, cells, quick in ((2, 64, False), (10, 64, True), (25, 64, True),
                                 (25, 256, False)):
        found.append(Case("axis ratio", f"1:{aspect} on {cells}^2", dict(
            axes=(0.5 / aspect, 0.5), stag_grid_x=cells, ts_dt=2 / cells), quick))
    for rate, ratio, quick in ((0.01, 1, False), (1, 1, False), (10, 1, True), (10, 0.1, False)):
        found.append(Case("shear", f"rate {rate:g}, dt {ratio:g} h", dict(
            flow="shear", shear_rate=float(rate), ts_dt=ratio * H), quick))
    # Such shear draws a membrane of 1e5 out by a percent, whatever the scheme.
    for rate, ratio, quick in ((100, 0.01, False), (1000, 0.001, True), (1000, 0.01, False)):
        found.append(Case("shear", f"rate {rate:g}, dt {ratio:g} h, sigma0 1e9", dict(
            flow="shear", shear_rate=float(rate), ts_dt=ratio * H, sigma0=1e9), quick))
    # The walls of the box move by the CFL number of cells in a step.
    for advection, cfl, cell_reynolds, quick in (
        ("explicit", 0.5, 10, True), ("implicit", 0.5, 10, False), ("implicit", 2, 10, True),
        ("implicit", 10, 1, False), ("implicit", 10, 10, False)):
        found.append(Case("advection", f"{advection}, CFL {cfl:g}, cell Re {cell_reynolds}", dict(
            flow="shear", advection=advection, rho=cell_reynolds / H, ts_dt=cfl * H), quick))
    for contrast, quick in ((0.01, True), (0.1, False), (10, False), (100, False), (1000, True)):
        found.append(Case("contrast", f"{contrast:g}, axes 0.2, 0.4", dict(
            axes=(0.2, 0.4), viscosity_contrast=float(contrast), flow="shear"), quick))
    for name in ("rho", "mu"):
        for power, quick in ((-4, True), (-2, False), (2, False), (4, True)):
            found.append(Case("fluid", f"{name} 1e{power}", {name: 10.0**power}, quick))
    for spacing, quick in ((0.2, True), (1, False), (2, True)):
        found.append(Case("markers", f"spacing {spacing:g} h", dict(
            markers=even_markers(AXES, CELLS, spacing=spacing)), quick))
    for count, quick in ((16, True), (32, False), (128, False), (256, False), (512, False),
                         (1024, False)):
        found.append(Case("grid", f"{count}^2", dict(stag_grid_x=count, ts_dt=2 / count), quick,
                          steps=20 if count <= 256 else 3))
    found.append(Case("box", "4:1", dict(domain=(-4.0, 4.0, -1.0, 1.0), stag_grid_x=256)))
    found.append(Case("box", "1:4, cells 1:2", dict(
        domain=(-1.0, 1.0, -4.0, 4.0), stag_grid_x=64, stag_grid_y=128, axes=(0.2, 0.5))))
    found.append(Case("wall", "a cell from the kernel's reach", dict(
        center=(1 - (KERNELS["yang"].reach + 1) * H - AXES[0], 0.0)), True))
    for name, options, quick in (
        ("sigma0 1e9, dt 64 h", dict(sigma0=1e9, ts_dt=64 * H), False),
        ("sigma0 1e13, dt 1000 h", dict(sigma0=1e13, ts_dt=1000 * H), True),
        ("sigma0 1e9, dt 16 h, 1:25, c_b 1", dict(
            sigma0=1e9, ts_dt=16 * H, axes=(0.02, 0.5), bending=1.0), False),
        ("sigma0 1e9, rho 1e-4, mu 1e-4", dict(sigma0=1e9, rho=1e-4, mu=1e-4), False),
    ):
        found.append(Case("combined", name, options, quick))
    return found


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("stability", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, [case for case in cases() if case.quick], steps=5, time_limit=60)
    else:
        study(campaign, cases(), time_limit=900)
    return campaign.exit_status


def study(campaign, chosen, steps=None, time_limit=900.0, schemes=SCHEMES):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    chosen : list of Case
    steps : int, optional
        Instead of each case's own number.
    time_limit : float
        Seconds a run.
    schemes : sequence of str
    """
    series = methods.series(schemes)
    labels = [(case, *one) for case in chosen for one in series]
    outcomes = campaign.run_all({
        (case.group, case.name, scheme, method): declare(case, scheme, method, steps)
        for case, scheme, method in labels}, time_limit)
    records = [judge(case, scheme, method, outcome)
               for (case, scheme, method), outcome in zip(labels, outcomes.values())]
    campaign.write_records(COLUMNS, records, _markdown(records, chosen, series))
    _draw(campaign.path("stability.png"), records, chosen, series)
    return records


def declare(case, scheme, method, steps=None):
    """Options of one run."""
    options = {**BASE, **methods.OPTIONS[method], "scheme": scheme, **case.options}
    if not SCHEMES[scheme].implicit:  # it takes its force from the markers, and has no energy law
        options.pop("stretch", None)
    else:
        options.update(LEDGER)
    return dict(options, ts_max_time=options["ts_dt"] * (steps or case.steps))


def judge(case, scheme, method, outcome):
    """The record of one run.  No number in it is infinite or NaN."""
    energy = outcome.column("energy")
    solver = outcome.column("coupled_iterations")
    solver = solver if len(solver) else outcome.column("momentum_iterations")
    picard = outcome.column("picard_iterations")
    record = dict(
        group=case.group, case=case.name, scheme=scheme, method=method, status=outcome.status,
        reason=outcome.reason, steps=outcome.steps,
        ledger_residual=outcome.largest("ledger_residual"),
        area_drift=outcome.largest("area_error"),
        perimeter_drift=outcome.largest("perimeter_error"),
        solver_iterations=float(solver.mean()) if len(solver) else None,
        picard_iterations=float(picard.mean()) if len(picard) else None,
        step_seconds=outcome.step_seconds)
    if case.at_rest and len(energy) > 1:
        rise = max(0.0, np.diff(energy).max() / max(energy.max(), np.finfo(float).tiny))
        record.update(energy_rise=rise, monotone=int(rise <= ROUND_OFF))
    record["verdict"] = _verdict(record) if outcome.is_result else UNKNOWN
    return record


def _verdict(record):
    if record["status"] != runs.FINISHED:
        return LOST
    if record.get("monotone") == 0:
        return RISES
    drift = max(record["area_drift"], record["perimeter_drift"])
    return DRIFTS if drift > DRIFT else SOUND


def _markdown(records, chosen, series):
    steps = sorted({one["steps"] for one in records if one["status"] == runs.FINISHED})
    span = f"{steps[0]} to {steps[-1]}" if len(steps) > 1 else str(*steps)
    parts = [f"Runs of {span} steps from rest; shear runs from the background flow. The base is a "
             f"vesicle {AXES} on {CELLS}^2 with dt = h, sigma0 = 1e5, c_b = 0.01, rho = mu = 1. "
             "Those of the paper's tables by its literal method, then all with kink correction and "
             "area kept.\n"]
    entries = {(one["group"], one["case"], one["scheme"], one["method"]): one for one in records}

    def table(title, entry, note=""):
        rows = [[case.group, case.name,
                 *(entry(entries[(case.group, case.name, *one)]) for one in series)]
                for case in chosen]
        header = ["", "case", *(methods.title(*one) for one in series)]
        parts.append(f"**{title}**{note}\n\n" + report.markdown_table(header, rows))

    def after(one):
        return one["verdict"] + (f" ({one['steps']})" if one["verdict"] == LOST else "")

    table("Verdict", after, f" (sound: at rest the energy falls in every step, area and perimeter "
          f"stay within {DRIFT:.0%}; in brackets the steps done)")
    for title, name in (
        ("Largest rise of the energy in a step, relative to the largest energy", "energy_rise"),
        ("Largest ledger residual", "ledger_residual"),
        ("Largest relative area error", "area_drift"),
        ("Largest relative perimeter error", "perimeter_drift"),
        ("Solver iterations a step", "solver_iterations"),
        ("Passes of the tangent a step", "picard_iterations"),
    ):
        table(title, lambda one, name=name: report.number(one.get(name), 2))
    lost = [one for one in records if one["verdict"] == LOST]
    if lost:
        rows = [[one["group"], one["case"], methods.title(one["scheme"], one["method"]),
                 str(one["steps"]), one["status"], first_clause(one["reason"])] for one in lost]
        parts.append("**Runs that did not finish**\n\n" + report.markdown_table(
            ["", "case", "scheme", "steps", "status", "last line of its output"], rows))
    return "\n".join(parts)


def first_clause(reason):
    """That of petscib's message, short enough for a table; stability.csv has it all."""
    clause = reason.split("; ")[0].replace("|", "/")
    return clause[len("petscib: "):] if clause.startswith("petscib: ") else clause


def _draw(path, records, chosen, series):
    """A square for every run: its colour the verdict, in it the larger drift."""
    colours = {SOUND: "#9BD0B9", RISES: "#F2CF7E", DRIFTS: "#BFDDF2", LOST: "#E59C78",
               UNKNOWN: "#DDDDDD"}
    with report.picture(path, 2.6 + 0.95 * len(series), 1.0 + 0.27 * len(chosen)) as (
            figure, axes):
        axis = axes[0, 0]
        for k, one in enumerate(records):
            row, column = divmod(k, len(series))
            axis.add_patch(_square(column, row, colours[one["verdict"]]))
            drift = [one[name] for name in ("area_drift", "perimeter_drift") if one.get(name)]
            text = f"step {one['steps'] + 1}" if one["verdict"] == LOST else report.number(
                max(drift, default=None), 2)
            axis.text(column, row, text, ha="center", va="center", fontsize=9)
        axis.set(xlim=(-0.5, len(series) - 0.5), ylim=(len(chosen) - 0.5, -0.5))
        axis.set_xticks(range(len(series)),
                        [methods.title(*one).replace(", ", "\n") for one in series])
        axis.set_yticks(range(len(chosen)), [f"{case.group}: {case.name}" for case in chosen],
                        fontsize=9)
        axis.tick_params(length=0, labeltop=True, labelbottom=False)
        handles = [_square(0, 0, colour) for colour in colours.values()]
        figure.legend(handles, colours, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=5,
                      title="number: larger relative error of area and perimeter; "
                            "or the step that failed")


def _square(column, row, colour):
    from matplotlib.patches import Rectangle

    return Rectangle((column - 0.5, row - 0.5), 1, 1, facecolor=colour, edgecolor="white")


if __name__ == "__main__":
    sys.exit(main())
