"""Cost of a step over the number of vesicles, on one grid.

Ellipses (0.05, 0.08) in rows between walls that shear them, dt = h, by transforms: what is solved
along the membranes grows with their number, the grid's part does not.
"""

import sys

from ..schemes.registry import SCHEMES
from . import report
from .campaign import Campaign

CHOSEN = "mbe", "gcn"
COMMON = dict(scene="tanktreading", axes=(0.05, 0.08), arrangement="lattice", periodic="x",
              fft=True, ts_max_steps=8)
COLUMNS = ("scheme", "vesicles", "markers", "step_seconds", "over_one", "iterations",
           "tangent_passes", "min_gap")


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("vesicles", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, 128, (1, 8, 16))
    else:
        study(campaign, 256, (1, 2, 4, 8, 16, 32, 64))
    return campaign.exit_status


def study(campaign, cells, numbers, schemes=CHOSEN):
    """Make the runs and the results; returns the rows of the CSV."""
    outcomes = campaign.run_all({
        (scheme, number): dict(COMMON, scheme=scheme, stag_grid_x=cells, ts_dt=2 / cells,
                               vesicles=number)
        for scheme in schemes for number in numbers
    })
    rows = []
    for (scheme, number), outcome in outcomes.items():
        alone = outcomes[scheme, numbers[0]].step_seconds
        seconds = outcome.step_seconds if outcome.finished else None
        kind = "coupled" if SCHEMES[scheme].coupled else "momentum"
        rows.append((
            scheme, number, number * len(outcome.final()["X"]) if outcome.finished else None,
            seconds, seconds / alone if seconds and alone else None,
            outcome.last(f"{kind}_iterations"), outcome.last("picard_iterations"),
            outcome.last("min_gap"),
        ))
    campaign.write(COLUMNS, rows, _markdown(rows, cells))
    if any(row[3] for row in rows):
        _draw(campaign.path("vesicles.png"), rows, schemes, cells)
    return rows


def _markdown(rows, cells):
    header = ["scheme", "vesicles", "markers", "s per step", "over one vesicle", "iterations",
              "tangent passes"]
    table = [[row[0], *(report.number(value) for value in row[1:7])] for row in rows]
    return (f"Mean step on {cells}^2 cells, iterations of the last step. Only ratios within one "
            "call of the study mean something.\n\n" + report.markdown_table(header, table))


def _draw(path, rows, schemes, cells):
    with report.picture(path, 9.0, 3.6, columns=2) as (_, axes):
        for axis, column, label in zip(axes.flat, (3, 5), ("seconds per step", "iterations")):
            for scheme in schemes:
                known = [row for row in rows if row[0] == scheme and row[column]]
                axis.plot([row[1] for row in known], [row[column] for row in known],
                          label=scheme, **SCHEMES[scheme].style)
            axis.set_xscale("log", base=2)
            axis.set(xlabel="vesicles", ylabel=label, ylim=(0, None))
            axis.set_title(f"${cells}^2$ cells")
            axis.legend()


if __name__ == "__main__":
    sys.exit(main())
