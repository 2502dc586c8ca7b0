"""What the iterations of the implicit system have in common (see `system`)."""

from . import krylov

# Of several solves in one step, as those of a tangent iteration: what each makes of its residual at
# least.  Were it content with the solution of the solve before, the markers would seem to have
# converged, and the acceleration would go astray.
REDUCTION = 0.1
ROUND_OFF = 1e-14  # relative tolerance below which no residual gets


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


class Iteration:
    """What `ImplicitSystem` asks of its iterations, besides update, iterate and destroy.

    Its methods do the same.  Collective.
    """

    def begin(self, rhs, stage):
        """Take right-hand side and first guess of a time step."""
        self.rhs, self.stage = rhs, stage

    def marker_velocity(self):
        """U of the last solution; None without markers."""
        return self.operators and self.operators.velocity(self.stage)

    def finish(self):
        """Set the stage, where `iterate` has not."""

    def forget(self):
        """Drop what is kept from one step to the next."""


class FluidIteration(Iteration):
    """A Krylov iteration whose first unknowns are the fluid's.  Collective.

    What differs is the matrix (`mult`), and how stresses enter the right-hand side and are found
    from the solution (`_load_stresses`, `_store_stresses`).

    Parameters
    ----------
    fluid : Momentum or Stokes
    defaults : dict
        Options of the Krylov method, unless the user has given them.
    preconditioner : object, optional
        A PETSc python PC, for options that ask for one.
    stresses : int, optional
        How many stresses, on the first rank, are unknowns too; by default they are not.
    """

    direct = None  # the first rank's direct solver within the preconditioner, if there is one

    def __init__(self, fluid, defaults, preconditioner=None, stresses=None):
        self.fluid = fluid
        self._unknowns, self._rhs = fluid.blocks(), fluid.blocks()
        if stresses is not None:
            for blocks in (self._unknowns, self._rhs):
                blocks.append(krylov.vector_on_root(stresses, fluid.grid.comm))
        self._solution, self._load = map(krylov.join, (self._unknowns, self._rhs))
        self._operator = krylov.Operator(self._solution, self)
        self.ksp = krylov.create(self._operator.matrix, fluid.prefix, defaults)
        self.ksp.getPC().setUseAmat(False)  # multigrid would otherwise smooth with the operator
        if preconditioner is not None:
            krylov.use_python(self.ksp, preconditioner)

    def _changed(self, preconditioned=None):
        """Tell PETSc that the matrix is another, and what it is to be preconditioned with."""
        self._operator.changed()
        self.ksp.setOperators(self._operator.matrix, preconditioned or self._operator.matrix)

    def iterate(self, accuracy):
        """Solve.  Returns the iterations."""
        fluid, stage = self.fluid, self.stage
        fluid.load(self._unknowns, stage.velocity, stage.pressure)
        self.rhs.copy(self._rhs[0])
        fluid.set_source(self._rhs)
        self._load_stresses()
        with krylov.tolerances(self.ksp, *self._tolerances(accuracy)):
            iterations = self._solve()
        if accuracy is None:
            iterations += self._go_on()
        fluid.store(self._unknowns, stage.velocity, stage.pressure)
        self._store_stresses()
        return iterations

    def _solve(self):
        return krylov.solve(
            self.ksp, self._load, self._solution, self.fluid.name, inner=self.direct)

    def _go_on(self):
        """Solve further, where the tolerance has been too coarse.  Returns the iterations."""
        return 0

    def _tolerances(self, accuracy):
        """Relative and absolute tolerance in place of the options', or None.  Collective."""
        return None, None

    def _load_stresses(self):
        """Set what the stresses add to the right-hand side, and their first guess."""

    def _store_stresses(self):
        """Find the stresses of the solution."""

    def destroy(self, pc=None):
        """Free the solver; where it is the preconditioner, PETSc calls this too.  Collective."""
        if pc is None:
            for part in (self.ksp, self._operator, self._solution, self._load,
                         *self._unknowns, *self._rhs):
                part.destroy()
