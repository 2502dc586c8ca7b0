"""A cylinder held in a stream: drag, lift and Strouhal number over grid, time step and box.

Diameter, speed and half the density are 1, so that drag and lift are the coefficients.  At a
Reynolds number of 40 the wake is steady; at 100 it sheds vortices, which a cylinder a little off
the middle begins sooner.  Published at 40: a drag of 1.52 (Dennis & Chang, J. Fluid Mech. 42, 1970)
to 1.54; at 100: a drag of 1.35 with a swing of 0.012, a lift that swings by 0.339 and a Strouhal
number of 0.1644 (Liu, Zheng & Sung, J. Comput. Phys. 139, 1998), 0.164 by experiment (Williamson,
J. Fluid Mech. 206, 1989).
"""

import sys

import numpy as np

from . import report
from .campaign import Campaign

COLUMNS = ("reynolds", "box", "cells", "dt", "drag", "drag_swing", "lift", "lift_swing", "strouhal",
           "steps", "seconds")
# By name: columns and rows of the box in diameters, and where its lower left corner is.
BOXES = {"12 x 8": (12, 8, -4), "24 x 16": (24, 16, -8), "40 x 32": (40, 32, -16)}
STEADY, SHEDDING = 40, 100
END = {STEADY: 24.0, SHEDDING: 150.0}
WINDOW = 30.0  # of shedding, some five periods, at the end
OFF_CENTRE = 0.17  # diameters
# Reynolds number, box, cells and time steps in a diameter.
CASES = tuple((STEADY, box, 8, 10) for box in BOXES) + (
    (SHEDDING, "24 x 16", 8, 20), (SHEDDING, "24 x 16", 8, 40), (SHEDDING, "24 x 16", 12, 40),
    (SHEDDING, "24 x 16", 16, 40), (SHEDDING, "40 x 32", 8, 40))


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("cylinder", __doc__.splitlines()[0], arguments)
    study(campaign, CASES[:1] if campaign.quick else CASES)
    return campaign.exit_status


def study(campaign, cases, end=END):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    cases : sequence of (int, str, int, int)
        As in CASES.
    end : mapping of int to float
        Time at which runs end, by Reynolds number.
    """
    records, outcomes = [], []
    for number, (reynolds, box, cells, steps) in enumerate(cases, 1):
        across, high, left = BOXES[box]
        title = f"Re {reynolds}, {box}, {cells} cells, dt 1/{steps}"
        outcome = campaign.run(title, dict(
            scene="cylinder", fft=True, mu=2 / reynolds, stag_grid_x=across * cells,
            domain=(float(left), float(left + across), -high / 2, high / 2),
            shear_rate=1 / high, markers=round(np.pi * cells), ts_dt=1 / steps,
            center=(0.0, 0.0 if reynolds == STEADY else OFF_CENTRE), ts_max_time=end[reynolds]),
            progress=f"{number}/{len(cases)}")
        record = dict(reynolds=reynolds, box=box, cells=cells, dt=1 / steps, steps=outcome.steps,
                      seconds=outcome.seconds)
        if outcome.finished:
            record.update(measure(outcome, WINDOW if reynolds == SHEDDING else 0.0))
            outcomes.append((title, outcome))
        records.append(record)
    campaign.write_records(COLUMNS, records, _markdown(records))
    _draw(campaign.path("cylinder.png"), outcomes)
    return records


def measure(outcome, window):
    """Drag, lift and Strouhal number over the last `window` of a run, a mapping by column.

    With a window of zero, drag and lift of the last step.
    """
    time, drag, lift = (outcome.rows[name] for name in ("time", "drag", "lift"))
    late = (time >= time[-1] - window) & np.isfinite(drag)  # there is none before the first step
    time, drag, lift = time[late], drag[late], lift[late]
    found = dict(drag=drag.mean(), lift=lift.mean())
    if window:
        found.update(drag_swing=np.ptp(drag) / 2, lift_swing=np.ptp(lift) / 2,
                     strouhal=frequency(time, lift))
    return {name: float(value) for name, value in found.items()}


def frequency(time, values):
    """Of the values about their mean, by the times at which they rise through it; nan without."""
    values = values - values.mean()
    k = np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0))
    if len(k) < 2:
        return np.nan
    rises = time[k] - values[k] * (time[k + 1] - time[k]) / (values[k + 1] - values[k])
    return (len(k) - 1) / (rises[-1] - rises[0])


def _markdown(records):
    header = ["Re", "box, diameters", "cells across it", "dt", "drag", "its swing", "lift",
              "its swing", "Strouhal number"]
    table = [[report.number(one["reynolds"]), one["box"], *(
        report.number(one.get(name), 4) for name in COLUMNS[2:9])] for one in records]
    return ("Of the last step, or means over the last shedding, with half of what they swing\n\n"
            + report.markdown_table(header, table))


def _draw(path, outcomes):
    with report.picture(path, 9.0, 3.6, columns=2) as (figure, axes):
        for axis, name, limits in zip(axes.flat, ("drag", "lift"), ((1.0, 2.2), None)):
            for k, (label, outcome) in enumerate(outcomes):
                axis.plot(outcome.rows["time"], outcome.rows[name], linewidth=0.8, label=label,
                          color=report.SERIES_COLOURS[k % len(report.SERIES_COLOURS)],
                          linestyle="-" if k < len(report.SERIES_COLOURS) else "--")
            axis.set(xlabel="t", ylabel=name, ylim=limits)
        report.legend_below(figure, axis, 2)


if __name__ == "__main__":
    sys.exit(main())
