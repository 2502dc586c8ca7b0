"""Transforms of one grid line, and which of them belong to which component of which field.

They diagonalise the second difference; the right one depends only on how the points lie to the two
sides of the line.
"""

from functools import partial
from typing import Callable, NamedTuple

import numpy as np
from scipy import fft, fftpack

Y, X = 0, 1


class Basis(NamedTuple):
    """Eigenvectors of the second difference on a line of N cells between two sides.

    Attributes
    ----------
    forward, inverse : callable
        Transforms of real arrays, called with the array, axis and overwrite_x.
    waves : callable
        Half waves on the line, for each of a number of transformed values: of w, the eigenvalue
        is (2/h sin(w pi / 2N))^2.
    given : int
        Points at either end whose values are known; N - given are unknown.
    """

    forward: Callable
    inverse: Callable
    waves: Callable
    given: int = 0

    def unknowns(self, cells):
        """Points whose values are unknown."""
        return cells - self.given

    def eigenvalues(self, cells, spacing):
        """Eigenvalues of minus the second difference, in the order of the transform."""
        waves = self.waves(self.unknowns(cells))
        return (2 / spacing * np.sin(waves * np.pi / (2 * cells))) ** 2

    @property
    def first(self):
        """Distance of the first unknown point from its wall, in cells."""
        return (1 + self.given) / 2


def _from_one(count):
    return np.arange(1, count + 1)


def _in_pairs(count):
    """Constant, cosine and sine of one wave, of two waves, ..."""
    return 2 * ((np.arange(count) + 1) // 2)


WALL_AT_POINT = Basis(partial(fft.dst, type=1), partial(fft.idst, type=1), _from_one, given=1)
WALL_BETWEEN = Basis(partial(fft.dst, type=2), partial(fft.idst, type=2), _from_one)
NO_FLUX = Basis(partial(fft.dct, type=2), partial(fft.idct, type=2), np.arange)
PERIODIC = Basis(fftpack.rfft, fftpack.irfft, _in_pairs)  # scipy.fft has none that stays real


class Field(NamedTuple):
    """One component.

    Attributes
    ----------
    index : ndarray of int
        PETSc numbers of its points in natural order (see Grid).
    bases : (Basis, Basis)
        In y and x.
    """

    index: np.ndarray
    bases: tuple[Basis, Basis]

    @property
    def unknown(self):
        """The part of `index` that is to be solved for."""
        return self.index[self._inside]

    @property
    def given(self):
        """The other PETSc numbers."""
        outside = np.ones(self.index.shape, dtype=bool)
        outside[self._inside] = False
        return self.index[outside]

    @property
    def _inside(self):
        (rows, columns), (y, x) = self.index.shape, self.bases
        return slice(y.given, rows - y.given), slice(x.given, columns - x.given)


def _between(grid, y, x):
    """The bases in y and x, given those between walls."""
    return tuple(
        PERIODIC if periodic else basis for periodic, basis in zip(grid.periodic[::-1], (y, x))
    )


def velocity_fields(grid):
    """Both components of the velocity."""
    return [
        Field(grid.u_index, _between(grid, WALL_BETWEEN, WALL_AT_POINT)),
        Field(grid.v_index, _between(grid, WALL_AT_POINT, WALL_BETWEEN)),
    ]


def pressure_field(grid):
    """The pressure, without flux through walls."""
    return Field(grid.p_index, _between(grid, NO_FLUX, NO_FLUX))


def corner_bases(grid):
    """Of a function at the corners of the cells that vanishes on walls."""
    return _between(grid, WALL_AT_POINT, WALL_AT_POINT)


def given_places(fields, vector):
    """Places of the given points of some fields in this rank's part of a vector."""
    numbers = np.concatenate([field.given for field in fields])
    start, end = vector.getOwnershipRange()
    return numbers[(start <= numbers) & (numbers < end)] - start
