"""The fluid's part of the momentum system: A0 = rho / (theta dt) - mu Laplacian."""

import numpy as np
from petsc4py import PETSc

from . import krylov

# Cells that momentum may diffuse in theta dt for conjugate gradients with the stresses eliminated
# to be the default.  Beyond, the block iteration is more than 1.5 times faster: at 5.7, 8 and 11
# cells (64^2, 128^2 and 256^2, dt = h, sigma0 = 1e9) 1.2, 1.6 and 2.8 times (`make bench`).
FARTHEST = 7.0

# The matrix changes with the time step only; the coarse grids made for another step may then be no
# approximation any more, and even make an indefinite preconditioner.
GAMG_DEFAULTS = {"pc_type": "gamg", "pc_gamg_reuse_interpolation": False}
VELOCITY_DEFAULTS = {"ksp_type": "preonly", **GAMG_DEFAULTS}


class Momentum:
    """A0 on the velocities, its preconditioner or its exact inverse.  Collective.

    Parameters
    ----------
    operators : Operators
    rho, mu : float
    transform : HelmholtzTransform, optional
        Exact inverse; without it, multigrid.
    advection : Advection, optional
        Added to A0 in products, and left out of preconditioner and inverse.

    Attributes
    ----------
    matrix : PETSc.Mat
        A0, symmetric positive definite; wall faces have decoupled rows.
    interval : float or None
        The theta dt that the matrix is made for.
    """

    name, prefix = "momentum", "momentum_"
    share = 1.0  # factor of the response to a force in `model`: here all of a force moves the fluid
    defaults = {"ksp_type": "cg", "ksp_rtol": 1e-6, "ksp_max_it": 500,
                # At sigma0 = 1e13 the first residuals may be 1e5 times that of the start.
                "ksp_divtol": 1e12, **GAMG_DEFAULTS}
    symmetric = True

    def __init__(self, operators, rho, mu, transform=None, advection=None):
        self.operators, self.grid = operators, operators.grid
        self.rho, self.mu = rho, mu
        self.transform = transform
        self.advection = advection
        if advection is not None:  # then products are not symmetric
            self.defaults = {**self.defaults, "ksp_type": "fgmres"}
        self.interval = None
        self.matrix = operators.laplacian.duplicate()
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)
        self._inner = None

    @property
    def exact(self):
        """Whether transforms solve the system exactly, on the whole grid and near the markers."""
        return self.transform is not None

    @property
    def at_membranes(self):
        """Viscosity that long waves along each membrane feel, and short ones if another."""
        return self.mu, None

    def update(self, interval):
        """Make the system for theta dt = `interval`.  Returns whether it changed."""
        if interval == self.interval:
            return False
        self.operators.laplacian.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.matrix.scale(-self.mu)
        self.matrix.shift(self.rho / interval)
        if self.transform is not None:
            self.transform.set_coefficients(self.rho / interval, self.mu)
        self.interval = interval
        return True

    def elimination_pays(self, interval):
        """Whether conjugate gradients with the stresses eliminated are the default."""
        if self.advection is not None:
            return False
        diffusion = np.sqrt(self.mu * interval / self.rho)
        return diffusion <= FARTHEST * min(self.grid.dx, self.grid.dy)

    def blocks(self):
        """New vectors of the unknowns."""
        return [self.grid.velocity_vector()]

    def load(self, unknowns, velocity, pressure):
        """Take first guesses over into the unknowns."""
        velocity.copy(unknowns[0])

    def store(self, unknowns, velocity, pressure):
        """Set velocity, and pressure where it is one of the unknowns."""
        unknowns[0].copy(velocity)

    def set_source(self, rhs):
        """Set the right-hand sides of what is not the momentum equation: here none."""

    def mult(self, x, y):
        """y = A0 x, or (A0 + rho N) x with advection, for lists of blocks."""
        self.multiply(x[0], y[0])
        if self.advection is not None:
            self.advection.add(x[0], y[0])

    def multiply(self, x, y):
        """y = A0 x for velocities."""
        self.matrix.mult(x, y)

    def add_to(self, matrix):
        """Add A0 to an assembled matrix."""
        matrix.axpy(1.0, self.matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)

    def solve(self, rhs, velocity, pressure=None):
        """Solve A0 w = rhs exactly, by transforms."""
        self.transform.solve(rhs, velocity)

    def window(self, faces):
        """The exact response to forces on some faces, restricted to them."""
        return self.transform.window(faces)

    def precondition(self, rhs, answer):
        """Set answer to about A0^{-1} rhs, lists of blocks."""
        self.precondition_velocity(rhs[0], answer[0])

    def precondition_velocity(self, rhs, velocity):
        """Set velocity to about A0^{-1} rhs: by one multigrid cycle, or exactly."""
        if self.transform is not None:
            self.transform.solve(rhs, velocity)
            return
        if self._inner is None:
            self._inner = krylov.create(
                self.matrix, self.prefix + "velocity_", VELOCITY_DEFAULTS)
        self._inner.setOperators(self.matrix)
        velocity.set(0.0)
        krylov.solve(self._inner, rhs, velocity, "velocity")

    def view(self, viewer):
        """Show what preconditions."""
        if self.transform is not None:
            viewer.printfASCII("  fluid: exact, by sine, cosine or Fourier transforms\n")
        elif self._inner is not None:
            self._inner.view(viewer)

    def destroy(self):
        """Free matrix and solvers.  Collective."""
        for part in (self._inner, self.transform, self.matrix):
            if part is not None:
                part.destroy()
