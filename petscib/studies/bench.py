"""Benchmark: seconds, iterations and memory of a step, beside what else could be done.

The vesicle (0.1, 0.5) in fluid at rest, dt = h, scheme mbe: with the membranes' stresses eliminated
(GAMG), with a block iteration (GAMG block) and by transforms (fft), on 1 and 2 ranks.  Beside it
the coupled schemes, other multigrid than ours, one fast solve of the fluid's matrix (the floor),
the method without the kink correction, factored (literal) and by plain CG and GAMG on the assembled
matrix, and the explicit scheme (Hu & Lai, Table 3).
All is measured anew at each call, since only ratios from one run mean something on a busy machine.
"""

import json
import os
import sys
from dataclasses import dataclass, replace

import numpy as np

from ..output.style import GREEN, GREY, PURPLE
from ..schemes.registry import SCHEMES
from . import cputime, report
from .campaign import Campaign
from .records import power
from .runs import Run

STIFFNESSES = 1e5, 1e9
RANKS = 1, 2
SOLVERS = {
    "GAMG": {"momentum_ksp_type": "cg"},
    "GAMG block": {"momentum_ksp_type": "fgmres"},
    "fft": {"fft": True},
}
COUPLED = {"fft": ("be", "gbe", "gcn"), "GAMG": ("be", "gcn")}
# Other choices for velocity and pressure in the block iteration: option names without prefix.
MULTIGRIDS = {
    "GAMG, SOR": {"mg_levels_ksp_type": "richardson", "mg_levels_ksp_max_it": 1,
                  "mg_levels_pc_type": "sor"},
    "GAMG, one sweep": {"mg_levels_ksp_max_it": 1},
    "GAMG, three sweeps": {"mg_levels_ksp_max_it": 3},
    "GAMG, threshold 0.02": {"pc_gamg_threshold": 0.02},
    "BoomerAMG": {"pc_type": "hypre"},
}
LITERAL, PLAIN = "literal", "plain CG+GAMG"
PLAIN_ITERATIONS = 2000
WITHOUT = {
    LITERAL: {"kink_correction": False, "conserve_area": False},
    PLAIN: {"kink_correction": False, "conserve_area": False, "momentum_pc_type": "gamg",
            "momentum_ksp_max_it": PLAIN_ITERATIONS},
}
WARM_UP = 2
# Explicit steps are timed with less than the paper's time step, at which ours soon blows up.
EXPLICIT_FRACTION = 0.25
MOMENTUM = "matrix assembly", "marker model", "momentum solve"
PHASES = (
    "interpolation assembly", "marker operators", "marker model", "momentum solve",
    "Poisson solve", "coupled solve", "tangent iteration", "marker motion", "matrix assembly",
    "diagnostics", "output", "checks", "no phase",
)
# What the table of steps shows one by one; the others are its rest.
SHOWN = "marker model", "momentum solve", "coupled solve", "Poisson solve"
ITERATIONS = "momentum", "poisson", "coupled", "picard"
COLUMNS = (
    "scheme", "solver", "cells", "ranks", "sigma0", "dt", "status",
    *(f"{name}_iterations" for name in ITERATIONS),
    "step_seconds", "fastest_step_seconds", "fast_solve_seconds", "step_over_fast_solve",
    "peak_memory_bytes", "bytes_per_cell",
    *(f"{name} seconds" for name in PHASES),
)


class Measurement(Run):
    """A run with a clock on its steps."""

    program = "petscib.studies.measure"


@dataclass(frozen=True)
class Case:
    """One line of the benchmark."""

    solver: str
    cells: int
    sigma0: float
    ranks: int = 1
    scheme: str = "mbe"

    @property
    def title(self):
        """What the progress line calls it."""
        return f"{self.scheme}, {self.solver}, {self.cells}^2, sigma0 {self.sigma0:g}, " \
            f"{self.ranks} rank(s)"

    def options(self):
        """Options of the run."""
        steps = WARM_UP + (8 if self.cells <= 256 else 4)
        dt = 2 / self.cells
        if not SCHEMES[self.scheme].implicit:
            dt = cputime.PAPER_EXPLICIT_DT[self.cells] * EXPLICIT_FRACTION
        if self.solver in WITHOUT:
            steps = WARM_UP + 1
        other = {}
        if self.solver in MULTIGRIDS:
            other = {f"{prefix}_{name}": value for prefix in ("momentum_velocity", "poisson")
                     for name, value in MULTIGRIDS[self.solver].items()}
            other.update(SOLVERS["GAMG block"])
        return dict(
            scene="stiff", scheme=self.scheme, sigma0=self.sigma0, stag_grid_x=self.cells,
            ts_dt=dt, ts_max_time=1e3, ts_max_steps=steps, warm_up=WARM_UP, delta="yang",
            **other, **WITHOUT.get(self.solver, {}), **SOLVERS.get(self.solver, {}))


