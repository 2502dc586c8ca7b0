"""The momentum system: viscous fluid plus implicit membrane force."""

import numpy as np
from petsc4py import PETSc

from ..events import phase
from . import krylov
from .block import TubeBlock, TubeDirect, tube_blocks
from .condensation import Condensation
from .force import ForceSolver
from .tube import Tube

DEFAULTS = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-6,
    "ksp_max_it": 500,
    "pc_type": "gamg",
}
# The dearer an iteration, the more it pays to enlarge the tube.
LAYERS, LAYERS_IF_EXACT = 3, 1


class FluidMatrix:
    """A0 = rho / (theta dt) - mu Laplacian, kept until theta dt changes.  Collective.

    Attributes
    ----------
    matrix : PETSc.Mat
        Symmetric positive definite; wall faces have decoupled rows.
    interval : float or None
        The theta dt that the matrix was made for.
    """

    def __init__(self, operators, rho, mu):
        self.operators = operators
        self.rho, self.mu = rho, mu
        self.interval = None
        self.matrix = operators.laplacian.duplicate()
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)
        self.matrix.setAttr("grid", operators.grid)  # for FluidTransform

    def update(self, interval):
        """Make the matrix for theta dt = `interval`.  Returns whether it changed."""
        if interval == self.interval:
            return False
        self.operators.laplacian.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.matrix.scale(-self.mu)
        self.matrix.shift(self.rho / interval)
        self.matrix.setAttr("coefficients", (self.rho / interval, self.mu))
        self.interval = interval
        return True


class ImplicitForce:
    """The operator theta dt F W J: implicit membrane force on the grid.

    Parameters
    ----------
    interpolation : Interpolation
    stiffness : Stiffness
    interval : float
        theta dt.
    """

    def __init__(self, interpolation, stiffness, interval):
        self.interpolation = interpolation
        self.stiffness = stiffness
        self.interval = interval

    @property
    def scale(self):
        """Factor of J^T W J in the momentum matrix."""
        return self.interval * self.interpolation.spreading_scale

    def ratio(self, fluid):
        """How many times stiffer the membrane is than the fluid, by diagonals of matrices."""
        membrane, grid = self.stiffness.membrane, self.interpolation.grid
        stiffest = max(membrane.sigma0 / membrane.ds**2, 4 * membrane.bending / membrane.ds**4)
        diagonal = fluid.rho / self.interval + 2 * fluid.mu * (1 / grid.dx**2 + 1 / grid.dy**2)
        return self.scale * stiffest / diagonal

    def root(self):
        """The matrix C with C^T C = W, times the square root of that factor, on rank 0."""
        root = self.stiffness.root()
        root.scale(np.sqrt(self.scale))
        return root

    def first_guess(self):
        """First guess of the force f = B u, on rank 0."""
        return np.sqrt(self.scale) * self.stiffness.first_rates(self.interval)

    def add_to(self, velocity, result):
        """Add its product with `velocity` to `result`.  Collective."""
        displacement = self.interval * self.interpolation.interpolate(velocity)
        self.interpolation.spread_add(self.stiffness.apply(displacement), result)

    def assemble(self):
        """The operator as a parallel matrix.  Collective."""
        stiffness = self.stiffness.matrix(self.interpolation.grid.comm)
        product = stiffness.ptap(self.interpolation.matrix)
        product.scale(self.scale)
        return product


class WholeOperator:
    """The momentum matrix A0 + theta dt F W J, applied piece by piece."""

    def __init__(self, fluid, force):
        self.fluid = fluid
        self.force = force

    def mult(self, x, y):
        """y = A x."""
        self.fluid.matrix.mult(x, y)
        self.force.add_to(x, y)


