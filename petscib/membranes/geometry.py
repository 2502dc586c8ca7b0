"""What the shapes of membranes measure.

Every function takes the markers of some curves and measures each of them, shape (V,); without
`curves` the markers are one closed polygon, and the result is a number.  Areas and what follows
from them mean nothing for curves that enclose none, which get NaN.  NumPy only, not collective.
"""

import numpy as np


def length(vectors):
    """Euclidean length of each row of an (M, 2) array."""
    return np.hypot(vectors[:, 0], vectors[:, 1])


def signed_area(markers, curves=None):
    """Area enclosed by the polygon, positive when it runs counter-clockwise."""
    local, ahead, cross = _products(markers, curves)
    return _closed(_sum(cross, curves) / 2, curves)


def area(markers, curves=None):
    """Area enclosed by the polygon."""
    return abs(signed_area(markers, curves))


def perimeter(markers, curves=None):
    """Length of the polygon; of an open curve, from end to end."""
    if curves is None:
        return length(_ahead(markers, None) - markers).sum()
    return curves.edge_sums(length(curves.edge_vectors(markers)))


def mean(markers, curves=None):
    """Mean of the markers, shape (2,) or (V, 2)."""
    count = len(markers) if curves is None else np.diff(curves.starts)[:, None]
    return _sum(markers, curves) / count


def centroid(markers, curves=None):
    """Centroid of the enclosed area, shape (2,) or (V, 2); the mean marker where there is none."""
    origin = mean(markers, curves)
    local, ahead, cross = _products(markers, curves)
    with np.errstate(invalid="ignore", divide="ignore"):
        offset = _sum((local + ahead) * cross[:, None], curves) / (
            3 * np.asarray(_sum(cross, curves))[..., None])
    if curves is not None:
        offset = np.where(curves.encloses[:, None], offset, 0.0)
    return origin + offset


def second_moments(markers, curves=None):
    """Central second moments (xx, yy, xy) of the enclosed area."""
    local, ahead, cross = _products(markers, curves, centroid(markers, curves))
    x, y = local.T
    x1, y1 = ahead.T
    sign = np.sign(_sum(cross, curves))
    xx = sign * _sum(cross * (x * x + x * x1 + x1 * x1), curves) / 12
    yy = sign * _sum(cross * (y * y + y * y1 + y1 * y1), curves) / 12
    xy = sign * _sum(cross * (x * y1 + 2 * x * y + 2 * x1 * y1 + x1 * y), curves) / 24
    return xx, yy, xy


def inclination(markers, curves=None):
    """Angle of the long axis of the enclosed area to the x-axis, in (-pi/2, pi/2]."""
    xx, yy, xy = second_moments(markers, curves)
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return _closed(np.where(angle <= -np.pi / 2, np.pi / 2, angle)[()], curves)


def treading_frequency(markers, velocity, curves=None):
    """Tank-treading frequency 2 pi / (integral of dl / u_tau) (Hu & Lai, section 4.3).

    The tangential velocity is taken along the mean edge direction at the markers, counted
    positive in the direction of most of the motion; NaN where it changes sign or vanishes.
    """
    ahead = _ahead(markers, curves) - markers
    behind = markers - _behind(markers, curves)
    chord = ahead + behind
    tangential = np.einsum("ki,ki->k", velocity, chord) / length(chord)
    sign = np.sign(_sum(tangential, curves))
    tangential = tangential * _spread(np.where(sign == 0, 1.0, sign), curves)
    weights = (length(ahead) + length(behind)) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        frequency = 2 * np.pi / _sum(weights / tangential, curves)
    treads = _sum((tangential <= 0).astype(int), curves) == 0
    return _closed(np.where(treads, frequency, np.nan)[()], curves)


def _ahead(markers, curves):
    if curves is None:
        return np.roll(markers, -1, axis=0)
    return markers[curves.after] + curves.ahead


def _behind(markers, curves):
    if curves is None:
        return np.roll(markers, 1, axis=0)
    return markers[curves.before] + curves.behind


def _sum(values, curves):
    return values.sum(axis=0) if curves is None else curves.sums(values)


def _spread(values, curves):
    return values if curves is None else curves.spread(values)


def _closed(values, curves):
    return values if curves is None else np.where(curves.encloses, values, np.nan)


def _products(markers, curves, origin=None):
    """Markers from an origin (by default, their mean), those after them, and cross products."""
    # A near origin keeps the products small far from that of the coordinates.
    origin = _spread(mean(markers, curves) if origin is None else origin, curves)
    local, ahead = markers - origin, _ahead(markers, curves) - origin
    return local, ahead, local[:, 0] * ahead[:, 1] - ahead[:, 0] * local[:, 1]
