"""The momentum system: viscous fluid plus implicit membrane force."""

from petsc4py import PETSc

from . import krylov
from .tube import TubeSchur

FLUID_DEFAULTS = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-8,
    "ksp_max_it": 500,
    "pc_type": "gamg",
}
DEFAULTS = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-8,
    "ksp_max_it": 500,
    "pc_type": "python",
}
ADVICE = (
    "try a smaller -ts_dt, a larger -momentum_ksp_max_it, or -momentum_ksp_monitor to see more"
)


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

    def update(self, interval):
        """Make the matrix for theta dt = `interval`.  Returns whether it changed."""
        if interval == self.interval:
            return False
        self.operators.laplacian.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.matrix.scale(-self.mu)
        self.matrix.shift(self.rho / interval)
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


class MomentumOperator:
    """A = A0 + implicit membrane force, applied without assembling it (python Mat)."""

    def __init__(self, fluid):
        self.fluid = fluid
        self.force = None

    def mult(self, matrix, x, y):
        """y = A x."""
        self.fluid.matrix.mult(x, y)
        self.force.add_to(x, y)


class MomentumSolver:
    """Conjugate gradients for (A0 + theta dt F W J) u = b.  Collective.

    Without a membrane the system is A0 and is preconditioned by GAMG; with one, by the tube
    Schur preconditioner.  Any other -momentum_pc_type acts on the assembled matrix.

    Parameters
    ----------
    operators : Operators
    rho, mu : float
    membrane : bool
        Whether there will be an implicit membrane force.
    prefix : str
    """

    def __init__(self, operators, rho, mu, membrane, prefix="momentum_"):
        self.fluid = FluidMatrix(operators, rho, mu)
        self.prefix = prefix
        self.operator = None
        if not membrane:
            self.ksp = krylov.create(self.fluid.matrix, prefix, FLUID_DEFAULTS)
        else:
            self.operator = MomentumOperator(self.fluid)
            sizes = self.fluid.matrix.getSizes()
            self.matrix = PETSc.Mat().createPython(sizes, self.operator, comm=operators.grid.comm)
            self.matrix.setUp()
            self.ksp = krylov.create(self.matrix, prefix, DEFAULTS)
            pc = self.ksp.getPC()
            self.assembled = pc.getType() != "python"
            if not self.assembled and pc.getPythonContext() is None:
                pc.setPythonContext(TubeSchur(self.operator, operators.grid, prefix))
        self.ksp.setInitialGuessNonzero(True)

    def update(self, interval, interpolation=None, stiffness=None):
        """Set the system for theta dt = `interval` and the membrane's present configuration."""
        self.fluid.update(interval)
        if self.operator is None:
            return
        self.operator.force = ImplicitForce(interpolation, stiffness, interval)
        self.matrix.assemble()  # tells PETSc that it changed
        if self.assembled:
            whole = self.operator.force.assemble()
            whole.axpy(1.0, self.fluid.matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            self.ksp.setOperators(self.matrix, whole)

    def solve(self, rhs, velocity):
        """Solve for `velocity` (first guess on entry).  Returns the iterations."""
        self.ksp.solve(rhs, velocity)
        krylov.check(self.ksp, "momentum", ADVICE)
        return self.ksp.getIterationNumber()

    def destroy(self):
        """Free the solver.  Collective."""
        self.ksp.destroy()
        if self.operator is not None:
            self.matrix.destroy()
        self.fluid.matrix.destroy()
