"""Differences between a solution and a finer one, as in section 4.1 of Hu & Lai.

Markers correspond by the fraction of the perimeter at which they started; the finer velocity is
interpolated linearly to the coarser staggered points.
"""

import numpy as np


def marker_error(markers, reference):
    """Largest distance between markers and the reference's curve at the same parameter.

    Parameters
    ----------
    markers, reference : ndarray, shapes (M, 2) and (N, 2)
        Both started equally spaced in arclength, marker 0 at the same place.
    """
    from scipy.interpolate import CubicSpline

    closed = np.concatenate((reference, reference[:1]))
    curve = CubicSpline(np.linspace(0, 1, len(closed)), closed, bc_type="periodic")
    there = curve(np.arange(len(markers)) / len(markers))
    return float(np.hypot(*(markers - there).T).max())


def face_points(shape, component, domain):
    """Coordinates y (rows) and x (columns) of the faces of one velocity component.

    Parameters
    ----------
    shape : (int, int)
        Of u, (n, m + 1), or of v, (n + 1, m).
    component : {"u", "v"}
    domain : (float, float, float, float)
    """
    a, b, c, d = domain
    rows, columns = shape
    if component == "u":
        return c + (np.arange(rows) + 0.5) * (d - c) / rows, np.linspace(a, b, columns)
    return np.linspace(c, d, rows), a + (np.arange(columns) + 0.5) * (b - a) / columns


def velocity_error(values, reference, component, domain=(-1.0, 1.0, -1.0, 1.0)):
    """Largest difference of one velocity component from a reference on a grid at least as fine."""
    from scipy.interpolate import RegularGridInterpolator

    interpolate = RegularGridInterpolator(
        face_points(reference.shape, component, domain), reference)
    there = np.meshgrid(*face_points(values.shape, component, domain), indexing="ij")
    return float(np.abs(values - interpolate(tuple(there))).max())


def errors(outcome, reference):
    """Errors of a finished run at its end.

    Parameters
    ----------
    outcome, reference : runs.Outcome
        On the default box.

    Returns
    -------
    dict
        Relative errors `area` and `perimeter`, largest errors `X`, `u`, `v`.
    """
    ours, theirs = outcome.final(), reference.final()
    return {
        "area": outcome.last("area_error"),
        "perimeter": outcome.last("perimeter_error"),
        "X": marker_error(ours["X"], theirs["X"]),
        "u": velocity_error(ours["u"], theirs["u"], "u"),
        "v": velocity_error(ours["v"], theirs["v"], "v"),
    }
