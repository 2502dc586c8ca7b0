"""Where to put ellipses in a box so that they do not overlap.

Two ellipses are apart when no point of either lies in the other made larger by the gap they must
keep; of that, points all around are looked at.
"""

import numpy as np

_POINTS = 64  # around an ellipse
# At random places for one ellipse.  Of 140 and more that fill 0.45, 0.5 and 0.55 of a periodic box,
# without gaps, 8, 5 and none of 8 arrangements were found (axes 0.06 both, and 0.05 and 0.08).
_MOST_TRIES = 2000


class NoRoom(ValueError):
    """There is no place for another ellipse, or none was found."""


class Box:
    """A box that keeps ellipses apart, and from its walls.

    Parameters
    ----------
    domain : (a, b, c, d)
    periodic : (bool, bool)
    gap : float
        Distance between ellipses.
    margin : (float, float)
        From walls, in x and y.
    """

    def __init__(self, domain, periodic, gap, margin):
        self.low, self.high = np.reshape(domain, (2, 2)).T
        self.periodic, self.gap = np.array(periodic), gap
        self.margin = np.where(periodic, 0.0, margin)

    def room(self, half_sizes):
        """Least and greatest coordinates that a centre may have, two arrays of shape (2,)."""
        inset = np.where(self.periodic, 0.0, self.margin + half_sizes)
        return self.low + inset, self.high - inset

    def apart(self, vectors):
        """Centre differences (N, 2) to the nearest image."""
        period = self.high - self.low
        return vectors - np.where(self.periodic, period * np.round(vectors / period), 0.0)


def _outline(axes, angle):
    """Points around an ellipse about the origin, shape (_POINTS, 2)."""
    s = 2 * np.pi * np.arange(_POINTS) / _POINTS
    return _turn(np.stack((axes[0] * np.sin(s), axes[1] * np.cos(s)), axis=1), angle)


def _turn(points, degrees):
    turn = np.deg2rad(degrees)
    c, s = np.cos(turn), np.sin(turn)
    return points @ np.array([[c, s], [-s, c]])


def _half_sizes(axes, angle):
    return np.abs(_outline(axes, angle)).max(axis=0)


def _overlap(axes, angle, other_axes, other_angle, apart, gap):
    """Whether an ellipse at the origin and one at `apart` come nearer than the gap."""
    if np.hypot(*apart) > max(axes) + max(other_axes) + gap:
        return False
    for points, large, turn in (
        (_outline(axes, angle) - apart, other_axes, other_angle),
        (_outline(other_axes, other_angle) + apart, axes, angle),
    ):
        local = _turn(points, -turn) / (np.asarray(large) + gap)
        if (np.hypot(*local.T) < 1).any():
            return True
    return False


def random(box, axes, seed):
    """Random places and angles, one ellipse after the other, the largest first.

    Parameters
    ----------
    box : Box
    axes : list of (float, float)
        Half axes of each.
    seed : int

    Returns
    -------
    centers : ndarray, shape (N, 2)
    angles : ndarray, shape (N,)
        In degrees.

    Raises
    ------
    NoRoom
    """
    generator = np.random.default_rng(seed)
    centers, angles = np.zeros((len(axes), 2)), np.zeros(len(axes))
    placed, largest = [], max(map(max, axes))
    for number in sorted(range(len(axes)), key=lambda k: -np.prod(axes[k])):
        for _ in range(_MOST_TRIES):
            angle = generator.uniform(0, 180)
            low, high = box.room(_half_sizes(axes[number], angle))
            center = low + generator.uniform(size=2) * (high - low)
            if (high < low).any():
                continue
            aways = box.apart(centers[placed] - center)
            near = np.hypot(*aways.T) <= 2 * largest + box.gap
            if not any(_overlap(axes[number], angle, axes[placed[k]], angles[placed[k]],
                                aways[k], box.gap) for k in np.flatnonzero(near)):
                break
        else:
            raise NoRoom(f"no place was found for more than {len(placed)} of {len(axes)} vesicles")
        centers[number], angles[number] = center, angle
        placed.append(number)
    return centers, angles


def lattice(box, axes, angles):
    """Places in rows, as many in each as there can be, give or take one.

    The same parameters and results as `random`, but the angles are given.
    """
    count = len(axes)
    sizes = np.array([_half_sizes(*one) for one in zip(axes, angles)])
    largest = sizes.max(axis=0)
    low, high = box.room(largest)
    # A wall may be nearer than another ellipse: a row along it begins at once.
    width, height = np.where(box.periodic, high - low, high - low + 2 * largest + box.gap)
    if min(width, height) <= 0:
        raise NoRoom("the box is too small for one vesicle")
    ratio = (width / (2 * largest[0] + box.gap)) / (height / (2 * largest[1] + box.gap))
    best = None
    for rows in {max(1, int(np.floor(np.sqrt(count / ratio)))),
                 max(1, int(np.ceil(np.sqrt(count / ratio))))}:
        cells = width / -(-count // rows), height / rows
        slack = min(cells[0] / (2 * largest[0] + box.gap), cells[1] / (2 * largest[1] + box.gap))
        if best is None or slack > best[0]:
            best = slack, rows
    slack, rows = best
    if slack < 1 - 1e-12:
        raise NoRoom(f"there is no room for {count} vesicles in rows")
    centers, first = np.zeros((count, 2)), 0
    start = np.where(box.periodic, low, low - largest - box.gap / 2)
    for row in range(rows):
        here = count // rows + (row < count % rows)
        place = np.arange(here) + 0.5
        centers[first : first + here, 0] = start[0] + width * place / here
        centers[first : first + here, 1] = start[1] + height * (row + 0.5) / rows
        first += here
    return centers, np.asarray(angles, float)
