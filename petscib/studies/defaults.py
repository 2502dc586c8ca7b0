"""Every scene as it runs by default, against the scheme gcn on twice the grid.

Shapes are compared at the end with centroids laid upon each other, places as they are: the largest
distance of a marker from the finer curve, wherever along it, relative to the radius of the circle
of the vesicle's perimeter.  Area and perimeter are compared with their first values, at every step;
the perimeter of a membrane that has a rest length is free to change.  Velocities, of scenes without
a vesicle, are compared by the root of their mean square.  The finer run takes half the time step,
and vesicles where the scene's arrangement, which depends on the grid, has put them.  Both take
-fft, which changes solvers and no answers.
"""

import os
import sys

import numpy as np
from scipy.interpolate import CubicSpline

from .. import options
from ..membranes.geometry import perimeter
from ..output import tables
from ..scenes import SCENES
from . import report
from .campaign import Campaign

ALLOWED = 0.01
REFINEMENT = 8  # of the finer curve between its markers
QUANTITIES = "shape", "place", "area", "perimeter", "velocity"
COLUMNS = ("scene", "status", "reason", "scheme", "cells", "dt", "steps", "seconds", *QUANTITIES,
           "right")
QUICK = "relaxation", "elastic", "driven", "taylor-green"


def main(arguments=None):
    """Run the study; returns the exit status."""
    campaign = Campaign.from_command_line("defaults", __doc__.splitlines()[0], arguments)
    study(campaign, QUICK if campaign.quick else tuple(SCENES), 3600)
    return campaign.exit_status


def study(campaign, scenes, time_limit, **changed):
    """Make the runs and the results; returns the records.

    Parameters
    ----------
    campaign : Campaign
    scenes : sequence of str
    time_limit : float
        Seconds a run.
    **changed
        Options that differ from the scenes'.
    """
    records = []
    for number, name in enumerate(scenes, 1):
        progress, declared = f"{number}/{len(scenes)}", dict(changed, scene=name, fft=True)
        settings = settings_of(declared, campaign.output)
        ours = campaign.run(name, declared, time_limit, progress)
        finer = declare_finer(declared, settings)
        if settings.arrangement != "none" and ours.finished:
            finer.update(places(ours, settings))
        finer = campaign.run(f"{name}, finer", finer, time_limit, progress)
        records.append(_record(name, settings, ours, finer))
    campaign.write_records(COLUMNS, records, _markdown(records))
    return records


def settings_of(declared, output):
    """The settings that a run takes with these options."""
    from ..settings import text_of

    texts = {name: text_of(value) for name, value in declared.items()}
    return options.read({**texts, "output": os.path.join(output, "runs")})


def declare_finer(declared, settings):
    """Options of the run to compare with."""
    finer = dict(declared, scheme="gcn", stag_grid_x=2 * settings.stag_grid_x,
                 stag_grid_y=2 * settings.stag_grid_y, ts_dt=settings.ts_dt / 2)
    if settings.vesicles:
        finer["delta"] = "bspline43"
    if settings.markers:
        finer["markers"] = 2 * settings.markers
    if settings.contact:
        finer["contact_range"] = 2 * settings.contact_range  # which is told in cells
    return finer


def places(outcome, settings):
    """Options that put ellipses where a run has had them at its start."""
    found = {"arrangement": "none"}
    for step, _, k, markers in tables.read_outlines(os.path.join(outcome.folder, "outlines.csv")):
        if step > 0:
            break
        center = markers.mean(axis=0)
        long_axis = np.linalg.svd(markers - center)[2][0]
        rx, ry = settings.each_vesicle()[k].axes
        upright = 90.0 if ry > rx else 0.0
        found[f"vesicle_{k}_center"] = tuple(map(float, center))
        found[f"vesicle_{k}_angle"] = float(np.degrees(np.arctan2(*long_axis[::-1])) - upright)
    return found


def _record(name, settings, ours, finer):
    record = dict(scene=name, status=ours.status, reason=ours.reason, scheme=settings.scheme,
                  cells=f"{settings.stag_grid_x} x {settings.stag_grid_y}", dt=settings.ts_dt,
                  steps=ours.steps)
    if not ours.finished:
        return record
    record["seconds"] = ours.cpu_seconds
    for quantity in ("area", "perimeter"):
        if quantity == "area" or settings.rest_length is None:
            found = [ours.largest(column) for column in ours.rows
                     if column.startswith(f"{quantity}_error")]
            record[quantity] = max((one for one in found if one is not None), default=None)
    if finer.finished:
        if settings.vesicles:
            record.update(_curve_errors(ours.curves(), finer.curves(), settings.shape == "line"))
        else:
            record["velocity"] = velocity_error(ours.final(), finer.final())
    else:
        record["reason"] = f"finer: {finer.status}"
    errors = [record[one] for one in QUANTITIES if record.get(one) is not None]
    if errors:
        record["right"] = int(max(errors) <= ALLOWED)
    return record


def _curve_errors(ours, finer, is_open):
    """The largest of all vesicles."""
    found = {"shape": 0.0, "place": 0.0}
    for coarse, fine in zip(ours, finer):
        size = perimeter(coarse) / (2 * np.pi)
        shift = fine.mean(axis=0) - coarse.mean(axis=0)
        for name, moved in (("place", coarse), ("shape", coarse + shift)):
            found[name] = max(found[name], curve_error(moved, fine, is_open) / size)
    return found


def curve_error(points, curve, is_open=False):
    """Largest distance of a point from a smooth curve through markers.

    Parameters
    ----------
    points, curve : ndarray, shapes (M, 2) and (N, 2)
    is_open : bool
        Whether the curve ends at its last marker.
    """
    if not is_open:
        curve = np.concatenate((curve, curve[:1]))
    places = np.arange(len(curve))
    spline = CubicSpline(places, curve, bc_type="not-a-knot" if is_open else "periodic")
    fine = spline(np.linspace(0, places[-1], REFINEMENT * places[-1] + 1))
    start, edge = fine[:-1], np.diff(fine, axis=0)
    to_point = points[:, None] - start
    along = np.clip((to_point * edge).sum(-1) / (edge**2).sum(-1), 0.0, 1.0)
    return float(np.hypot(*(to_point - along[..., None] * edge).T).min(axis=0).max())


def velocity_error(ours, finer):
    """Root of the mean square of the difference from a velocity on twice the grid, over its own."""
    u, v = finer["u"], finer["v"]
    means = (u[::2, ::2] + u[1::2, ::2]) / 2, (v[::2, ::2] + v[::2, 1::2]) / 2
    missed = sum(((ours[name] - mean) ** 2).mean() for name, mean in zip("uv", means))
    return float(np.sqrt(missed / sum((mean**2).mean() for mean in means)))


def _markdown(records):
    text = (f"Every scene by default against gcn on twice the grid with half the time step: right "
            f"when each error is within {ALLOWED:.0%}.\n")
    rows = []
    for one in records:
        verdict = "-" if "right" not in one else "yes" if one["right"] else "no"
        rows.append([one["scene"], one["scheme"], one["cells"], report.number(one["dt"]),
                     str(one["steps"]), report.number(one.get("seconds"), 2),
                     *(report.number(one.get(name), 2) for name in QUANTITIES), verdict,
                     one["reason"]])
    return text + "\n" + report.markdown_table(
        ["scene", "scheme", "cells", "dt", "steps", "processor seconds", *QUANTITIES, "right",
         "remark"], rows)


if __name__ == "__main__":
    sys.exit(main())
