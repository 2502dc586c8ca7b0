"""Fast direct solver of the fluid's coupled system: velocity and pressure at once."""

import numpy as np
from petsc4py import PETSc

from ...fluid.operators import assemble
from .bases import X, Y, corner_bases, given_places, velocity_fields
from .diagonal import PoissonTransform
from .slabs import Slabs, transform
from .stream import Spectrum
from .windows import extent


class StokesWindow:
    """The velocities without divergence that forces on some faces cause there.  Collective.

    R Z (Z^T A0 Z)^{-1} Z^T R^T, with R the restriction to the faces and Z the curl of a stream
    function, and the same for net fluxes.  Transforms leave out grid lines that meet none of the
    faces.

    Parameters
    ----------
    grid : Grid
    spectrum : Spectrum
        Its coefficients may change later.
    corners : (ndarray, ndarray)
        Rows and columns of the corners next to the faces, of those that are not on walls.
    faces : list of (ndarray, ndarray)
        Rows and columns of the faces of u and of v that this rank has.
    places : ndarray
        Place of each, u before v, in this rank's part of the vectors.
    vector : PETSc.Vec
        Any vector over the faces; entries at other places are left out.

    Attributes
    ----------
    vector : PETSc.Vec
    """

    def __init__(self, grid, spectrum, corners, faces, places, vector):
        self.spectrum, self.vector = spectrum, vector
        self._first = 1 - spectrum.axis
        self._bases = corner_bases(grid)
        lines = list(corners)
        # Complete lines in the first direction.
        lines[self._first] = _all_lines(grid)[self._first]
        turned = spectrum.slabs
        window = np.ix_(*(part - basis.given for part, basis in zip(lines, self._bases)))
        numbers = turned.numbers[0][window]
        self._turn = None
        if grid.comm.size == 1 and numbers.size == turned.numbers[0].size:
            self._begin = turned
        else:
            self._begin = Slabs(grid.comm, [numbers.shape], self._first)
            self._turn = self._begin.scatter_from(turned.vector, [numbers])
        # One corner more on each side: on walls, and outside the window, it stays -1.
        table = np.full((grid.n + 1, grid.m + 1), -1, dtype=PETSc.IntType)
        table[np.ix_(*lines)] = self._begin.numbers[0]
        if grid.periodic[1]:
            table[-1] = table[0]
        if grid.periodic[0]:
            table[:, -1] = table[:, 0]
        self._curl = self._assemble_curl(grid, table, faces, places)
        self._prepare_net_flows(grid, faces, places)

    def _assemble_curl(self, grid, table, faces, places):
        """The matrix R Z."""
        (u_rows, u_columns), (v_rows, v_columns) = faces
        joined = np.full((self.vector.getLocalSize(), 2), -1, dtype=PETSc.IntType)
        values = np.zeros(joined.shape)
        count = len(u_rows)
        u_places, v_places = places[:count], places[count:]
        joined[u_places, 0] = table[u_rows + 1, u_columns]
        joined[u_places, 1] = table[u_rows, u_columns]
        joined[v_places, 0] = table[v_rows, v_columns]
        joined[v_places, 1] = table[v_rows, v_columns + 1]
        values[u_places] = np.array([1, -1]) / grid.dy
        values[v_places] = np.array([1, -1]) / grid.dx
        shape = self.vector.getSizes(), self._begin.vector.getSizes()
        return assemble(grid.comm, shape, joined, values)

    def _prepare_net_flows(self, grid, faces, places):
        """What flows along periodic directions at each face depends on: its row, or column."""
        split = len(faces[0][0])
        lines = (places[:split], faces[0][Y]), (places[split:], faces[1][X])
        self._net = [
            (number, self.vector.duplicate(), *lines[number])
            for number in (0, 1) if grid.periodic[number]
        ]
        self._coefficients = None

    def _net_flows(self):
        if self._coefficients != self.spectrum.coefficients:
            self._coefficients = self.spectrum.coefficients
            for number, vector, places, lines in self._net:
                vector.set(0.0)
                vector.getArray()[places] = self.spectrum.net_flows[number][lines]
        return [vector for _, vector, *_ in self._net]

    def respond(self, force, velocity):
        """Set `velocity` to what `force` causes; they may be the same vector."""
        begin, turned, basis = self._begin, self.spectrum.slabs, self._bases[self._first]
        net = [(flow, flow.dot(force)) for flow in self._net_flows()]
        self._curl.multTranspose(force, begin.vector)
        transform([basis.forward], self._first, begin)
        if self._turn is not None:
            turned.values[:] = 0.0
            self._turn.scatter(begin.vector, turned.vector, mode=PETSc.ScatterMode.REVERSE)
        self.spectrum.solve()
        if self._turn is not None:
            self._turn.scatter(turned.vector, begin.vector, mode=PETSc.ScatterMode.FORWARD)
        transform([basis.inverse], self._first, begin)
        self._curl.mult(begin.vector, velocity)
        for flow, share in net:
            velocity.axpy(share, flow)

    def solve(self):
        """Replace the vector's values, forces on the faces, by the velocities there."""
        self.respond(self.vector, self.vector)

    def destroy(self):
        """Free matrix and vectors.  Collective."""
        self._curl.destroy()
        self.vector.destroy()
        for _, vector, *_ in self._net:
            vector.destroy()
        if self._turn is not None:
            self._turn.destroy()
            self._begin.vector.destroy()


def _all_lines(grid):
    """Rows and columns of all corners that are not on walls."""
    return [
        np.arange(basis.given, cells)
        for basis, cells in zip(corner_bases(grid), (grid.n, grid.m))
    ]


