"""Implicit advection around the exact solve of the implicit system without it.

With M the symmetric system, membranes included, and N the advection, (M + N) w = b is the fixed
point of w -> M^{-1} (b - N w).  As N is skew-symmetric but for walls that fluid passes through, the
Krylov space of M^{-1} N serves well: its minimal residual method, in the form of Anderson
acceleration, takes as many solves as the conjugate gradients of Concus, Golub & Widlund (1976, 1978)
for M + N, and does with the walls, and with solves of M that are themselves iterations.
"""

import numpy as np
from petsc4py import PETSc

from ..errors import SolveError
from .anderson import Anderson

# Of the velocity's change by a solve: the ledger then balances to 1e-8 up to CFL 10.
DEFAULTS = {"ksp_rtol": 1e-9, "ksp_max_it": 200}
DEPTH = 40


class Skew:
    """Iteration for the system with advection.  Collective.

    Parameters
    ----------
    inner : Force or Alone
        Solves the system without it.
    fluid : Momentum or Stokes
        With an advection; its options prefix gives the tolerance, relative to the velocity, and the
        most solves.
    """

    def __init__(self, inner, fluid):
        self.inner, self.fluid = inner, fluid
        options = PETSc.Options(fluid.prefix)
        self.rtol = options.getReal("ksp_rtol", DEFAULTS["ksp_rtol"])
        self.most = options.getInt("ksp_max_it", DEFAULTS["ksp_max_it"])
        self._rhs = fluid.grid.velocity_vector()
        self._total = fluid.grid.comm.tompi4py().allreduce

    def begin(self, rhs, stage):
        """Take right-hand side and first guess."""
        self.rhs, self.stage = rhs, stage

    def update(self, interval, operators, stress):
        """Set the system for a configuration of the membranes."""
        self.inner.update(interval, operators, stress)

    def iterate(self, accuracy):
        """Solve.  Returns the iterations of the inner solves."""
        velocity, iterations = self.stage.velocity, 0
        acceleration = Anderson(DEPTH, self._total)
        guess = velocity.getArray(readonly=True).copy()
        for _ in range(self.most):
            self.rhs.copy(self._rhs)
            self.fluid.advection.add(velocity, self._rhs, -1.0)
            self.inner.begin(self._rhs, self.stage)
            iterations += self.inner.iterate(accuracy)
            self.inner.finish()
            image = velocity.getArray(readonly=True).copy()
            change, size = np.sqrt(self._total(np.array(
                [np.sum((image - guess) ** 2), np.sum(image**2)])))
            if change <= (self.rtol if accuracy is None else accuracy) * size:
                return iterations
            if not np.isfinite(change):
                break
            guess = acceleration.next(guess, image)
            velocity.getArray()[:] = guess
        raise SolveError(
            f"{self.fluid.name} solve failed: advection did not converge in {self.most} solves "
            f"(the velocity still changes by {change / size:.1e}); a smaller -ts_dt may help"
        )

    def marker_velocity(self):
        """U of the last solution."""
        return self.inner.marker_velocity()

    def finish(self):
        """Nothing is left to do."""

    def destroy(self):
        """Free the solver.  Collective."""
        self.inner.destroy()
        self._rhs.destroy()
