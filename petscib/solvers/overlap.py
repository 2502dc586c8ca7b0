"""How markers share faces of the grid: J J^T, in marker space."""

import numpy as np
from scipy.sparse import csr_matrix, identity, kron


class Overlap:
    """a J J^T a / (dx dy) + K, with entries that stay in place.  Not collective; on rank 0.

    The places are those of markers that share faces, and of their neighbours along the curves; they
    are chosen anew when markers share faces that have no place.

    Parameters
    ----------
    grid : Grid
    curves : Curves

    Attributes
    ----------
    places : csr_matrix, shape (2 M, 2 M)
        With an entry at every place, in the order of the values.
    """

    def __init__(self, grid, curves):
        self.curves, self.places = curves, None
        self._area, self._faces, self._tables = grid.cell_area, 0, []
        for index in (grid.u_index, grid.v_index):
            last = self._faces + index.size
            self._tables.append(np.arange(self._faces, last).reshape(index.shape))
            self._faces = last

    def forget(self):
        """Choose the places at the next update."""
        self.places = None

    def update(self, stencil):
        """Take the markers' faces and weights.  Returns whether the places are others."""
        starts, columns, weights = stencil.csr(*self._tables)
        rows = len(starts) - 1
        matrix = csr_matrix((weights, columns, starts), (rows, self._faces))
        product = matrix @ matrix.T
        row = np.repeat(np.arange(rows), np.diff(product.indptr))
        where = row * rows + product.indices
        new = self.places is None
        if not new:
            entry = np.searchsorted(self._sorted, where)
            new = entry[-1] == len(self._sorted) or not np.array_equal(self._sorted[entry], where)
        if new:
            self._choose(row // 2, product.indices // 2)
            entry = np.searchsorted(self._sorted, where)
        self._shared = np.zeros(len(self._sorted))
        self._shared[entry] = product.data / self._area
        return new

    def _choose(self, first, second):
        """Find places for pairs of markers that share faces."""
        markers = np.arange(len(self.curves.ds))
        count = len(markers)

        def pairs(one, other):
            return csr_matrix((np.ones(len(one)), (one, other)), (count, count))

        beside = sum((pairs(markers, self.curves.before), pairs(markers, self.curves.after)),
                     identity(count, format="csr"))
        near = beside @ pairs(first, second) @ beside.T
        self.places = csr_matrix(kron(near, identity(2)) + kron(identity(count), np.ones((2, 2))))
        self.places.sort_indices()
        self._row = np.repeat(np.arange(2 * count), np.diff(self.places.indptr))
        self._sorted = self._row * (2 * count) + self.places.indices.astype(int)
        self._blocks = np.searchsorted(
            self._sorted,
            (2 * markers[:, None, None] + [[0], [1]]) * 2 * count + 2 * markers[:, None, None]
            + [0, 1])

    def values(self, scale, slip):
        """Its values (`data`).

        Parameters
        ----------
        scale : ndarray, shape (M,)
            a.
        slip : Slip
            K.
        """
        scale = np.repeat(scale, 2)
        values = self._shared * scale[self._row] * scale[self.places.indices]
        tangent = slip.tangent
        values[self._blocks] += (
            slip.mobility[:, None, None] * tangent[:, :, None] * tangent[:, None, :])
        return values
