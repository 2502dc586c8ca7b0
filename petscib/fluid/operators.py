"""Assembled difference operators on the staggered grid.

Faces on the walls carry Dirichlet data: their rows and columns in the Laplacian are empty and the
gradient is zero there, so that the equations of a wall face read "keep the given value".  Across
periodic sides the stencils go on.
"""

import numpy as np
from petsc4py import PETSc

from .sides import OUTWARDS, WALLS


def assemble(comm, shape, columns, values):
    """Assemble a parallel sparse matrix from at most w entries a row.

    Parameters
    ----------
    comm : MPI communicator
    shape : ((int, int), (int, int))
        Local and global numbers of rows, and of columns.
    columns : ndarray of int, shape (local rows, w)
        Global column numbers; negative ones are left out.
    values : ndarray, shape (local rows, w)

    Returns
    -------
    PETSc.Mat
    """
    order = np.argsort(columns, axis=1)
    columns = np.take_along_axis(columns, order, axis=1)
    values = np.take_along_axis(values, order, axis=1)
    keep = columns >= 0
    row_starts = np.concatenate(([0], np.cumsum(keep.sum(axis=1)))).astype(PETSc.IntType)
    matrix = PETSc.Mat().createAIJ(
        shape, csr=(row_starts, columns[keep].astype(PETSc.IntType), values[keep]), comm=comm
    )
    matrix.assemble()
    return matrix


def shifted(table, box, row, column, periodic=(False, False)):
    """Entries of `table` over `box` moved by (row, column).

    Beyond a periodic side (flags in x and y) they are those within the other; beyond walls, -1.
    """
    rows, columns = (
        np.arange(part.start, part.stop) + shift for part, shift in zip(box, (row, column))
    )
    inside = []
    for axis, places in enumerate((rows, columns)):
        size = table.shape[axis]
        inside.append(np.full(len(places), True) if periodic[1 - axis]
                      else (places >= 0) & (places < size))
        places %= size
    return np.where(np.logical_and.outer(*inside), table[np.ix_(rows, columns)], -1)


