"""The coupled system: velocity and pressure of the implicit step at once."""

import numpy as np
from petsc4py import PETSc

from ..events import phase
from . import krylov
from .block import TubeBlock, TubeDirect
from .condensation import Condensation
from .force import ForceSolver
from .momentum import FluidMatrix, ImplicitForce, tube_blocks
from .pair import FluidPair, PairLayout
from .projection import ProjectionPC
from .stream import TubeSaddle, divergence_free_basis
from .tube import Tube

DEFAULTS = {
    "ksp_type": "fgmres",
    "ksp_rtol": 1e-6,
    "ksp_max_it": 200,
    "pc_type": "python",
}
# Relative change of the membrane's matrix beyond which a factorisation of it is made anew: what a
# stale one costs in iterations would then be more than what it saves.
LARGE_DRIFT = 0.01


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
        self.direct = self._tube = self._interpolation = self._method = None

    def update(self, interval, interpolation=None, stiffness=None):
        """Set the system for theta dt = `interval` and the membrane's present configuration.

        With the interpolation of the last call, only the stiffness is taken anew.
        """
        changed = self.fluid.update(interval)
        if changed or interpolation is None:
            self.operator.act_as(self.pair)
            self.ksp.getPC().setUp()
        if self._method is None:
            forces = interpolation is not None and krylov.has_exact_preconditioner(self.ksp)
            self._method = (ForceMethod if forces else CondensedMethod)(self)
        if interpolation is None:
            return
        if self.direct is None:
            self.direct = TubeDirect(self.prefix + "tube_")
        with phase("tube set-up"):
            if interpolation is not self._interpolation:
                self._place(interpolation, changed)
            force = ImplicitForce(interpolation, stiffness, interval)
            self.direct.block.set(stiffness, force.scale)
            self._method.take_stiffness()

    def _place(self, interpolation, changed):
        """Take new positions of the markers: as a rule, they are still in the same tube."""
        grid = self.grid
        tube = Tube(grid, interpolation.stencil)
        same = not changed and self._tube is not None and tube.has_faces_of(self._tube)
        if grid.comm.tompi4py().bcast(same):
            self.direct.block.move(tube)
            self.direct.move()
        else:
            self._method.leave_tube()
            matrix, to_faces = tube_blocks(self.fluid.matrix, tube)
            block = TubeBlock(tube, matrix)
            basis = divergence_free_basis(tube) if block.size else None
            self.direct.set_block(block, basis)
            self._method.enter_tube(tube, to_faces)
        self._tube, self._interpolation = tube, interpolation

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
            In place of the solver's relative tolerance, where that means anything.

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
        for part in (self._method, self.direct, self.ksp, self.operator, self.pair, self.layout):
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
        self.condensation = self._condensed = None
        self._rhs, *self._force = solver.layout.joint()
        self._solution, *self._found = solver.layout.joint()

    def leave_tube(self):
        """Free what belongs to one tube."""
        if self.condensation is not None:
            self.condensation.destroy()
            self._saddle.destroy()
            self.condensation = None

    def enter_tube(self, tube, to_faces):
        """Condense a new tube, coupled by `to_faces` to the faces of its shell."""
        solver, layout = self.solver, self.solver.layout
        gradient, scale = solver.pair.gradient, solver.pair.scale
        if self._condensed is None:
            self._condensed = self._rhs.duplicate()
        faces, cells, shell = (
            PETSc.IS().createGeneral(numbers, comm=PETSc.COMM_SELF)
            for numbers in (tube.faces, tube.cells, tube.shell_cells)
        )
        (inner,) = gradient.createSubMatrices([faces], [cells])
        (to_cells,) = gradient.createSubMatrices([faces], [shell])
        inner.scale(scale)
        to_cells.scale(scale)
        self._saddle = TubeSaddle(solver.direct, inner, solver.prefix + "tube_")
        self.condensation = Condensation(
            solver.pair.mult,
            layout.vector,
            np.concatenate((layout.faces(tube.faces), layout.cells(tube.cells))),
            np.concatenate((layout.faces(tube.shell_faces), layout.cells(tube.shell_cells))),
            [to_faces, to_cells],
            self._saddle.solve,
            self._saddle.solve_with_pressure,
        )

    def take_stiffness(self):
        """Follow a new stiffness of the membrane."""
        self.solver.direct.factor()
        self.solver.operator.act_as(self.condensation)

    def begin(self, velocity, pressure):
        """Take first guesses."""
        velocity.copy(self._found[0])
        pressure.copy(self._found[1])
        self._found[1].scale(1 / self.solver.pair.scale)

    def iterate(self, rhs, velocity, rtol):
        """Solve, and set `velocity`."""
        solver, scale = self.solver, self.solver.pair.scale
        rhs.copy(self._force[0])
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
        """Free vectors.  Collective."""
        self.leave_tube()
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
        vector = solver.layout.velocity
        self.force_solver = ForceSolver(self, vector, solver.prefix, DEFAULTS, "coupled")
        self._rest, self._slope = vector.duplicate(), vector.duplicate()
        self._lift = self._lift_force = self._lift_interval = None
        self.condensation = self._new_tube = None
        self._factored = False

    def leave_tube(self):
        """Free what belongs to one tube."""
        if self.condensation is not None:
            self.condensation.destroy()
            self.condensation = None

    def enter_tube(self, tube, to_faces):
        """Take a new tube, coupled by `to_faces` to the faces of its shell."""
        solver = self.solver
        self.condensation = Condensation(
            solver.fluid.matrix.mult, solver.layout.velocity, tube.faces, tube.shell_faces,
            [to_faces], solver.direct.solve,
        )
        self._new_tube, self._factored = tube, False

    def take_stiffness(self):
        """Follow a new stiffness of the membrane.

        Between solves that belong together, an earlier factorisation will do.
        """
        direct = self.solver.direct
        if not self._factored or direct.drift() > LARGE_DRIFT:
            direct.factor()
            self._factored = True
        if self._new_tube is not None:
            self.force_solver.set_tube(self._new_tube, self.solver.direct, self.condensation)
            self._new_tube = None

    def begin(self, velocity, pressure):
        """Take first guesses."""
        self.solver.pair.gradient.mult(pressure, self._slope)
        self.force_solver.begin()

    def iterate(self, rhs, velocity, rtol):
        """Solve, and set `velocity` in the tube."""
        self._given = rhs
        return self.force_solver.iterate(rhs, velocity, rtol, self._slope)

    def finish(self, velocity, pressure):
        """Set `velocity` and `pressure`."""
        rest, forces = self._rest, self.force_solver
        forces.finish(self._given, velocity)
        self.solver.fluid.matrix.mult(velocity, rest)
        rest.aypx(-1.0, self._given)
        self.condensation.add(rest, tube=-forces.block.spread(forces.force))
        self.stokes.pressure(rest, pressure)
        self._factored = False

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
        self.leave_tube()
        self.force_solver.destroy()
        for vector in (self._rest, self._slope, self._lift, self._lift_force):
            if vector is not None:
                vector.destroy()
