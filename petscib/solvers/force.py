"""An implicit system solved for the membrane's force, given exact solves of the fluid alone.

With B as in `block`, the momentum system A u = b, A = A0 + B^T B, is

    A0 u + B^T f = b,    f = B u,

so that

    (1 + B H B^T) f = B H b,    u = H (b - B^T f),    H = A0^{-1}.

For the coupled system H takes forces to velocities without divergence; the pressure follows from
them.  The matrix is symmetric positive definite, has a few rows a marker, and does not grow with
the stiffness.  Its products need H near the membrane only (a *window*).  The preconditioner is the
same matrix with the tube in place of the box, which the tube's factorisation gives; on several
ranks, an arc of it each (see `arcs`).  On one rank, the two have together the same eigenvalues
other than one as the condensed operator (see `condensation`) preconditioned by the fluid's inverse,
hence the same iterations, but the whole grid is solved only twice.

Convergence is measured by velocities: an error of the markers' velocities U leaves a residual of
about B H J^T g, with the forces g = U |U|^2 / (U . J H J^T U) that would cause it.  The right-hand
side would be no measure, as it may be a balance of large forces.
"""

import numpy as np
from petsc4py import PETSc

from . import krylov
from .arcs import TubeArcs
from .block import TubeBlock
from .condensation import TubeAccess
from .tube import Tube

# When the markers turn out to be this much slower than guessed, the solve goes on; though not below
# the tolerance for the second, as at rest there is nothing to measure by.
MUCH_SLOWER, LEAST_SLOWER = 0.1, 1e-3


