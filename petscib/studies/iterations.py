"""Linear iterations over grid and stiffness, by each of the iterations of the implicit system.

An ellipse (0.1, 0.5) at rest, dt = h, tolerance 1e-6.  Momentum system (scheme mbe): conjugate
gradients with the membranes' stresses eliminated and one GAMG cycle, FGMRES for fluid and stresses
with one GAMG cycle, conjugate gradients for the stresses with transforms.  Coupled system (scheme
be): FGMRES with the projection method by GAMG, and conjugate gradients with transforms.  Without
the kink correction: conjugate gradients with GAMG on the assembled matrix, as the paper has it.
"""

import sys

from . import report
from .campaign import Campaign

MOST = 2000
COMMON = {
    "scene": "stiff",
    "delta": "yang",
    "ts_max_steps": 2,
    "momentum_ksp_rtol": 1e-6,
    "momentum_ksp_max_it": MOST,
    "coupled_ksp_rtol": 1e-6,
}
SOLVERS = {
    "momentum, GAMG, stresses eliminated": {"scheme": "mbe", "momentum_ksp_type": "cg"},
    "momentum, GAMG, block": {"scheme": "mbe", "momentum_ksp_type": "fgmres"},
    "momentum, transforms": {"scheme": "mbe", "fft": True},
    "coupled, GAMG": {"scheme": "be"},
    "coupled, transforms": {"scheme": "be", "fft": True},
    "uncorrected, GAMG on the assembled matrix": {
        "scheme": "mbe", "kink_correction": False, "conserve_area": False,
        "momentum_pc_type": "gamg"},
}


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("iterations", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, (64, 128), (1e5, 1e9))
    else:
        study(campaign, (64, 128, 256), (1e5, 1e7, 1e9, 1e13))
    return campaign.exit_status


def study(campaign, cells, stiffnesses, solvers=tuple(SOLVERS)):
    """Make the runs and the results; returns the rows of the CSV."""
    declared = {
        (solver, count, sigma0): dict(
            COMMON, stag_grid_x=count, ts_dt=2 / count, sigma0=sigma0, **SOLVERS[solver]
        )
        for solver in solvers for count in cells for sigma0 in stiffnesses
    }
    outcomes = campaign.run_all(declared)
    rows = [(*label, most_iterations(outcome)) for label, outcome in outcomes.items()]
    header = ["solver", "cells", *(f"sigma0 = {report.number(one, 1)}" for one in stiffnesses)]
    table = [
        [solver, f"{count}^2"]
        + [_text(outcomes[solver, count, sigma0]) for sigma0 in stiffnesses]
        for solver in solvers for count in cells
    ]
    campaign.write(
        ("solver", "cells", "sigma0", "iterations"),
        rows,
        "Largest number of iterations to 1e-6 in the first two steps (dt = h, ellipse "
        "(0.1, 0.5)).\n\n" + report.markdown_table(header, table),
    )
    return rows


def most_iterations(outcome):
    """Most iterations of a step; None when a solve failed."""
    name = "momentum" if outcome.run.options["scheme"] == "mbe" else "coupled"
    return int(outcome.largest(f"{name}_iterations")) if outcome.finished else None


def _text(outcome):
    if "DIVERGED_MAX_IT" in outcome.reason:
        return f"none in {MOST}"
    return str(most_iterations(outcome)) if outcome.finished else outcome.status


if __name__ == "__main__":
    sys.exit(main())
