"""The coupled system: velocity and pressure of the implicit step at once."""

import numpy as np
from petsc4py import PETSc

from ..events import phase
from . import krylov
from .block import TubeBlock
from .condensation import Condensation
from .momentum import ImplicitForce, MomentumSolver, tube_blocks
from .poisson import PoissonSolver
from .skeleton import Skeleton
from .stream import TubeStream
from .tube import Tube

DEFAULTS = {
    "ksp_type": "fgmres",
    "ksp_rtol": 1e-6,
    "ksp_max_it": 200,
    "pc_type": "python",
}
INNER_VELOCITY = {"ksp_type": "preonly", "pc_type": "gamg"}
INNER_POISSON = {"ksp_type": "preonly", "pc_type": "gamg", "mg_coarse_sub_pc_type": "svd"}


class PairLayout:
    """Vectors that hold on each rank its velocities and then its pressures."""

    def __init__(self, grid):
        self.comm = grid.comm
        self.velocity = grid.velocity_vector()
        self.pressure = grid.pressure_vector()
        self.count = self.velocity.getLocalSize()
        sizes = (self.count + self.pressure.getLocalSize(), PETSc.DETERMINE)
        self.vector = PETSc.Vec().createMPI(sizes, comm=self.comm)
        self._starts = self.vector.getOwnershipRanges()

    def faces(self, numbers):
        """Numbers in pair vectors of faces given by their numbers in velocity vectors."""
        ranges = self.velocity.getOwnershipRanges()
        rank = np.searchsorted(ranges, numbers, side="right") - 1
        return numbers - ranges[rank] + self._starts[rank]

    def cells(self, numbers):
        """Numbers in pair vectors of cells given by their numbers in pressure vectors."""
        ranges = self.pressure.getOwnershipRanges()
        faces = np.diff(self.velocity.getOwnershipRanges())
        rank = np.searchsorted(ranges, numbers, side="right") - 1
        return numbers - ranges[rank] + self._starts[rank] + faces[rank]

    def joint(self):
        """A new pair vector, and vectors of its velocities and pressures in the same memory."""
        values = np.zeros(self.vector.getLocalSize())
        parts = values, values[: self.count], values[self.count :]
        return [PETSc.Vec().createWithArray(part, comm=self.comm) for part in parts]

    def split(self, pair, velocity, pressure):
        """Copy a pair vector's parts.  Not collective."""
        values = pair.getArray(readonly=True)
        velocity.getArray()[:] = values[: self.count]
        pressure.getArray()[:] = values[self.count :]

    def join(self, velocity, pressure, pair):
        """Set a pair vector from its parts.  Not collective."""
        values = pair.getArray()
        values[: self.count] = velocity.getArray(readonly=True)
        values[self.count :] = pressure.getArray(readonly=True)

    def destroy(self):
        """Free the vectors.  Collective."""
        for vector in (self.velocity, self.pressure, self.vector):
            vector.destroy()


class FluidPair:
    """K0 = [[A0, s G], [s G^T, 0]], the coupled system of the fluid alone.

    The factor s balances the rows; the pressures of the system are p / s.

    Parameters
    ----------
    operators : Operators
    fluid : FluidMatrix
    layout : PairLayout
    """

    def __init__(self, operators, fluid, layout):
        self.gradient = operators.gradient
        self.fluid = fluid
        self.layout = layout
        self.width = min(operators.grid.dx, operators.grid.dy)
        self._velocity, self._pressure = operators.grid.velocity_vector(), layout.pressure.copy()
        self._force, self._source = self._velocity.duplicate(), self._pressure.duplicate()

    @property
    def scale(self):
        """The factor s: how a momentum residual answers a velocity error, times its width."""
        fluid = self.fluid
        return fluid.rho * self.width / fluid.interval + fluid.mu / self.width

    def mult(self, x, y):
        """y = K0 x.  Collective."""
        self.layout.split(x, self._velocity, self._pressure)
        self._pressure.scale(self.scale)
        self.fluid.matrix.mult(self._velocity, self._force)
        self.gradient.multAdd(self._pressure, self._force, self._force)
        self.gradient.multTranspose(self._velocity, self._source)
        self._source.scale(self.scale)
        self.layout.join(self._force, self._source, y)

    def destroy(self):
        """Free the work vectors.  Collective."""
        for vector in (self._velocity, self._pressure, self._force, self._source):
            vector.destroy()


