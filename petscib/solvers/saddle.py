"""The coupled system: velocity and pressure of the implicit step at once."""

import numpy as np
from petsc4py import PETSc

from ..events import phase
from . import krylov
from .block import TubeBlock
from .condensation import Condensation
from .momentum import ImplicitForce, MomentumSolver, tube_blocks
from .poisson import PoissonSolver
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
    """

    def __init__(self, pair, velocity, poisson):
        self.pair = pair
        self.velocity_solver = velocity
        self.poisson_solver = poisson
        layout = pair.layout
        self._force, self._velocity = layout.velocity.duplicate(), layout.velocity.duplicate()
        self._source, self._phi = layout.pressure.duplicate(), layout.pressure.duplicate()

    def apply(self, pc, x, y):
        """y = approximately K0^{-1} x.  Collective."""
        pair, fluid = self.pair, self.pair.fluid
        interval, scale = fluid.interval, pair.scale
        velocity, source, phi = self._velocity, self._source, self._phi
        pair.layout.split(x, self._force, source)
        velocity.set(0.0)
        self.velocity_solver.solve(self._force, velocity)

        # (theta dt) Laplacian phi = div u*, with div = -G^T and the given source of divergence
        pair.gradient.multTranspose(velocity, phi)
        source.axpby(1.0, -1.0 / scale, phi)
        self._force.set(0.0)
        excess = source.copy()
        source.scale(-1.0 / interval)
        phi.set(0.0)
        self.poisson_solver.solve(source, phi)

        # u = u* - theta dt grad phi,  p = rho phi - mu (div u* less its source)
        pair.gradient.mult(phi, self._force)
        velocity.axpy(-interval, self._force)
        phi.scale(fluid.rho / scale)
        phi.axpy(fluid.mu / scale, excess)
        excess.destroy()
        pair.layout.join(velocity, phi, y)

    def view(self, pc, viewer):
        """Show the inner solvers."""
        self.velocity_solver.ksp.view(viewer)
        self.poisson_solver.ksp.view(viewer)

    def destroy(self, pc):
        """Free the inner solvers; PETSc calls this.  Collective."""
        self.velocity_solver.destroy()
        self.poisson_solver.destroy()
        for vector in (self._force, self._velocity, self._source, self._phi):
            vector.destroy()


class CoupledSolver:
    """FGMRES for A u + G p = f, div u = 0, with the tube condensed.  Collective.

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
        vector = self.layout.vector
        self._operator = krylov.Operator(vector)
        self.ksp = krylov.create(self._operator.matrix, prefix, DEFAULTS)
        pc = self.ksp.getPC()
        if pc.getType() == "python" and pc.getPythonContext() is None:
            pc.setPythonContext(ProjectionPC(self.pair, velocity, poisson))
        self.condensation = self._interpolation = self._tube = self._condensed = None
        self._rhs, self._solution = vector.duplicate(), vector.duplicate()

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
            if changed or interpolation is not self._interpolation:
                self._release()
                self._condense(interpolation)
            force = ImplicitForce(interpolation, stiffness, interval)
            self._tube.factor(stiffness, force.scale)
        self._operator.act_as(self.condensation)

    def _condense(self, interpolation):
        grid, scale = self.operators.grid, self.pair.scale
        if self._condensed is None:
            self._condensed = self._rhs.duplicate()
        tube = Tube(grid, interpolation.stencil)
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
        self._tube = TubeStream(tube, block, gradient, self.prefix + "tube_")
        layout = self.layout
        self.condensation = Condensation(
            self.pair.mult,
            layout.vector,
            np.concatenate((layout.faces(tube.faces), layout.cells(tube.cells))),
            np.concatenate((layout.faces(tube.shell_faces), layout.cells(tube.shell_cells))),
            [to_faces, to_cells],
            self._tube.solve,
            self._tube.solve_with_pressure,
        )
        self._interpolation = interpolation

    def solve(self, rhs, velocity, pressure, rtol=None):
        """Solve for `velocity` and `pressure` (first guesses on entry).

        Parameters
        ----------
        rhs : PETSc.Vec
            Force on the faces.
        velocity, pressure : PETSc.Vec
        rtol : float, optional
            In place of the solver's relative tolerance, where it is larger.

        Returns
        -------
        int
            Iterations.
        """
        layout, scale = self.layout, self.pair.scale
        flux = self.operators.wall_flux
        if flux is None:
            layout.pressure.set(0.0)
        else:
            flux.copy(layout.pressure)
            layout.pressure.scale(scale)
        layout.join(rhs, layout.pressure, self._rhs)
        pressure.copy(layout.pressure)
        layout.pressure.scale(1 / scale)
        layout.join(velocity, layout.pressure, self._solution)

        usual = self.ksp.getTolerances()[0]
        if rtol is not None:
            self.ksp.setTolerances(rtol=max(rtol, usual))
        try:
            iterations = self._solve_pair()
        finally:
            self.ksp.setTolerances(rtol=usual)
        layout.split(self._solution, velocity, pressure)
        pressure.scale(scale)
        pressure.shift(-pressure.sum() / pressure.getSize())
        return iterations

    def _solve_pair(self):
        if self.condensation is None:
            return self._iterate(self._rhs)
        self.condensation.condense(self._rhs, self._condensed)
        iterations = self._iterate(self._condensed)
        self.condensation.recover(self._rhs, self._solution)
        return iterations

    def _iterate(self, rhs):
        return krylov.solve(self.ksp, rhs, self._solution, "coupled", krylov.advice(self.ksp))

    def _release(self):
        """Free what belongs to one configuration of the markers."""
        if self.condensation is not None:
            self.condensation.destroy()
            self._tube.destroy()
            self.condensation = self._interpolation = self._tube = None

    def destroy(self):
        """Free the solver.  Collective."""
        self._release()
        self.ksp.destroy()
        self._operator.destroy()
        self.pair.destroy()
        self.layout.destroy()
        for vector in (self._rhs, self._condensed, self._solution):
            if vector is not None:
                vector.destroy()
