"""The staggered grid: where each unknown lies and which PETSc number it has."""

import numpy as np
from petsc4py import PETSc


class Grid:
    """Uniform marker-and-cell grid of m x n cells on a box, distributed by DMStag.

    Velocity components live on cell faces (u on x-faces, v on y-faces) and the pressure at cell
    centres.  PETSc numbers unknowns rank by rank; arrays in *natural order* have row index y and
    column index x whatever the number of ranks.  Collective.

    Parameters
    ----------
    cells : (int, int)
        Cells m, n in x and y.
    domain : (float, float, float, float)
        The box (a, b, c, d): a <= x <= b, c <= y <= d.
    comm : MPI communicator, optional
        Default PETSC_COMM_WORLD.
    periodic : (bool, bool)
        Whether left and right sides are the same, and bottom and top ones.

    Attributes
    ----------
    dm : PETSc.DMStag
        Layout with dof (0, 1, 1): u, v and p together.
    velocity_dm, pressure_dm : PETSc.DMStag
        The same layout with faces only and with cells only.
    dx, dy : float
        Cell sizes.
    velocity_sizes, pressure_sizes : (int, int)
        Numbers of faces and of cells: this rank's, and all.
    u_index : ndarray of int, shape (n, m + 1), or (n, m) when periodic in x
    v_index : ndarray of int, shape (n + 1, m), or (n, m) when periodic in y
    p_index : ndarray of int, shape (n, m)
        PETSc number, in vectors of `velocity_dm` or `pressure_dm`, of each unknown in natural
        order.  Held by every rank.
    u_box, v_box, p_box : (slice, slice)
        Rows and columns of the natural arrays that this rank owns.
    """

    def __init__(self, cells, domain, comm=None, periodic=(False, False)):
        self.comm = comm or PETSc.COMM_WORLD
        self.m, self.n = (int(c) for c in cells)
        self.domain = tuple(float(x) for x in domain)
        a, b, c, d = self.domain
        self.dx, self.dy = (b - a) / self.m, (d - c) / self.n
        self.periodic = tuple(bool(direction) for direction in periodic)
        kind = PETSc.DM.BoundaryType
        self.dm = PETSc.DMStag().create(
            2,
            dofs=(0, 1, 1),
            sizes=(self.m, self.n),
            boundary_types=[kind.PERIODIC if wraps else kind.NONE for wraps in self.periodic],
            stencil_type=PETSc.DMStag.StencilType.BOX,
            stencil_width=1,
            comm=self.comm,
            setUp=False,
        )
        self.dm.setFromOptions()
        # Its own options may be those of another simulation in the same script.
        self.dm.setGlobalSizes((self.m, self.n))
        self.dm.setUp()
        self.velocity_dm = self.dm.createCompatibleDMStag((0, 1, 0))
        self.pressure_dm = self.dm.createCompatibleDMStag((0, 0, 1))
        self.velocity_sizes, self.pressure_sizes = map(
            _sizes, (self.velocity_vector(), self.pressure_vector()))
        self._number()

    @property
    def cell_area(self):
        """Area dx dy of a cell: the weight of a grid point in the discrete inner product."""
        return self.dx * self.dy

    @property
    def _lines_x(self):
        """Grid lines across x: the last is the first again where the box is periodic."""
        return self.m + (not self.periodic[0])

    @property
    def _lines_y(self):
        return self.n + (not self.periodic[1])

    def _number(self):
        (x0, y0), (nx, ny), (extra_x, extra_y) = self.dm.getCorners()
        rows, columns = slice(y0, y0 + ny), slice(x0, x0 + nx)
        self.p_box = (rows, columns)
        self.u_box = (rows, slice(x0, x0 + nx + extra_x))
        self.v_box = (slice(y0, y0 + ny + extra_y), columns)
        where = PETSc.DMStag.StencilLocation
        shape_u, shape_v = (self.n, self._lines_x), (self._lines_y, self.m)
        self.u_index = self.number(self.velocity_dm, where.LEFT, self.u_box, shape_u)
        self.v_index = self.number(self.velocity_dm, where.DOWN, self.v_box, shape_v)
        self.p_index = self.number(self.pressure_dm, where.ELEMENT, self.p_box, (self.n, self.m))

    def number(self, dm, location, box, shape, component=0):
        """PETSc numbers of one kind of unknown in natural order, on every rank.  Collective."""
        (gx, gy), (width, height) = dm.getGhostCorners()
        local = dm.getLGMap().indices.reshape(height, width, dm.getEntriesPerElement())
        slot = dm.getLocationSlot(location, component)
        rows, columns = box
        mine = local[rows.start - gy : rows.stop - gy, columns.start - gx : columns.stop - gx, slot]
        table = np.empty(shape, dtype=PETSc.IntType)
        for (r, c), part in self.comm.tompi4py().allgather((box, mine)):
            table[r, c] = part
        return table

    def way_home(self, point):
        """The translation by whole periods, (x, y), that takes a point (x, y) into the box."""
        low, high = np.reshape(self.domain, (2, 2)).T
        periods = np.floor((np.asarray(point) - low) / (high - low))
        return np.where(self.periodic, -periods * (high - low), 0.0)

    def velocity_vector(self):
        """New zero vector over all faces."""
        return self.velocity_dm.createGlobalVec()

    def pressure_vector(self):
        """New zero vector over all cells."""
        return self.pressure_dm.createGlobalVec()

    def u_points(self, box=(slice(None), slice(None))):
        """Coordinates x (1, columns) and y (rows, 1) of the x-faces in `box`."""
        a, _, c, _ = self.domain
        x = a + np.arange(self._lines_x) * self.dx
        y = c + (np.arange(self.n) + 0.5) * self.dy
        return x[None, box[1]], y[box[0], None]

    def v_points(self, box=(slice(None), slice(None))):
        """Coordinates x (1, columns) and y (rows, 1) of the y-faces in `box`."""
        a, _, c, _ = self.domain
        x = a + (np.arange(self.m) + 0.5) * self.dx
        y = c + np.arange(self._lines_y) * self.dy
        return x[None, box[1]], y[box[0], None]

    def p_points(self, box=(slice(None), slice(None))):
        """Coordinates x (1, columns) and y (rows, 1) of the cell centres in `box`."""
        a, _, c, _ = self.domain
        x = a + (np.arange(self.m) + 0.5) * self.dx
        y = c + (np.arange(self.n) + 0.5) * self.dy
        return x[None, box[1]], y[box[0], None]

    def local_positions(self, index, box, vector):
        """Positions in this rank's part of `vector` of the natural entries in `box`.

        Returns an integer array of the shape of the box.  Not collective.
        """
        return index[box] - vector.getOwnershipRange()[0]

    def velocity_blocks(self, vector):
        """Copies of this rank's parts of u and v in natural order (shapes of u_box, v_box)."""
        values = vector.getArray(readonly=True)
        return (
            values[self.local_positions(self.u_index, self.u_box, vector)],
            values[self.local_positions(self.v_index, self.v_box, vector)],
        )

    def pressure_block(self, vector):
        """Copy of this rank's part of p in natural order (shape of p_box)."""
        return vector.getArray(readonly=True)[
            self.local_positions(self.p_index, self.p_box, vector)
        ]

    def set_velocity(self, vector, u, v):
        """Set this rank's entries from natural blocks u, v of the shapes of u_box, v_box."""
        values = vector.getArray()
        values[self.local_positions(self.u_index, self.u_box, vector)] = u
        values[self.local_positions(self.v_index, self.v_box, vector)] = v

    def set_pressure(self, vector, p):
        """Set this rank's entries from a natural block p of the shape of p_box."""
        vector.getArray()[self.local_positions(self.p_index, self.p_box, vector)] = p


def _sizes(vector):
    """Local and global size of a vector, which is not needed any more."""
    sizes = vector.getSizes()
    vector.destroy()
    return sizes
