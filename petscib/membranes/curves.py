"""How markers are joined to curves: which follows which, and at what parameter step.

The markers of all membranes lie one after the other in the arrays, those of one membrane in the
order along it.  Differences along all curves at once are then plain indexing.
"""

import numpy as np


class Curves:
    """Some curves of markers.  Not collective.

    Parameters
    ----------
    counts : sequence of int
        Markers of each curve; none on the ranks that hold no markers.
    spacings : sequence of float
        Parameter step ds of each curve.
    closed : sequence of bool, optional
        Whether the last marker of each is joined to its first; by default all are.
    periods : sequence of (float, float), optional
        For a closed curve across a periodic box, how far its first marker is found again beyond
        its last: positions are unwrapped.  By default none, the curve encloses an area.

    Attributes
    ----------
    starts : ndarray, shape (V + 1,)
        First marker of each of the V curves, and the end.
    ds : ndarray, shape (M,)
        Parameter step at each marker.
    edges : ndarray of int, shape (H, 2)
        The two markers of each half point: (k - 1, k) for all k on a closed curve, where the
        one before the first is the last.
    edge_ds : ndarray, shape (H,)
    edge_starts : ndarray, shape (V + 1,)
        First half point of each curve, and the end.
    triples : ndarray of int, shape (B, 3)
        (k - 1, k, k + 1) of each marker that has two neighbours.
    before, after : ndarray of int, shape (M,)
        Neighbours of each marker, or itself at an open end.
    closed : ndarray of bool, shape (M,)
        Whether each marker belongs to a closed curve.
    encloses : ndarray of bool, shape (V,)
        Whether each curve encloses an area.
    periods : ndarray, shape (V, 2)
    ahead, behind : ndarray, shape (M, 2)
        What the positions of the markers `after` and `before` lack: zero but at the joint of a
        curve across a periodic box.
    """

    def __init__(self, counts, spacings, closed=None, periods=None):
        counts = np.asarray(counts, dtype=int)
        shut = np.ones(len(counts), bool) if closed is None else np.asarray(closed, bool)
        self.periods = np.zeros((len(counts), 2))
        if periods is not None:
            self.periods += np.reshape(periods, (-1, 2))
        self.encloses = shut & ~self.periods.any(axis=1)
        self.starts = np.concatenate(([0], np.cumsum(counts)))
        self._counts = counts
        self.ds = np.repeat(np.asarray(spacings, float), counts)
        self.closed = np.repeat(shut, counts)
        marker = np.arange(self.starts[-1])
        first, last = self.starts[:-1], self.starts[1:] - 1
        self.before, self.after = marker - 1, marker + 1
        self.before[first] = np.where(shut, last, first)
        self.after[last] = np.where(shut, first, last)
        self.ahead, self.behind = np.zeros((2, len(marker), 2))
        self.ahead[last], self.behind[first] = self.periods, -self.periods
        joined = self.before != marker
        self.edges = np.stack((self.before, marker), axis=1)[joined]
        self.edge_ds = self.ds[joined]
        self._edge_shift = -self.behind[joined]
        self.edge_starts = np.concatenate(([0], np.cumsum(counts - ~shut)))
        inner = joined & (self.after != marker)
        self.triples = np.stack((self.before, marker, self.after), axis=1)[inner]

    def edge_vectors(self, markers):
        """X_k - X_{k-1} at the half points, shape (H, 2)."""
        return markers[self.edges[:, 1]] - markers[self.edges[:, 0]] + self._edge_shift

    def stretching(self, markers):
        """Stretching |X_s| at the half points, shape (H,)."""
        return np.hypot(*self.edge_vectors(markers).T) / self.edge_ds

    def chords(self, markers):
        """X_{k+1} - X_{k-1} at the markers, shape (M, 2); one edge at an open end."""
        return markers[self.after] - markers[self.before] + (self.ahead - self.behind)

    @property
    def count(self):
        """Number of curves."""
        return len(self.starts) - 1

    @property
    def owner(self):
        """Number of its curve, at each marker."""
        return self.spread(np.arange(self.count))

    def sums(self, values):
        """Sum over each curve of values at the markers, shape (V, ...)."""
        return np.add.reduceat(values, self.starts[:-1]) if len(values) else values[:0]

    def spread(self, values):
        """Value of its curve, from an array (V, ...) over the curves, at each marker."""
        return np.repeat(values, self._counts, axis=0)

    def edge_sums(self, values):
        """Sum over each curve of values at the half points, shape (V,)."""
        return np.add.reduceat(values, self.edge_starts[:-1]) if len(values) else values[:0]

    def parts(self, values):
        """Views of an array over the markers, one for each curve."""
        return [values[a:b] for a, b in zip(self.starts[:-1], self.starts[1:])]

    def edge_parts(self, values):
        """Views of an array over the half points, one for each curve."""
        return [values[a:b] for a, b in zip(self.edge_starts[:-1], self.edge_starts[1:])]
