"""The fluid without membrane forces."""

from . import krylov
from .iteration import FluidIteration, FluidPC, Iteration


class Alone(FluidIteration):
    """Solves A w = b by iteration.  Collective.

    Parameters
    ----------
    fluid : Momentum or Stokes
    """

    what = "fluid"

    def __init__(self, fluid):
        super().__init__(fluid, fluid.defaults, FluidPC(fluid))

    def mult(self, x, y):
        """y = A x."""
        self.fluid.mult(krylov.blocks_of(x), krylov.blocks_of(y))

    def update(self, interval, operators, stress):
        """Follow the time step."""
        self.operators = operators
        if self.fluid.update(interval):
            self._changed(self.fluid.matrix if self.fluid.symmetric else None)


class AloneExact(Iteration):
    """Solves A w = b by transforms.  Collective.

    Parameters
    ----------
    fluid : Momentum or Stokes
        With a transform.
    """

    def __init__(self, fluid):
        self.fluid = fluid

    take = Iteration.begin

    def update(self, interval, operators, stress):
        """Follow the time step."""
        self.operators = operators
        self.fluid.update(interval)

    def iterate(self, accuracy):
        """Solve.  Returns the iterations, one."""
        self.fluid.solve(self.rhs, self.stage.velocity, self.stage.pressure)
        return 1

    def destroy(self):
        """There is nothing of its own to free."""