class Operators:
    """Laplacian, gradient, divergence and the walls' contributions.  Collective.

    Parameters
    ----------
    grid : Grid
    sides : Sides

    Attributes
    ----------
    laplacian : PETSc.Mat
        Five-point Laplacian of both velocity components, symmetric; rows and columns of wall
        faces are zero.
    gradient : PETSc.Mat
        From cells to faces; rows of wall faces are zero.
    divergence : PETSc.Mat
        From faces to cells, wall faces included.  On the other faces it is minus the transpose
        of the gradient.
    pressure_laplacian : PETSc.Mat
        Minus divergence times gradient, positive semidefinite for use with conjugate gradients,
        with the constants as its null space.
    wall_source : PETSc.Vec or None
        What the walls' velocities add to the Laplacian; None when the walls are at rest.
    wall_flux : PETSc.Vec or None
        What the normal velocities of the walls add to the divergence; None when they are zero.
    wall_norm : float
        Sum over wall links of the squared wall velocity over the squared spacing, as it enters
        the squared norm of the velocity gradient.
    wall_faces : float
        Sum of the squared velocities on wall faces; half of each lies outside the box.
    """

    def __init__(self, grid, sides):
        self.grid = grid
        self.sides = sides
        self._faces = grid.velocity_vector()
        self._cells = grid.pressure_vector()
        self._find_wall_faces()
        self.laplacian = self._assemble_laplacian()
        self.gradient = self._assemble_gradient()
        self.divergence = self._assemble_divergence()
        self.pressure_laplacian = self._assemble_pressure_laplacian()
        self.wall_source, self.wall_flux, self.wall_norm, self.wall_faces = None, None, 0.0, 0.0
        if sides.moving:
            self._assemble_wall_terms()

    def _find_wall_faces(self):
        grid = self.grid
        self.u_unknown, self.v_unknown = grid.u_index.copy(), grid.v_index.copy()
        if not grid.periodic[0]:
            self.u_unknown[:, [0, -1]] = -1
        if not grid.periodic[1]:
            self.v_unknown[[0, -1], :] = -1

    def _neighbours(self, table, box, row, column):
        return shifted(table, box, row, column, self.grid.periodic)

    def force(self, *force):
        """New velocity vector of a force that acts on all faces but those of walls.

        Its two components are numbers, or arrays of the shapes of u_box and v_box.
        """
        grid, vector = self.grid, self.grid.velocity_vector()
        inner = self.u_unknown[grid.u_box] >= 0, self.v_unknown[grid.v_box] >= 0
        grid.set_velocity(vector, *(size * part for size, part in zip(force, inner)))
        return vector

    def _shape(self, rows, columns):
        return (rows.getSizes(), columns.getSizes())

    def _assemble_laplacian(self):
        grid = self.grid
        rx, ry = 1 / grid.dx**2, 1 / grid.dy**2
        size = self._faces.getLocalSize()
        columns = np.full((size, 5), -1, dtype=PETSc.IntType)
        values = np.zeros((size, 5))
        components = (
            (self.u_unknown, grid.u_index, grid.u_box, ry, 0),
            (self.v_unknown, grid.v_index, grid.v_box, rx, 1),
        )
        for unknown, index, box, half, axis in components:
            here = unknown[box]
            neighbours = [
                self._neighbours(unknown, box, *shift)
                for shift in ((0, -1), (0, 1), (-1, 0), (1, 0))
            ]
            diagonal = np.full(here.shape, -2 * (rx + ry))
            if not grid.periodic[1 - axis]:
                # A wall half a cell away: the ghost value 2 u_wall - u_inside adds to the diagonal.
                across = np.arange(index.shape[axis])[box[axis]]
                count = (across == 0).astype(float) + (across == index.shape[axis] - 1)
                diagonal -= half * (count[:, None] if axis == 0 else count[None, :])
            weights = (rx, rx, ry, ry)
            row = grid.local_positions(index, box, self._faces)
            inner = here >= 0
            # Wall faces keep a zero on the diagonal, so that adding to it later is cheap.
            columns[row, 0] = index[box]
            values[row[inner], 0] = diagonal[inner]
            for slot, (neighbour, weight) in enumerate(zip(neighbours, weights), start=1):
                columns[row[inner], slot] = neighbour[inner]
                values[row[inner], slot] = weight
        matrix = assemble(grid.comm, self._shape(self._faces, self._faces), columns, values)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return matrix

    def _assemble_gradient(self):
        grid = self.grid
        size = self._faces.getLocalSize()
        columns = np.full((size, 2), -1, dtype=PETSc.IntType)
        values = np.zeros((size, 2))
        components = (
            (self.u_unknown, grid.u_index, grid.u_box, (0, -1), grid.dx),
            (self.v_unknown, grid.v_index, grid.v_box, (-1, 0), grid.dy),
        )
        for unknown, index, box, back, spacing in components:
            inner = unknown[box] >= 0
            row = grid.local_positions(index, box, self._faces)[inner]
            columns[row, 0] = self._neighbours(grid.p_index, box, *back)[inner]
            columns[row, 1] = self._neighbours(grid.p_index, box, 0, 0)[inner]
            values[row] = (-1 / spacing, 1 / spacing)
        return assemble(grid.comm, self._shape(self._faces, self._cells), columns, values)

    def _assemble_divergence(self):
        grid = self.grid
        faces = (
            grid.u_index[grid.p_box],
            self._neighbours(grid.u_index, grid.p_box, 0, 1),
            grid.v_index[grid.p_box],
            self._neighbours(grid.v_index, grid.p_box, 1, 0),
        )
        weights = (-1 / grid.dx, 1 / grid.dx, -1 / grid.dy, 1 / grid.dy)
        row = grid.local_positions(grid.p_index, grid.p_box, self._cells)
        columns = np.empty((self._cells.getLocalSize(), 4), dtype=PETSc.IntType)
        values = np.empty(columns.shape)
        for slot, (face, weight) in enumerate(zip(faces, weights)):
            columns[row, slot] = face
            values[:, slot] = weight
        return assemble(grid.comm, self._shape(self._cells, self._faces), columns, values)

    def _assemble_pressure_laplacian(self):
        grid = self.grid
        rx, ry = 1 / grid.dx**2, 1 / grid.dy**2
        row = grid.local_positions(grid.p_index, grid.p_box, self._cells)
        columns = np.empty((self._cells.getLocalSize(), 5), dtype=PETSc.IntType)
        values = np.zeros(columns.shape)
        columns[row, 0] = grid.p_index[grid.p_box]
        shifts = (((0, -1), rx), ((0, 1), rx), ((-1, 0), ry), ((1, 0), ry))
        for slot, (shift, weight) in enumerate(shifts, start=1):
            columns[row, slot] = self._neighbours(grid.p_index, grid.p_box, *shift)
            values[:, slot] = -weight
        values[:, 0] = -np.where(columns[:, 1:] >= 0, values[:, 1:], 0.0).sum(axis=1)
        matrix = assemble(grid.comm, self._shape(self._cells, self._cells), columns, values)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrix.setNullSpace(PETSc.NullSpace().create(constant=True, comm=grid.comm))
        return matrix

    def _assemble_wall_terms(self):
        grid, sides = self.grid, self.sides
        u, v = np.zeros(grid.u_index.shape), np.zeros(grid.v_index.shape)
        flux = np.zeros(grid.p_index.shape)
        # For each direction: its own component, the other one, cells and spacing, lines first.
        views = (u.T, v.T, flux.T, grid.dx), (v, u, flux, grid.dy)
        for side, normal in sides.normal.items():
            direction, end = WALLS[side]
            across, along, cells, spacing = views[direction]
            # The places along the wall that are not on another wall.
            inner = slice(None) if grid.periodic[1 - direction] else slice(1, -1)
            tangential = sides.tangential[side][inner]
            across[1 if end == 0 else -2] += normal / spacing**2
            along[end, inner] += 2 / spacing**2 * tangential
            cells[end] += OUTWARDS[end] * normal / spacing
            self.wall_norm += (np.sum(normal**2) + 2 * np.sum(tangential**2)) / spacing**2
            self.wall_faces += np.sum(normal**2)
        self.wall_source = grid.velocity_vector()
        grid.set_velocity(self.wall_source, u[grid.u_box], v[grid.v_box])
        if self.wall_faces:
            self.wall_flux = grid.pressure_vector()
            grid.set_pressure(self.wall_flux, flux[grid.p_box])
