"""Rates of strain on the staggered grid, from which viscous forces are made.

The stretching rates u_x and v_y lie at cell centres, the shearing rate u_y + v_x at the corners of
cells.  Half a cell beyond a wall a velocity is 2 u_wall - u_inside, as in the Laplacian.
"""

import numpy as np
from petsc4py import PETSc

from .operators import assemble, shifted
from .sides import OUTWARDS, WALLS


class Strain:
    """The matrix E of the strain rates e = E u + `walls`, and where they lie.  Collective.

    With the weights h^2 at cells and corners, and half of that at corners on walls, E^T E is up to
    factors the viscous operator; at the corners of the box nothing is sheared.

    Parameters
    ----------
    operators : Operators

    Attributes
    ----------
    matrix : PETSc.Mat
        E; the columns of wall faces are zero.
    x_index, y_index : ndarray of int, shape (n, m)
    corner_index : ndarray of int, shape of lines across y and across x
        PETSc number of each strain rate, in natural order: u_x, v_y and the shearing rate.
    weights : PETSc.Vec
        2, 2 and 1, so that viscosity times weight is stress; 1/2 for corners on walls.
    walls : PETSc.Vec or None
        What the walls' velocities add; None when they are at rest.
    """

    def __init__(self, operators):
        grid = self.grid = operators.grid
        dm = self._dm = grid.dm.createCompatibleDMStag((1, 0, 2))
        where = PETSc.DMStag.StencilLocation
        lines_x, lines_y = grid.u_index.shape[1], grid.v_index.shape[0]
        cells = grid.n, grid.m
        self.corner_box = grid.v_box[0], grid.u_box[1]
        self.x_index = grid.number(dm, where.ELEMENT, grid.p_box, cells)
        self.y_index = grid.number(dm, where.ELEMENT, grid.p_box, cells, 1)
        self.corner_index = grid.number(dm, where.DOWN_LEFT, self.corner_box, (lines_y, lines_x))
        self.weights = self.vector()
        self._assemble(operators)
        self.walls = self._of_walls(operators.sides) if operators.sides.moving else None

    def vector(self):
        """New zero vector over all strain rates."""
        return self._dm.createGlobalVec()

    def _places(self, index, box):
        return self.grid.local_positions(index, box, self.weights)

    def _on_walls(self):
        """How many walls each of this rank's corners is on."""
        count = np.zeros(self.corner_index.shape, dtype=int)
        if not self.grid.periodic[0]:
            count[:, [0, -1]] += 1
        if not self.grid.periodic[1]:
            count[[0, -1], :] += 1
        return count[self.corner_box]

    def _assemble(self, operators):
        grid, size = self.grid, self.weights.getLocalSize()
        columns = np.full((size, 4), -1, dtype=PETSc.IntType)
        values, weights = np.zeros((size, 4)), self.weights.getArray()
        u, v, box = operators.u_unknown, operators.v_unknown, grid.p_box

        def join(row, *entries):
            for slot, (table, box, shift, value) in enumerate(entries):
                columns[row, slot] = shifted(table, box, *shift, grid.periodic)
                values[row, slot] = value

        x, y = self._places(self.x_index, box), self._places(self.y_index, box)
        join(x, (u, box, (0, 1), 1 / grid.dx), (u, box, (0, 0), -1 / grid.dx))
        join(y, (v, box, (1, 0), 1 / grid.dy), (v, box, (0, 0), -1 / grid.dy))
        weights[x], weights[y] = 2.0, 2.0

        box, on_walls = self.corner_box, self._on_walls()
        row = self._places(self.corner_index, box)
        # Across a wall the difference is that to the velocity inside with its sign changed.
        twice = np.where(on_walls == 0, 1.0, 2.0) * (on_walls < 2)
        join(row, (u, box, (0, 0), twice / grid.dy), (u, box, (-1, 0), -twice / grid.dy),
             (v, box, (0, 0), twice / grid.dx), (v, box, (0, -1), -twice / grid.dx))
        weights[row] = np.where(on_walls == 0, 1.0, 0.5)
        shape = self.weights.getSizes(), grid.velocity_sizes
        self.matrix = assemble(grid.comm, shape, columns, values)

    def _of_walls(self, sides):
        """Strain rates of a velocity that is zero but for the walls."""
        grid = self.grid
        x, y = np.zeros(self.x_index.shape), np.zeros(self.y_index.shape)
        corners = np.zeros(self.corner_index.shape)
        # For each direction: stretching rates and corners, lines across it first, and spacings.
        views = (x.T, corners.T, grid.dx, grid.dy), (y, corners, grid.dy, grid.dx)
        for side, normal in sides.normal.items():
            direction, end = WALLS[side]
            stretching, shearing, across, along = views[direction]
            stretching[end] += OUTWARDS[end] * normal / across
            # The places along the wall that are not on another wall; the normal velocities
            # between which they lie.
            inner, ring = slice(1, -1), normal
            if grid.periodic[1 - direction]:
                inner, ring = slice(None), np.concatenate((normal[-1:], normal))
            shearing[end, inner] += OUTWARDS[end] * 2 / across * sides.tangential[side][inner]
            shearing[end, inner] += np.diff(ring) / along
        strain = self.vector()
        values = strain.getArray()
        for part, index, box in ((x, self.x_index, grid.p_box), (y, self.y_index, grid.p_box),
                                 (corners, self.corner_index, self.corner_box)):
            values[self._places(index, box)] = part[box]
        return strain

    def averages(self):
        """Matrices of the means of the cells around each strain rate, and around each face.

        Returns
        -------
        to_strain, to_faces : PETSc.Mat
            From cells.  A stretching rate has the value of its cell, a corner the mean of four,
            and a place on a wall that of those inside.
        """
        grid, faces = self.grid, self.grid.velocity_vector()

        def mean(vector, parts):
            columns = np.full((vector.getLocalSize(), 4), -1, dtype=PETSc.IntType)
            for index, box, shifts in parts:
                row = grid.local_positions(index, box, vector)
                for slot, shift in enumerate(shifts):
                    columns[row, slot] = shifted(grid.p_index, box, *shift, grid.periodic)
            values = (columns >= 0) / np.maximum(np.sum(columns >= 0, axis=1), 1)[:, None]
            shape = vector.getSizes(), grid.pressure_sizes
            return assemble(grid.comm, shape, columns, values)

        to_strain = mean(self.weights, (
            (self.x_index, grid.p_box, [(0, 0)]), (self.y_index, grid.p_box, [(0, 0)]),
            (self.corner_index, self.corner_box, [(0, 0), (-1, 0), (0, -1), (-1, -1)])))
        to_faces = mean(faces, ((grid.u_index, grid.u_box, [(0, 0), (0, -1)]),
                                (grid.v_index, grid.v_box, [(0, 0), (-1, 0)])))
        faces.destroy()
        return to_strain, to_faces

    def destroy(self):
        """Free matrix and vectors.  Collective."""
        for part in (self.matrix, self.weights, self.walls):
            if part is not None:
                part.destroy()
