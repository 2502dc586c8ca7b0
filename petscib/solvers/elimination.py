"""The implicit system with the membranes' stresses eliminated.

With B = 1 / (theta dt) + C K C^T, sparse and in marker space alone, the stresses are

    m = B^{-1} (m0 / (theta dt) + C Pi J w),

and what remains is (A + J^T Pi C^T B^{-1} C Pi J / (dx dy)) w = ..., symmetric positive definite
where A is.  The correction K bounds what is added to A, so that multigrid for A alone
preconditions; without it, only a factorisation of the whole assembled matrix does.
"""

from scipy.sparse import triu

from ..events import phase
from . import direct, krylov
from .alone import FluidPC
from .cholesky import Cholesky
from .literal import LiteralPC, assembled
from .model import StressMatrix

ACCURACY = 1e-10  # of a pass at least: with 1e-7 the tangent iteration takes up to twice the passes


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
            block = triu(self._stress.matrix(interval, operators), format="csr")
            block.sort_indices()
            self.direct.factor(block)

    def solve(self, values):
        """B^{-1} times an array over the stresses."""
        return self.interval * values if self._diagonal else self.direct.solve(values)

    def destroy(self):
        """Free the factor."""
        self.direct.destroy()


class Elimination:
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
        self.fluid, self.literal = fluid, literal
        self.block = StressBlock(fluid.prefix + "stress_")
        self._unknowns, self._rhs = fluid.blocks(), fluid.blocks()
        self._solution, self._load = map(krylov.join, (self._unknowns, self._rhs))
        self._operator = krylov.Operator(self._solution, self)
        defaults = fluid.defaults
        if literal and fluid.symmetric:
            defaults = {**defaults, **direct.defaults("cholesky", fluid.grid.comm)}
        self.ksp = krylov.create(self._operator.matrix, fluid.prefix, defaults)
        self.ksp.getPC().setUseAmat(False)  # multigrid would otherwise smooth with the operator
        self._whole = None
        if literal and not fluid.symmetric:
            self._direct = LiteralPC(fluid)
            krylov.use_python(self.ksp, self._direct)
        elif not literal:
            krylov.use_python(self.ksp, FluidPC(fluid))

    def begin(self, rhs, stage):
        """Take right-hand side and first guess."""
        self.rhs, self.stage = rhs, stage

    def update(self, interval, operators, stress):
        """Set the system for a configuration of the membranes."""
        fluid = self.fluid
        fluid.update(interval)
        self.operators = operators
        with phase("marker model"):
            self.block.update(interval, operators)
        self._free = stress / interval
        self._operator.changed()
        preconditioned = fluid.matrix
        if self.literal:
            with phase("matrix assembly"):
                self._replace(assembled(fluid, interval, operators))
            preconditioned = self._whole
            if not fluid.symmetric:
                self._direct.factor(self._whole)
                preconditioned = self._operator.matrix
        self.ksp.setOperators(self._operator.matrix, preconditioned)

    def _replace(self, matrix):
        if self._whole is not None:
            self._whole.destroy()
        self._whole = matrix

    def mult(self, x, y):
        """y = (A + J^T Pi C^T B^{-1} C Pi J / (dx dy)) x."""
        x, y = krylov.blocks_of(x), krylov.blocks_of(y)
        self.fluid.mult(x, y)
        operators = self.operators
        stress = self.block.solve(operators.rate(operators.interpolate(x[0])))
        operators.spread_add(-operators.force(stress), y[0])

    def iterate(self, accuracy):
        """Solve.  Returns the iterations."""
        fluid, stage, operators = self.fluid, self.stage, self.operators
        fluid.load(self._unknowns, stage.velocity, stage.pressure)
        self.rhs.copy(self._rhs[0])
        fluid.set_source(self._rhs)
        operators.spread_add(operators.force(self.block.solve(self._free)), self._rhs[0])
        if accuracy is not None:
            # The last pass's answer, when good enough, would be taken for that of this one, and
            # the markers for converged because they do not move.  And beside a factorisation, an
            # accurate solve is cheap.
            self._solution.set(0.0)
            accuracy = min(accuracy, ACCURACY)
        with krylov.tolerances(self.ksp, accuracy):
            iterations = krylov.solve(
                self.ksp, self._load, self._solution, fluid.name, krylov.advice(self.ksp),
                self.block.direct)
        fluid.store(self._unknowns, stage.velocity, stage.pressure)
        self._carried = operators.interpolate(stage.velocity)
        stage.stress = self.block.solve(self._free + operators.rate(self._carried))
        return iterations

    def marker_velocity(self):
        """U of the last solution."""
        operators = self.operators
        return self._carried + operators.slip_velocity(operators.force(self.stage.stress))

    def finish(self):
        """Nothing is left to do."""

    def destroy(self):
        """Free the solver.  Collective."""
        self._replace(None)
        if self.literal and not self.fluid.symmetric:
            self._direct.destroy()
        for part in (self.ksp, self._operator, self._solution, self._load,
                     *self._unknowns, *self._rhs, self.block):
            part.destroy()
