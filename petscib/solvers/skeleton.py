"""The coupled system on its skeleton, given exact solves of the fluid's two parts.

When A0 and the pressure's Laplacian are inverted exactly, the projection method P leaves of the
coupled system K0 of the fluid only the slip along the walls,

    K0 P z - z = -(2 mu / h^2) w grad phi    at faces half a cell h from a wall along them,

with phi the Poisson problem's solution and w = theta dt: nowhere else do Laplacian and gradient
fail to commute.  The condensed operator S (see `condensation`) differs from K0 in the tube's
shell.  So after one application of P to the residual, what is left of it lives on the *skeleton*,
the shell and these faces, and so do all residuals of

    S P z = r,    x = x_0 + P z,

an iteration whose vectors are as short as the membrane and the walls are long.  A product costs
one projection and one solve in the tube.

A second solve, with another membrane in the same tube, starts from a residual on the skeleton
again; of x it needs the values in the tube and its shell only, until the last one is done.
"""

import numpy as np
from petsc4py import PETSc

from ..events import phase
from . import krylov


class Skeleton:
    """Krylov iteration on the skeleton.  Collective.

    Parameters
    ----------
    operators : Operators
    projection : ProjectionPC
        With exact solvers inside.
    prefix : str
        Options prefix of the iteration.
    defaults : dict
        Solver options unless given.
    """

    def __init__(self, operators, projection, prefix, defaults):
        self.projection = projection
        self.prefix, self.defaults = prefix, defaults
        self.layout = layout = projection.pair.layout
        self._given, *self._source = layout.joint()
        self._answer, *self._found = layout.joint()
        self._sum = layout.vector.duplicate()
        self._slip_faces, weights = slip_faces(operators, layout)
        self._slip_weights = projection.pair.fluid.mu * weights
        self.ksp = None
        self.begin()

    def begin(self):
        """Forget the last solution: the next solve starts from a first guess."""
        self.started = False

    def set_tube(self, condensation):
        """Take the condensation in a new tube; not between solves that belong together."""
        self.condensation = condensation
        self._given.set(0.0)
        marks = self._given.getArray()
        marks[self._slip_faces] = 1.0
        condensation.add(self._given, tube=-2.0, shell=1.0)
        marks = self._given.getArray()
        self._places = np.flatnonzero(marks > 0)
        self._given.set(0.0)
        self._create()
        self.begin()

    def _create(self):
        """Vectors and solver of this length.

        The preconditioner maps r to the triple (r, S P r, P r near the membrane), and the operator
        picks the second part: so products are made once, and the answer brings along what the
        markers ask for.
        """
        self._release()
        count = len(self._places)
        length = 2 * count + self.condensation.local_size
        self._residual = PETSc.Vec().createMPI((length, PETSc.DETERMINE), comm=self.layout.comm)
        self._change = self._residual.duplicate()
        self._parts = slice(0, count), slice(count, 2 * count), slice(2 * count, None)
        self._operator = krylov.Operator(self._residual)
        self._operator.act_as(self)
        self.ksp = krylov.create(self._operator.matrix, self.prefix, self.defaults)
        self.ksp.setInitialGuessNonzero(False)
        self.ksp.getPC().setPythonContext(_SkeletonPC(self))
        self._tolerances = self.ksp.getTolerances()

    def mult(self, x, y):
        """Pick the product out of a preconditioned vector."""
        residual, product, _ = self._parts
        y.set(0.0)
        y.getArray()[residual] = x.getArray(readonly=True)[product]

    def precondition(self, x, y):
        """Set y to the triple that belongs to the residual in x."""
        residual, product, values = self._parts
        source, triple = x.getArray(readonly=True)[residual], y.getArray()
        self._given.getArray()[self._places] = source
        near = self._project()
        excess, near = self._excess(near)
        triple[residual] = source
        triple[product] = source + excess
        triple[values] = near

    def _project(self):
        """Apply P to the given vector and clear that; values near the membrane."""
        self.projection.project(*self._source, *self._found)
        self._given.getArray()[self._places] = 0.0
        return self.condensation.gather(self._answer)

    def _excess(self, near):
        """(S P - 1) z on the skeleton, and P z near the membrane with the tube's values of S."""
        condensation, count = self.condensation, self.condensation.count
        with phase("tube solve"):
            tube = -condensation.solve_tube(condensation.from_shell(near[count:]))
        change = condensation.to_shell(tube - near[:count])
        near[:count] = tube
        slip = self.projection.slope.getArray(readonly=True)[self._slip_faces]
        return self._collect(change, self._slip_weights * slip), near

    def _collect(self, shell, slip=0.0):
        """Values on the skeleton from those in the shell (on rank 0) and at the slip faces."""
        work = self._given
        self.condensation.add(work, shell=shell)
        values = work.getArray()
        values[self._slip_faces] += slip
        found = values[self._places].copy()
        values[self._slip_faces] = 0.0
        values[self._places] = 0.0
        return found

    def solve(self, rhs, solution, rtol):
        """Solve so far that `solution` holds in the tube.  Returns the iterations.

        The first time after `begin`, `solution` is the first guess.  Relative tolerances refer to
        the condensed right-hand side.
        """
        residual, product, values = self._parts
        if self.started:
            self._take_membrane(rhs)
        else:
            self._start(rhs, solution)
        usual, atol = self._tolerances[:2]
        self.ksp.setTolerances(rtol=0.0, atol=max(atol, max(rtol, usual) * self._norm))
        iterations = krylov.solve(
            self.ksp, self._residual, self._change, "coupled", krylov.advice(self.ksp)
        )
        change = self._change.getArray(readonly=True)
        self._residual.getArray()[residual] -= change[product]
        self._sum.getArray()[self._places] += change[residual]
        self._near += change[values]
        self.condensation.set_tube(self._near[: self.condensation.count], solution)
        return iterations

    def _start(self, rhs, solution):
        """Project the first guess's residual onto the skeleton."""
        condensation = self.condensation
        condensation.condense(rhs, self._answer)
        self._norm = self._answer.norm()
        condensation.mult(solution, self._given)
        self._given.aypx(-1.0, self._answer)
        near = self._project()
        solution.axpy(1.0, self._answer)
        self._given.set(0.0)
        excess, _ = self._excess(near)
        self._residual.set(0.0)
        self._residual.getArray()[self._parts[0]] = -excess
        self._sum.set(0.0)
        self._near = condensation.gather(solution)
        self._near[: condensation.count] = self._tube_values(rhs)
        self.started = True

    def _take_membrane(self, rhs):
        """The tube's values, and with them the residual, after the membrane has changed."""
        count = self.condensation.count
        tube = self._tube_values(rhs)
        change = self.condensation.to_shell(tube - self._near[:count])
        self._residual.getArray()[self._parts[0]] -= self._collect(change)
        self._near[:count] = tube

    def _tube_values(self, rhs):
        condensation, count = self.condensation, self.condensation.count
        source = condensation.from_tube(rhs) - condensation.from_shell(self._near[count:])
        with phase("tube solve"):
            return condensation.solve_tube(source)

    def finish(self, rhs, solution):
        """Make `solution` hold everywhere."""
        self._given.getArray()[self._places] = self._sum.getArray(readonly=True)[self._places]
        self._project()
        solution.axpy(1.0, self._answer)
        self.condensation.recover(rhs, solution)
        self.begin()

    def _release(self):
        if self.ksp is not None:
            for part in (self.ksp, self._operator, self._residual, self._change):
                part.destroy()

    def destroy(self):
        """Free the solver.  Collective."""
        self._release()
        for vector in (*self._source, *self._found, self._given, self._answer, self._sum):
            vector.destroy()


class _SkeletonPC:
    """PETSc python PC: the projection method."""

    def __init__(self, skeleton):
        self.skeleton = skeleton

    def apply(self, pc, x, y):
        """Set y to the preconditioned x."""
        self.skeleton.precondition(x, y)

    def view(self, pc, viewer):
        """Say what it is, and what is inside."""
        viewer.printfASCII("  the projection method, for residuals beside membrane and walls\n")
        self.skeleton.projection.view(pc, viewer)


def slip_faces(operators, layout):
    """Faces of this rank half a cell from a wall along them.

    Returns
    -------
    (places, factors)
        Places among the rank's velocities, and -2 / h^2 for each.
    """
    grid = operators.grid
    found = (
        (grid.u_index[[0, -1], 1:-1], -2 / grid.dy**2),
        (grid.v_index[1:-1, [0, -1]], -2 / grid.dx**2),
    )
    numbers = np.concatenate([index.ravel() for index, _ in found])
    weights = np.concatenate([np.full(index.size, weight) for index, weight in found])
    start, end = layout.velocity.getOwnershipRange()
    mine = (start <= numbers) & (numbers < end)
    return numbers[mine] - start, weights[mine]
