"""The coupled system: velocity and pressure of the implicit step at once."""

import numpy as np
from petsc4py import PETSc

from ..events import phase
from . import krylov
from .block import TubeBlock, TubeDirect, tube_blocks
from .condensation import Condensation
from .force import ForceSolver
from .momentum import FluidMatrix, ImplicitForce
from .pair import FluidPair, PairLayout
from .projection import ProjectionPC
from .stream import TubeSaddle, divergence_free_basis
from .tube import LAYERS, Tube

DEFAULTS = {
    "ksp_type": "fgmres",
    "ksp_rtol": 1e-6,
    "ksp_max_it": 200,
    "pc_type": "python",
}


class CoupledSolver:
    """Solver of A u + G p = f, div u = 0.  Collective.

    FGMRES, preconditioned by the projection method, on all unknowns outside the tube; or, when the
    preconditioner inverts the fluid's system, conjugate gradients for the membrane's force (see
    `force`).  Several solves with the membrane in almost the same place belong together::

        solver.update(interval, interpolation, stiffness)
        solver.begin(velocity, pressure)
        solver.iterate(rhs, velocity)
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
        projection method <prefix>velocity_ and <prefix>poisson_.
    """

    def __init__(self, operators, rho, mu, prefix="coupled_"):
        self.grid = operators.grid
        self.prefix = prefix
        self.flux = operators.wall_flux
        self.layout = PairLayout(self.grid)
        self.fluid = FluidMatrix(operators, rho, mu)
        self.pair = FluidPair(operators, self.fluid, self.layout)
        self.operator = krylov.Operator(self.layout.vector)
        self.operator.matrix.setAttr("pair", self.pair)  # for StokesTransform
        self.ksp = krylov.create(self.operator.matrix, prefix, DEFAULTS)
        pc = self.ksp.getPC()
        if pc.getType() == "python" and pc.getPythonContext() is None:
            pc.setPythonContext(ProjectionPC(self.pair, operators, prefix))
        self._method = None

    def update(self, interval, interpolation=None, stiffness=None):
        """Set the system for theta dt = `interval` and the membrane's present configuration.

        With the interpolation of the last call, only the stiffness is taken anew.  A solver once
        used with a membrane stays one with a membrane, and likewise without.
        """
        changed = self.fluid.update(interval)
        if changed or interpolation is None:
            self.operator.act_as(self.pair)
            self.ksp.getPC().setUp()
        if self._method is None:
            forces = interpolation is not None and krylov.has_exact_preconditioner(self.ksp)
            self._method = (ForceMethod if forces else CondensedMethod)(self)
        if interpolation is not None:
            with phase("tube set-up"):
                force = ImplicitForce(interpolation, stiffness, interval)
                self._method.update(interpolation, force)

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
        self._method.begin(velocity, pressure)

    @property
    def rtol(self):
        """Relative tolerance of a solve."""
        return self.ksp.getTolerances()[0]

    def iterate(self, rhs, velocity, rtol=None):
        """Solve so far that `velocity` holds where the markers see it.

        Parameters
        ----------
        rhs : PETSc.Vec
            Force on the faces.
        velocity : PETSc.Vec
        rtol : float, optional
            In place of the solver's relative tolerance; with FGMRES, where it is larger.

        Returns
        -------
        int
            Iterations.
        """
        return self._method.iterate(rhs, velocity, rtol)

    def finish(self, velocity, pressure):
        """Set `velocity` and `pressure` everywhere."""
        self._method.finish(velocity, pressure)
        pressure.shift(-pressure.sum() / pressure.getSize())

    def destroy(self):
        """Free the solver.  Collective."""
        parts = (self._method, self.ksp, self.operator, self.pair, self.layout, self.fluid.matrix)
        for part in parts:
            if part is not None:
                part.destroy()


