"""Differences along a closed curve of markers, and what its shape measures.

Markers k = 0 .. M - 1 are cyclic.  Entry k of a half-point array stands at k - 1/2.  All
functions are NumPy only, not collective, and accept M = 0 (a rank without markers).
"""

import numpy as np


def length(vectors):
    """Euclidean length of each row of an (M, 2) array."""
    return np.hypot(vectors[:, 0], vectors[:, 1])


def _edge_products(markers):
    ahead = np.roll(markers, -1, axis=0)
    cross = markers[:, 0] * ahead[:, 1] - ahead[:, 0] * markers[:, 1]
    return ahead, cross


def area(markers):
    """Area enclosed by the polygon (absolute value)."""
    return abs(_edge_products(markers)[1].sum()) / 2


def perimeter(markers):
    """Length of the polygon."""
    return length(markers - np.roll(markers, 1, axis=0)).sum()


def centroid(markers):
    """Centroid of the enclosed area, shape (2,)."""
    origin = markers.mean(axis=0)  # keeps the products small far from the coordinate origin
    local = markers - origin
    ahead, cross = _edge_products(local)
    return origin + ((local + ahead) * cross[:, None]).sum(axis=0) / (3 * cross.sum())


def second_moments(markers):
    """Central second moments (xx, yy, xy) of the enclosed area."""
    local = markers - centroid(markers)
    ahead, cross = _edge_products(local)
    x, y = local.T
    x1, y1 = ahead.T
    sign = np.sign(cross.sum())
    xx = sign * (cross * (x * x + x * x1 + x1 * x1)).sum() / 12
    yy = sign * (cross * (y * y + y * y1 + y1 * y1)).sum() / 12
    xy = sign * (cross * (x * y1 + 2 * x * y + 2 * x1 * y1 + x1 * y)).sum() / 24
    return xx, yy, xy


def inclination(markers):
    """Angle of the long axis of the enclosed area to the x-axis, in (-pi/2, pi/2]."""
    xx, yy, xy = second_moments(markers)
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return np.pi / 2 if angle <= -np.pi / 2 else angle


def treading_frequency(markers, velocity):
    """Tank-treading frequency 2 pi / (integral of dl / u_tau) (Hu & Lai, section 4.3).

    The tangential velocity is taken along the mean edge direction at the markers, counted
    positive in the direction of most of the motion; NaN where it changes sign or vanishes.
    """
    edges = markers - np.roll(markers, 1, axis=0)
    ahead = np.roll(edges, -1, axis=0)
    chord = edges + ahead
    tangential = np.einsum("ki,ki->k", velocity, chord) / length(chord)
    tangential = tangential * (np.sign(tangential.sum()) or 1.0)
    if not (tangential > 0).all():
        return np.nan
    weights = (length(edges) + length(ahead)) / 2
    return 2 * np.pi / (weights / tangential).sum()
