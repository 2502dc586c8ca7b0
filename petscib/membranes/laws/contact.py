"""Contact: a short-range repulsion between different membranes, and from walls.

The energy of two pieces of membranes at the distance d is K / 2 (1 - d / r)^4 per length^2 within
the range r, and a wall acts like a straight membrane along it would, K r / 2 (1 - d / r)^4 per
length.  Only markers near each other count.  They are looked up with a margin in KD-trees, and
again when they may have moved by more than that; the matrices keep their entries in between.
"""

import numpy as np

# Of the range.  With 0.25, 0.5 and 1 the list has 140, 360 and 1100 pairs and changes in every step
# twice, twice and once, and the look-ups take 6, 5 to 7 and 9 ms of 600 ms and more a step: it
# hardly matters (-scene suspension -vesicles 24 -axes 0.12,0.2 -stag_grid_x 128 -scheme gbe -ts_dt
# 0.03125 -fft -ts_max_steps 40).
MARGIN = 0.5


class _Repulsion:
    """What both have in common: stresses a (1 - d / r)_+^2 of a list of near neighbours."""

    def __init__(self, curves, strength, reach):
        self.curves, self.strength, self.reach = curves, strength, reach
        self._start, self._places, self._list, self._grown = None, [], self._near(None, 0.0), False
        self._take()

    def cover(self, before, after):
        """See to it that the list holds all that is in range in two configurations.

        Returns whether it has changed.
        """
        changed = False
        # A list grown for a long step, or by neighbours that have left, begins anew in the next.
        new = self._start is not before
        if not self._covers(before) or new and self._grown:
            self._list, self._places = self._near(before, (1 + MARGIN) * self.reach), [before]
            changed, self._grown = True, False
        self._start = before
        if after is not before and not self._covers(after):
            more = self._near(after, (1 + MARGIN) * self.reach)
            self._list = np.unique(np.concatenate((self._list, more)), axis=0)
            self._places.append(after)
            changed = self._grown = True
        if changed:
            self._take()
        return changed

    def forget(self):
        """Begin the list anew at the next step, wherever the markers have gone."""
        self._places = []

    def _covers(self, markers):
        # Two markers approach each other by at most twice this.
        return any(
            np.hypot(*(markers - place).T).max(initial=0.0) < MARGIN * self.reach / 2
            for place in self._places
        )

    def _closeness(self, distance):
        """1 - d / r, and 0 beyond the range."""
        return np.maximum(1 - distance / self.reach, 0.0)

    def _slope(self, scale, before, after):
        """Change of a (1 - d / r)_+^2 per change of d, the derivative where there is none."""
        one, other = self._closeness(before), self._closeness(after)
        inside = (one > 0) & (other > 0) | (before == after)
        rate = np.full(len(one), -1 / self.reach)
        np.divide(other - one, after - before, out=rate, where=~inside)
        return scale * (one + other) * rate

    def stress(self, markers, stretch, time=0.0):
        """a (1 - d / r)_+^2 with a^2 = K times the weights of the two."""
        return self._scale * self._closeness(self._distance(self._list, markers)) ** 2

    def energy(self, markers):
        """Energy of all that is in range."""
        near = self._near(markers, self.reach)
        closeness = self._closeness(self._distance(near, markers))
        return np.sum(self._weight(near) * closeness**4) / 2


class Contact(_Repulsion):
    """Repulsion between the markers of different membranes.

    Parameters
    ----------
    curves : Curves
    strength : float
        K (force/length).
    reach : float
        The range r (length).
    grid : Grid
        For its periodic sides.
    """

    name, linear = "contact", False

    def __init__(self, curves, strength, reach, grid):
        a, b, c, d = grid.domain
        self._corner = np.array((a, c))
        self._period = np.where(grid.periodic, (b - a, d - c), 0.0)
        super().__init__(curves, strength, reach)

    def _near(self, markers, distance):
        """Pairs of markers of different membranes, shape (P, 2)."""
        if markers is None or self.curves.count < 2:
            return np.zeros((0, 2), int)
        from scipy.spatial import cKDTree

        period = self._period
        at_home = markers - self._corner
        wraps = period > 0
        at_home[:, wraps] %= period[wraps]
        at_home[:, wraps] %= period[wraps]  # round-off may have made it the period itself
        tree = cKDTree(at_home, boxsize=period if wraps.any() else None)
        pairs = tree.query_pairs(distance, output_type="ndarray")
        owner = self.curves.owner
        return pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]].astype(int)

    def _weight(self, pairs):
        return self.strength * np.prod(self.curves.ds[pairs], axis=1)

    def _take(self):
        self._scale = np.sqrt(self._weight(self._list))
        self.columns = (2 * self._list[:, :, None] + np.arange(2)).reshape(-1, 4)

    def _apart(self, pairs, markers):
        """From the first of each pair to the nearest image of the second."""
        apart = markers[pairs[:, 1]] - markers[pairs[:, 0]]
        for axis in np.flatnonzero(self._period):
            apart[:, axis] -= self._period[axis] * np.round(apart[:, axis] / self._period[axis])
        return apart

    def _distance(self, pairs, markers):
        return np.hypot(*self._apart(pairs, markers).T)

    def weights(self, before, after):
        """Its rows; the direction of a pair is averaged as that of an edge is for the tension."""
        one, other = self._apart(self._list, before), self._apart(self._list, after)
        lengths = np.hypot(*one.T), np.hypot(*other.T)
        slope = self._slope(self._scale, *lengths)
        weights = (slope / np.add(*lengths))[:, None] * (one + other)
        return np.concatenate((-weights, weights), axis=1)


class WallContact(_Repulsion):
    """Repulsion of markers from walls.

    Parameters
    ----------
    curves : Curves
    strength : float
        K (force/length).
    reach : float
        The range r (length).
    grid : Grid
    """

    name, linear = "wall_contact", False

    def __init__(self, curves, strength, reach, grid):
        low, high = np.reshape(grid.domain, (2, 2)).T
        self._walls = [
            (axis, end, place[axis]) for end, place in ((1, low), (-1, high)) for axis in (0, 1)
            if not grid.periodic[axis]
        ]
        super().__init__(curves, strength, reach)

    def _near(self, markers, distance):
        """Markers and numbers of the walls that they are near, shape (P, 2)."""
        parts = [np.zeros((0, 2), int)]
        for number, (axis, end, place) in enumerate(self._walls if markers is not None else ()):
            near = np.flatnonzero(end * (markers[:, axis] - place) < distance)
            parts.append(np.stack((near, np.full_like(near, number)), axis=1))
        return np.concatenate(parts)

    def _weight(self, near):
        return self.strength * self.reach * self.curves.ds[near[:, 0]]

    def _take(self):
        marker, wall = self._list.T
        axes, ends, places = np.array(self._walls).reshape(-1, 3).T
        self._scale = np.sqrt(self._weight(self._list))
        self.columns = (2 * marker + axes.astype(int)[wall])[:, None]
        self._end = ends[wall]

    def _distance(self, near, markers):
        axes, ends, places = np.array(self._walls).reshape(-1, 3).T
        marker, wall = near.T
        return ends[wall] * (markers[marker, axes.astype(int)[wall]] - places[wall])

    def weights(self, before, after):
        """Its rows."""
        one, other = (self._distance(self._list, markers) for markers in (before, after))
        return (self._end * self._slope(self._scale, one, other))[:, None]
