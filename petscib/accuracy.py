"""Warnings of time steps that are stable, but too long to be accurate.

Measured on 48 cells across, main job to t = 2: with shear_rate dt = 0.1, mbe has lost 5 percent of
the area, with 0.3 it is 14; gcn 0.3 and 3.  A vesicle that Poiseuille flow carries by 0.2 of its
radius in a step is a tenth of it late after eight steps of mbe.
"""

import numpy as np

from .fluid.flows import FLOWS
from .membranes import geometry

LARGEST_TURN = 0.1  # radians, or strain
LARGEST_MOVE = 0.25  # of the radius of a circle of the vesicle's area


def of_flow(settings, markers, curves=None):
    """What the background flow does to a vesicle in one time step, if it is too much.

    Parameters
    ----------
    settings : Settings
    markers : ndarray, shape (M, 2)
        At the start; without any there is nothing to be carried.
    curves : Curves, optional
        By default the markers are one vesicle.

    Returns
    -------
    str
        A warning, or an empty text.
    """
    if not len(markers):
        return ""
    dt, rate = settings.ts_dt, abs(settings.shear_rate)
    if rate * dt > LARGEST_TURN:
        return _warning(
            f"the flow turns and strains a vesicle by {rate * dt:.2g} (shear_rate ts_dt)",
            LARGEST_TURN, LARGEST_TURN / rate)
    x, y = markers.T
    speed = np.hypot(*FLOWS[settings.flow](x, y, settings.shear_rate, settings.domain))
    return _of_move(speed * dt, markers, dt, curves)


def of_step(start, end, dt, curves=None):
    """How far a step has moved a vesicle, if it is too far: a warning, or an empty text.

    Parameters
    ----------
    start, end : ndarray, shape (M, 2)
        Markers before and after it.
    dt : float
    curves : Curves, optional
        By default the markers are one vesicle.
    """
    if not len(start):
        return ""
    return _of_move(geometry.length(end - start), start, dt, curves)


def _of_move(distance, markers, dt, curves):
    size = np.sqrt(geometry.area(markers, curves) / np.pi)
    if curves is not None:  # the length of what encloses no area is taken for that of a circle
        circle = geometry.perimeter(markers, curves) / (2 * np.pi)
        size = curves.spread(np.where(np.isnan(size), circle, size))
    part = (distance / size).max()
    if not part > LARGEST_MOVE:
        return ""
    return _warning(f"a vesicle moves by {part:.2g} of its radius", LARGEST_MOVE,
                    dt * LARGEST_MOVE / part)


def _warning(what, most, dt):
    return (f"in one time step {what}; above {most:g} errors of some percent are likely, and "
            f"-ts_dt {dt:.2g} is advised")
