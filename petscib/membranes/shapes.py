"""Initial shapes: curves of markers equally spaced in arclength."""

import numpy as np

# At least, for the quadrature of a length.  With half and twice as many, lengths and places of
# markers are the same to 1e-13 (an ellipse 1000 times as long as wide, a line with an amplitude of
# 5 times its length), and with a quarter the ellipse's begin to differ.  It takes 7 ms a curve.
PANELS = 4096
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def _speed(angle, rx, ry):
    return np.hypot(rx * np.cos(angle), ry * np.sin(angle))


def arc_length(speed, start, stop):
    """Arclength between parameters (Gauss quadrature, elementwise)."""
    half = (stop - start) / 2
    nodes = (start + half)[..., None] + half[..., None] * _NODES
    return half * (speed(nodes) @ _WEIGHTS)


def ellipse_perimeter(axes):
    """Length of the ellipse with semi-axes (rx, ry)."""
    edges = np.linspace(0, 2 * np.pi, PANELS + 1)
    return arc_length(lambda angle: _speed(angle, *axes), edges[:-1], edges[1:]).sum()


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
    edges = np.linspace(0, 2 * np.pi, PANELS + 1)
    s = equal_arcs(lambda angle: _speed(angle, rx, ry), edges, count)
    turn = np.deg2rad(angle)
    x, y = rx * np.sin(s), ry * np.cos(s)
    return np.stack(
        (
            center[0] + np.cos(turn) * x - np.sin(turn) * y,
            center[1] + np.sin(turn) * x + np.cos(turn) * y,
        ),
        axis=1,
    )


def line(start, end, amplitude, count):
    """Markers from one side of a periodic box to the other, on one wave of a sine.

    Parameters
    ----------
    start, end : (float, float)
        Where it would begin and end if it were straight; the end is the start again.
    amplitude : float
        To the left of the way, at first.
    count : int

    Returns
    -------
    markers : ndarray, shape (count, 2)
    length : float
    """
    along = np.subtract(end, start)
    across = np.array((-along[1], along[0])) / np.hypot(*along)
    turn = 2 * np.pi

    def speed(part):
        return np.hypot(np.hypot(*along), amplitude * turn * np.cos(turn * part))

    edges = np.linspace(0, 1, PANELS + 1)
    part = equal_arcs(speed, edges, count)[:, None]
    markers = start + part * along + amplitude * np.sin(turn * part) * across
    return markers, arc_length(speed, edges[:-1], edges[1:]).sum()


def plate(half, center, angle, count):
    """Markers on a straight open line of the length 2 `half`, turned from the vertical.

    Returns
    -------
    ndarray, shape (count, 2)
        The first at the upper end where the angle is 0.
    """
    turn = np.deg2rad(angle)
    along = half * np.array((-np.sin(turn), np.cos(turn)))
    return center + np.linspace(1, -1, count)[:, None] * along


def equal_arcs(speed, edges, count):
    """Parameters, from edges[0] on, that cut a curve into `count` pieces of equal length.

    Parameters
    ----------
    speed : callable
        Arclength per parameter, elementwise.
    edges : ndarray
        Panels for the quadrature, over one turn.
    count : int
    """
    sums = np.concatenate(([0], np.cumsum(arc_length(speed, edges[:-1], edges[1:]))))
    target = sums[-1] * np.arange(count) / count
    panel = np.clip(np.searchsorted(sums, target, side="right") - 1, 0, len(edges) - 2)
    s = np.interp(target, sums, edges)
    for _ in range(8):  # Newton's method; the first guess is good to the panel's curvature
        s -= (sums[panel] + arc_length(speed, edges[panel], s) - target) / speed(s)
    return s
