"""Fast direct solver of the fluid's coupled system: velocity and pressure at once."""

import numpy as np
from petsc4py import PETSc

from ..fluid.operators import assemble
from .biharmonic import Spectrum
from .spectral import (
    NO_FLUX,
    WALL_AT_POINT,
    Field,
    Slabs,
    SpectralSolver,
    X,
    Y,
    given_places,
    transform,
    velocity_fields,
)
from .transforms import attribute


class StreamWindow:
    """R Z (Z^T A0 Z)^{-1} Z^T R^T, with R the restriction to some faces.  Collective.

    The velocities without divergence that forces on these faces cause there.  Transforms leave out
    grid lines that meet none of the faces.

    Parameters
    ----------
    grid : Grid
    spectrum : Spectrum
    bounds : ((int, int), (int, int))
        First and last row, and first and last column, of the corners next to the faces.
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

    def __init__(self, grid, spectrum, bounds, faces, places, vector):
        self.spectrum, self.vector = spectrum, vector
        self._first = 1 - spectrum.axis
        rows, columns = (
            slice(max(start, 1), min(stop + 1, cells))
            for (start, stop), cells in zip(bounds, (grid.n, grid.m))
        )
        window = slice(rows.start - 1, rows.stop - 1), slice(columns.start - 1, columns.stop - 1)
        # Complete lines in the first direction.
        if self._first == Y:
            rows, window = slice(1, grid.n), (slice(None), window[1])
        else:
            columns, window = slice(1, grid.m), (window[0], slice(None))
        turned = spectrum.slabs
        numbers = turned.numbers[0][window]
        self._turn = None
        if grid.comm.size == 1 and numbers.size == turned.numbers[0].size:
            self._begin = turned
        else:
            self._begin = Slabs(grid.comm, [numbers.shape], self._first)
            self._turn = self._begin.scatter_from(turned.vector, [numbers])
        # One corner more on each side: on walls, and outside the window, it stays -1.
        table = np.full((grid.n + 1, grid.m + 1), -1, dtype=PETSc.IntType)
        table[rows, columns] = self._begin.numbers[0]
        self._curl = self._assemble_curl(grid, table, faces, places)

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

    def respond(self, force, velocity):
        """Set `velocity` to what `force` causes; they may be the same vector."""
        begin, turned, basis = self._begin, self.spectrum.slabs, WALL_AT_POINT
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

    def solve(self):
        """Replace the vector's values, forces on the faces, by the velocities there."""
        self.respond(self.vector, self.vector)

    def destroy(self):
        """Free matrix and vectors.  Collective."""
        self._curl.destroy()
        self.vector.destroy()
        if self._turn is not None:
            self._turn.destroy()
            self._begin.vector.destroy()


