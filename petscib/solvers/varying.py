"""The fluid where its viscosity varies: A0 = rho / (theta dt) - mu_min Laplacian + E^T D E.

(See `fluid.viscosity`.)  It is preconditioned by the solver of the constant viscosity mu_min, scaled
from both sides: with s = sqrt(mu / mu_min) at faces, A0 is about s (- mu_min Laplacian) s.  That
solver, multigrid or transforms, is set up once; multigrid for A0 itself would take more iterations,
and be set up anew in each step.  The coupled system is preconditioned by the projection method.
"""

import numpy as np

from .momentum import Momentum
from .stokes import POISSON_DEFAULTS, Stokes
from .poisson import PoissonSolver


class Varying:
    """What is different, for either system; comes before `Momentum` or `Stokes`.  Collective.

    Parameters
    ----------
    operators : Operators
    rho : float
    viscosity : Viscosity
        Kept; its present configuration counts.
    transform : HelmholtzTransform, optional
        Exact solver for constant viscosity; without it, multigrid.
    advection : Advection, optional
        As in Momentum.
    """

    exact = False

    def __init__(self, operators, rho, viscosity, transform=None, advection=None):
        super().__init__(operators, rho, viscosity.outer, transform, advection)
        self.viscosity, self.least = viscosity, viscosity.least
        self.defaults = {**self.defaults, "pc_type": "python"}
        self._inner_faces = operators.uniform_force((1.0, 1.0))
        self._scale, self._scaled = self.grid.velocity_vector(), self.grid.velocity_vector()
        self._version = None

    @property
    def near(self):
        """Viscosity at each membrane, for the model of its answer: the mean of both sides."""
        return self.viscosity.near

    def update(self, interval):
        """Make the system for theta dt = `interval` and the viscosity.  Returns if it changed."""
        changed = super().update(interval)
        if not changed and self._version == self.viscosity.version:
            return False
        self._version = self.viscosity.version
        relative = self.viscosity.faces.getArray(readonly=True) / self.least
        inner = self._inner_faces.getArray(readonly=True)
        self._scale.getArray()[:] = np.where(inner, 1 / np.sqrt(relative), 1.0)
        return True

    def mult(self, x, y):
        """y = A0 x, and what else belongs to the system, for lists of blocks."""
        super().mult(x, y)
        self.viscosity.add_force(x[0], y[0], 1.0)

    def precondition_velocity(self, rhs, velocity):
        """Set velocity to about A0^{-1} rhs."""
        self._scaled.pointwiseMult(rhs, self._scale)
        super().precondition_velocity(self._scaled, velocity)
        velocity.pointwiseMult(velocity, self._scale)

    def add_to(self, matrix):
        """Add A0 to an assembled matrix."""
        super().add_to(matrix)
        self.viscosity.add_to(matrix)

    def destroy(self):
        """Free matrix and solvers.  Collective."""
        super().destroy()
        for part in (self._inner_faces, self._scale, self._scaled):
            part.destroy()


class VaryingMomentum(Varying, Momentum):
    """A0 on the velocities."""


class VaryingStokes(Varying, Stokes):
    """The saddle point of A0 on velocities and pressures."""

    def poisson(self):
        """A new solver of the pressure's Poisson problem, for the preconditioner."""
        if self.transform is None:
            return super().poisson()
        from .transforms.poisson import PoissonTransform

        return PoissonSolver(self.operators, self.prefix + "poisson_", POISSON_DEFAULTS,
                             PoissonTransform(self.grid))

    def viscosity_of(self, cells):
        """The factor that makes values at cells the viscosity times these; they change."""
        cells.pointwiseMult(cells, self.viscosity.cells)
        return 1.0
