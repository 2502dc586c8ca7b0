"""The fluid's coupled problem as one for the stream function, between transforms.

Velocities without divergence, and zero through the walls, are u = Z psi, differences of a stream
function psi at the corners of the cells, zero on the walls; besides, where the box is periodic,
flows with a net flux (see `net_flows`).  With walls along which the fluid slips freely, sine and
Fourier transforms diagonalise

    Z^T (a - b Laplacian) Z = (a + b L) L,    L = minus the five-point Laplacian at the corners.

A wall at which it sticks, half a cell from the nearest velocities along it, adds
2 b / h^2 times the square of each of them: with R their weighted values (those of psi at the
corners next to the walls), in transformed space

    (Q^{-1} + R^T R) psi = g,    Q = 1 / ((a + b L) L),
    psi = Q (g - R^T s),    (1 + R Q R^T) s = R Q g.

The last matrix, one row a velocity along a wall, is symmetric positive definite.  In transforms
along each wall, and sums and differences of opposite walls, it is diagonal for two walls; for four
it falls into four blocks [[D1, E^T], [E, D2]] with diagonal D1 and D2 for the horizontal and the
vertical walls, whose Schur complements are factored once: a direct solve, as Bjorstad's of the
biharmonic equation (SIAM J. Numer. Anal. 20 (1983) 59-71), which this is in the limit of large b.
"""

import numpy as np
from mpi4py import MPI
from scipy.linalg import cho_factor, cho_solve

from .bases import corner_bases, velocity_fields
from .slabs import Slabs, transform

PARITIES = slice(0, None, 2), slice(1, None, 2)  # odd wave numbers, even ones


def _wall_weights(basis, cells, spacing, b):
    """Row of R for the sum (first) and the difference (second) of two opposite walls.

    Shape (2, cells - 1): the weight of each wave number across the walls, in orthonormal
    transforms; (0, cells) where there are none.
    """
    if not basis.given:
        return np.zeros((0, cells))
    k = np.arange(1, cells)
    weights = np.sqrt(8 * b / cells) / spacing**2 * np.sin(np.pi * k / cells)
    table = np.zeros((2, cells - 1))
    for row, parity in zip(table, PARITIES):
        row[parity] = weights[parity]
    return table


class TwoWalls:
    """The system 1 + R Q R^T of two opposite walls' forces.  Not collective.

    Parameters
    ----------
    diagonal : ndarray
        Its diagonal, and all that there is of it, less one.
    """

    def __init__(self, diagonal):
        self._diagonal = 1 + diagonal

    def solve(self, sums):
        """Replace the right-hand sides by the solutions."""
        sums /= self._diagonal


