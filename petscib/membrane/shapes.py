"""Initial shapes: closed curves of markers equally spaced in arclength."""

import numpy as np

_PANELS = 4096
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def _speed(angle, rx, ry):
    return np.hypot(rx * np.cos(angle), ry * np.sin(angle))


def _arc(start, stop, rx, ry):
    """Arclength of the ellipse between parameter angles (Gauss quadrature, elementwise)."""
    half = (stop - start) / 2
    nodes = (start + half)[..., None] + half[..., None] * _NODES
    return half * (_speed(nodes, rx, ry) @ _WEIGHTS)


def ellipse_perimeter(axes):
    """Length of the ellipse with semi-axes (rx, ry)."""
    edges = np.linspace(0, 2 * np.pi, _PANELS + 1)
    return _arc(edges[:-1], edges[1:], *axes).sum()


def ellipse(axes, center, angle, count):
    """Markers on c + R(angle) (rx sin s, ry cos s), equally spaced in arclength.

    Parameters
    ----------
    axes : (float, float)
        Semi-axes rx, ry.
    center : (float, float)
    angle : float
        Rotation in degrees, counter-clockwise.
    count : int
        Number of markers M; marker 0 is at s = 0.

    Returns
    -------
    ndarray, shape (M, 2)
    """
    rx, ry = axes
    edges = np.linspace(0, 2 * np.pi, _PANELS + 1)
    sums = np.concatenate(([0], np.cumsum(_arc(edges[:-1], edges[1:], rx, ry))))
    target = sums[-1] * np.arange(count) / count
    panel = np.clip(np.searchsorted(sums, target, side="right") - 1, 0, _PANELS - 1)
    s = np.interp(target, sums, edges)
    for _ in range(8):  # Newton's method; the first guess is good to the panel's curvature
        s -= (sums[panel] + _arc(edges[panel], s, rx, ry) - target) / _speed(s, rx, ry)
    turn = np.deg2rad(angle)
    x, y = rx * np.sin(s), ry * np.cos(s)
    return np.stack(
        (
            center[0] + np.cos(turn) * x - np.sin(turn) * y,
            center[1] + np.sin(turn) * x + np.cos(turn) * y,
        ),
        axis=1,
    )
