"""Option values that follow from others, such as the time step from the grid and the flow."""

import os

import numpy as np

from .errors import InputError
from .fluid.flows import velocity
from .own import Function
from .schemes.registry import SCHEMES
from .vesicles import of


def typical_speed(values):
    """The speed by which the default time step is chosen.

    It is the top speed of the background flow in the box, or that of a vesicle driven by its
    bending if that is more. With L half the shorter side of the box, the latter is
    100 c_b / (mu L^2), as for a vesicle of the half width L / 10, or the smaller
    sqrt(1000 c_b / (rho L^3)) where inertia holds it back. Waves on a line stretched across the
    box run at sqrt(pi sigma / (rho length)), sigma the tension, without viscosity. Where nothing
    moves, it is the speed mu / (rho L) at which momentum spreads.

    Parameters
    ----------
    values : mapping of str to value
        Of the options.

    Returns
    -------
    float
        In the units of the options: a time step in proportion to h over this speed is the same
        in all systems of units. Infinite or not a number if the values are beyond all measure.
    """
    a, b, c, d = values["domain"]
    eighths = np.arange(9) / 8  # where all flows have their top speed, vortices at quarters
    x, y = np.meshgrid(a + (b - a) * eighths, c + (d - c) * eighths)
    rho, mu = np.float64(values["rho"]), np.float64(values["mu"])
    bending = max((of(values, k).bending for k in range(values["vesicles"])), default=0.0)
    size = min(b - a, d - c) / 2
    flow = values["flow"]
    with np.errstate(all="ignore"):
        flow = np.abs(flow.tried(x, y, 0.0) if isinstance(flow, Function) else velocity(
            flow, x, y, values["shear_rate"], values["domain"])).max()
        membrane = min(100 * bending / (mu * size**2), np.sqrt(1000 * bending / (rho * size**3)))
        length = b - a if "x" in values["periodic"] else d - c
        waves = np.sqrt(np.pi * _tension_of_lines(values) / (rho * length))
        return float(max(flow, membrane, waves) or mu / (rho * size))


def _tension_of_lines(values):
    """The largest tension at the start in a line across the box; 0 without any."""
    vesicles = [of(values, k) for k in range(values["vesicles"])]
    return max([0.0, *(one.sigma0 * (1 - one.rest_length) for one in vesicles
                       if one.shape == "line" and one.rest_length is not None)])


def resolve(values, given, cfl):
    """Fill in the values that follow from others, in place.

    Parameters
    ----------
    values : dict
        Option name to typed value: table defaults, then the scene, then the user.
    given : set of str
        Names the user gave; none of these is changed.
    cfl : float
        The scene's time step in units of min(dx, dy) / `typical_speed`.

    Raises
    ------
    InputError
        There is no time step for these values.
    """
    _square_cells(values, given)
    derived = {}
    if values["area_fraction"] is not None and values["arrangement"] != "none":
        _fill_box(values, given)
    if values["ts_dt"] is None:
        derived["ts_dt"] = _time_step(values, cfl)
    if values["startup"] is None:
        derived["startup"] = SCHEMES[values["scheme"]].startup
    for name in ("kink_correction", "conserve_area"):
        if values[name] is None:
            derived[name] = SCHEMES[values["scheme"]].implicit
    if values["output"] is None:
        name = os.path.splitext(os.path.basename(values["scene"]))[0]
        derived["output"] = os.path.join("out", name)
    if values["flow"] == "rest":
        derived["shear_rate"] = 0.0
    if values["marker_file"] is not None or values["shape"] == "line":
        derived["axes"] = None
    if values["vesicles"] == 0:
        derived.update(axes=None, sigma0=0.0, bending=0.0, rest_length=None)
    values.update({name: value for name, value in derived.items() if name not in given})


def _square_cells(values, given):
    """The number of cells in one direction that makes them square, unless both are given."""
    a, b, c, d = values["domain"]
    counted = given & {"stag_grid_x", "stag_grid_y"}
    if values["stag_grid_y"] is None or counted == {"stag_grid_x"}:
        values["stag_grid_y"] = max(1, round(values["stag_grid_x"] * (d - c) / (b - a)))
    elif counted == {"stag_grid_y"}:
        values["stag_grid_x"] = max(1, round(values["stag_grid_y"] * (b - a) / (d - c)))


def _time_step(values, cfl):
    """The scene's multiple of the cell size over the typical speed."""
    a, b, c, d = values["domain"]
    cells, speed = (values["stag_grid_x"], values["stag_grid_y"]), typical_speed(values)
    dt = cfl * min((b - a) / cells[0], (d - c) / cells[1]) / speed if speed > 0 else 0.0
    if not 0 < dt < np.inf:
        raise InputError("-ts_dt: no default follows from a flow, fluid and membrane of such "
                         "values; allowed: number above 0")
    return dt


def _fill_box(values, given):
    """Number of vesicles, or the size of their axes, from the part of the box that they fill."""
    a, b, c, d = values["domain"]
    rx, ry = values["axes"]
    inside = values["area_fraction"] * (b - a) * (d - c) / (np.pi * rx * ry)
    if "vesicles" in given and "axes" not in given:
        size = np.sqrt(inside / max(values["vesicles"], 1))
        values["axes"] = (size * rx, size * ry)
    elif "vesicles" not in given:
        values["vesicles"] = max(1, round(min(inside, 1e6)))