class ProjectionPC:
    """PETSc python PC: K0 solved approximately by the projection method.

    A0 u* = f, then a Poisson problem for the pressure.  Exact in a periodic box with exact inner
    solvers; walls leave a splitting error that the outer iteration removes.

    Parameters
    ----------
    pair : FluidPair
    velocity : MomentumSolver
        Without membrane.
    poisson : PoissonSolver

    Attributes
    ----------
    slope : PETSc.Vec
        theta dt grad phi of the last application.
    """

    def __init__(self, pair, velocity, poisson):
        self.pair = pair
        self.velocity_solver = velocity
        self.poisson_solver = poisson
        layout = pair.layout
        self._given, *self._source = layout.joint()
        self._answer, *self._found = layout.joint()
        self.slope = layout.velocity.duplicate()
        self._excess = layout.pressure.duplicate()

    @property
    def exact(self):
        """Whether both inner solvers are."""
        return self.velocity_solver.exact and self.poisson_solver.exact

    def apply(self, pc, x, y):
        """y = approximately K0^{-1} x.  Collective."""
        x.copy(self._given)
        self.project(*self._source, *self._found)
        self._answer.copy(y)

    def project(self, force, source, velocity, pressure):
        """Set velocity and pressure to the answer for a force and a source.  Collective."""
        pair, fluid, excess = self.pair, self.pair.fluid, self._excess
        interval, scale = fluid.interval, pair.scale
        velocity.set(0.0)
        self.velocity_solver.solve(force, velocity)

        # (theta dt) Laplacian phi = div u* less what the source asks for, with div = -G^T
        pair.gradient.multTranspose(velocity, excess)
        excess.axpby(1 / (scale * interval), -1 / interval, source)
        pressure.set(0.0)
        self.poisson_solver.solve(excess, pressure)

        # u = u* - theta dt grad phi,  p = rho phi - mu (div u* less its source)
        pair.gradient.mult(pressure, self.slope)
        self.slope.scale(interval)
        velocity.axpy(-1.0, self.slope)
        pressure.axpby(-fluid.mu * interval / scale, fluid.rho / scale, excess)

    def view(self, pc, viewer):
        """Show the inner solvers."""
        self.velocity_solver.ksp.view(viewer)
        self.poisson_solver.ksp.view(viewer)

    def destroy(self, pc):
        """Free the inner solvers; PETSc calls this.  Collective."""
        self.velocity_solver.destroy()
        self.poisson_solver.destroy()
        for vector in (*self._source, *self._found, self._given, self._answer):
            vector.destroy()
        self.slope.destroy()
        self._excess.destroy()


