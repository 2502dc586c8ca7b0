"""FGMRES for fluid and membrane stresses together.

The preconditioner is block triangular: the marker-space model for the stresses (see `model`), then
the fluid with the force that they exert, by one multigrid cycle or a projection made of two.  (The
other way round it takes an iteration more.)
"""

import numpy as np

from ..events import phase
from . import krylov
from .iteration import REDUCTION, ROUND_OFF, FluidIteration
from .model import MarkerModel


class Block(FluidIteration):
    """Block iteration.  Collective.

    Parameters
    ----------
    fluid : Momentum or Stokes
    membranes : Membranes
    kernel : Kernel
    """

    what = "fluid and membrane stresses together"

    def __init__(self, fluid, membranes, kernel):
        mu, short = fluid.at_membranes
        self.model = MarkerModel(membranes.curves, fluid.grid, kernel, fluid.rho, mu,
                                 fluid.share, fluid.prefix + "model_", short)
        self.direct = self.model.direct
        super().__init__(
            fluid, {**fluid.defaults, "ksp_type": "fgmres", "pc_type": "python"}, self,
            membranes.stress_count)
        self._force, self._residual = fluid.grid.velocity_vector(), self._load.duplicate()

    def begin(self, rhs, stage):
        """Take right-hand side and first guess of a time step."""
        super().begin(rhs, stage)
        self.model.begin()

    def forget(self):
        """Place the model's entries anew at the next step."""
        self.model.forget()

    def update(self, interval, operators, stress):
        """Set the system for a configuration of the membranes."""
        fluid, grid = self.fluid, self.fluid.grid
        fluid.update(interval)
        self.interval, self.operators = interval, operators
        self._free = stress / interval
        with phase("marker model"):
            self.model.update(interval, operators)
        # Residuals of the stresses are weighted so that, like those of the fluid, they tell a
        # power: that of an error at its own place.
        diagonal = fluid.rho / interval + 2 * fluid.mu * (1 / grid.dx**2 + 1 / grid.dy**2)
        self._weight = np.sqrt(diagonal / grid.cell_area)
        mobility = np.mean(operators.slip.mobility) if len(self._free) else 0.0
        squares = operators.rates.multiply(operators.rates).sum(axis=1)
        diagonal = 1 / interval + mobility * np.asarray(squares).ravel()
        self._weights = self._weight / np.sqrt(diagonal)
        self._changed()

    def mult(self, x, y):
        """The system's matrix times x."""
        *fluid_x, stress_x = krylov.blocks_of(x)
        *fluid_y, stress_y = krylov.blocks_of(y)
        operators = self.operators
        stress = stress_x.getArray(readonly=True)
        force = operators.force(stress)
        self.fluid.mult(fluid_x, fluid_y)
        operators.spread_add(-force, fluid_y[0])
        velocity = operators.interpolate(fluid_x[0]) + operators.slip_velocity(force)
        stress_y.getArray()[:] = self._weights * (
            operators.rate(velocity) - stress / self.interval)

    def apply(self, pc, x, y):
        """y = the preconditioner times x."""
        *fluid_x, stress_x = krylov.blocks_of(x)
        *fluid_y, stress_y = krylov.blocks_of(y)
        stress = self.model.solve(stress_x.getArray(readonly=True) / -self._weights)
        stress_y.getArray()[:] = stress
        fluid_x[0].copy(self._force)
        self.operators.spread_add(self.operators.force(stress), self._force)
        self.fluid.precondition([self._force, *fluid_x[1:]], fluid_y)

    def _load_stresses(self):
        self._unknowns[-1].getArray()[:] = self.stage.stress
        self._rhs[-1].getArray()[:] = -self._weights * self._free

    def _tolerances(self, accuracy):
        if accuracy is None:
            return None, None
        # By the part of the forces' power that the slip takes up, which is known at once.
        force = self.operators.force(self.stage.stress)
        power = np.sum(force * self.operators.slip_velocity(force))
        power = self.fluid.grid.comm.tompi4py().bcast(float(power))
        self.mult(self._solution, self._residual)
        self._residual.aypx(-1.0, self._load)
        most = REDUCTION * self._residual.norm()
        return ROUND_OFF, min(accuracy * self._weight * np.sqrt(power), most)

    def _store_stresses(self):
        self.stage.stress = self._unknowns[-1].getArray(readonly=True).copy()

    def view(self, pc, viewer):
        """Say what it is, and show the solvers inside."""
        viewer.printfASCII("  block triangular: membrane stresses in marker space, then fluid\n")
        self.fluid.view(viewer)

    def destroy(self, pc=None):
        """Free the solver; PETSc calls this too.  Collective."""
        super().destroy(pc)
        if pc is None:
            for part in (self.model, self._residual, self._force):
                part.destroy()
