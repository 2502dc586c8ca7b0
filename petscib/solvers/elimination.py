"""The implicit system with the membranes' stresses eliminated.

With B = 1 / (theta dt) + C K C^T, sparse and in marker space alone, the stresses are

    m = B^{-1} (m0 / (theta dt) + C Pi J w),

and what remains is (A + J^T Pi C^T B^{-1} C Pi J / (dx dy)) w = ..., symmetric positive definite
where A is.  The correction K bounds what is added to A, so that multigrid for A alone
preconditions; without it, only a factorisation of the whole assembled matrix does.
"""

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from ..events import phase
from . import direct, krylov
from .cholesky import Cholesky
from .iteration import ROUND_OFF, FluidIteration, FluidPC
from .literal import LiteralPC, assembled
from .product import Product, numbered, transposed

ACCURACY = 1e-10  # of a pass at least: with 1e-7 the tangent iteration takes up to twice the passes


class StressMatrix:
    """1 / (theta dt) + C K C^T, always with the same entries.  Not collective; on rank 0."""

    def __init__(self):
        self._product = None

    def _begin(self, rates, count):
        columns = np.repeat(np.arange(count), 2)
        root = csr_matrix(
            (np.ones(2 * count), columns, np.arange(2 * count + 1)), (2 * count, count))
        self._along = Product(rates, root)
        across, self._transposed = transposed(self._along)
        self._product = Product(numbered(self._along), across, upper=True)
        self._diagonal = np.flatnonzero(self._product.rows == self._product.indices)

    def upper(self, interval, operators):
        """Its upper triangle, a csr_matrix, for theta dt = `interval` and a configuration.

        Parameters
        ----------
        interval : float
        operators : MarkerOperators
            With a `slip`.
        """
        rates, slip = operators.rates, operators.slip
        if self._product is None:
            self._begin(rates, len(slip.mobility))
        # K is the square of this: along each marker's tangent.
        root = (np.sqrt(slip.mobility)[:, None] * slip.tangent).ravel()
        along = self._along.values(rates.data, root)
        square = self._product.values(along, along[self._transposed])
        square[self._diagonal] += 1 / interval
        return self._product.csr(square)


class StressBlock:
    """B^{-1}.  Not collective; work of rank 0.

    Parameters
    ----------
    prefix : str
        Options prefix of the direct solver.
    """

    def __init__(self, prefix):
        self.direct = Cholesky(prefix)
        self._stress = StressMatrix()

    def update(self, interval, operators):
        """Factor, where there is a correction; else B is a multiple of one."""
        self.interval, self._diagonal = interval, operators.slip is None
        if not self._diagonal and operators.rates.shape[0]:
            self.direct.factor(self._stress.upper(interval, operators))

    def solve(self, values):
        """B^{-1} times an array over the stresses."""
        return self.interval * values if self._diagonal else self.direct.solve(values)

    def destroy(self):
        """Free the factor."""
        self.direct.destroy()


class Elimination(FluidIteration):
    """Krylov iteration for the fluid with the stresses eliminated.  Collective.

    Parameters
    ----------
    fluid : Momentum or Stokes
    membranes : Membranes
    kernel : Kernel
    literal : bool
        Without the kink correction: precondition by a factorisation of the whole matrix.
    """

    what = "fluid, membrane stresses eliminated"

    def __init__(self, fluid, membranes, kernel, literal=False):
        self.literal, self._whole, self._factored = literal, None, None
        self.block = StressBlock(fluid.prefix + "stress_")
        self.direct = self.block.direct
        defaults, preconditioner = fluid.defaults, FluidPC(fluid)
        if literal and fluid.symmetric:
            defaults = {**defaults, **direct.defaults("cholesky", fluid.grid.comm)}
            preconditioner = None
        elif literal:
            preconditioner = self._factored = LiteralPC(fluid)
        super().__init__(fluid, defaults, preconditioner)
        self._work = fluid.grid.velocity_vector()

    def update(self, interval, operators, stress):
        """Set the system for a configuration of the membranes."""
        fluid = self.fluid
        fluid.update(interval)
        self.operators = operators
        with phase("marker model"):
            self.block.update(interval, operators)
        self._free = stress / interval
        preconditioned = fluid.matrix
        if self.literal:
            with phase("matrix assembly"):
                self._free_whole()
                preconditioned = self._whole = assembled(fluid, interval, operators)
            if self._factored is not None:
                self._factored.factor(self._whole)
                preconditioned = None
        self._changed(preconditioned)

    def _free_whole(self):
        if self._whole is not None:
            self._whole.destroy()

    def mult(self, x, y):
        """y = (A + J^T Pi C^T B^{-1} C Pi J / (dx dy)) x."""
        x, y = krylov.blocks_of(x), krylov.blocks_of(y)
        self.fluid.mult(x, y)
        operators = self.operators
        stress = self.block.solve(operators.rate(operators.interpolate(x[0])))
        operators.spread_add(-operators.force(stress), y[0])

    def _load_stresses(self):
        force = self.operators.force(self.block.solve(self._free))
        self.operators.spread_add(force, self._rhs[0])

    def _tolerances(self, accuracy):
        if accuracy is None:
            return None, None
        # The last pass's solution, when good enough, would be taken for that of this one, and the
        # markers for converged because they do not move.  And beside a factorisation, an accurate
        # solve is cheap.
        self._solution.set(0.0)
        return min(accuracy, ACCURACY), None

    def _go_on(self):
        """Solve until the error's power is small beside that of the velocity.  Returns iterations.

        The right-hand side is no measure: it holds the forces of the start, which the stiffer a
        membrane is, are the larger, and of which the more goes.  As the system's matrix is at least
        A, the residual's norm r . A^{-1} r bounds that of the velocity's error.
        """
        if self.literal or self.ksp.getNormType() != PETSc.KSP.NormType.NATURAL:
            return 0
        rtol, iterations, reason = self.ksp.getTolerances()[0], 0, PETSc.KSP.ConvergedReason
        velocity, work = self._unknowns[0], self._work
        while True:
            self.fluid.multiply(velocity, work)
            wanted = rtol * np.sqrt(abs(velocity.dot(work)))
            if self.ksp.getResidualNorm() <= wanted:
                return iterations
            if iterations and self.ksp.getConvergedReason() == reason.CONVERGED_RTOL:
                return iterations  # to round-off
            with krylov.tolerances(self.ksp, ROUND_OFF, wanted):
                iterations += max(1, self._solve())

    def _store_stresses(self):
        operators = self.operators
        rate = operators.rate(operators.interpolate(self.stage.velocity))
        self.stage.stress = self.block.solve(self._free + rate)

    def destroy(self, pc=None):
        """Free the solver.  Collective."""
        self._free_whole()
        super().destroy()
        self.block.destroy()
        self._work.destroy()
        if self._factored is not None:
            self._factored.destroy()
