"""How markers share faces of the grid: J J^T, in marker space."""

import numpy as np
from scipy.sparse import csr_matrix, identity, kron

# Largest entry of J J^T, relative to those on the diagonal, that may be left out.  1e-4 and less
# change no iterations, 1e-3 costs up to three of 16, 1e-2 doubles them (yang and bspline43, 64^2
# and 128^2, dt = h and 4 h, sigma0 = 1e9, bending 0.01).
LEFT_OUT = 1e-4


class Overlap:
    """a J J^T a / (dx dy) + K, with entries that stay in place.  Not collective; on rank 0.

    The places are those of markers that share faces.  They are chosen anew when other markers share
    so much that it may not be left out.  For each entry left out the two on the diagonal grow by
    as much, so that the matrix stays positive definite.

    Parameters
    ----------
    area : float
        dx dy.

    Attributes
    ----------
    places : csr_matrix, shape (2 M, 2 M)
        With an entry at every place, in the order of the values.
    """

    def __init__(self, area):
        self._area = area
        self.forget()

    def forget(self):
        """Choose the places at the next update."""
        self.places = None

    def update(self, interpolation):
        """Take J, a csr_matrix with 2 M rows.  Returns whether the places are others."""
        rows, product = interpolation.shape[0], interpolation @ interpolation.T
        row, column = np.repeat(np.arange(rows), np.diff(product.indptr)), product.indices
        shared, diagonal = product.data / self._area, product.diagonal() / self._area
        new = self.places is None
        if not new:
            entry, missing = self._find(row, column)
            needed = np.abs(shared[missing]) > LEFT_OUT * np.sqrt(
                diagonal[row[missing]] * diagonal[column[missing]])
            new = needed.any()
        if new:
            self._choose(row, column, rows)
            entry, missing = self._find(row, column)
        self._shared = np.zeros(len(self._numbers))
        self._shared[entry[~missing]] = shared[~missing]
        self._shared[self._diagonal] += np.bincount(row[missing], np.abs(shared[missing]), rows)
        return new

    def _choose(self, row, column, rows):
        """Find places for entries, for both components of both markers."""
        count = rows // 2
        pairs = csr_matrix((np.ones(len(row)), (row // 2, column // 2)), (count, count))
        self.places = csr_matrix(
            kron(pairs, identity(2)) + kron(identity(count), np.ones((2, 2))))
        self.places.sort_indices()
        self._row = np.repeat(np.arange(rows), np.diff(self.places.indptr))
        self._numbers = self._row * rows + self.places.indices.astype(int)
        every = np.arange(rows)
        self._diagonal = self._find(every, every)[0]
        self._beside = self._find(every, every ^ 1)[0]  # the marker's other component

    def _find(self, row, column):
        """Which place each entry has, and whether it has none."""
        number = row * self.places.shape[0] + column
        entry = np.minimum(np.searchsorted(self._numbers, number), len(self._numbers) - 1)
        return entry, self._numbers[entry] != number

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
        along = slip.mobility[:, None] * slip.tangent
        values[self._diagonal] += (along * slip.tangent).ravel()
        values[self._beside] += (along * slip.tangent[:, ::-1]).ravel()
        return values
