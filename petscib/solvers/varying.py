"""The fluid where its viscosity varies: A0 = rho / (theta dt) - mu_min Laplacian + E^T D E.

(See `fluid.viscosity`.)  Multigrid for A0 is made of its part that does not couple u and v, anew in
each step: for A0 itself the coarse grids are poor, and for constant viscosity, scaled by that at
each face, it takes twice the iterations at contrasts of 0.1 and 10 (`studies.contrast`).  The
transforms, which know nothing but constant viscosity, are scaled: with s = sqrt(mu / mu_min) at
faces, A0 is about s (- mu_min Laplacian) s.  The coupled system is preconditioned by the projection
method.
"""

import numpy as np
from petsc4py import PETSc

from .force import RTOL
from .momentum import Momentum
from .stokes import Stokes

# Largest ratio of viscosities for which scaled transforms precondition.  For -scheme be, dt = h,
# they take 0.4 to 0.6 of multigrid's time at ratios of 5 and 10 (64^2, 128^2), 0.7 and 1.5 at 100.
LARGEST_SCALED = 30.0


class Varying:
    """What is different, for either system; comes before `Momentum` or `Stokes`.  Collective.

    Parameters
    ----------
    operators : Operators
    rho : float
    viscosity : Viscosity
        Kept; its present configuration counts.
    transform : HelmholtzTransform, optional
        Exact solver for constant viscosity, used up to a ratio of viscosities; without, multigrid.
    advection : Advection, optional
        As in Momentum.

    Attributes
    ----------
    matrix : PETSc.Mat
        A0 without what couples u and v, symmetric positive definite: what multigrid is made of.
    """

    exact = False

    def __init__(self, operators, rho, viscosity, transform=None, advection=None):
        self.fast = transform is not None
        if self.fast and viscosity.most > LARGEST_SCALED * viscosity.least:
            transform.destroy()
            transform = None
        super().__init__(operators, rho, viscosity.outer, transform, advection)
        self.viscosity = viscosity
        self.defaults = {**self.defaults, "ksp_max_it": 1000}
        if self.fast:  # as where transforms solve exactly
            self.defaults["ksp_rtol"] = RTOL
        if transform is not None:
            self.defaults["pc_type"] = "python"
        grid = self.grid
        self._inner_faces = operators.force(1.0, 1.0)
        self._scale, self._scaled = grid.velocity_vector(), grid.velocity_vector()
        self._is_u = np.zeros(self._scale.getSize(), dtype=bool)
        self._is_u[grid.u_index] = True
        self._version = None

    @property
    def at_membranes(self):
        """Viscosity that long waves along each membrane feel, and that which short ones do."""
        return self.viscosity.at_membranes

    def elimination_pays(self, interval):
        """Whether conjugate gradients with the stresses eliminated are the default."""
        return self.transform is None and super().elimination_pays(interval)

    def update(self, interval):
        """Make the system for theta dt = `interval` and the viscosity.  Returns if it changed."""
        viscosity = self.viscosity
        if interval == self.interval and self._version == viscosity.version:
            return False
        if self.transform is None:
            self._make_matrix(interval)
        else:
            self.transform.set_coefficients(self.rho / interval, viscosity.least)
            relative = viscosity.faces.getArray(readonly=True) / viscosity.least
            inner = self._inner_faces.getArray(readonly=True)
            self._scale.getArray()[:] = np.where(inner, 1 / np.sqrt(relative), 1.0)
        self.interval, self._version = interval, viscosity.version
        return True

    def _make_matrix(self, interval):
        """Set A0 without the entries that couple u and v; they are where the Laplacian has some."""
        self.operators.laplacian.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.matrix.scale(-self.viscosity.least)
        self.matrix.shift(self.rho / interval)
        excess = self.viscosity.matrix()
        starts, columns, values = excess.getValuesCSR()
        excess.destroy()
        rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        first = self.matrix.getOwnershipRange()[0]
        keep = self._is_u[rows + first] == self._is_u[columns]
        keep &= values != 0  # none on walls
        counts = np.bincount(rows[keep], minlength=len(starts) - 1)
        starts = np.concatenate(([0], np.cumsum(counts))).astype(PETSc.IntType)
        self.matrix.setValuesCSR(starts, columns[keep], values[keep],
                                 addv=PETSc.InsertMode.ADD_VALUES)
        self.matrix.assemble()

    def multiply(self, x, y):
        """y = A0 x for velocities."""
        self.operators.laplacian.mult(x, y)
        y.axpby(self.rho / self.interval, -self.viscosity.least, x)
        self.viscosity.add_force(x, y, 1.0)

    def precondition_velocity(self, rhs, velocity):
        """Set velocity to about A0^{-1} rhs."""
        if self.transform is None:
            super().precondition_velocity(rhs, velocity)
            return
        self._scaled.pointwiseMult(rhs, self._scale)
        super().precondition_velocity(self._scaled, velocity)
        velocity.pointwiseMult(velocity, self._scale)

    def add_to(self, matrix):
        """Add A0 to an assembled matrix."""
        different = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
        matrix.axpy(-self.viscosity.least, self.operators.laplacian, different)
        matrix.shift(self.rho / self.interval)
        excess = self.viscosity.matrix()
        matrix.axpy(1.0, excess, different)
        excess.destroy()

    def destroy(self):
        """Free matrix and solvers.  Collective."""
        super().destroy()
        for part in (self._inner_faces, self._scale, self._scaled):
            part.destroy()


class VaryingMomentum(Varying, Momentum):
    """A0 on the velocities."""


class VaryingStokes(Varying, Stokes):
    """The saddle point of A0 on velocities and pressures."""

    def viscosity_of(self, cells):
        """The factor that makes values at cells the viscosity times these; they change."""
        cells.pointwiseMult(cells, self.viscosity.cells)
        return 1.0
