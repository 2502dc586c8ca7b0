"""Products of sparse matrices whose entries stay in place, whatever their values."""

import numpy as np
from scipy.sparse import csr_matrix


def numbered(matrix, first=0):
    """A matrix or Product with the numbers of its entries, from first + 1 on, as a csr_matrix.

    Not from 0 on, as scipy may drop zeros.
    """
    numbers = np.arange(first + 1.0, first + len(matrix.indices) + 1)
    return csr_matrix((numbers, matrix.indices, matrix.indptr), matrix.shape)


def transposed(matrix):
    """The transposed places, as a csr_matrix, and which entry of the matrix is at each."""
    places = numbered(matrix).T.tocsr()
    return places, places.data.astype(int) - 1


class Product:
    """The product of two sparse matrices, made again and again with other values.

    A factorisation can be reused only where entries stay that happen to be zero, which scipy drops.

    Parameters
    ----------
    first, second : csr_matrix
        With the entries of all the factors to come, in their order.
    upper : bool
        Only the product's upper triangle.

    Attributes
    ----------
    rows, indices, indptr : ndarray of int
        Row and column of each value, and where each row's begin.
    shape : (int, int)
    """

    def __init__(self, first, second, upper=False):
        rows = np.repeat(np.arange(first.shape[0]), np.diff(first.indptr))
        counts = np.diff(second.indptr)[first.indices]
        # Each entry of the first factor meets those in a row of the second.
        self._first = np.repeat(np.arange(first.nnz), counts)
        begins = np.repeat(np.cumsum(counts) - counts, counts)
        self._second = (
            np.repeat(second.indptr[first.indices], counts) + np.arange(len(begins)) - begins)
        if upper:
            kept = rows[self._first] <= second.indices[self._second]
            self._first, self._second = self._first[kept], self._second[kept]
        places = rows[self._first] * second.shape[1] + second.indices[self._second]
        # As np.unique does, but for the kind of sort, quick with what is sorted piece by piece.
        order = np.argsort(places, kind="stable")
        places = places[order]
        new = np.diff(places, prepend=-1) > 0
        self._entry = np.empty(len(order), int)
        self._entry[order] = np.cumsum(new) - 1
        places = places[new]
        self.shape = first.shape[0], second.shape[1]
        self.rows, self.indices = np.divmod(places, second.shape[1])
        self.indptr = np.searchsorted(self.rows, np.arange(self.shape[0] + 1))

    def values(self, first, second):
        """The product's values (`data`) for those of the factors."""
        values = first[self._first] * second[self._second]
        if not len(values):  # whose sums are integers
            return values
        return np.bincount(self._entry, values, len(self.indices))

    def csr(self, values):
        """The matrix with these values."""
        return csr_matrix((values, self.indices, self.indptr), self.shape)
