"""Operators with constant coefficients, made diagonal by transforms, and their inverses."""

import numpy as np
from petsc4py import PETSc

from .bases import X, Y, given_places, pressure_field, velocity_fields
from .slabs import Slabs, transform
from .windows import HelmholtzWindow


class DiagonalSolver:
    """Solves a x - b Laplacian(x) = r for each of some fields, exactly.  Collective.

    Parameters
    ----------
    grid : Grid
    fields : list of Field
    vector : PETSc.Vec
        Any vector of their layout.
    """

    def __init__(self, grid, fields, vector):
        self._fields = fields
        self._eigenvalues = [
            (y.eigenvalues(grid.n, grid.dy), x.eigenvalues(grid.m, grid.dx))
            for y, x in (field.bases for field in fields)
        ]
        unknown = [field.unknown for field in fields]
        shapes = [numbers.shape for numbers in unknown]
        # First along the lines that ranks hold already, where they do.
        self._first, self._second = (Y, X) if grid.dm.getProcSizes()[1] == 1 else (X, Y)
        self._begin = self._turned = Slabs(grid.comm, shapes, self._first)
        self._fetch, self._turn = self._begin.scatter_from(vector, unknown), None
        if grid.comm.size > 1:
            self._turned = Slabs(grid.comm, shapes, self._second)
            self._turn = self._turned.scatter_from(self._begin.vector, self._begin.numbers)
        self._factors = self._turned.allocate()[1]

    def set_operator(self, a, b):
        """Set the coefficients.  With a = 0 a constant part of r is left out."""
        parts = zip(self._eigenvalues, self._turned.boxes, self._factors)
        for (along_y, along_x), (rows, columns), factors in parts:
            np.add.outer(a + b * along_y[rows], b * along_x[columns], out=factors)
            np.divide(1, factors, out=factors, where=factors != 0)

    def solve(self, source, target):
        """Solve; given points of the target keep their values."""
        forward, reverse = PETSc.ScatterMode.FORWARD, PETSc.ScatterMode.REVERSE
        begin, turned = self._begin, self._turned
        self._fetch.scatter(source, begin.vector, mode=forward)
        self._transform("forward", self._first, begin)
        if self._turn is not None:
            self._turn.scatter(begin.vector, turned.vector, mode=forward)
        self._transform("forward", self._second, turned)
        for work, factors in zip(turned.arrays, self._factors):
            work *= factors
        self._transform("inverse", self._second, turned)
        if self._turn is not None:
            self._turn.scatter(turned.vector, begin.vector, mode=reverse)
        self._transform("inverse", self._first, begin)
        self._fetch.scatter(begin.vector, target, mode=reverse)

    def _transform(self, way, axis, slabs):
        transform([getattr(field.bases[axis], way) for field in self._fields], axis, slabs)

    def destroy(self):
        """Free vectors and scatters.  Collective."""
        for slabs, scatter in ((self._begin, self._fetch), (self._turned, self._turn)):
            slabs.vector.destroy()
            if scatter is not None:
                scatter.destroy()


class HelmholtzTransform(DiagonalSolver):
    """The inverse of A0 = a - b Laplacian, the Laplacian that of `Operators`.  Collective.

    Faces on walls are coupled to no others: their equation is a x = r.

    Parameters
    ----------
    grid : Grid
    """

    def __init__(self, grid):
        self.grid, self.coefficients = grid, None
        fields, vector = velocity_fields(grid), grid.velocity_vector()
        super().__init__(grid, fields, vector)
        self._walls = given_places(fields, vector)
        vector.destroy()

    def set_coefficients(self, a, b):
        """Set a > 0 (density/time) and b > 0 (viscosity)."""
        if (a, b) != self.coefficients:
            self.coefficients = a, b
            self.set_operator(a, b)

    def solve(self, rhs, velocity):
        """Set velocity = A0^{-1} rhs.  They may be the same velocity vector."""
        on_walls = rhs.getArray(readonly=True)[self._walls]
        super().solve(rhs, velocity)
        velocity.getArray()[self._walls] = on_walls / self.coefficients[0]

    def window(self, faces):
        """R A0^{-1} R^T with the present coefficients (see `HelmholtzWindow`).

        Parameters
        ----------
        faces : list of (ndarray, ndarray)
            Rows and columns of the faces of u and of v, on rank 0 (empty elsewhere); on no wall.
        """
        return HelmholtzWindow(self.grid, *self.coefficients, faces)


class PoissonTransform(DiagonalSolver):
    """Pseudo-inverse of minus the pressure's Laplacian, G^T G.  Collective.

    The solution has zero mean, and the mean of the source is left out.  Source and solution are
    pressure vectors, and may be the same.

    Parameters
    ----------
    grid : Grid
    """

    def __init__(self, grid):
        vector = grid.pressure_vector()
        super().__init__(grid, [pressure_field(grid)], vector)
        vector.destroy()
        self.set_operator(0.0, 1.0)
