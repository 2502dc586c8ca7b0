"""The momentum system solved for the membrane's force, given exact solves of the fluid alone.

With B as in `block`, A = A0 + B^T B, and the system A u = b is

    A0 u + B^T f = b,    f = B u,

so that

    (1 + B A0^{-1} B^T) f = B A0^{-1} b,    u = A0^{-1} (b - B^T f).

The matrix is symmetric positive definite, has a few rows a marker, and does not grow with the
stiffness.  Its products need A0^{-1} near the membrane only (see `window`).  The preconditioner
is the same matrix with the tube in place of the box, (1 + B A0_tt^{-1} B^T)^{-1}, which the
tube's factorisation gives.  Together they have the same eigenvalues other than one as the
condensed operator (see `condensation`) preconditioned by A0^{-1}, hence the same iterations, but
the whole grid is solved only twice.

The iteration starts from the force f_0 that would act if the velocities around the tube were
zero, and its right-hand side is what f_0 leaves over: else the balance of large forces, which the
tube settles by itself, would be the measure of convergence.

Of f only its action counts: in the end the velocities in the tube are found from those around
it, as in the condensation, so that A u = b holds within the tube to round-off.
"""

from petsc4py import PETSc

from ..events import phase
from . import krylov
from .window import Window


class ForceSolver:
    """Conjugate gradients for the membrane's force.  Collective.

    Parameters
    ----------
    grid : Grid
    fluid : FluidMatrix
    ksp : PETSc.KSP
        For A0, with a preconditioner that inverts it; the iteration takes its options prefix.
    defaults : dict
        Solver options unless given.
    """

    def __init__(self, grid, fluid, ksp, defaults):
        self.grid = grid
        self.fluid = fluid
        self.fluid_ksp = ksp
        self.prefix, self.defaults = ksp.getOptionsPrefix(), defaults
        self.ksp = self.window = None
        self._rhs = fluid.matrix.createVecLeft()

    def update(self, tube, direct, condensation):
        """Take the tube's blocks for the membrane's present configuration.

        Parameters
        ----------
        tube : Tube
        direct : TubeVelocity
            Factored.
        condensation : Condensation
        """
        self.block, self.direct, self.condensation = direct.block, direct, condensation
        coefficients = self.fluid.matrix.getAttr("coefficients")
        self.window = Window(self.grid, *coefficients, tube.face_positions())
        if self.ksp is None:
            self._create()
        self._operator.act_as(self)

    def _create(self):
        count = self.block.root.getSize()[0] if self.block.size else 0
        self._force = PETSc.Vec().createMPI((count, PETSc.DETERMINE), comm=self.grid.comm)
        self._caused, self._total = self._force.duplicate(), self._force.duplicate()
        self._operator = krylov.Operator(self._force)
        self.ksp = krylov.create(self._operator.matrix, self.prefix, self.defaults)
        self.ksp.getPC().setType("python")
        self.ksp.getPC().setPythonContext(_TubePC(self))

    def mult(self, x, y):
        """y = (1 + B A0^{-1} B^T) x."""
        force = x.getArray(readonly=True)
        velocity = self.window.vector
        velocity.getArray()[:] = self.block.spread(force)
        self.window.solve()
        y.getArray()[:] = force + self.block.forces_of(velocity.getArray(readonly=True))

    def solve(self, rhs, velocity):
        """Solve for `velocity` (first guess on entry).  Returns the iterations."""
        outer, total = self.condensation, self._total
        with phase("tube solve"):
            base = self.direct.force(outer.from_tube(rhs))
            guess = self.direct.force(outer.tube_rhs(rhs, velocity))
        total.getArray()[:] = base
        self._respond(rhs, velocity)
        self._caused.getArray()[:] = self.block.forces_of(outer.from_tube(velocity)) - base
        self._force.getArray()[:] = guess - base
        iterations = krylov.solve(
            self.ksp, self._caused, self._force, "momentum", krylov.advice(self.ksp)
        )
        total.axpy(1.0, self._force)
        self._respond(rhs, velocity)
        outer.recover(rhs, velocity)
        return iterations

    def _respond(self, rhs, velocity):
        """Set the velocity to A0^{-1} (rhs - B^T f), with f the total force."""
        rhs.copy(self._rhs)
        spread = self.block.spread(self._total.getArray(readonly=True))
        self.condensation.add(self._rhs, tube=-spread)
        self.fluid_ksp.getPC().apply(self._rhs, velocity)

    def release(self):
        """Free what belongs to one configuration of the membrane.  Collective."""
        self.window.destroy()

    def destroy(self):
        """Free the solver.  Collective."""
        if self.ksp is not None:
            self.ksp.destroy()
            self._operator.destroy()
            self._force.destroy()
            self._caused.destroy()
            self._total.destroy()
        self._rhs.destroy()


class _TubePC:
    """PETSc python PC: the tube in place of the box."""

    def __init__(self, solver):
        self.solver = solver

    def apply(self, pc, x, y):
        """Set y to the preconditioner times x."""
        with phase("tube solve"):
            y.getArray()[:] = self.solver.direct.precondition(x.getArray(readonly=True))

    def view(self, pc, viewer):
        """Say what it is, and what inverts A0."""
        viewer.printfASCII("  the membrane's force in the tube alone, by a direct solver\n")
        viewer.printfASCII("  within products with the inverse of the fluid's matrix:\n")
        self.solver.fluid_ksp.getPC().view(viewer)