class CoupledSolver:
    """FGMRES for A u + G p = f, div u = 0, with the tube condensed.  Collective.

    When the solvers inside the preconditioner are exact, the iteration is on the skeleton (see
    `skeleton`).  Several solves with the membrane in almost the same place belong together::

        solver.begin(velocity, pressure)
        for ...:
            solver.update(interval, interpolation, stiffness)
            solver.iterate(rhs, velocity)
        solver.finish(velocity, pressure)

    Parameters
    ----------
    operators : Operators
    rho, mu : float
    prefix : str
        Options prefix; the tube's direct solver has <prefix>tube_, the solvers inside the
        preconditioner <prefix>velocity_ and <prefix>poisson_.
    """

    def __init__(self, operators, rho, mu, prefix="coupled_"):
        self.operators = operators
        self.prefix = prefix
        self.layout = PairLayout(operators.grid)
        velocity = MomentumSolver(operators, rho, mu, prefix + "velocity_", INNER_VELOCITY)
        poisson = PoissonSolver(operators, prefix + "poisson_", INNER_POISSON)
        self.velocity_solver = velocity
        self.fluid = velocity.fluid
        self.pair = FluidPair(operators, self.fluid, self.layout)
        self._operator = krylov.Operator(self.layout.vector)
        self.ksp = krylov.create(self._operator.matrix, prefix, DEFAULTS)
        self.skeleton = None
        pc = self.ksp.getPC()
        if pc.getType() == "python" and pc.getPythonContext() is None:
            projection = ProjectionPC(self.pair, velocity, poisson)
            pc.setPythonContext(projection)
            if projection.exact:
                self.skeleton = Skeleton(operators, projection, prefix, DEFAULTS)
        self.condensation = self._interpolation = self._tube = self._stream = None
        self._condensed = None
        self._rhs, *self._force = self.layout.joint()
        self._solution, *self._found = self.layout.joint()

    def update(self, interval, interpolation=None, stiffness=None):
        """Set the system for theta dt = `interval` and the membrane's present configuration.

        With the interpolation of the last call, only the stiffness is taken anew.
        """
        changed = interval != self.fluid.interval
        self.velocity_solver.update(interval)
        if interpolation is None:
            self._operator.act_as(self.pair)
            return
        with phase("tube set-up"):
            if interpolation is not self._interpolation:
                self._place(interpolation, changed)
            force = ImplicitForce(interpolation, stiffness, interval)
            self._stream.factor(stiffness, force.scale)
        self._operator.act_as(self.condensation)

    def _place(self, interpolation, changed):
        """Take new positions of the markers: as a rule, they are still in the same tube."""
        grid = self.operators.grid
        tube = Tube(grid, interpolation.stencil)
        same = not changed and self._tube is not None and tube.has_faces_of(self._tube)
        if grid.comm.tompi4py().bcast(same):
            self._stream.move(tube)
        else:
            if self.skeleton and self.skeleton.started:
                self.skeleton.finish(self._rhs, self._solution)
            self._release()
            self._condense(tube)
        self._tube, self._interpolation = tube, interpolation

    def _condense(self, tube):
        scale = self.pair.scale
        if self._condensed is None:
            self._condensed = self._rhs.duplicate()
        block, to_faces = tube_blocks(self.fluid.matrix, tube)
        faces, cells, shell = (
            PETSc.IS().createGeneral(numbers, comm=PETSc.COMM_SELF)
            for numbers in (tube.faces, tube.cells, tube.shell_cells)
        )
        (gradient,) = self.operators.gradient.createSubMatrices([faces], [cells])
        (to_cells,) = self.operators.gradient.createSubMatrices([faces], [shell])
        gradient.scale(scale)
        to_cells.scale(scale)
        block = TubeBlock(tube, block)
        self._stream = TubeStream(tube, block, gradient, self.prefix + "tube_")
        layout = self.layout
        self.condensation = Condensation(
            self.pair.mult,
            layout.vector,
            np.concatenate((layout.faces(tube.faces), layout.cells(tube.cells))),
            np.concatenate((layout.faces(tube.shell_faces), layout.cells(tube.shell_cells))),
            [to_faces, to_cells],
            self._stream.solve,
            self._stream.solve_with_pressure,
        )
        if self.skeleton:
            self.skeleton.set_tube(self.condensation)

    def solve(self, rhs, velocity, pressure):
        """Solve for `velocity` and `pressure` (first guesses on entry).

        Parameters
        ----------
        rhs : PETSc.Vec
            Force on the faces.
        velocity, pressure : PETSc.Vec

        Returns
        -------
        int
            Iterations.
        """
        self.begin(velocity, pressure)
        iterations = self.iterate(rhs, velocity)
        self.finish(velocity, pressure)
        return iterations

    def begin(self, velocity, pressure):
        """Take first guesses for solves that belong together."""
        velocity.copy(self._found[0])
        pressure.copy(self._found[1])
        self._scaled = False  # by a factor that the next update may change
        if self.skeleton:
            self.skeleton.begin()

    def iterate(self, rhs, velocity, rtol=0.0):
        """Solve so far that `velocity` holds where the markers see it.

        Parameters
        ----------
        rhs : PETSc.Vec
            Force on the faces.
        velocity : PETSc.Vec
        rtol : float
            In place of the solver's relative tolerance, where it is larger.

        Returns
        -------
        int
            Iterations.
        """
        flux = self.operators.wall_flux
        rhs.copy(self._force[0])
        if flux is not None:
            flux.copy(self._force[1])
            self._force[1].scale(self.pair.scale)
        if not self._scaled:
            self._found[1].scale(1 / self.pair.scale)
            self._scaled = True
        if self.condensation is None:
            iterations = self._iterate(self._rhs, rtol)
        elif self.skeleton:
            iterations = self.skeleton.solve(self._rhs, self._solution, rtol)
        else:
            self.condensation.condense(self._rhs, self._condensed)
            iterations = self._iterate(self._condensed, rtol)
            self.condensation.recover(self._rhs, self._solution)
        self._found[0].copy(velocity)
        return iterations

    def finish(self, velocity, pressure):
        """Set `velocity` and `pressure` everywhere."""
        if self.skeleton and self.condensation:
            self.skeleton.finish(self._rhs, self._solution)
        self._found[0].copy(velocity)
        self._found[1].copy(pressure)
        pressure.scale(self.pair.scale)
        pressure.shift(-pressure.sum() / pressure.getSize())

    def _iterate(self, rhs, rtol):
        usual = self.ksp.getTolerances()[0]
        self.ksp.setTolerances(rtol=max(rtol, usual))
        try:
            return krylov.solve(self.ksp, rhs, self._solution, "coupled", krylov.advice(self.ksp))
        finally:
            self.ksp.setTolerances(rtol=usual)

    def _release(self):
        """Free what belongs to one tube."""
        if self.condensation is not None:
            self.condensation.destroy()
            self._stream.destroy()
            self.condensation = self._tube = self._stream = None

    def destroy(self):
        """Free the solver.  Collective."""
        self._release()
        for part in (self.skeleton, self.ksp, self._operator, self.pair, self.layout,
                     self._condensed, *self._force, *self._found, self._rhs, self._solution):
            if part is not None:
                part.destroy()
