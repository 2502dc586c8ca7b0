"""Warnings of time steps that are stable, but too long to be accurate.

Measured on the main job to t = 10: with shear_rate dt = 0.1 the treading frequency of cn, be and
mbe is 11, 18 and 22 percent off the truth, with 0.03 it is 3 to 6; that of gcn 0.4 percent with
0.25, 0.5 with 0.5.  A vesicle that Poiseuille flow carries by 0.2 of its radius in a step is a
tenth of it late after eight steps of mbe, a thousandth with gcn.
"""

import numpy as np

from .fluid import flows
from .membranes import geometry
from .schemes.registry import SCHEMES

# By the scheme's order in time: radians or strain a step, and moves a step over the radius of a
# circle of the vesicle's area.
LARGEST_TURN = {1: 0.1, 2: 0.5}
LARGEST_MOVE = {1: 0.25, 2: 1.0}


def _order(settings):
    return SCHEMES[settings.scheme].order


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
    if not len(markers) or settings.tether > 0:  # what is held is not carried
        return ""
    dt, (x, y) = settings.ts_dt, markers.T
    flow = settings.flow, x, y, settings.shear_rate, settings.domain
    rate = flows.rate(*flow)
    most = LARGEST_TURN[_order(settings)]
    if rate * dt > most:
        return _warning(
            f"the flow turns and strains a vesicle by {rate * dt:.2g} (shear_rate ts_dt)",
            most, most / rate)
    speed = np.hypot(*flows.velocity(*flow))
    return _of_move(settings, speed * dt, markers, dt, curves)


def of_step(settings, start, end, dt, curves=None):
    """How far a step has moved a vesicle, if it is too far: a warning, or an empty text.

    Parameters
    ----------
    settings : Settings
    start, end : ndarray, shape (M, 2)
        Markers before and after it.
    dt : float
    curves : Curves, optional
        By default the markers are one vesicle.
    """
    if not len(start):
        return ""
    return _of_move(settings, geometry.length(end - start), start, dt, curves)


def _of_move(settings, distance, markers, dt, curves):
    size = np.sqrt(geometry.area(markers, curves) / np.pi)
    if curves is not None:  # the length of what encloses no area is taken for that of a circle
        circle = geometry.perimeter(markers, curves) / (2 * np.pi)
        size = curves.spread(np.where(np.isnan(size), circle, size))
    part = (distance / size).max()
    most = LARGEST_MOVE[_order(settings)]
    if not part > most:
        return ""
    return _warning(f"a vesicle moves by {part:.2g} of its radius", most, dt * most / part)


def _warning(what, most, dt):
    return (f"in one time step {what}; above {most:g} errors of some percent are likely, and "
            f"-ts_dt {dt:.2g} is advised")
