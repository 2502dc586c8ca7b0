"""Cost of a step over the number of vesicles: on one grid, and in a box that grows with them.

Ellipses (0.05, 0.08) in rows between walls that shear them, dt = h, by transforms, on one and on
two ranks.  On one grid, what is solved along the membranes grows with their number, the grid's part
does not; in the growing box (weak scaling) both grow alike, and iterations should not.
"""

import sys

from ..schemes.registry import SCHEMES
from . import report, runs
from .campaign import Campaign
from .records import select

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
    """Make the runs and the results; returns the records.

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
    records = []
    for scheme in schemes:
        for count in ranks:
            usual = [_record(campaign, scheme, count, cells, 1, number) for number in numbers]
            first = usual[0].get("step_seconds")
            for one in usual:
                if first and "step_seconds" in one:
                    one["over_one"] = one["step_seconds"] / first
            records += usual
            records += [_record(campaign, scheme, count, cells // 2 * box, box, GROWN * box**2)
                        for box in boxes]
    campaign.write_records(COLUMNS, records, _markdown(records))
    known = [one for one in records if "step_seconds" in one]
    if known:
        shown = select(known, cells=cells, box=1, ranks=ranks[0])
        _draw(campaign.path("vesicles.png"), shown, schemes, cells)
    return records


def _record(campaign, scheme, ranks, cells, box, number):
    """The record of a run, but for its cost relative to one vesicle's."""
    options = dict(COMMON, scheme=scheme, stag_grid_x=cells, ts_dt=2 * box / cells,
                   domain=(-box, box, -box, box), vesicles=number)
    outcome = campaign.make(runs.Run(options, ranks), f"{scheme} {number} in {box} on {ranks}")
    kind = "coupled" if SCHEMES[scheme].coupled else "momentum"
    record = dict(scheme=scheme, ranks=ranks, cells=cells, box=box, vesicles=number,
                  iterations=outcome.last(f"{kind}_iterations"),
                  tangent_passes=outcome.last("picard_iterations"), min_gap=outcome.last("min_gap"))
    if outcome.finished:
        record.update(markers=number * len(outcome.final()["X"]),
                      step_seconds=outcome.step_seconds)
    return record


def _markdown(records):
    header = ["scheme", "ranks", "cells", "box", "vesicles", "markers", "s per step",
              "over one vesicle", "iterations", "tangent passes"]
    table = [[one["scheme"], *(report.number(one.get(name)) for name in COLUMNS[1:10])]
             for one in records]
    return ("Mean step, iterations of the last step; box: size relative to the usual one. Only "
            "ratios within one call of the study mean something.\n\n"
            + report.markdown_table(header, table))


def _draw(path, records, schemes, cells):
    with report.picture(path, 9.0, 3.6, columns=2) as (_, axes):
        for axis, name, label in ((axes[0, 0], "step_seconds", "seconds per step"),
                                  (axes[0, 1], "iterations", "iterations")):
            for scheme in schemes:
                among = select(records, scheme=scheme)
                axis.plot([one["vesicles"] for one in among], [one[name] for one in among],
                          label=scheme, **SCHEMES[scheme].style)
            axis.set_xscale("log", base=2)
            axis.set(xlabel="vesicles", ylabel=label, ylim=(0, None))
            axis.set_title(f"${cells}^2$ cells")
            axis.legend()


if __name__ == "__main__":
    sys.exit(main())
