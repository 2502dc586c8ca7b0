"""Implicit advection around the exact solve of the implicit system without it.

With M the symmetric system, membranes included, and N the advection, (M + N) w = b is solved by the
generalised conjugate gradients of Concus & Golub (1976) and Widlund (1978), which need no more than
solves with M:

    M z = b - (M + N) w_k,    w_{k+1} = w_{k-1} + omega (z + w_k - w_{k-1}),
    1 / omega = 1 + (r_k . z_k) / (r_{k-1} . z_{k-1} omega_k).

As z + w_k solves M (z + w_k) = b - N w_k, nothing but N is ever multiplied with, and sources and
stresses of membranes at the start need not be known here: they are in every solve alike, and the
weights add up to one.  N is skew-symmetric but for walls that fluid passes through; the iteration
does with those as long as M outweighs them.
"""

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from ..errors import SolveError
from .iteration import ROUND_OFF, Iteration

# A tolerance of 1e-7 takes two solves more, 1e-8 four.  (FGMRES in `block`, with the same exact
# solves as preconditioner, needs 1e-9 for an energy ledger nearly as good, and with a vesicle takes
# 0.5 to 1.3 times the time at 64^2 and 1.0 to 2.3 times at 128^2: mbe, be, gcn, CFL 0.5 to 10.)
DEFAULTS = {"ksp_rtol": 1e-6, "ksp_max_it": 200}
INNER = 0.1  # accuracy of the inner solves in a pass of the tangent iteration, relative to its own
# Power of the residual that may be left, relative to the kinetic energy over theta dt: the energy
# ledger's share of it, as `_balance` takes the rest away.
BALANCE = 1e-10


@dataclass
class _Iterate:
    """A solution of M x = load."""

    velocity: PETSc.Vec
    pressure: PETSc.Vec
    load: PETSc.Vec
    stress: np.ndarray = None

    def blend(self, weight, other):
        """Become (1 - weight) times this and weight times the other."""
        for name in ("velocity", "pressure", "load"):
            getattr(self, name).axpby(weight, 1 - weight, getattr(other, name))
        if other.stress is not None:
            self.stress = (1 - weight) * self.stress + weight * other.stress

    def destroy(self):
        """Free its vectors."""
        for vector in (self.velocity, self.pressure, self.load):
            vector.destroy()


def _balance(now, last, residual, earlier, both):
    """The share of the last iterate with which the residual has no power, and what is left of it.

    Then the energy law holds whatever the tolerance.

    Parameters
    ----------
    now, last : _Iterate
    residual, earlier : PETSc.Vec
        Theirs.
    both : bool
        Whether there is a last one.
    """
    own = now.velocity.dot(residual)
    if not both or not own:
        return 0.0, abs(own)
    mixed, other = now.velocity.dot(earlier), last.velocity.dot(residual)
    # The power of (1 - s) w + s w_last with (1 - s) r + s r_last, a parabola in s
    slope = mixed + other - 2 * own
    bend = own - mixed - other + last.velocity.dot(earlier)
    root = slope**2 - 4 * own * bend
    if root < 0:
        return 0.0, abs(own)
    return -2 * own / (slope + np.copysign(np.sqrt(root), slope)), 0.0


class Skew(Iteration):
    """Iteration for the system with advection.  Collective.

    Parameters
    ----------
    inner : Force or AloneExact
        Solves the system without it.
    fluid : Momentum or Stokes
        With an advection.  Under its options prefix, with "advection_" added, are the tolerance
        ksp_rtol, of the error relative to the velocity, and the most solves, ksp_max_it.
    """

    def __init__(self, inner, fluid):
        self.inner, self.fluid = inner, fluid
        self.prefix = fluid.prefix + "advection_"
        options, grid = PETSc.Options(self.prefix), fluid.grid
        self.rtol = options.getReal("ksp_rtol", DEFAULTS["ksp_rtol"])
        self.most = options.getInt("ksp_max_it", DEFAULTS["ksp_max_it"])
        self._spare = [
            _Iterate(grid.velocity_vector(), grid.pressure_vector(), grid.velocity_vector())
            for _ in range(3)]
        self._residuals = [grid.velocity_vector() for _ in range(2)]

    def begin(self, rhs, stage):
        """Take right-hand side and first guess."""
        super().begin(rhs, stage)
        self.inner.begin(rhs, stage)

    def update(self, interval, operators, stress):
        """Set the system for a configuration of the membranes."""
        self.operators = operators
        self.inner.update(interval, operators, stress)

    def _load(self, velocity, load):
        """Set load = b - N w."""
        self.rhs.copy(load)
        self.fluid.advection.add(velocity, load, -1.0)

    def _solve(self, iterate, stress, accuracy):
        """Solve M x = load from a first guess of the stresses.  Returns the iterations."""
        iterate.stress = stress
        self.inner.take(iterate.load, iterate)
        iterations = self.inner.iterate(accuracy)
        self.inner.finish()
        return iterations

    def iterate(self, accuracy):
        """Solve.  Returns the iterations of the inner solves."""
        stage, (residual, earlier) = self.stage, self._residuals
        now, last, image = self._spare
        self._load(stage.velocity, now.load)
        accuracy = accuracy and max(INNER * accuracy, ROUND_OFF)
        iterations = self._solve(now, stage.stress, accuracy)
        omega = product_before = None
        for _ in range(self.most):
            self._load(now.velocity, image.load)
            residual, earlier = earlier, residual
            residual.waxpy(-1.0, now.load, image.load)
            size = now.velocity.norm()
            share = power = 0.0
            if accuracy is None:
                share, power = _balance(now, last, residual, earlier, omega is not None)
            # As M is at least rho / (theta dt), this bounds what another solve would change.
            scale = self.fluid.interval / self.fluid.rho
            error = scale * (abs(1 - share) * residual.norm() + abs(share) * earlier.norm())
            if error <= (self.rtol if accuracy is None else accuracy) * size and (
                    scale * power <= BALANCE * size**2):
                if share:
                    now.blend(share, last)
                return self._accept(now, iterations)
            if not np.isfinite(error):
                break
            iterations += self._solve(image, now.stress, accuracy)
            product = residual.dot(image.velocity) - residual.dot(now.velocity)
            if omega is None:
                omega, last, now, image = 1.0, now, image, last
            else:
                omega = 1 / (1 + product / (product_before * omega))
                last.blend(omega, image)
                last, now = now, last
            product_before = product
        raise SolveError(
            f"{self.fluid.name} solve failed: advection did not converge in {self.most} solves "
            f"(relative error {error / size:.1e}); -{self.prefix}ksp_max_it allows more"
        )

    def _accept(self, iterate, iterations):
        iterate.velocity.copy(self.stage.velocity)
        iterate.pressure.copy(self.stage.pressure)
        self.stage.stress = iterate.stress
        return iterations

    def forget(self):
        """Drop what depends on earlier steps."""
        self.inner.forget()

    def destroy(self):
        """Free the solver.  Collective."""
        self.inner.destroy()
        for part in (*self._spare, *self._residuals):
            part.destroy()
