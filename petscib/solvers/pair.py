"""The coupled system of the fluid alone, and vectors of velocities and pressures."""

import numpy as np
from petsc4py import PETSc


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
        """A new pair vector, and vectors of its velocities and pressures in the same memory.

        PETSc does not notice that a write to one changes the others: before a norm of theirs is
        asked for again, `stateIncrease` must tell it.
        """
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
        self.grid = operators.grid
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