def _corners_of(grid, faces):
    """Rows and columns of a box of corners, not on walls, with those of some faces in it."""
    (u_rows, u_columns), (v_rows, v_columns) = faces
    corners = []
    rows = np.concatenate((u_rows, u_rows + 1, v_rows))
    columns = np.concatenate((u_columns, v_columns, v_columns + 1))
    for places, cells, periodic in zip((rows, columns), (grid.n, grid.m), grid.periodic[::-1]):
        if periodic:
            start, count = extent(places % cells, cells, True)
            corners.append((start + np.arange(count)) % cells)
        else:
            start, count = extent(places, cells + 1, False)
            corners.append(np.arange(max(start, 1), min(start + count, cells)))
    return corners


class StokesTransform:
    """Direct solver of A0 w + G p = f, G^T w = s, with A0 = a - b Laplacian.  Collective.

    The velocity is a gradient that has the divergence asked for, plus a flow without divergence
    (see `stream`); the pressure is what balances the forces then.  Faces on walls are coupled to
    no others: their equation is a w = f.

    Parameters
    ----------
    grid : Grid
    operators : Operators
    """

    def __init__(self, grid, operators):
        self.grid, self.operators = grid, operators
        self.coefficients = None
        self._spectra = {}
        self._rest, self._work = grid.velocity_vector(), grid.velocity_vector()
        self._lift, self._excess = grid.velocity_vector(), grid.pressure_vector()
        self._poisson = PoissonTransform(grid)
        self._walls = given_places(velocity_fields(grid), self._rest)
        boxes = grid.u_box, grid.v_box
        faces = [np.mgrid[box].reshape(2, -1) for box in boxes]
        places = np.concatenate([
            grid.local_positions(index, box, self._rest).ravel()
            for index, box in zip((grid.u_index, grid.v_index), boxes)])
        # First along the lines that ranks hold already, where they do.
        first = Y if grid.dm.getProcSizes()[1] == 1 else X
        self._box = StokesWindow(grid, self._spectrum(1 - first), _all_lines(grid), faces, places,
                                 self._rest.duplicate())

    def _spectrum(self, axis):
        if axis not in self._spectra:
            self._spectra[axis] = Spectrum(self.grid, axis)
            if self.coefficients is not None:
                self._spectra[axis].set_operator(*self.coefficients)
        return self._spectra[axis]

    def set_coefficients(self, a, b):
        """Set a > 0 (density/time) and b > 0 (viscosity).  Windows follow."""
        if (a, b) != self.coefficients:
            self.coefficients = a, b
            for spectrum in self._spectra.values():
                spectrum.set_operator(a, b)

    def window(self, faces):
        """The velocities that forces on some faces cause there.

        Parameters
        ----------
        faces : list of (ndarray, ndarray)
            Rows and columns of the faces of u and of v, on rank 0 (empty elsewhere).

        Returns
        -------
        StokesWindow
            Its vector is over these faces, u before v, all on rank 0.
        """
        grid = self.grid
        corners = _corners_of(grid, faces) if grid.comm.rank == 0 else None
        corners = grid.comm.tompi4py().bcast(corners)
        rows, columns = (len(lines) / cells for lines, cells in zip(corners, (grid.n, grid.m)))
        first = Y if columns <= rows else X
        count = sum(len(rows) for rows, _ in faces)
        vector = PETSc.Vec().createMPI((count, PETSc.DETERMINE), comm=grid.comm)
        return StokesWindow(grid, self._spectrum(1 - first), corners, faces, np.arange(count),
                            vector)

    def respond(self, force, velocity):
        """Set `velocity` to what `force` causes, without divergence.

        They may be the same velocity vector.
        """
        on_walls = force.getArray(readonly=True)[self._walls]
        self._box.respond(force, velocity)
        velocity.getArray()[self._walls] = on_walls / self.coefficients[0]

    def pressure(self, rest, pressure):
        """Set the pressure of zero mean whose gradient is `rest`, or comes nearest to it."""
        self.operators.gradient.multTranspose(rest, self._excess)
        self._poisson.solve(self._excess, pressure)

    def lift(self, source, velocity):
        """Set `velocity` to the gradient g with G^T g = `source` (less its mean)."""
        self._poisson.solve(source, self._excess)
        self.operators.gradient.mult(self._excess, velocity)

    def _subtract_product(self, velocity, rest):
        """rest -= A0 velocity."""
        self.operators.laplacian.mult(velocity, self._work)
        a, b = self.coefficients
        rest.axpy(b, self._work)
        rest.axpy(-a, velocity)

    def solve(self, force, source, velocity, pressure):
        """Solve A0 w + G p = force, G^T w = source.

        Parameters
        ----------
        force, source : PETSc.Vec
            On faces and cells; the mean of the source is left out.  None instead of the source
            stands for zero, at half the cost.
        velocity, pressure : PETSc.Vec
            The solution; other vectors than force and source.  None instead of the pressure leaves
            it out.
        """
        force.copy(self._rest)
        if source is not None:
            self.lift(source, self._lift)
            self._subtract_product(self._lift, self._rest)
        self.respond(self._rest, velocity)
        if pressure is not None:
            self._subtract_product(velocity, self._rest)
            self.pressure(self._rest, pressure)
        if source is not None:
            velocity.axpy(1.0, self._lift)

    def destroy(self):
        """Free vectors, matrices and scatters.  Collective."""
        self._poisson.destroy()
        self._box.destroy()
        for spectrum in self._spectra.values():
            spectrum.destroy()
        for vector in (self._rest, self._work, self._lift, self._excess):
            vector.destroy()
