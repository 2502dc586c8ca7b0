"""The fluid without membrane forces."""

from . import krylov


class FluidPC:
    """PETSc python PC: the fluid's own preconditioner.

    Parameters
    ----------
    fluid : Momentum or Stokes
    """

    def __init__(self, fluid):
        self.fluid = fluid

    def apply(self, pc, x, y):
        """y = about A^{-1} x."""
        self.fluid.precondition(krylov.blocks_of(x), krylov.blocks_of(y))

    def view(self, pc, viewer):
        """Show the solvers inside."""
        self.fluid.view(viewer)


class Alone:
    """Solves A w = b, directly where there are transforms.  Collective.

    Parameters
    ----------
    fluid : Momentum or Stokes
    """

    what = "fluid"

    def __init__(self, fluid):
        self.fluid = fluid
        self.ksp = None
        if not fluid.exact:
            self._unknowns, self._rhs = fluid.blocks(), fluid.blocks()
            self._solution, self._load = map(krylov.join, (self._unknowns, self._rhs))
            self._operator = krylov.Operator(self._solution, self)
            self.ksp = krylov.create(self._operator.matrix, fluid.prefix, fluid.defaults)
            self.ksp.getPC().setUseAmat(False)  # as in `elimination`
            krylov.use_python(self.ksp, FluidPC(fluid))

    def mult(self, x, y):
        """y = A x."""
        self.fluid.mult(krylov.blocks_of(x), krylov.blocks_of(y))

    def begin(self, rhs, stage):
        """Take right-hand side and first guess."""
        self.rhs, self.stage = rhs, stage

    take = begin

    def forget(self):
        """There is nothing."""

    def update(self, interval, operators, stress):
        """Follow the time step."""
        self.operators = operators
        if self.fluid.update(interval) and self.ksp:
            self._operator.changed()
            matrix = self.fluid.matrix if self.fluid.symmetric else self._operator.matrix
            self.ksp.setOperators(self._operator.matrix, matrix)

    def iterate(self, accuracy):
        """Solve.  Returns the iterations."""
        if not self.ksp:
            self.fluid.solve(self.rhs, self.stage.velocity, self.stage.pressure)
            return 1
        self.fluid.load(self._unknowns, self.stage.velocity, self.stage.pressure)
        self.rhs.copy(self._rhs[0])
        self.fluid.set_source(self._rhs)
        iterations = krylov.solve(
            self.ksp, self._load, self._solution, self.fluid.name, krylov.advice(self.ksp))
        self.fluid.store(self._unknowns, self.stage.velocity, self.stage.pressure)
        return iterations

    def marker_velocity(self):
        """U at markers that the fluid only carries, or None without any."""
        return self.operators and self.operators.interpolate(self.stage.velocity)

    def finish(self):
        """Nothing is left to do."""

    def destroy(self):
        """Free the solver.  Collective."""
        if self.ksp:
            for part in (self.ksp, self._operator, self._solution, self._load,
                         *self._unknowns, *self._rhs):
                part.destroy()
