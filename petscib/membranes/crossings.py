"""Where a closed polygon crosses or touches itself.

The edges are gathered two by two into a tree of bounding boxes.  A curve passes its own
neighbourhood only where it comes near itself, so of the pairs of boxes on a level of the tree only
about as many overlap as there are boxes: some n log n comparisons in all, however unevenly the
points lie.
"""

import numpy as np

_MOST = 2**18  # pairs looked at together: some ten arrays of this length are alive at a time


def find_crossing(points):
    """Two edges of a closed polygon that meet and are not neighbours; None if there are none.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        Edge k goes from point k to the next.

    Returns
    -------
    (int, int) or None
        Numbers of the edges, the smaller first.
    """
    ends = np.roll(points, -1, axis=0)
    last = len(points) - 1
    for one, other in _overlapping(np.minimum(points, ends), np.maximum(points, ends)):
        distant = (other - one > 1) & ((one > 0) | (other < last))
        one, other = one[distant], other[distant]
        crossing = meet(points[one], ends[one], points[other], ends[other])
        if crossing.any():
            one, other = one[crossing], other[crossing]
            first = np.lexsort((other, one))[0]
            return int(one[first]), int(other[first])
    return None


def meet(a, b, c, d):
    """Whether the edges a-b and c-d, whose boxes overlap, have a point in common."""
    return (_side(a, b, c) * _side(a, b, d) <= 0) & (_side(c, d, a) * _side(c, d, b) <= 0)


def _side(a, b, p):
    """The side of the line a-b on which p lies: -1, 0 or 1."""
    along, towards = b - a, p - a
    return np.sign(along[:, 0] * towards[:, 1] - along[:, 1] * towards[:, 0])


def _overlapping(low, high):
    """Pairs i < j of boxes that overlap: arrays of i and j, a part of all pairs at a time.

    Parameters
    ----------
    low, high : ndarray, shape (N, 2)
        Corners of the boxes.
    """
    levels = [(low, high)]
    while len(levels[-1][0]) > 1:
        low, high = levels[-1]
        if len(low) % 2:  # a box that overlaps none
            low = np.append(low, [[np.inf, np.inf]], axis=0)
            high = np.append(high, [[-np.inf, -np.inf]], axis=0)
            levels[-1] = low, high
        levels.append((np.minimum(low[::2], low[1::2]), np.maximum(high[::2], high[1::2])))
    root = np.zeros(1, dtype=int)
    waiting = [(len(levels) - 1, root, root)]
    while waiting:
        level, one, other = waiting.pop()
        low, high = levels[level]
        overlap = ((low[one] <= high[other]) & (low[other] <= high[one])).all(axis=1)
        one, other = one[overlap], other[overlap]
        if level == 0:
            yield one[one < other], other[one < other]
            continue
        # Both halves of the one box with both of the other, each pair once.
        one = (2 * one[:, None] + [0, 0, 1, 1]).ravel()
        other = (2 * other[:, None] + [0, 1, 0, 1]).ravel()
        once = one <= other
        one, other = one[once], other[once]
        for start in reversed(range(0, len(one), _MOST)):  # the first part is the next to be taken
            part = slice(start, start + _MOST)
            waiting.append((level - 1, one[part], other[part]))
