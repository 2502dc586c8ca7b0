"""Interpolation where the viscosity is another on the other side of a membrane.

The smoothed viscosity lets the fluid beside the membrane be sheared more on one side and less on
the other than it should: with the shear stress s = t . (2 mu e) n at the membrane, the same on both
sides but for the force, the markers' velocity is wrong by c (1 / mu_o - 1 / mu_i) s along the
tangent t.  It is subtracted in interpolation, and in spreading too, which keeps both adjoint and
undoes the slip between both fluids that a smoothed force makes in the smoothed viscosity:

    J' = J - c (1 / mu_o - 1 / mu_i) t Q,    Q u = t . (2 mu e(u)) n,

with n the outward normal.  c = C' h_n / 2 with a factor C' like C of `kink`, but for velocities at
faces and a viscosity that changes at faces with the kernel of the normals, and is used at cells and
corners (`kink.contrast_constants`).  With C itself all is of first order only.

Q interpolates with the kernel's function across a component, at cells and corners alike (for
kernels that are a product of one function with itself, it is the kernel), at places a little on
the more viscous side of the membrane (`kernels.STRESS_SHIFT`).
"""

import numpy as np
from petsc4py import PETSc

from .interpolation import Stencil


class StressInterpolation:
    """The stresses 2 mu e at markers as a matrix over the velocities.  Collective.

    Rows 3k, 3k + 1 and 3k + 2 are the xx, yy and xy stresses at marker k; all rows are on rank 0.

    Parameters
    ----------
    viscosity : Viscosity
        With the present viscosity.
    kernel : Kernel
    places : ndarray, shape (M, 2)
        Where the stress is read for each marker, on rank 0; shape (0, 2) elsewhere.
    """

    def __init__(self, viscosity, kernel, places):
        strain, grid = viscosity.strain, viscosity.grid
        weigh = self._weights(strain, kernel, places)
        rates = strain.matrix.copy()
        rates.diagonalScale(L=viscosity.stresses)
        self.matrix = weigh.matMult(rates)
        weigh.destroy()
        rates.destroy()
        self._values = self.matrix.createVecLeft()
        self._area = grid.cell_area

    @staticmethod
    def _weights(strain, kernel, places):
        """The interpolation of strain rates."""
        grid, radius, count = strain.grid, kernel.across_radius, len(places)
        lattice, periods = Stencil.lattice(grid, places)
        columns, values = [], []
        lines = {}
        for shift in (0.5, 0.0):
            x, y = Stencil.lines(lattice - shift, kernel.across, radius, periods)
            lines[shift] = Stencil.product(y, x)
        for index, shift in ((strain.x_index, 0.5), (strain.y_index, 0.5),
                             (strain.corner_index, 0.0)):
            rows, cols, weights = lines[shift]
            width = weights.shape[1] * weights.shape[2]
            columns.append(index[rows, cols].reshape(count, width))
            values.append(weights.reshape(count, width))
        columns, values = np.stack(columns, axis=1), np.stack(values, axis=1)
        starts = np.arange(3 * count + 1) * columns.shape[2]
        matrix = PETSc.Mat().createAIJ(
            ((3 * count, PETSc.DETERMINE), strain.weights.getSizes()),
            csr=(starts.astype(PETSc.IntType), columns.ravel().astype(PETSc.IntType),
                 values.ravel()),
            comm=grid.comm)
        matrix.assemble()
        return matrix

    def interpolate(self, velocity):
        """Stresses xx, yy, xy at the markers: (M, 3) on rank 0, (0, 3) elsewhere."""
        self.matrix.mult(velocity, self._values)
        return self._values.getArray(readonly=True).reshape(-1, 3)

    def spread_add(self, values, vector):
        """Add the transpose times values (M, 3) over the cells' area to a velocity vector."""
        self._values.getArray()[:] = values.ravel() / self._area
        self.matrix.multTransposeAdd(self._values, vector, vector)

    def destroy(self):
        """Free the matrix.  Collective."""
        self.matrix.destroy()
        self._values.destroy()


class CorrectedInterpolation:
    """J' for one configuration, in place of an Interpolation.  Collective.

    Parameters
    ----------
    plain : Interpolation
        J, with stresses; owned.
    slip : ContrastSlip
        Tangents, and what the shear stress does along them.
    """

    def __init__(self, plain, slip):
        self.plain, self.stresses = plain, plain.stresses
        t, n = slip.tangent, slip.normal
        self._shear = np.stack((t[:, 0] * n[:, 0], t[:, 1] * n[:, 1],
                                t[:, 0] * n[:, 1] + t[:, 1] * n[:, 0]), axis=1)
        self._along = slip.per_stress[:, None] * t

    def on_root(self):
        """J as a scipy matrix, as in Interpolation."""
        return self.plain.on_root()

    def interpolate(self, velocity):
        """J' u: (M, 2) on rank 0, (0, 2) elsewhere."""
        shear = np.einsum("ki,ki->k", self._shear, self.stresses.interpolate(velocity))
        return self.plain.interpolate(velocity) - self._along * shear[:, None]

    def spread_add(self, force, vector):
        """Add the spread force, as in Interpolation."""
        self.plain.spread_add(force, vector)
        along = np.einsum("ki,ki->k", self._along, force)
        self.stresses.spread_add(-along[:, None] * self._shear, vector)

    def destroy(self):
        """Free J and the stresses.  Collective."""
        self.plain.destroy()
