"""Cost of a step over the number of vesicles: on one grid, and in a box that grows with them.

Ellipses (0.05, 0.08) in rows between walls that shear them, dt = h, by transforms, on one and on
two ranks.  On one grid, what is solved along the membranes grows with their number, the grid's part
does not; in the growing box (weak scaling) both grow alike, and iterations should not.
"""

import sys

from ..schemes.registry import SCHEMES
from . import report, runs
from .campaign import Campaign

CHOSEN = "mbe", "gcn"
RANKS = 1, 2
COMMON = dict(scene="tanktreading", axes=(0.05, 0.08), arrangement="lattice", periodic="x",
              fft=True, ts_max_steps=8)
GROWN = 16  # vesicles in the growing box while it is of the usual size
COLUMNS = ("scheme", "ranks", "cells", "box", "vesicles", "markers", "step_seconds", "over_one",
           "iterations", "tangent_passes", "min_gap")


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("vesicles", __doc__.splitlines()[0], arguments)
    if campaign.quick:
        study(campaign, 128, (1, 8, 16), (1, 2))
    else:
        study(campaign, 256, (1, 2, 4, 8, 16, 32, 64), (1, 2, 3))
    return campaign.exit_status


def study(campaign, cells, numbers, boxes, schemes=CHOSEN, ranks=RANKS):
    """Make the runs and the results; returns the rows of the CSV.

    Parameters
    ----------
    campaign : Campaign
    cells : int
        Across the usual box, (-1, 1) each way.
    numbers : tuple of int
        Of vesicles in it.
    boxes : tuple of int
        Sizes of the growing box, of the usual one.
    schemes : tuple of str
    ranks : tuple of int
    """
    rows = []
    for scheme in schemes:
        for count in ranks:
            usual = [_row(campaign, scheme, count, cells, 1, number) for number in numbers]
            for row in usual:
                row[7] = row[6] / usual[0][6] if row[6] and usual[0][6] else None
            rows += usual
            rows += [_row(campaign, scheme, count, cells // 2 * box, box, GROWN * box**2)
                     for box in boxes]
    campaign.write(COLUMNS, rows, _markdown(rows))
    if any(row[6] for row in rows):
        _draw(campaign.path("vesicles.png"), [row for row in rows if row[2] == cells], schemes,
              cells)
    return rows


def _row(campaign, scheme, ranks, cells, box, number):
    """A row of the table, the cost relative to one vesicle's left open."""
    options = dict(COMMON, scheme=scheme, stag_grid_x=cells, ts_dt=2 * box / cells,
                   domain=(-box, box, -box, box), vesicles=number)
    outcome = campaign.make(runs.Run(options, ranks), f"{scheme} {number} in {box} on {ranks}")
    kind = "coupled" if SCHEMES[scheme].coupled else "momentum"
    done = outcome.finished
    return [scheme, ranks, cells, box, number, number * len(outcome.final()["X"]) if done else None,
            outcome.step_seconds if done else None, None, outcome.last(f"{kind}_iterations"),
            outcome.last("picard_iterations"), outcome.last("min_gap")]


def _markdown(rows):
    header = ["scheme", "ranks", "cells", "box", "vesicles", "markers", "s per step",
              "over one vesicle", "iterations", "tangent passes"]
    table = [[row[0], *(report.number(value) for value in row[1:10])] for row in rows]
    return ("Mean step, iterations of the last step; box: size relative to the usual one. Only "
            "ratios within one call of the study mean something.\n\n"
            + report.markdown_table(header, table))


def _draw(path, rows, schemes, cells):
    with report.picture(path, 9.0, 3.6, columns=2) as (_, axes):
        for axis, column, label in zip(axes.flat, (6, 8), ("seconds per step", "iterations")):
            for scheme in schemes:
                known = [row for row in rows if row[:2] == [scheme, rows[0][1]] and row[column]]
                axis.plot([row[4] for row in known], [row[column] for row in known],
                          label=scheme, **SCHEMES[scheme].style)
            axis.set_xscale("log", base=2)
            axis.set(xlabel="vesicles", ylabel=label, ylim=(0, None))
            axis.set_title(f"${cells}^2$ cells")
            axis.legend()


if __name__ == "__main__":
    sys.exit(main())
