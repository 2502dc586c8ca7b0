"""Interpolation of grid velocity to the markers, and its adjoint, spreading."""

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix


class Stencil:
    """Which faces a set of markers sees, and with which weights.  Not collective.

    Parameters
    ----------
    grid : Grid
    kernel : Kernel
    markers : ndarray, shape (M, 2)
        Positions x, y.

    Attributes
    ----------
    u, v : (rows, columns, weights)
        Integer arrays of shapes (M, r, 1) and (M, 1, c), and weights (M, r, c), of the x-faces
        and of the y-faces.  Where the box is periodic they are counted from 0 again, wherever the
        marker has gone.
    """

    def __init__(self, grid, kernel, markers):
        lattice, periods = self.lattice(grid, markers)
        (x_along, y_along), (x_across, y_across) = (
            self.lines(lattice - shift, weight, radius, periods)
            for shift, weight, radius in (
                (0.0, kernel.along, kernel.along_radius),
                (0.5, kernel.across, kernel.across_radius),
            )
        )
        self.u = self.product(y_across, x_along)
        self.v = self.product(y_along, x_across)

    @staticmethod
    def lattice(grid, points):
        """Coordinates of points in grid spacings, shape (2, M), and the periods in x and in y.

        A period is a number of grid lines, or None between walls.
        """
        a, _, c, _ = grid.domain
        periods = [cells if wraps else None
                   for cells, wraps in zip((grid.m, grid.n), grid.periodic)]
        return np.stack(((points[:, 0] - a) / grid.dx, (points[:, 1] - c) / grid.dy)), periods

    @staticmethod
    def lines(positions, weight, radius, periods):
        """Grid lines within `radius` of each of two coordinates: indices and weights."""
        first = np.ceil(positions - radius).astype(PETSc.IntType)
        lines = first[:, :, None] + np.arange(round(2 * radius), dtype=PETSc.IntType)
        weights = weight(lines - positions[:, :, None])
        return [
            (part if period is None else part % period, part_weights)
            for part, period, part_weights in zip(lines, periods, weights)
        ]

    @staticmethod
    def product(vertical, horizontal):
        """Rows, columns and weights of all pairs of a line across y and one across x."""
        rows, row_weights = vertical
        columns, column_weights = horizontal
        weights = row_weights[:, :, None] * column_weights[:, None, :]
        return rows[:, :, None], columns[:, None, :], weights

    def csr(self, u_table, v_table, origin=(0, 0)):
        """Rows (u then v of each marker) of the interpolation matrix.

        Parameters
        ----------
        u_table, v_table : ndarray of int
            Column number of each face, in natural order from row and column `origin` on.
        origin : (int, int)

        Returns
        -------
        (row starts, columns, values)
        """
        count = len(self.u[2])
        columns, values, widths = [], [], []
        for (rows, cols, weights), table in ((self.u, u_table), (self.v, v_table)):
            widths.append(weights.shape[1] * weights.shape[2])
            columns.append(table[rows - origin[0], cols - origin[1]].reshape(count, widths[-1]))
            values.append(weights.reshape(count, widths[-1]))
        starts = np.concatenate(([0], np.cumsum(np.tile(widths, count))))
        return (
            starts.astype(PETSc.IntType),
            np.concatenate(columns, axis=1).ravel().astype(PETSc.IntType),
            np.concatenate(values, axis=1).ravel(),
        )


class Interpolation:
    """The sparse interpolation matrix J at given marker positions.  Collective.

    Rows 2k and 2k + 1 are the velocity components of marker k; all rows belong to rank 0, the
    columns follow the grid's layout.  Spreading is 1 / (dx dy) times the transpose, hence exactly
    adjoint in the discrete inner products.

    Parameters
    ----------
    grid : Grid
    kernel : Kernel
    markers : ndarray, shape (M, 2)
        Positions on rank 0; shape (0, 2) on the other ranks.
    stresses : StressInterpolation, optional
        At the same markers, where the viscosity varies; owned.

    Attributes
    ----------
    stencil : Stencil
    """

    def __init__(self, grid, kernel, markers, stresses=None):
        self.grid, self.stresses = grid, stresses
        self.stencil = Stencil(grid, kernel, markers)
        self._count = len(markers)
        self._matrix = self._values = self._near = None

    def use(self, near, matrix):
        """Interpolate by way of the faces near the markers, without a matrix over all of them.

        Parameters
        ----------
        near : Near
            Gathers a velocity vector's values there (see `petscib.solvers.force`).
        matrix : scipy.sparse.csr_matrix
            J on these faces.
        """
        self._near = near, matrix

    @property
    def matrix(self):
        """J as a parallel PETSc matrix, assembled when first asked for.  Collective."""
        if self._matrix is None:
            self._matrix = PETSc.Mat().createAIJ(
                ((2 * self._count, PETSc.DETERMINE), self.grid.velocity_sizes),
                csr=self.stencil.csr(self.grid.u_index, self.grid.v_index),
                comm=self.grid.comm,
            )
            self._values = self._matrix.createVecLeft()
        return self._matrix

    def on_root(self):
        """J as a csr_matrix on rank 0: over the faces near the markers, or over all.

        Not collective.
        """
        if self._near is not None:
            return self._near[1]
        u, v = self.grid.u_index, self.grid.v_index
        faces = np.arange(u.size + v.size)
        starts, columns, values = self.stencil.csr(
            faces[: u.size].reshape(u.shape), faces[u.size :].reshape(v.shape))
        return csr_matrix((values, columns, starts), (2 * self._count, len(faces)))

    def interpolate(self, velocity):
        """Velocity U at the markers: (M, 2) on rank 0, (0, 2) elsewhere."""
        if self._near is not None:
            near, matrix = self._near
            return (matrix @ near.gather(velocity)).reshape(-1, 2)
        self.matrix.mult(velocity, self._values)
        return self._values.getArray(readonly=True).reshape(-1, 2).copy()

    def spread_add(self, force, vector):
        """Add the spread force to `vector`.

        Parameters
        ----------
        force : ndarray, shape (M, 2)
            Force on each marker, on rank 0; (0, 2) elsewhere.
        vector : PETSc.Vec
            Over all faces; force per unit area is added.
        """
        matrix = self.matrix
        self._values.getArray()[:] = force.ravel() / self.grid.cell_area
        matrix.multTransposeAdd(self._values, vector, vector)

    def destroy(self):
        """Free the matrix.  Collective; left to Python it would outlive the step."""
        if self.stresses is not None:
            self.stresses.destroy()
            self.stresses = None
        if self._matrix is not None:
            self._matrix.destroy()
            self._values.destroy()
            self._matrix = None
