"""The implicit system solved for the membranes' stresses, given exact solves of the fluid alone.

With H the fluid's response to forces, restricted to the markers, H = J A^{-1} J^T / (dx dy), the
stresses solve

    (1 / (theta dt) + C (H' + K) C^T) m = m0 / (theta dt) + C Pi J A^{-1} b,    H' = Pi H Pi,

symmetric positive definite, with a few rows a marker.  Conjugate gradients, preconditioned by the
model of H in marker space (see `model`), need products with H near the membranes only, which a
*window* of the grid gives; the whole grid is solved twice a step.
"""

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from ..events import phase
from . import krylov
from .iteration import REDUCTION, ROUND_OFF, Iteration
from .model import MarkerModel

# Cells around the faces that the markers see, for them to move in.  At dt = h/4 this saves 3 to 10
# percent of a step (mbe and be, 64^2 and 256^2), at dt = h nothing; a second one saves no more.
MARGIN = 1

# The energy ledger then balances to 3e-9, with 1e-10 to 2e-8, with 1e-9 to 4e-7 (be, cn and mbe,
# 64^2, dt = h, at rest and in shear); a power of ten costs an iteration of some ten.
RTOL = 1e-11
# The limit is high because iterations are cheap, and a membrane that nearly touches itself needs
# many.
DEFAULTS = {"ksp_type": "cg", "ksp_rtol": RTOL, "ksp_max_it": 1000, "pc_type": "python"}


class Near:
    """The faces near the markers, and the fluid's response to forces there.  Collective.

    Parameters
    ----------
    fluid : Momentum or Stokes
    stencil : Stencil
        Of the markers, on rank 0; of no markers elsewhere.
    """

    def __init__(self, fluid, stencil):
        grid = fluid.grid
        self._tables, faces, numbers, first = [], [], [], 0
        # Direction across which each component's faces may lie on walls: x of u, y of v.
        for normal, (rows, columns, _), index in zip(
            (1, 0), (stencil.u, stencil.v), (grid.u_index, grid.v_index)
        ):
            lines = (rows[:, :1] - MARGIN + np.arange(rows.shape[1] + 2 * MARGIN)[:, None],
                     columns[:, :, :1] - MARGIN + np.arange(columns.shape[2] + 2 * MARGIN))
            table = np.full(index.shape, -1, dtype=np.int32)
            table[tuple(
                part % count if periodic else np.clip(part, on_wall, count - 1 - on_wall)
                for part, count, periodic, on_wall in zip(
                    lines, index.shape, grid.periodic[::-1], (normal == 0, normal == 1))
            )] = 0
            found = np.nonzero(table == 0)
            table[found] = np.arange(first, first + len(found[0]))
            first += len(found[0])
            self._tables.append(table)
            faces.append(found)
            numbers.append(index[found])
        self.count = first
        self.window = fluid.window(faces)
        self.vector = self.window.vector
        source = PETSc.IS().createGeneral(np.concatenate(numbers), comm=PETSc.COMM_SELF)
        start = self.vector.getOwnershipRange()[0]
        target = PETSc.IS().createStride(self.count, start, 1, comm=PETSc.COMM_SELF)
        whole = grid.velocity_vector()
        self._scatter = PETSc.Scatter().create(whole, source, self.vector, target)
        whole.destroy()

    def interpolation(self, stencil):
        """J on these faces as a scipy matrix, or None where a marker sees others."""
        starts, columns, values = stencil.csr(*self._tables)
        unknown = columns < 0
        if values[unknown].any():
            return None
        columns[unknown] = 0  # with the weight zero, on walls just out of reach
        return csr_matrix((values, columns, starts), (2 * len(stencil.u[2]), self.count))

    def gather(self, velocity):
        """Values of a velocity vector on these faces: an array on rank 0.  Collective."""
        self._scatter.scatter(velocity, self.vector)
        return self.vector.getArray(readonly=True).copy()

    def respond(self, force):
        """Velocities on these faces caused by forces there, arrays on rank 0.  Collective."""
        self.vector.getArray()[:] = force
        self.window.solve()
        return self.vector.getArray(readonly=True)

    def add(self, force, vector):
        """Add forces on these faces to a velocity vector.  Collective."""
        self.vector.getArray()[:] = force
        self._scatter.scatter(self.vector, vector, addv=True, mode=PETSc.ScatterMode.REVERSE)

    def destroy(self):
        """Free window and scatter.  Collective."""
        self.window.destroy()
        self._scatter.destroy()


