"""The fluid's coupled problem as one for the stream function, between sine transforms.

Velocities without divergence, and zero through the walls, are u = Z psi, differences of a stream
function psi at the corners inside the box.  With walls along which the fluid slips freely, sine
transforms diagonalise

    Z^T (a - b Laplacian) Z = (a + b L) L,    L = minus the five-point Laplacian at the corners.

A wall at which it sticks, half a cell from the nearest velocities along it, adds
2 b / h^2 times the square of each of them: with R their weighted values (those of psi at the
corners next to the walls), in transformed space

    (Q^{-1} + R^T R) psi = g,    Q = 1 / ((a + b L) L),
    psi = Q (g - R^T s),    (1 + R Q R^T) s = R Q g.

The last matrix, one row a velocity along a wall, is symmetric positive definite.  In transforms
along each wall, and sums and differences of opposite walls, it falls into four blocks
[[D1, E^T], [E, D2]] with diagonal D1 and D2 for the horizontal and the vertical walls, whose Schur
complements are factored once: a direct solve, as Bjorstad's of the biharmonic equation (SIAM J.
Numer. Anal. 20 (1983) 59-71), which this is in the limit of large b.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from .spectral import WALL_AT_POINT, Slabs, transform

PARITIES = slice(0, None, 2), slice(1, None, 2)  # odd wave numbers, even ones


def _wall_weights(cells, spacing, b):
    """Row of R for the sum (first) and the difference (second) of two opposite walls.

    Shape (2, cells - 1): the weight of each wave number across the walls, in orthonormal
    transforms.
    """
    k = np.arange(1, cells)
    weights = np.sqrt(8 * b / cells) / spacing**2 * np.sin(np.pi * k / cells)
    table = np.zeros((2, cells - 1))
    for row, parity in zip(table, PARITIES):
        row[parity] = weights[parity]
    return table


class WallSystem:
    """The system 1 + R Q R^T of the walls' forces, factored.  Not collective.

    Parameters
    ----------
    inverse : ndarray, shape (n - 1, m - 1)
        Q.
    horizontal, vertical : ndarray, shapes (2, n - 1) and (2, m - 1)
        Rows of R for the horizontal and the vertical walls (see `_wall_weights`).
    """

    def __init__(self, inverse, horizontal, vertical):
        self._blocks = []
        for number_y, parity_y in enumerate(PARITIES):
            for number_x, parity_x in enumerate(PARITIES):
                q = inverse[parity_y, parity_x]
                along_y, along_x = horizontal[number_y, parity_y], vertical[number_x, parity_x]
                root = np.sqrt(1 + along_y**2 @ q)
                link = along_y[:, None] * q * (along_x / root)
                schur = -link @ link.T
                schur.flat[:: len(schur) + 1] += 1 + q @ along_x**2
                factor = cho_factor(schur, lower=True, overwrite_a=True, check_finite=False)
                places = (number_y, parity_x), (number_x, parity_y)
                self._blocks.append((places, root, link, factor))

    def solve(self, horizontal, vertical):
        """Replace the right-hand sides, shapes (2, m - 1) and (2, n - 1), by the answers."""
        for (here, there), root, link, factor in self._blocks:
            half = horizontal[here] / root
            vertical[there] = cho_solve(
                factor, vertical[there] - link @ half, check_finite=False)
            horizontal[here] = (half - vertical[there] @ link) / root


class Spectrum:
    """Transformed stream functions, on complete grid lines in one direction.  Collective.

    Parameters
    ----------
    grid : Grid
    axis : int
        Direction of the lines.

    Attributes
    ----------
    slabs : Slabs
    """

    def __init__(self, grid, axis):
        self.grid, self.axis = grid, axis
        self.comm = grid.comm.tompi4py()
        self.slabs = Slabs(grid.comm, [(grid.n - 1, grid.m - 1)], axis)
        self._product = np.empty(self.slabs.arrays[0].shape)
        self._sums = np.empty(2 * (grid.n - 1) + 2 * (grid.m - 1))
        self._horizontal = self._sums[: 2 * (grid.m - 1)].reshape(2, -1)
        self._vertical = self._sums[2 * (grid.m - 1) :].reshape(2, -1)

    def set_operator(self, a, b):
        """Set the coefficients of a - b Laplacian."""
        grid, (rows, columns) = self.grid, self.slabs.boxes[0]
        along_y = WALL_AT_POINT.eigenvalues(grid.n, grid.dy)
        along_x = WALL_AT_POINT.eigenvalues(grid.m, grid.dx)
        horizontal = _wall_weights(grid.n, grid.dy, b)
        vertical = _wall_weights(grid.m, grid.dx, b)

        def inverse(rows, columns):
            square = np.add.outer(along_y[rows], along_x[columns])
            return 1 / ((a + b * square) * square)

        self._inverse = inverse(rows, columns)
        self._weights = horizontal[:, rows], vertical[:, columns]
        self._walls = None
        if self.comm.rank == 0:
            everything = inverse(slice(None), slice(None)) if self.comm.size > 1 else self._inverse
            self._walls = WallSystem(everything, horizontal, vertical)

    def solve(self):
        """Replace forces on the stream function, transformed across the lines, by their answers."""
        (values,), (rows, columns) = self.slabs.arrays, self.slabs.boxes[0]
        basis, product = WALL_AT_POINT, self._product
        transform([basis.forward], self.axis, self.slabs)
        np.multiply(values, self._inverse, out=product)
        across, along = self._weights
        self._sums[:] = 0.0
        self._horizontal[:, columns] = across @ product
        self._vertical[:, rows] = along @ product.T
        self._solve_walls()
        left = np.concatenate((across, self._vertical[:, rows])).T
        right = np.concatenate((self._horizontal[:, columns], along))
        values -= np.matmul(left, right, out=product)
        values *= self._inverse
        transform([basis.inverse], self.axis, self.slabs)

    def _solve_walls(self):
        """Sum over the ranks; the first one solves for all."""
        total = self.comm.reduce(self._sums) if self.comm.size > 1 else self._sums
        if self.comm.rank == 0:
            self._sums[:] = total
            self._walls.solve(self._horizontal, self._vertical)
        if self.comm.size > 1:
            self.comm.Bcast(self._sums)

    def destroy(self):
        """Free the vector.  Collective."""
        self.slabs.vector.destroy()