class StokesTransform:
    """PETSc python PC: K0^{-1}, the coupled system of the fluid alone solved directly.

    The velocity is a gradient that has the divergence asked for, plus the curl of a stream
    function (see `biharmonic`); the pressure is what balances the forces then.  Its matrix must be
    that of a `CoupledSolver`, which carries the `FluidPair`.
    """

    exact = True

    def __init__(self):
        self._pair = self._coefficients = None

    def setUp(self, pc):
        """Take over the matrix's coefficients.  Collective."""
        if self._pair is None:
            self._begin(attribute(pc.getOperators()[1], "pair"))
        coefficients = self._pair.fluid.matrix.getAttr("coefficients")
        if coefficients != self._coefficients:
            self._coefficients = coefficients
            for spectrum in self._spectra.values():
                spectrum.set_operator(*coefficients)

    def _begin(self, pair):
        self._pair, grid, layout = pair, pair.grid, pair.layout
        self._spectra = {}
        self._given, *self._source = layout.joint()
        self._answer, *self._found = layout.joint()
        self._rest, self._excess = layout.velocity.duplicate(), layout.pressure.duplicate()
        self._poisson = SpectralSolver(grid, [Field(grid.p_index, (NO_FLUX, NO_FLUX))],
                                       layout.pressure)
        self._poisson.set_operator(0.0, 1.0)
        boxes = grid.u_box, grid.v_box
        faces = [np.mgrid[box].reshape(2, -1) for box in boxes]
        places = np.concatenate([
            grid.local_positions(index, box, layout.velocity).ravel()
            for index, box in zip((grid.u_index, grid.v_index), boxes)])
        self._walls = given_places(velocity_fields(grid), layout.velocity)
        first = Y if grid.dm.getProcSizes()[1] == 1 else X
        self._box = StreamWindow(grid, self._spectrum(1 - first), ((0, grid.n), (0, grid.m)),
                                 faces, places, layout.velocity.duplicate())

    def _spectrum(self, axis):
        if axis not in self._spectra:
            self._spectra[axis] = Spectrum(self._pair.grid, axis)
            if self._coefficients is not None:
                self._spectra[axis].set_operator(*self._coefficients)
        return self._spectra[axis]

    def window(self, faces):
        """The answer to forces on some faces, restricted to them.

        Parameters
        ----------
        faces : list of (ndarray, ndarray)
            Rows and columns of the faces of u and of v, on rank 0 (empty elsewhere).

        Returns
        -------
        StreamWindow
            Its vector is over these faces, all on rank 0.
        """
        grid = self._pair.grid
        faces = [np.stack(part) for part in faces]
        bounds = None
        if grid.comm.rank == 0:
            # Each face has corners at its ends.
            ends = np.concatenate([faces[0], faces[0] + [[1], [0]], faces[1],
                                   faces[1] + [[0], [1]]], axis=1)
            bounds = np.stack((ends.min(axis=1), ends.max(axis=1)), axis=1)
        bounds = grid.comm.tompi4py().bcast(bounds)
        lines = (bounds[:, 1] - bounds[:, 0]) / (grid.n, grid.m)
        first = Y if lines[X] <= lines[Y] else X
        count = sum(part.shape[1] for part in faces)
        vector = PETSc.Vec().createMPI((count, PETSc.DETERMINE), comm=grid.comm)
        return StreamWindow(grid, self._spectrum(1 - first), bounds, faces, np.arange(count),
                            vector)

    def respond(self, force, velocity):
        """Set `velocity` to what `force` causes, without divergence.  Collective."""
        self._box.respond(force, velocity)
        # Faces on walls are coupled to no others.
        velocity.getArray()[self._walls] = (
            force.getArray(readonly=True)[self._walls] / self._coefficients[0])

    def pressure(self, rest, pressure):
        """Set the pressure whose gradient is `rest`, or comes nearest to it.  Collective."""
        self._pair.gradient.multTranspose(rest, self._excess)
        self._poisson.solve(self._excess, pressure)

    def lift(self, source, velocity):
        """Set `velocity` to the gradient g with G^T g = `source`.  Collective."""
        self._poisson.solve(source, self._excess)
        self._pair.gradient.mult(self._excess, velocity)

    def apply(self, pc, x, y):
        """y = K0^{-1} x."""
        pair = self._pair
        (force, source), (velocity, pressure) = self._source, self._found
        x.copy(self._given)
        source.scale(1 / pair.scale)
        self.lift(source, self._rest)
        pair.fluid.matrix.mult(self._rest, velocity)
        force.axpy(-1.0, velocity)
        self.respond(force, velocity)
        pair.fluid.matrix.mult(velocity, self._box.vector)
        force.axpy(-1.0, self._box.vector)
        velocity.axpy(1.0, self._rest)
        self.pressure(force, pressure)
        pressure.scale(1 / pair.scale)
        self._answer.copy(y)

    def view(self, pc, viewer):
        """Say what it is."""
        viewer.printfASCII("  exact, by sine transforms of the stream function\n")

    def destroy(self, pc):
        """Free what PETSc keeps; PETSc calls this.  Collective."""
        if self._pair is None:
            return
        self._poisson.destroy()
        self._box.destroy()
        for spectrum in self._spectra.values():
            spectrum.destroy()
        for vector in (*self._source, *self._found, self._given, self._answer, self._rest,
                       self._excess):
            vector.destroy()