class Force(Iteration):
    """Conjugate gradients for the stresses.  Collective.

    Parameters
    ----------
    fluid : Momentum or Stokes
        With a transform.
    membranes : Membranes
    kernel : Kernel
    """

    what = "membrane stresses, fluid solved exactly"

    def __init__(self, fluid, membranes, kernel):
        self.fluid = fluid
        self.model = MarkerModel(membranes.curves, fluid.grid, kernel, fluid.rho, fluid.mu,
                                 fluid.share, fluid.prefix + "model_")
        self._near = self._free_velocity = self._stage_velocity = None
        self._base = fluid.grid.velocity_vector()
        self._load = krylov.vector_on_root(membranes.stress_count, fluid.grid.comm)
        self._change = self._load.duplicate()
        self._operator = krylov.Operator(self._change, self)
        self.ksp = krylov.create(self._operator.matrix, fluid.prefix, DEFAULTS)
        krylov.use_python(self.ksp, self)
        self.ksp.setInitialGuessNonzero(False)

    def forget(self):
        """Place the window and the model's entries anew at the next step."""
        self.model.forget()
        self._leave()

    def _leave(self):
        if self._near:
            self._near.destroy()
            self._near = None

    def begin(self, rhs, stage):
        """Take right-hand side and first guess of a time step."""
        self.model.begin()
        self.take(rhs, stage)

    def take(self, rhs, stage):
        """Take another right-hand side and first guess in the same step."""
        self.rhs, self.stage = rhs, stage
        self._free_velocity = None

    def update(self, interval, operators, stress):
        """Set the system for a configuration of the membranes."""
        changed = self.fluid.update(interval)
        self.interval, self.operators, self._stage_velocity = interval, operators, None
        self._free = stress / interval
        self._place(operators.interpolation, changed)
        with phase("marker model"):
            self.model.update(interval, operators)
        self._operator.changed()
        self.ksp.setOperators(self._operator.matrix)

    def _solve_without_membranes(self):
        """The velocity without membrane forces, unless this right-hand side's is there already."""
        if self._free_velocity is None:
            self.fluid.solve(self.rhs, self._base)
            area = self.fluid.grid.cell_area
            self._free_power = np.sqrt(abs(area * self.rhs.dot(self._base)))
            self._free_velocity = self._near.gather(self._base)

    def _place(self, interpolation, changed):
        """Follow the markers: as a rule, they are still where they see the same faces."""
        stencil = interpolation.stencil
        matrix = self._near.interpolation(stencil) if self._near and not changed else None
        if self.fluid.grid.comm.tompi4py().bcast(matrix is None):
            self._leave()
            self._near = Near(self.fluid, stencil)
            matrix = self._near.interpolation(stencil)
            if self._free_velocity is not None:
                self._free_velocity = self._near.gather(self._base)
        interpolation.use(self._near, matrix)
        self._interpolation, self._spreading = matrix, matrix.T

    def _carry(self, velocity):
        """Pi J w for velocities near the markers."""
        return self.operators.project((self._interpolation @ velocity).reshape(-1, 2))

    def _spread(self, force):
        """J^T Pi f / (dx dy), the force per area near the markers."""
        density = self.operators.project(force) / self.fluid.grid.cell_area
        return self._spreading @ density.ravel()

    def _moved_by(self, force):
        """(H' + K) f for forces on the markers."""
        velocity = self._near.respond(self._spread(force))
        return self._carry(velocity) + self.operators.slip_velocity(force)

    def mult(self, x, y):
        """y = (1 / (theta dt) + C (H' + K) C^T) x."""
        stress = x.getArray(readonly=True)
        velocity = self._moved_by(self.operators.force(stress))
        y.getArray()[:] = stress / self.interval - self.operators.rate(velocity)

    def apply(self, pc, x, y):
        """y = the model's inverse times x."""
        y.getArray()[:] = self.model.solve(x.getArray(readonly=True))

    def iterate(self, accuracy):
        """Solve for the stresses.  Returns the iterations."""
        self._solve_without_membranes()
        operators, stress = self.operators, self.stage.stress
        load = self._free + operators.rate(self._carry(self._free_velocity))
        force = operators.force(stress)
        moved = self._moved_by(force)
        residual = load - stress / self.interval + operators.rate(moved)
        self._load.getArray()[:] = residual
        if accuracy is None:
            loaded = self._on_all(self._size(load))
            tolerance = self.ksp.getTolerances()[0] * np.hypot(loaded, self._free_power)
        else:  # the error is measured by the power that the forces of the first guess exert
            exerted = np.sqrt(abs(np.sum(force * moved)))
            tolerance = self._on_all(max(
                min(accuracy * exerted, REDUCTION * self._size(residual)),
                ROUND_OFF * self._size(load)))
        with krylov.tolerances(self.ksp, 0.0, tolerance):
            iterations = krylov.solve(
                self.ksp, self._load, self._change, self.fluid.name, inner=self.model.direct)
        self.stage.stress = stress + self._change.getArray(readonly=True)
        return iterations

    def _size(self, residual):
        """Norm of a residual as the iteration measures it, on the first rank."""
        return np.sqrt(abs(residual @ self.model.solve(residual)))

    def _on_all(self, value):
        """A number of the first rank, on all.  Collective."""
        return self.fluid.grid.comm.tompi4py().bcast(value)

    def marker_velocity(self):
        """U for the stresses of the last solution."""
        force = self.operators.force(self.stage.stress)
        if self._stage_velocity is not None:
            return self._carry(self._stage_velocity) + self.operators.slip_velocity(force)
        return self._carry(self._free_velocity) + self._moved_by(force)

    def finish(self):
        """Set the stage's velocity, and its pressure where there is one."""
        self.rhs.copy(self._base)
        self._near.add(self._spread(self.operators.force(self.stage.stress)), self._base)
        self.fluid.solve(self._base, self.stage.velocity, self.stage.pressure)
        self._stage_velocity = self._near.gather(self.stage.velocity)

    def view(self, pc, viewer):
        """Say what it is, and what inverts the fluid's matrix."""
        viewer.printfASCII("  membrane stresses in marker space; within products:\n")
        self.fluid.view(viewer)

    def destroy(self, pc=None):
        """Free the solver; PETSc calls this too.  Collective."""
        if pc is not None:
            return
        self._leave()
        self.model.destroy()
        for part in (self.ksp, self._operator, self._load, self._change, self._base):
            part.destroy()