def main(arguments=None):
    """Run the benchmark; returns the exit status."""
    bench = Campaign.from_command_line("bench", __doc__.splitlines()[0], arguments)
    if bench.quick:
        study(bench, (64, 128), most_literal=128, explicit=(128,), coupled=(128,),
              multigrid=(64,))
    else:
        study(bench, (64, 128, 256, 512, 1024), most_literal=256,
              explicit=(128, 256, 512), coupled=(128, 256, 512), multigrid=(256,))
    return bench.exit_status


def study(bench, cells, most_literal, explicit, coupled, multigrid):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    bench : Campaign
    cells : tuple of int
    most_literal : int
        Largest grid for the method without the correction.
    explicit, coupled, multigrid : tuple of int
        Grids for scheme ep, for the coupled schemes, and for other multigrid than ours.
    """
    cases = []
    for count in cells:
        for sigma0 in STIFFNESSES:
            # Neighbours in time, as they are going to be compared.
            cases += [
                Case(solver, count, sigma0, ranks) for solver in SOLVERS for ranks in RANKS
            ]
            if count <= most_literal:
                cases += [Case(solver, count, sigma0) for solver in WITHOUT]
        if count in multigrid:
            cases += [Case(solver, count, 1e9) for solver in MULTIGRIDS]
        if count in coupled:
            cases += [Case(solver, count, 1e9, scheme=scheme)
                      for solver, schemes in COUPLED.items() for scheme in schemes]
        cases += [Case("fft", count, 1e9, scheme="ep")] if count in explicit else []
    records = {
        case: measure(bench, case, f"{number}/{len(cases)}")
        for number, case in enumerate(cases, 1)
    }
    start = start_up(bench, 128)
    bench.write_records(
        COLUMNS,
        records.values(),
        _steps_table(records) + _others_table(records) + _explicit_table(records)
        + _targets_table(records, start),
    )
    _draw(bench.path("bench.png"), records)
    return records


def measure(bench, case, progress):
    """Make the run of a case; returns a record by the names of COLUMNS."""
    outcome = bench.make(
        Measurement(case.options(), case.ranks), case.title, progress, again=True)
    record = dict(
        scheme=case.scheme, solver=case.solver, cells=case.cells, ranks=case.ranks,
        sigma0=case.sigma0, dt=case.options()["ts_dt"], status=outcome.status)
    if "DIVERGED_MAX_IT" in outcome.reason:
        record["status"] = f"none in {PLAIN_ITERATIONS}"
    if outcome.finished:
        with open(os.path.join(outcome.folder, "measurement.json")) as file:
            measured = json.load(file)
        phases = measured.pop("phase_seconds")
        record.update((name, measured[name]) for name in COLUMNS if name in measured)
        record.update((f"{name} seconds", phases.get(name)) for name in PHASES)
        record["bytes_per_cell"] = record["peak_memory_bytes"] / case.cells**2
        for name in ITERATIONS:
            counts = outcome.column(f"{name}_iterations")[WARM_UP:]
            record[f"{name}_iterations"] = float(np.median(counts)) if len(counts) else None
    return record


def start_up(bench, cells):
    """Seconds from the command to the end of a run of one step; None if it has no end."""
    options = dict(scene="stiff", stag_grid_x=cells, ts_max_steps=1, fft=True)
    outcome = bench.make(Run(options), f"start-up, {cells}^2", again=True)
    return outcome.seconds if outcome.finished else None


def momentum_seconds(record):
    """Seconds of a momentum solve with all that prepares it."""
    return sum(record[f"{name} seconds"] or 0.0 for name in MOMENTUM)


def exponent(records, solver):
    """The power of the number of cells that the seconds of a step of mbe grow with, from 128^2 on.

    On one rank, with the larger stiffness; None for one grid.
    """
    found = {
        case.cells**2: record["step_seconds"] for case, record in records.items()
        if case == Case(solver, case.cells, 1e9) and case.cells >= 128 and "step_seconds" in record
    }
    return power(found.keys(), found.values())


def speed_up(records, case):
    """How many times faster the ranks of a case are than one; None unless both were measured."""
    values = [records.get(one, {}).get("fastest_step_seconds")
              for one in (replace(case, ranks=1), case)]
    return values[0] / values[1] if all(values) else None


def _ms(seconds):
    return report.number(None if seconds is None else 1e3 * seconds)


def _steps_table(records):
    header = ["scheme", "solver", "cells", "ranks", "sigma0", "iterations", "step, ms",
              "model", "solve", "Poisson", "rest", "/ fast solve",
              "2 ranks: times faster", "MB", "bytes a cell"]
    rows = []
    for case, record in records.items():
        row = [case.scheme, case.solver, f"{case.cells}^2", str(case.ranks),
               report.number(case.sigma0, 1)]
        if "step_seconds" not in record:
            rows.append([*row, record["status"], *["-"] * (len(header) - len(row) - 1)])
            continue
        model, momentum, coupled, poisson = (record[f"{name} seconds"] for name in SHOWN)
        rest = sum(record[f"{name} seconds"] or 0.0 for name in PHASES if name not in SHOWN)
        faster = speed_up(records, case) if case.ranks > 1 else None
        counts = [record[f"{name}_iterations"] for name in ITERATIONS]
        rows.append([
            *row, " + ".join(f"{count:g}" for count in counts if count is not None),
            *map(_ms, (record["step_seconds"], model, momentum or coupled, poisson, rest)),
            report.number(record["step_over_fast_solve"]), report.number(faster),
            f"{record['peak_memory_bytes'] / 1e6:.0f}", f"{record['bytes_per_cell']:.0f}"])
    return (
        f"Medians over the steps after the first {WARM_UP}; milliseconds. Iterations: momentum + "
        "Poisson (mbe, ep), coupled (be), coupled + tangent (gbe, gcn). Model: factorisations in "
        "marker space. Solve: CG or FGMRES with its preconditioner. Rest: interpolation, forces, "
        "diagnostics, output. Times faster: by "
        "the fastest steps, as other work on the machine only adds time. Memory: most that all "
        "ranks held, interpreter and libraries (some 100 MB a rank) included. "
        f"{os.cpu_count()} cores; at the end of the benchmark {os.getloadavg()[0]:.1f} processes "
        "wanted to run (load average).\n\n"
        + report.markdown_table(header, rows))


def _others_table(records):
    """The same work without the correction, and the floor."""
    rows = []
    for case, record in records.items():
        if (case.solver, case.ranks, case.scheme) != ("fft", 1, "mbe") or (
                "step_seconds" not in record):
            continue
        times = []
        for solver in (*WITHOUT, *SOLVERS):
            other = records.get(replace(case, solver=solver), {})
            times.append(momentum_seconds(other) if "step_seconds" in other else None)
        rows.append([f"{case.cells}^2", report.number(case.sigma0, 1),
                     *map(_ms, (*times, record["fast_solve_seconds"]))])
    return (
        "\nOne momentum solve with its preparation, milliseconds, 1 rank: without the correction "
        f"({', '.join(WITHOUT)}), and with it.\n\n"
        + report.markdown_table(["cells", "sigma0", *WITHOUT, *SOLVERS, "one fast solve"], rows))


def _explicit_table(records):
    """Cost to T = 1 of the explicit scheme and of ours (Hu & Lai, Table 3)."""
    rows = []
    for case, record in records.items():
        implicit = records.get(Case("fft", case.cells, 1e9), {})
        if case.scheme != "ep" or not ("step_seconds" in record and "step_seconds" in implicit):
            continue
        explicit_dt = cputime.PAPER_EXPLICIT_DT[case.cells]
        for one, dt in ((record, explicit_dt), (implicit, implicit["dt"])):
            total = cputime.END / dt * one["step_seconds"]
            paper = cputime.PAPER[case.cells][one["scheme"]]
            rows.append([f"{case.cells}^2", one["scheme"], report.number(dt),
                         f"{_ms(one['step_seconds'])} ({1e3 * paper[0]:g})",
                         f"{report.number(total)} ({paper[1]})"])
    if not rows:
        return ""
    return (
        "\nTo T = 1 at sigma0 = 1e9, with the time steps of Hu & Lai's Table 3 (their seconds in "
        "brackets). All totals are extrapolated: number of steps times the median step (that of "
        f"ep measured at {EXPLICIT_FRACTION:g} of its time step, which is unstable here).\n\n"
        + report.markdown_table(["cells", "scheme", "dt", "step, ms", "total, s"], rows))


def _targets_table(records, start):
    rows = []

    def add(what, value, goal, at_most=True):
        if value is not None:
            met = value <= goal if at_most else value >= goal
            rows.append([what, report.number(value), f"{'<=' if at_most else '>='} {goal:g}",
                         "yes" if met else "no"])

    def of(case, name):
        return records.get(case, {}).get(name)

    for count, goal in ((64, 25), (128, 18), (256, 14), (512, 10), (1024, 8)):
        add(f"mbe step / fast solve, {count}^2, sigma0 1e9, fft",
            of(Case("fft", count, 1e9), "step_over_fast_solve"), goal)
    add("gcn step / fast solve, 512^2, sigma0 1e9, fft",
        of(Case("fft", 512, 1e9, scheme="gcn"), "step_over_fast_solve"), 35)
    for solver in ("GAMG block", "fft"):
        add(f"2 ranks against 1: times faster, 512^2, sigma0 1e9, {solver}",
            speed_up(records, Case(solver, 512, 1e9, 2)), 1.6, False)
    for count in (64, 128, 256, 512):
        elimination, block = (of(Case(solver, count, 1e9), "step_seconds")
                              for solver in ("GAMG", "GAMG block"))
        if elimination and block:
            add(f"mbe step by elimination / by block iteration, {count}^2, sigma0 1e9",
                elimination / block, 1.5)
    for solver, goal in (("fft", 1500), ("GAMG", 4000)):
        add(f"bytes a cell, 1024^2, {solver}", of(Case(solver, 1024, 1e9), "bytes_per_cell"), goal)
    for solver in SOLVERS:
        add(f"power of cells that a step grows with, from 128^2, {solver}",
            exponent(records, solver), 1.1)
    add("seconds from the command to the end of a run of one step, 128^2", start, 2)
    return "\n" + report.markdown_table(["quantity", "measured", "target", "met"], rows)


def _draw(path, records):
    cells = sorted({case.cells for case in records})
    with report.picture(path, 14, 4.6, columns=3) as (figure, axes):
        seconds, shares, memory = axes[0]
        colours = dict(zip(SOLVERS, report.SERIES_COLOURS))
        for solver in SOLVERS:
            for ranks, line in zip(RANKS, ("-", "--")):
                style = dict(color=colours[solver], marker="o", linestyle=line,
                             label=f"{solver}, {ranks} rank{'s' if ranks > 1 else ''}")
                family = [case for case in records if (case.solver, case.ranks, case.sigma0,
                                                       case.scheme) == (solver, ranks, 1e9, "mbe")]
                _line(seconds, records, family, "step_seconds", **style)
                _line(memory, records, family, "peak_memory_bytes", **style)
        ours = [Case("fft", count, 1e9) for count in cells]
        _line(seconds, records, [Case(LITERAL, count, 1e9) for count in cells], "step_seconds",
              label="literal", color=PURPLE, marker="v")
        _line(seconds, records, ours, "fast_solve_seconds", label="one fast solve (floor)",
              color=GREY, marker="x")
        _line(seconds, records, [Case(PLAIN, count, 1e5) for count in cells], "step_seconds",
              label="plain CG+GAMG, sigma0 1e5", color=GREEN, marker="^")
        paper = [count for count in cells if count in cputime.PAPER]
        seconds.plot(paper, [cputime.PAPER[count]["mbe"][0] for count in paper], "k:", marker="s",
                     mfc="none", label="Hu & Lai, 2013")
        seconds.set_title("seconds a step, sigma0 = 1e9")
        memory.set_title("memory of all ranks, GB")
        memory.yaxis.set_major_formatter(lambda value, _: f"{value / 1e9:g}")
        memory.set_ylim(bottom=0)
        seconds.set_yscale("log")
        for axis in (seconds, memory):
            report.cells_axis(axis, cells)
        _draw_shares(shares, records, [case for case in ours if case in records])
        report.legend_below(figure, seconds, 4)


def _line(axis, records, cases, name, **style):
    known = [case for case in cases if records.get(case, {}).get(name)]
    if known:
        axis.plot([case.cells for case in known], [records[case][name] for case in known],
                  **style)


def _draw_shares(axis, records, cases):
    """Stacked bars: the phases of a step in units of one fast solve."""
    groups = {
        "marker model": ("marker model",),
        "CG and transforms": ("momentum solve",),
        "Poisson": ("Poisson solve",),
        "interpolation": ("interpolation assembly", "marker operators", "marker motion"),
    }
    known = [case for case in cases if "step_seconds" in records[case]]
    names = [f"{case.cells}" for case in known]
    bottom = np.zeros(len(known))
    floors = np.array([records[case]["fast_solve_seconds"] for case in known])
    for (label, phases), colour in zip(groups.items(), report.SERIES_COLOURS):
        spent = [sum(records[case][f"{name} seconds"] or 0.0 for name in phases)
                 for case in known]
        axis.bar(names, spent / floors, bottom=bottom, label=label, color=colour)
        bottom += spent / floors
    steps = np.array([records[case]["step_seconds"] for case in known]) / floors
    axis.bar(names, np.maximum(steps - bottom, 0.0), bottom=bottom, label="rest",
             color=GREY)
    axis.set_title("a step in fast solves, fft, 1 rank")
    axis.set_xlabel("cells across")
    axis.legend()


if __name__ == "__main__":
    sys.exit(main())
