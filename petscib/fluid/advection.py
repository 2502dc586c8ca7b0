"""Advection of momentum in skew-symmetric form, which neither makes nor takes energy.

The momentum equation gets rho N(U) w on its left, with the transport U interpolated to the links
between the faces of one component: for u, with i along x and j along y,

    N(U) w = [Ub_{i+1/2} w_{i+1} - Ub_{i-1/2} w_{i-1}] / (2 dx)
             + [Vb_{j+1/2} w_{j+1} - Vb_{j-1/2} w_{j-1}] / (2 dy),

and likewise for v.  For div U = 0 it is the divergence form; for any U, w . N(U) w has nothing but
the terms of links to walls, and those are zero where no fluid passes through them (Morinishi,
Lund, Vasilyev & Moin 1998).  Half a cell beyond a wall, w is 2 w_wall - w_inside.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from .sides import WALLS

# CFL number to which explicit treatment is kept; where the cell Reynolds number is below 1, divided
# by it.  By cn vortices stay finite up to 0.85 and 1.2 at cell Reynolds numbers of 62 and 16
# (-scene taylor-green -domain 0,2,0,1 -shear_rate 3.1416 -stag_grid_x 64 -fft -advection explicit
# -ts_max_time 4 -mu 0.0005 and 0.002), and 200 steps in the cavity up to 2 at 1, and up to all that
# was tried, 40 and 400, at 0.2 and 0.02 (-scene cavity -scheme cn -stag_grid_x 32 -fft -advection
# explicit -mu 0.03125, 0.15625 and 1.5625).
LARGEST_CFL = 0.7


class Advection:
    """rho N(U), applied with the neighbouring ranks' values next to this rank's.  Collective.

    Parameters
    ----------
    operators : Operators
    rho : float
    implicit : bool
        Whether w is the stage velocity to be solved for, or U itself.

    Attributes
    ----------
    source : PETSc.Vec or None
        What the walls' tangential velocities add to rho N(U) w.  It is the same for every U, of
        which it depends on the values on walls alone.  None where no fluid passes through walls.
    """

    def __init__(self, operators, rho, implicit):
        self.grid, self.rho, self.implicit = operators.grid, rho, implicit
        grid = self.grid
        self._local = grid.velocity_dm.createLocalVec()
        (x, y), (nx, ny), _ = grid.dm.getCorners()
        (left, low), (width, height) = grid.velocity_dm.getGhostCorners()
        self._shape = height, width, 2
        where = PETSc.DMStag.StencilLocation
        self._slots = [grid.velocity_dm.getLocationSlot(place, 0)
                       for place in (where.LEFT, where.DOWN)]
        # Fields of this rank's cells with one more all around: entry (j, i) of u is the left face
        # of a cell, of v the lower one.  Beyond walls there is nothing to fill in from.
        self._fields = np.zeros((2, ny + 2, nx + 2))
        rows, columns = low - y + 1, left - x + 1
        self._filled = slice(rows, rows + height), slice(columns, columns + width)
        box = slice(y, y + ny), slice(x, x + nx)
        vector = grid.velocity_vector()
        self._places = [grid.local_positions(index, box, vector)
                        for index in (grid.u_index, grid.v_index)]
        vector.destroy()
        # Which of the four walls this rank touches.
        ends = {"left": x == 0, "right": x + nx == grid.m,
                "bottom": y == 0, "top": y + ny == grid.n}
        self._walls = [name for name in WALLS if ends[name] and not grid.periodic[WALLS[name][0]]]
        self._links = None
        self.source = None
        if operators.wall_faces:
            self._find_source(operators.sides, box)

    def _find_source(self, sides, box):
        """Apply N to a velocity that is zero but for what lies beyond the walls."""
        transport, self.source = self.grid.velocity_vector(), self.grid.velocity_vector()
        sides.fill(transport)
        self.carry(transport)
        fields = self._fields
        fields[:] = 0.0
        for name in self._walls:
            direction, end = WALLS[name]
            along = sides.tangential[name][box[direction]]
            lines = fields[1, 1:-1, :].T if direction == 0 else fields[0, :, 1:-1]
            lines[end] = 2 * along
        self._apply(fields, self.source, 1.0)
        transport.destroy()

    def _fill(self, velocity):
        """The fields of a velocity vector on this rank, with those around it."""
        self.grid.velocity_dm.globalToLocal(velocity, self._local)
        values = self._local.getArray(readonly=True).reshape(self._shape)
        for field, slot in zip(self._fields, self._slots):
            field[self._filled] = values[:, :, slot]
        return self._fields

    def carry(self, transport):
        """Take over the transport U, a velocity vector.  Collective."""
        u, v = self._fill(transport)
        here = slice(1, -1)
        x, y = self.rho / (2 * self.grid.dx), self.rho / (2 * self.grid.dy)
        # rho U / (2 dx) on the links of u and v along x, each with both its ends ...
        across = (x / 2 * (u[here, 1:] + u[here, :-1]), x / 2 * (u[1:, 1:] + u[:-1, 1:]))
        # ... and rho V / (2 dy) on those along y.
        up = (y / 2 * (v[1:, 1:] + v[1:, :-1]), y / 2 * (v[1:, here] + v[:-1, here]))
        # A cell's left face has the corners below and above to its left, its lower face has those
        # to the left and right below it.
        self._links = [(across[0][:, 1:], across[0][:, :-1], up[0][1:, :-1], up[0][:-1, :-1]),
                       (across[1][:-1, 1:], across[1][:-1, :-1], up[1][1:, :], up[1][:-1, :])]

    def add(self, velocity, vector, factor=1.0):
        """Add factor rho N(U) w to a vector, with walls at rest beyond their faces.  Collective.

        Parameters
        ----------
        velocity, vector : PETSc.Vec
            w, its values on wall faces included; what is added to is zero there.
        factor : float
        """
        fields = self._fill(velocity)
        for name in self._walls:
            direction, end = WALLS[name]
            lines = fields[1].T if direction == 0 else fields[0]
            lines[end] = -lines[1 if end == 0 else -2]
        self._apply(fields, vector, factor)

    def _apply(self, fields, vector, factor):
        values, here = vector.getArray(), slice(1, -1)
        for component, (w, links, places) in enumerate(zip(fields, self._links, self._places)):
            east, west, north, south = links
            with np.errstate(over="ignore", invalid="ignore"):  # a step's result is checked
                change = (east * w[here, 2:] - west * w[here, :-2]
                          + north * w[2:, here] - south * w[:-2, here])
            if ("left", "bottom")[component] in self._walls:  # whose faces keep their values
                (change.T if component == 0 else change)[0] = 0.0
            values[places] += factor * change

    def load(self, rhs, transport):
        """Take over the transport, and subtract what does not depend on the solution.  Collective.

        Parameters
        ----------
        rhs : PETSc.Vec
            Force per area on the faces, less that of advection on return.
        transport : PETSc.Vec
            U.
        """
        self.carry(transport)
        if self.source is not None:
            rhs.axpy(-1.0, self.source)
        if not self.implicit:
            self.add(transport, rhs, -1.0)

    def power(self, transport, velocity):
        """w . rho N(U) w, or w . rho N(U) U where it is explicit, summed over the faces.

        Times the cells' area it is a power.  Collective.
        """
        force = velocity.duplicate()
        force.set(0.0)
        self.carry(transport)
        self.add(velocity if self.implicit else transport, force)
        if self.source is not None:
            force.axpy(1.0, self.source)
        power = velocity.dot(force)
        force.destroy()
        return power

    def longest_step(self, velocity, mu):
        """Largest stable time step at a velocity; infinite when implicit.  Collective.

        Parameters
        ----------
        velocity : PETSc.Vec
        mu : float
            Viscosity.
        """
        if self.implicit:
            return np.inf
        grid = self.grid
        local = np.array([np.abs(part).max(initial=0) for part in grid.velocity_blocks(velocity)])
        speeds = np.empty(2)
        grid.comm.tompi4py().Allreduce(local, speeds, op=MPI.MAX)
        spacings = np.array([grid.dx, grid.dy])
        with np.errstate(divide="ignore"):
            cfl = LARGEST_CFL * np.maximum(1.0, mu / (self.rho * speeds * spacings))
            return float(np.min(cfl * spacings / speeds))

    def destroy(self):
        """Free its vectors.  Collective."""
        self._local.destroy()
        if self.source is not None:
            self.source.destroy()