class ForceSolver:
    """Krylov iteration, by default conjugate gradients, for the membrane's force.  Collective.

    Solves with the membrane in almost the same place belong together::

        solver.update(interpolation, force)
        solver.begin()
        solver.iterate(rhs, velocity)
        for ...:
            solver.update(interpolation, force)
            solver.iterate(rhs, velocity)
        solver.finish(rhs, velocity)

    Between them the right-hand side may change within the tube.

    Parameters
    ----------
    grid : Grid
    fluid : FluidMatrix
    response
        H: its method `respond(force, velocity)` on the whole grid, and `window(faces)`, as those of
        `FluidTransform`.
    prefix : str
        Options prefix of the iteration; the tube's direct solvers have <prefix>tube_.
    defaults : dict
        Solver options unless given.
    what : str
        Which solve it is, for messages.
    layers : int
        Layers of faces in the tube beyond those that the markers see.
    solenoidal : bool
        Whether the velocities are without divergence.
    """

    def __init__(self, grid, fluid, response, prefix, defaults, what, layers, solenoidal):
        self.grid, self.fluid, self.response = grid, fluid, response
        self.prefix, self.defaults, self.what = prefix, defaults, what
        self.layers = layers
        self._rhs = grid.velocity_vector()
        self.arcs = TubeArcs(grid, fluid, self._rhs, prefix + "tube_", layers, solenoidal)
        self.ksp = self.window = self.block = self._tube = self._root = None
        self._interpolation = self._interval = None
        # On rank 0: the force f, the load b - B^T f on the tube's faces, and the velocities near
        # the membrane that belong to it.
        self.force = self._load = self._near = None

    def update(self, interpolation, force):
        """Set the system for the membrane's present configuration.

        Parameters
        ----------
        interpolation : Interpolation
            With that of the last call, only the stiffness is taken anew.
        force : ImplicitForce
        """
        changed, fresh = self.fluid.interval != self._interval, self._near is None
        if changed or interpolation is not self._interpolation:
            self._place(interpolation.stencil, force.ratio(self.fluid), changed)
            self._interpolation, self._interval = interpolation, self.fluid.interval
        root = force.root()
        self.block.set(root)
        if self.ksp is None:
            self._create(root.getSize()[0])
        self.arcs.set_root(root, self._residual)
        self.arcs.factor()
        if self._root is not None:
            self._root.destroy()
        self._root = root
        self._guess = force.first_guess() if fresh or changed else self.force

    def _place(self, stencil, ratio, changed):
        """Take new positions of the markers: as a rule, they are still in the same tube."""
        tube = Tube(self.grid, stencil, self.layers)
        same = not changed and self._tube is not None and tube.has_faces_of(self._tube)
        if self.grid.comm.tompi4py().bcast(same):
            if self.block.size:
                self.block.move(tube)
        else:
            self._release()
            self.block = TubeBlock(tube)
            self.access = TubeAccess(self._rhs, tube.faces)
            self.window = self.response.window(tube.face_positions())
            self.begin()
        self.arcs.place(tube, self.block, ratio, changed)
        self._tube = tube

    def _create(self, count):
        self._residual = PETSc.Vec().createMPI((count, PETSc.DETERMINE), comm=self.grid.comm)
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
        self._near = None

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
        block, force = self.block, self.access.from_tube(rhs)
        if self._near is None:
            self._start(rhs, force, velocity, slope)
        else:
            load = force - block.spread(self.force)
            self._near += self._respond_near(load - self._load)
            self._load = load
        tolerance = self.ksp.getTolerances()[0] if rtol is None else rtol
        iterations = self._improve(tolerance)
        slower = self._speed_of(self._near) / self._speed if self._speed else 1.0
        if slower < MUCH_SLOWER:  # than guessed: so was the tolerance, then
            self._speed *= max(slower, LEAST_SLOWER)
            self._norm *= max(slower, LEAST_SLOWER)
            iterations += self._improve(tolerance)
        self.access.set_tube(self._near, velocity)
        return iterations

    def _improve(self, tolerance):
        """Iterate until the residual is small enough.  Returns the iterations."""
        block = self.block
        self._residual.getArray()[:] = block.forces_of(self._near) - self.force
        self._products = []
        least = max(self.ksp.getTolerances()[1], tolerance * self._norm)
        with krylov.tolerances(self.ksp, 0.0, least):
            iterations = krylov.solve(
                self.ksp, self._residual, self._change, self.what, krylov.advice(self.ksp)
            )
        change = self._change.getArray(readonly=True)
        self.force = self.force + change
        self._load -= block.spread(change)
        self._near -= self._caused(change)
        return iterations

    def _start(self, rhs, force, velocity, slope):
        """Take the force that belongs to the first guess, and the velocities that belong to it."""
        guess = self.access.from_tube(velocity)
        self.force = self._guess
        self._subtract_force(rhs)
        self._change.getArray()[:] = self.force
        self.arcs.add_forces(self._rhs, velocity, slope, self._change)
        self.force = self._change.getArray(readonly=True).copy()
        self._load = force - self.block.spread(self.force)
        self._respond(rhs, velocity)
        self._near = self.access.from_tube(velocity)
        self._speed = self._speed_of(guess)
        if not self._speed:
            guess = self._near
            self._speed = self._speed_of(guess)
        self._norm = self._norm_of(guess)

    def _subtract_force(self, rhs):
        """Prepare rhs - B^T f."""
        rhs.copy(self._rhs)
        self.spread_add(self._rhs, -1.0)

    def _respond(self, rhs, velocity):
        """Set `velocity` to H (rhs - B^T f)."""
        self._subtract_force(rhs)
        self.response.respond(self._rhs, velocity)

    def _speed_of(self, velocity):
        """Size of the markers' velocities, on every rank, for an array over the tube's faces."""
        speed = np.linalg.norm(self.block.interpolate(velocity))
        return self.grid.comm.tompi4py().bcast(speed)

    def _norm_of(self, velocity):
        """Norm of the residual that an error as large as these velocities in the tube leaves."""
        block = self.block
        at_markers = block.interpolate(velocity)
        caused = self._respond_near(block.spread_markers(at_markers))
        square, response = at_markers @ at_markers, at_markers @ block.interpolate(caused)
        factor = square / response if response else 0.0
        self._residual.getArray()[:] = factor * block.forces_of(caused)
        return self._measure(self._residual)

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

    def finish(self, rhs, velocity):
        """Make `velocity` hold everywhere."""
        self._respond(rhs, velocity)
        # The energy law asks for f = B u where f is large, more than for the momentum.
        near = self.access.from_tube(velocity)
        self._residual.getArray()[:] = self.force - self.block.forces_of(near)
        self.arcs.correct(self._residual, velocity)
        self.force = self.force + self._residual.getArray(readonly=True)
        self.arcs.age()
        self.begin()

    def spread_add(self, vector, scale):
        """Add `scale` times B^T f to a velocity vector."""
        self.access.add_tube(scale * self.block.spread(self.force), vector)

    def _release(self):
        """Free what belongs to one tube."""
        if self.window is not None:
            self.window.destroy()
            self.access.destroy()

    def destroy(self):
        """Free the solver.  Collective."""
        self._release()
        self.arcs.destroy()
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
        self.solver.arcs.precondition(x, y)

    def view(self, pc, viewer):
        """Say what it is, and what inverts the fluid's matrix."""
        viewer.printfASCII("  the membrane's force in the tube alone, by a direct solver\n")
        viewer.printfASCII("  within products with the inverse of the fluid's matrix:\n")
        self.solver.response.view(pc, viewer)
