"""Initial shapes: closed curves of markers equally spaced in arclength."""

import numpy as np

_PANELS = 4096
FEWEST_POINTS = 8  # of a file: fewer would not show a shape
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def _speed(angle, rx, ry):
    return np.hypot(rx * np.cos(angle), ry * np.sin(angle))


def _arc(speed, start, stop):
    """Arclength between parameters (Gauss quadrature, elementwise)."""
    half = (stop - start) / 2
    nodes = (start + half)[..., None] + half[..., None] * _NODES
    return half * (speed(nodes) @ _WEIGHTS)


def ellipse_perimeter(axes):
    """Length of the ellipse with semi-axes (rx, ry)."""
    edges = np.linspace(0, 2 * np.pi, _PANELS + 1)
    return _arc(lambda angle: _speed(angle, *axes), edges[:-1], edges[1:]).sum()


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
    s = _equal_arcs(lambda angle: _speed(angle, rx, ry), edges, count)
    turn = np.deg2rad(angle)
    x, y = rx * np.sin(s), ry * np.cos(s)
    return np.stack(
        (
            center[0] + np.cos(turn) * x - np.sin(turn) * y,
            center[1] + np.sin(turn) * x + np.cos(turn) * y,
        ),
        axis=1,
    )


def _equal_arcs(speed, edges, count):
    """Parameters, from edges[0] on, that cut a closed curve into `count` pieces of equal length.

    Parameters
    ----------
    speed : callable
        Arclength per parameter, elementwise.
    edges : ndarray
        Panels for the quadrature, over one turn.
    count : int
    """
    sums = np.concatenate(([0], np.cumsum(_arc(speed, edges[:-1], edges[1:]))))
    target = sums[-1] * np.arange(count) / count
    panel = np.clip(np.searchsorted(sums, target, side="right") - 1, 0, len(edges) - 2)
    s = np.interp(target, sums, edges)
    for _ in range(8):  # Newton's method; the first guess is good to the panel's curvature
        s -= (sums[panel] + _arc(speed, edges[panel], s) - target) / speed(s)
    return s


class Spline:
    """Periodic cubic spline through points, parametrised by the length of the chords.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        Corners of a closed polygon.

    Attributes
    ----------
    length : float
        Length of the curve.
    """

    def __init__(self, points):
        from scipy.interpolate import CubicSpline

        closed = np.concatenate((points, points[:1]))
        knots = np.concatenate(([0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))))
        self._curve = CubicSpline(knots, closed, bc_type="periodic")
        self._edges = np.unique(np.linspace(knots[:-1], knots[1:], 9))
        self.length = _arc(self._speed, self._edges[:-1], self._edges[1:]).sum()

    def _speed(self, parameter):
        return np.linalg.norm(self._curve(parameter, 1), axis=-1)

    def markers(self, count):
        """Markers equally spaced in arclength, shape (count, 2); the first is the first point."""
        return self._curve(_equal_arcs(self._speed, self._edges, count))


def read_points(path):
    """Points of a closed curve from a text file.

    Each line holds x and y, with blanks or a comma between; ``#`` begins a comment.  The last
    point may repeat the first.

    Returns
    -------
    ndarray, shape (N, 2)

    Raises
    ------
    ValueError
        For anything that is not a simple closed curve, with the line at fault.
    """
    points, lines = [], []
    try:
        with open(path, encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                words = line.split("#")[0].replace(",", " ").split()
                if words:
                    points.append(_point(words, number))
                    lines.append(number)
    except UnicodeDecodeError:
        raise ValueError("not a text file") from None
    if len(points) > 1 and points[0] == points[-1]:
        points.pop()
    if len(points) < FEWEST_POINTS:
        raise ValueError(f"{len(points)} points, and a closed curve needs {FEWEST_POINTS}")
    points = np.array(points)
    _, index, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    twice = np.flatnonzero(index[place.ravel()] != np.arange(len(points)))
    if len(twice):
        first = index[place.ravel()[twice[0]]]
        raise ValueError(f"the point of line {lines[first]} again in line {lines[twice[0]]}")
    crossing = find_crossing(points)
    if crossing:
        one, other = (lines[k] for k in crossing)
        raise ValueError(f"the curve crosses itself, after lines {one} and {other}")
    return points


def _point(words, number):
    if len(words) != 2:
        raise ValueError(f"line {number} has {len(words)} columns instead of x and y")
    try:
        point = tuple(map(float, words))
    except ValueError:
        raise ValueError(f"line {number} is not two numbers") from None
    if not np.isfinite(point).all():
        raise ValueError(f"line {number} is not finite")
    return point


def find_crossing(points):
    """The first two edges of a closed polygon that meet, other than neighbours; None if none do.

    Edge k goes from point k to the next.
    """
    ends = np.roll(points, -1, axis=0)
    count = len(points)

    def side(a, b, p):
        """Twice the area of the triangle a, b, p: its sign tells on which side of a-b p lies."""
        return (b[..., 0] - a[..., 0]) * (p[..., 1] - a[..., 1]) - (
            b[..., 1] - a[..., 1]
        ) * (p[..., 0] - a[..., 0])

    for k in range(count - 2):
        others = slice(k + 2, count - 1 if k == 0 else count)
        a, b, c, d = points[k], ends[k], points[others], ends[others]
        meet = (side(a, b, c) * side(a, b, d) <= 0) & (side(c, d, a) * side(c, d, b) <= 0)
        # Four points in a line pass the test above wherever they lie.
        apart = np.maximum(np.minimum(a, b), np.minimum(c, d)) > np.minimum(
            np.maximum(a, b), np.maximum(c, d)
        )
        found = np.flatnonzero(meet & ~apart.any(axis=1))
        if len(found):
            return k, k + 2 + int(found[0])
    return None