class MomentumSolver:
    """Conjugate gradients for (A0 + theta dt F W J) u = b.  Collective.

    The tube around the membrane is condensed; the preconditioner, GAMG unless options say
    otherwise, is set up for A0 alone and kept while theta dt stays.  When it inverts A0 exactly,
    the iteration is for the membrane's force instead (see `force`).  -<prefix>condense false
    keeps the whole matrix, preconditioned as assembled: for comparison.

    Parameters
    ----------
    operators : Operators
    rho, mu : float
    prefix : str
        Options prefix; that of the tube's direct solver is <prefix>tube_.
    defaults : dict
        Solver options unless given.
    """

    def __init__(self, operators, rho, mu, prefix="momentum_", defaults=DEFAULTS):
        self.grid = operators.grid
        self.fluid = FluidMatrix(operators, rho, mu)
        self.condense = PETSc.Options(prefix).getBool("condense", True)
        self.prefix, self.defaults = prefix, defaults
        self.ksp = krylov.create(self.fluid.matrix, prefix, defaults)
        # Multigrid would otherwise smooth with the operator, at a tube solve a sweep.
        self.ksp.getPC().setUseAmat(False)
        self.condensation = self.force_solver = self.direct = self._operator = self._rhs = None

    def _prepare_for_membrane(self):
        if self.condense and krylov.has_exact_preconditioner(self.ksp):
            self.force_solver = ForceSolver(
                self.grid, self.fluid, self.ksp.getPC().getPythonContext(), self.prefix,
                self.defaults, "momentum", LAYERS_IF_EXACT, solenoidal=False,
            )
            return
        self._rhs = self.fluid.matrix.createVecLeft()
        self._operator = krylov.Operator(self._rhs)
        if self.condense:
            self.direct = TubeDirect(self.prefix + "tube_")

    def update(self, interval, interpolation=None, stiffness=None):
        """Set the system for theta dt = `interval` and the membrane's present configuration.

        A solver once used with a membrane stays one with a membrane.
        """
        self.fluid.update(interval)
        self._release()
        if interpolation is None:
            self.ksp.setOperators(self.fluid.matrix)
            return
        if self.force_solver is None and self._operator is None:
            self._prepare_for_membrane()
        force = ImplicitForce(interpolation, stiffness, interval)
        if self.force_solver:
            self.ksp.setOperators(self.fluid.matrix)
            self.ksp.getPC().setUp()
            with phase("tube set-up"):
                self.force_solver.update(interpolation, force)
        elif self.condense:
            with phase("tube set-up"):
                self.condensation = self._condense(force)
            self._operator.act_as(self.condensation)
            self.ksp.setOperators(self._operator.matrix, self.fluid.matrix)
        else:
            with phase("momentum assembly"):
                whole = force.assemble()
                whole.axpy(1.0, self.fluid.matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            self._operator.act_as(WholeOperator(self.fluid, force))
            self.ksp.setOperators(self._operator.matrix, whole)
            whole.destroy()

    def _condense(self, force):
        tube = Tube(self.grid, force.interpolation.stencil, LAYERS)
        matrix, coupling = tube_blocks(self.fluid.matrix, tube)
        block = TubeBlock(tube, matrix)
        block.set(force.root())
        self.direct.set_block(block)
        self.direct.factor()
        return Condensation(
            self.fluid.matrix.mult, self._rhs, tube.faces, tube.shell_faces, [coupling],
            self.direct.solve,
        )

    def solve(self, rhs, velocity):
        """Solve for `velocity` (first guess on entry).  Returns the iterations."""
        if self.force_solver:
            return self.force_solver.solve(rhs, velocity)
        if self.condensation is None:
            return self._iterate(rhs, velocity)
        self.condensation.condense(rhs, self._rhs)
        iterations = self._iterate(self._rhs, velocity)
        self.condensation.recover(rhs, velocity)
        return iterations

    def _iterate(self, rhs, velocity):
        return krylov.solve(self.ksp, rhs, velocity, "momentum", krylov.advice(self.ksp))

    def _release(self):
        """Free what belongs to one configuration of the membrane."""
        if self.condensation is not None:
            self.condensation.destroy()
            self.condensation = None

    def destroy(self):
        """Free the solver.  Collective."""
        self._release()
        parts = (
            self.force_solver,
            self.direct,
            self.ksp,
            self._operator,
            self.fluid.matrix,
            self._rhs,
        )
        for part in parts:
            if part is not None:
                part.destroy()