class FourWalls:
    """The system 1 + R Q R^T of the forces of four walls, factored.  Collective.

    Its four blocks are dealt out to the ranks.

    Parameters
    ----------
    inverse : callable
        Q for slices of its rows and columns.
    horizontal, vertical : ndarray, shapes (2, n - 1) and (2, m - 1)
        Rows of R for the horizontal and the vertical walls (see `_wall_weights`).
    comm : mpi4py communicator
    """

    def __init__(self, inverse, horizontal, vertical, comm):
        self._comm, self._blocks = comm, []
        self._split = vertical.size
        for number_y, parity_y in enumerate(PARITIES):
            for number_x, parity_x in enumerate(PARITIES):
                if (2 * number_y + number_x) % comm.size != comm.rank:
                    continue
                q = inverse(parity_y, parity_x)
                along_y, along_x = horizontal[number_y, parity_y], vertical[number_x, parity_x]
                root = np.sqrt(1 + along_y**2 @ q)
                link = along_y[:, None] * q * (along_x / root)
                schur = -link @ link.T
                schur.flat[:: len(schur) + 1] += 1 + q @ along_x**2
                factor = cho_factor(schur, lower=True, overwrite_a=True, check_finite=False)
                places = (number_y, parity_x), (number_x, parity_y)
                self._blocks.append((places, root, link, factor))

    def solve(self, sums):
        """Replace the right-hand sides, shapes (2, m - 1) and (2, n - 1), by the solutions."""
        horizontal, vertical = self._sides(sums.copy())
        sums[:] = 0.0
        answers = self._sides(sums)
        for (here, there), root, link, factor in self._blocks:
            half = horizontal[here] / root
            answer = cho_solve(factor, vertical[there] - link @ half, check_finite=False)
            answers[0][here], answers[1][there] = (half - answer @ link) / root, answer
        if self._comm.size > 1:
            self._comm.Allreduce(MPI.IN_PLACE, sums)

    def _sides(self, sums):
        return [part.reshape(2, -1) for part in np.split(sums, [self._split])]


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
    coefficients : (float, float) or None
        The a and b that it was set for.
    net_flows : list
        See `net_flows`.
    """

    def __init__(self, grid, axis):
        self.grid, self.axis = grid, axis
        self.coefficients = None
        self.comm = grid.comm.tompi4py()
        self._bases = corner_bases(grid)
        self._sizes = (grid.n, grid.dy), (grid.m, grid.dx)
        rows, columns = (
            basis.unknowns(cells) for basis, (cells, _) in zip(self._bases, self._sizes))
        self.slabs = Slabs(grid.comm, [(rows, columns)], axis)
        self._product = np.empty(self.slabs.arrays[0].shape)
        pairs_y, pairs_x = (2 if basis.given else 0 for basis in self._bases)
        self._sums = np.empty(pairs_y * columns + pairs_x * rows)
        self._horizontal = self._sums[: pairs_y * columns].reshape(pairs_y, columns)
        self._vertical = self._sums[pairs_y * columns :].reshape(pairs_x, rows)

    def set_operator(self, a, b):
        """Set the coefficients of a - b Laplacian."""
        self.coefficients = a, b
        self.net_flows = net_flows(self.grid, a, b)
        rows, columns = self.slabs.boxes[0]
        along_y, along_x = (
            basis.eigenvalues(*size) for basis, size in zip(self._bases, self._sizes))
        horizontal, vertical = (
            _wall_weights(basis, *size, b) for basis, size in zip(self._bases, self._sizes))

        def inverse(rows, columns):
            square = np.add.outer(along_y[rows], along_x[columns])
            square *= a + b * square
            # A constant is no flow.
            return np.divide(1, square, out=square, where=square > 0)

        self._inverse = inverse(rows, columns)
        self._weights = horizontal[:, rows], vertical[:, columns]
        if len(horizontal) and len(vertical):
            self._walls = FourWalls(inverse, horizontal, vertical, self.comm)
        elif self._sums.size:
            self._add_up(*(weights**2 for weights in self._weights), self._inverse)
            self._walls = TwoWalls(self._sums.copy())

    def solve(self):
        """Replace forces on the stream function, transformed across the lines, by psi."""
        (values,), basis = self.slabs.arrays, self._bases[self.axis]
        transform([basis.forward], self.axis, self.slabs)
        if self._sums.size:
            self._subtract_walls(values)
        values *= self._inverse
        transform([basis.inverse], self.axis, self.slabs)

    def _subtract_walls(self, values):
        """Take from the forces, transformed, those that the walls exert."""
        (rows, columns), product = self.slabs.boxes[0], self._product
        across, along = self._weights
        self._add_up(across, along, np.multiply(values, self._inverse, out=product))
        self._walls.solve(self._sums)
        left = np.concatenate((across, self._vertical[:, rows])).T
        right = np.concatenate((self._horizontal[:, columns], along))
        values -= np.matmul(left, right, out=product)

    def _add_up(self, across, along, values):
        """Sums of values with the weights of the walls, over all ranks and on all of them."""
        rows, columns = self.slabs.boxes[0]
        self._sums[:] = 0.0
        self._horizontal[:, columns] = across @ values
        self._vertical[:, rows] = along @ values.T
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, self._sums)

    def destroy(self):
        """Free the vector.  Collective."""
        self.slabs.vector.destroy()


def net_flows(grid, a, b):
    """The flows with a net flux that A0 = a - b Laplacian has besides those of the stream function.

    A uniform force along a periodic direction drives the flow w = A0^{-1} 1, between walls a
    channel's.  For every stream function, <w, A0 Z psi> = <1, Z psi> = 0, so that the responses
    of both parts add up: that of w to a force f is w <w, f> / <w, A0 w>.

    Returns
    -------
    list of ndarray or None
        w / sqrt(<w, A0 w>) of u by row and of v by column; None for a direction with walls.  Zero
        where A0 is singular (a = 0 without walls).
    """
    flows = []
    sizes = (grid.n, grid.dy), (grid.m, grid.dx)
    for number, field in enumerate(velocity_fields(grid)):
        if not grid.periodic[number]:
            flows.append(None)
            continue
        basis, (cells, spacing) = field.bases[number], sizes[number]
        values = a + b * basis.eigenvalues(cells, spacing)
        inverse = np.divide(1, values, out=values, where=values != 0)
        flow = basis.inverse(basis.forward(np.ones(cells)) * inverse)
        energy = flow.sum() * sizes[1 - number][0]
        flows.append(flow / np.sqrt(energy) if energy else flow)
    return flows
