"""An implicit system solved for the membrane's force, given exact solves of the fluid alone.

With B as in `block`, the momentum system A u = b, A = A0 + B^T B, is

    A0 u + B^T f = b,    f = B u,

so that

    (1 + B H B^T) f = B H b,    u = H (b - B^T f),    H = A0^{-1}.

For the coupled system H takes forces to velocities without divergence; the pressure follows from
them.  The matrix is symmetric positive definite, has a few rows a marker, and does not grow with
the stiffness.  Its products need H near the membrane only (a *window*).  The preconditioner is the
same matrix with the tube in place of the box, which the tube's factorisation gives.  Together they
have the same eigenvalues other than one as the condensed operator (see `condensation`)
preconditioned by the fluid's inverse, hence the same iterations, but the whole grid is solved only
twice.

The measure of convergence is what the force f_0, which would act if the velocities around the
tube were zero, leaves over: else it would be the balance of large forces, which the tube settles by
itself.

At the end, the velocities in the tube and the force are corrected together so that f = B u there
holds to round-off, with the surroundings as they are.
"""

import numpy as np
from petsc4py import PETSc

from ..events import phase
from . import krylov


class ForceSolver:
    """Krylov iteration, by default conjugate gradients, for the membrane's force.  Collective.

    Solves with the membrane in almost the same place belong together::

        solver.begin()
        for ...:
            solver.iterate(rhs, velocity)
        solver.finish(rhs, velocity)

    Between them the block and the right-hand side may change within the tube, and the
    factorisation may stay that of an earlier block: it only preconditions.

    Parameters
    ----------
    response
        H: its method `respond(force, velocity)` on the whole grid, and `window(faces)`, as those of
        `FluidTransform`.
    vector : PETSc.Vec
        Any velocity vector.
    prefix : str
        Options prefix of the iteration.
    defaults : dict
        Solver options unless given.
    what : str
        Which solve it is, for messages.
    """

    def __init__(self, response, vector, prefix, defaults, what):
        self.response = response
        self.prefix, self.defaults, self.what = prefix, defaults, what
        self.ksp = self.window = None
        self._rhs = vector.duplicate()
        self.begin()

    def set_tube(self, tube, direct, condensation):
        """Take a new tube.

        Parameters
        ----------
        tube : Tube
        direct : TubeDirect
            Factored.
        condensation : Condensation
            Of the velocities.
        """
        self.release()
        self.block, self.direct, self.condensation = direct.block, direct, condensation
        self.window = self.response.window(tube.face_positions())
        if self.ksp is None:
            self._create()
        self.begin()

    def _create(self):
        count = self.block.root.getSize()[0] if self.block.size else 0
        comm = self._rhs.comm
        self._residual = PETSc.Vec().createMPI((count, PETSc.DETERMINE), comm=comm)
        self._change = self._residual.duplicate()
        self._operator = krylov.Operator(self._residual)
        self._operator.act_as(self)
        self.ksp = krylov.create(self._operator.matrix, self.prefix, self.defaults)
        self.ksp.setInitialGuessNonzero(False)
        self.ksp.getPC().setType("python")
        self.ksp.getPC().setPythonContext(_TubePC(self))

    def mult(self, x, y):
        """y = (1 + B H B^T) x.  Keeps x and H B^T x near the membrane."""
        force = x.getArray(readonly=True)
        velocity = self._respond_near(self.block.spread(force))
        y.getArray()[:] = force + self.block.forces_of(velocity)
        self._products.append((force.copy(), velocity))

    def _respond_near(self, force):
        """The velocities on the tube's faces caused by forces there: arrays on rank 0."""
        self.window.vector.getArray()[:] = force
        self.window.solve()
        return self.window.vector.getArray(readonly=True).copy()

    def begin(self):
        """Forget the last solution: the next solve starts from a first guess."""
        self._started = False

    def solve(self, rhs, velocity):
        """Solve for `velocity` (first guess on entry).  Returns the iterations."""
        self.begin()
        iterations = self.iterate(rhs, velocity)
        self.finish(rhs, velocity)
        return iterations

    def iterate(self, rhs, velocity, rtol=None, slope=None):
        """Solve so far that `velocity` holds in the tube.  Returns the iterations.

        Parameters
        ----------
        rhs, velocity : PETSc.Vec
            The first time after `begin`, `velocity` is the first guess.
        rtol : float, optional
            In place of the solver's relative tolerance.
        slope : PETSc.Vec, optional
            Part of the right-hand side that, at the first guess, a pressure balances.
        """
        block, force = self.block, self.condensation.from_tube(rhs)
        if not self._started:
            self._start(rhs, force, velocity, slope)
        near = self._near + self._respond_near(
            force - self._given - block.spread(self.force))
        self._residual.getArray()[:] = block.forces_of(near) - self.force

        usual, atol = self.ksp.getTolerances()[:2]
        least = (usual if rtol is None else rtol) * self._norm
        self._products = []
        with krylov.tolerances(self.ksp, 0.0, max(atol, least)):
            iterations = krylov.solve(
                self.ksp, self._residual, self._change, self.what, krylov.advice(self.ksp)
            )
        change = self._change.getArray(readonly=True)
        self.force += change
        near -= self._caused(change)
        # What is left of the residual goes into the velocities only: put into the force as well, it
        # would be a step of an iteration that need not converge.
        _, shift = self._correction(near)
        self.condensation.set_tube(near + shift, velocity)
        return iterations

    def _start(self, rhs, force, velocity, slope):
        """Solve with the force f_0, and take the guessed one."""
        block, direct, outer = self.block, self.direct, self.condensation
        rest = outer.tube_rhs(rhs, velocity)
        if slope is not None:
            rest -= outer.from_tube(slope)
        with phase("tube solve"):
            base = direct.force(force)
            self.force = direct.force(rest)
        spread = block.spread(base)
        self._given = force - spread
        rhs.copy(self._rhs)
        outer.add(self._rhs, tube=-spread)
        self.response.respond(self._rhs, velocity)
        self._near = outer.from_tube(velocity)
        self._residual.getArray()[:] = block.forces_of(self._near) - base
        self._norm = self._measure(self._residual)
        self._started = True

    def _measure(self, residual):
        """Norm of a residual as the iteration measures it."""
        kind, kinds = self.ksp.getNormType(), PETSc.KSP.NormType
        if kind == kinds.UNPRECONDITIONED:
            return residual.norm()
        self.ksp.getPC().apply(residual, self._change)
        if kind == kinds.NATURAL:
            return np.sqrt(abs(residual.dot(self._change)))
        return self._change.norm()

    def _caused(self, force):
        """H B^T times the array, a combination of those that products were made with."""
        if not self._products or not self.block.size:
            return 0.0
        forces, velocities = (np.stack(part, axis=1) for part in zip(*self._products))
        sizes = np.linalg.norm(forces, axis=0)
        weights = np.linalg.lstsq(forces / sizes, force, rcond=None)[0]
        return velocities @ (weights / sizes)

    def _correction(self, near):
        """Changes of force and velocities that make f = B u in the tube."""
        with phase("tube solve"):
            return self.direct.correction(self.force - self.block.forces_of(near))

    def finish(self, rhs, velocity):
        """Make `velocity` hold everywhere."""
        outer = self.condensation
        rhs.copy(self._rhs)
        outer.add(self._rhs, tube=-self.block.spread(self.force))
        self.response.respond(self._rhs, velocity)
        near = outer.from_tube(velocity)
        correction, shift = self._correction(near)
        self.force += correction
        outer.set_tube(near + shift, velocity)
        self.begin()

    def release(self):
        """Free what belongs to one tube.  Collective."""
        if self.window is not None:
            self.window.destroy()
            self.window = None

    def destroy(self):
        """Free the solver.  Collective."""
        self.release()
        if self.ksp is not None:
            for part in (self.ksp, self._operator, self._residual, self._change):
                part.destroy()
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
        """Say what it is, and what inverts the fluid's matrix."""
        viewer.printfASCII("  the membrane's force in the tube alone, by a direct solver\n")
        viewer.printfASCII("  within products with the inverse of the fluid's matrix:\n")
        self.solver.response.view(pc, viewer)