class CondensedMethod:
    """The iteration on all unknowns outside the tube.

    Parameters
    ----------
    solver : CoupledSolver
    """

    def __init__(self, solver):
        self.solver = solver
        self.direct = self.condensation = self._tube = None
        self._interpolation = self._interval = None
        self._rhs, *self._force = solver.layout.joint()
        self._solution, *self._found = solver.layout.joint()
        self._condensed = None

    def update(self, interpolation, force):
        """Set the system for the membrane's present configuration."""
        if self.direct is None:
            self.direct = TubeDirect(self.solver.prefix + "tube_")
            self._condensed = self._rhs.duplicate()
        changed = force.interval != self._interval
        if changed or interpolation is not self._interpolation:
            self._place(interpolation.stencil, changed)
            self._interpolation, self._interval = interpolation, force.interval
        self.direct.block.set(force.root())
        self.direct.factor()
        self.solver.operator.act_as(self.condensation)

    def _place(self, stencil, changed):
        """Take new positions of the markers: as a rule, they are still in the same tube."""
        grid = self.solver.grid
        tube = Tube(grid, stencil)
        same = not changed and self._tube is not None and tube.has_faces_of(self._tube)
        if grid.comm.tompi4py().bcast(same):
            if self.direct.block.size:
                self.direct.block.move(tube)
                self.direct.move()
        else:
            self._release()
            self._condense(tube)
        self._tube = tube

    def _condense(self, tube):
        solver, layout = self.solver, self.solver.layout
        gradient, scale = solver.pair.gradient, solver.pair.scale
        matrix, to_faces = tube_blocks(solver.fluid.matrix, tube)
        faces, cells, shell = (
            PETSc.IS().createGeneral(numbers, comm=PETSc.COMM_SELF)
            for numbers in (tube.faces, tube.cells, tube.shell_cells)
        )
        (inner,) = gradient.createSubMatrices([faces], [cells])
        (to_cells,) = gradient.createSubMatrices([faces], [shell])
        inner.scale(scale)
        to_cells.scale(scale)
        block = TubeBlock(tube, matrix)
        self.direct.set_block(block, divergence_free_basis(tube) if block.size else None)
        self._saddle = TubeSaddle(self.direct, inner, solver.prefix + "tube_")
        self.condensation = Condensation(
            solver.pair.mult,
            layout.vector,
            np.concatenate((layout.faces(tube.faces), layout.cells(tube.cells))),
            np.concatenate((layout.faces(tube.shell_faces), layout.cells(tube.shell_cells))),
            [to_faces, to_cells],
            self._saddle.solve,
            self._saddle.solve_with_pressure,
        )

    def _release(self):
        """Free what belongs to one tube."""
        if self.condensation is not None:
            self.condensation.destroy()
            self._saddle.destroy()
            self.condensation = None

    def begin(self, velocity, pressure):
        """Take first guesses."""
        velocity.copy(self._found[0])
        pressure.copy(self._found[1])
        self._found[1].scale(1 / self.solver.pair.scale)

    def iterate(self, rhs, velocity, rtol):
        """Solve, and set `velocity`."""
        solver, scale = self.solver, self.solver.pair.scale
        rhs.copy(self._force[0])
        self._rhs.stateIncrease()  # through its parts: PETSc must not take its norm for known
        if solver.flux is not None:
            solver.flux.copy(self._force[1])
            self._force[1].scale(scale)
        if self.condensation is None:
            iterations = self._solve(self._rhs, rtol)
        else:
            self.condensation.condense(self._rhs, self._condensed)
            iterations = self._solve(self._condensed, rtol)
            self.condensation.recover(self._rhs, self._solution)
        self._found[0].copy(velocity)
        return iterations

    def _solve(self, rhs, rtol):
        ksp = self.solver.ksp
        usual, atol = ksp.getTolerances()[:2]
        # What is left over stays the same from one solve to the next, so it need not be less.
        with krylov.tolerances(ksp, max(usual, rtol or 0.0), atol):
            return krylov.solve(ksp, rhs, self._solution, "coupled", krylov.advice(ksp))

    def finish(self, velocity, pressure):
        """Set `velocity` and `pressure`."""
        self._found[0].copy(velocity)
        self._found[1].copy(pressure)
        pressure.scale(self.solver.pair.scale)

    def destroy(self):
        """Free vectors and factors.  Collective."""
        self._release()
        if self.direct is not None:
            self.direct.destroy()
        for vector in (self._condensed, *self._force, *self._found, self._rhs, self._solution):
            if vector is not None:
                vector.destroy()


class ForceMethod:
    """The iteration for the membrane's force, given a direct solver of the fluid's system.

    Parameters
    ----------
    solver : CoupledSolver
    """

    def __init__(self, solver):
        self.solver = solver
        self.stokes = solver.ksp.getPC().getPythonContext()
        self.forces = ForceSolver(
            solver.grid, solver.fluid, self, solver.prefix, DEFAULTS, "coupled", LAYERS,
            solenoidal=True,
        )
        vector = solver.layout.velocity
        self._rest, self._slope = vector.duplicate(), vector.duplicate()
        self._lift = self._lift_force = self._lift_interval = None

    def update(self, interpolation, force):
        """Set the system for the membrane's present configuration."""
        self.forces.update(interpolation, force)

    def begin(self, velocity, pressure):
        """Take first guesses."""
        self.solver.pair.gradient.mult(pressure, self._slope)
        self.forces.begin()

    def iterate(self, rhs, velocity, rtol):
        """Solve, and set `velocity` in the tube."""
        self._given = rhs
        return self.forces.iterate(rhs, velocity, rtol, self._slope)

    def finish(self, velocity, pressure):
        """Set `velocity` and `pressure`."""
        self.forces.finish(self._given, velocity)
        self.solver.fluid.matrix.mult(velocity, self._rest)
        self._rest.aypx(-1.0, self._given)
        self.forces.spread_add(self._rest, -1.0)
        self.stokes.pressure(self._rest, pressure)

    def respond(self, force, velocity):
        """Set `velocity` to what the force and the walls cause without membrane."""
        flux, fluid = self.solver.flux, self.solver.fluid
        if flux is None:
            self.stokes.respond(force, velocity)
            return
        if self._lift is None:
            self._lift, self._lift_force = force.duplicate(), force.duplicate()
            self.stokes.lift(flux, self._lift)
        if self._lift_interval != fluid.interval:
            self._lift_interval = fluid.interval
            fluid.matrix.mult(self._lift, self._lift_force)
        force.copy(self._rest)
        self._rest.axpy(-1.0, self._lift_force)
        self.stokes.respond(self._rest, velocity)
        velocity.axpy(1.0, self._lift)

    def window(self, faces):
        """The answer to forces on some faces, restricted to them."""
        return self.stokes.window(faces)

    def view(self, pc, viewer):
        """Say what solves the fluid's system."""
        self.stokes.view(pc, viewer)

    def destroy(self):
        """Free vectors.  Collective."""
        self.forces.destroy()
        for vector in (self._rest, self._slope, self._lift, self._lift_force):
            if vector is not None:
                vector.destroy()
