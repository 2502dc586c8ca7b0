"""How near membranes come to each other and to walls, and whether two of them have crossed.

On periodic sides they meet the images of the others and of themselves.

Membranes whose bounding circles are far apart are never compared, and the markers of the others
are looked up in trees: with M markers in all this takes some M log M operations.
"""

from dataclasses import dataclass

import numpy as np

_AROUND = np.arange(-3, 3)  # edges beside the nearest marker of which one may be crossed


@dataclass(frozen=True)
class Gap:
    """The smallest distance found.

    Attributes
    ----------
    distance : float
        Between membranes, or from one to a wall or to its own image; infinite if there is none.
    between : float
        Between membranes alone; infinite where the walls are certainly nearer.
    pair : (int, int) or None
        The two membranes of `between`, twice the same where it is an image of its own.
    crossed : (int, int) or None
        Two membranes whose edges meet, likewise.
    """

    distance: float
    between: float
    pair: tuple
    crossed: tuple


class Gaps:
    """Measures gaps.  Not collective; for the rank with the markers.

    Parameters
    ----------
    curves : Curves
    grid : Grid
    """

    def __init__(self, curves, grid):
        self.curves = curves
        self._low, self._high = np.reshape(grid.domain, (2, 2)).T
        self._periodic = np.array(grid.periodic)
        self._own = self._own_images()
        self._known = None, None

    def _own_images(self):
        """Numbers of curves, and the translations to half of the images around each.

        The other half is as far, and a line across the box goes on in its images along it.
        """
        x, y = np.diag(np.where(self._periodic, self._high - self._low, 0.0))
        around = np.unique([shift for shift in (x, y, x + y, x - y) if shift.any()]
                           or np.zeros((0, 2)), axis=0)
        numbers = np.repeat(np.arange(self.curves.count), len(around))
        shifts = np.tile(around, (self.curves.count, 1))
        along = self.curves.periods[numbers]
        apart = (along[:, 0] * shifts[:, 1] != along[:, 1] * shifts[:, 0]) | ~along.any(axis=1)
        return numbers[apart], shifts[apart]

    def measure(self, markers):
        """The Gap for some positions (M, 2); asked again for the same array, it remembers."""
        if self._known[0] is not markers:
            self._known = markers, self._measure(markers)
        return self._known[1]

    def _measure(self, markers):
        walls = np.minimum(markers - self._low, self._high - markers)[:, ~self._periodic]
        nearest = walls.min(initial=np.inf)
        if self.curves.count < 2 and not len(self._own[0]):
            return Gap(nearest, np.inf, None, None)
        from scipy.spatial import cKDTree

        curves = self.curves
        parts, trees = curves.parts(markers), {}
        longest = np.hypot(*curves.edge_vectors(markers).T).max()
        between, pair, crossed = np.inf, None, None
        for one, other, shift, least in self._candidates(markers):
            limit = max(min(between, nearest), longest)
            if least >= limit:
                break
            if curves.ds[curves.starts[one]] < curves.ds[curves.starts[other]]:
                one, other, shift = other, one, -shift  # the closer markers are looked up
            if one not in trees:
                trees[one] = cKDTree(parts[one])
            distance, found = trees[one].query(
                parts[other] + shift, distance_upper_bound=limit + longest)
            near = np.flatnonzero(np.isfinite(distance))
            if not len(near):
                continue
            theirs, ours = near + curves.starts[other], found[near] + curves.starts[one]
            apart = self._distances(markers, ours, theirs, shift).min()
            if apart < between:
                between, pair = apart, (min(one, other), max(one, other))
            close = distance[near] <= 2 * longest
            if crossed is None and self._meet(markers, ours[close], theirs[close], shift):
                crossed = min(one, other), max(one, other)
        return Gap(min(nearest, between), between, pair, crossed)

    def _candidates(self, markers):
        """Pairs of membranes and images of the second, those that may be nearest first.

        A membrane makes pairs with its own images.  Yields numbers of both, the translation of the
        second, and a bound on their distance.
        """
        curves = self.curves
        first = curves.starts[:-1]
        low, high = (bound.reduceat(markers, first) for bound in (np.minimum, np.maximum))
        center = (low + high) / 2
        radius = np.sqrt(np.maximum.reduceat(
            ((markers - curves.spread(center)) ** 2).sum(axis=1), first))
        one, other = np.triu_indices(curves.count, 1)
        apart = center[other] - center[one]
        period = np.where(self._periodic, self._high - self._low, 0.0)
        home = np.zeros_like(apart)
        for axis in np.flatnonzero(self._periodic):
            home[:, axis] = -period[axis] * np.round(apart[:, axis] / period[axis])
        shifts = [home]
        for axis in np.flatnonzero(self._periodic):  # the image second nearest in each direction
            step = np.zeros_like(apart)
            step[:, axis] = -period[axis] * np.where((apart + home)[:, axis] < 0, -1, 1)
            shifts += [shift + step for shift in shifts]
        images = len(shifts)
        own, around = self._own
        shifts = np.concatenate([*shifts, around])
        one, other = (np.concatenate((np.tile(each, images), own)) for each in (one, other))
        least = np.hypot(*(center[other] - center[one] + shifts).T) - radius[one] - radius[other]
        for k in np.argsort(least, kind="stable"):
            yield int(one[k]), int(other[k]), shifts[k], least[k]

    def _distances(self, markers, ours, theirs, shift):
        """From markers to the edges beside those nearest to them, both ways."""
        curves, distances = self.curves, []
        for points, others, move in ((theirs, ours, shift), (ours, theirs, -shift)):
            point, middle = markers[points] + move, markers[others]
            for end in (markers[curves.after] + curves.ahead, markers[curves.before]
                        + curves.behind):
                distances.append(_to_segment(point, middle, end[others]))
        return np.minimum.reduce(distances)

    def _meet(self, markers, ours, theirs, shift):
        """Whether edges beside near markers of two membranes have a point in common."""
        from .crossings import meet

        ours = np.repeat(self._around(ours), 2, axis=1).ravel()
        theirs = np.tile(self._around(theirs)[:, 2:4], (1, len(_AROUND))).ravel()
        ends = markers[self.curves.after] + self.curves.ahead
        edges = markers[ours], ends[ours], markers[theirs] + shift, ends[theirs] + shift
        a, b, c, d = edges
        overlap = ((np.minimum(a, b) <= np.maximum(c, d))
                   & (np.minimum(c, d) <= np.maximum(a, b))).all(axis=1)
        return meet(*(points[overlap] for points in edges)).any()

    def _around(self, markers):
        """Numbers of the markers where the edges around some markers begin, shape (N, 6)."""
        curves = self.curves
        one = np.searchsorted(curves.starts, markers, side="right") - 1
        first, length = curves.starts[one], np.diff(curves.starts)[one]
        return first[:, None] + ((markers - first)[:, None] + _AROUND) % length[:, None]


def _to_segment(points, start, end):
    """Distance of each point to a segment of its own."""
    along, towards = end - start, points - start
    square = np.einsum("ki,ki->k", along, along)
    part = np.divide(np.einsum("ki,ki->k", along, towards), square, out=np.zeros_like(square),
                     where=square > 0)
    return np.hypot(*(towards - np.clip(part, 0, 1)[:, None] * along).T)


def contains(polygon, point):
    """Whether a point (2,) lies inside a closed polygon (N, 2)."""
    x, y = (polygon - point).T
    x1, y1 = np.roll(x, -1), np.roll(y, -1)
    crosses = (y > 0) != (y1 > 0)
    left = (x * y1 - x1 * y) * np.sign(y1 - y) > 0
    return bool(np.sum(crosses & left) % 2)
