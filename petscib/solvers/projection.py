"""The projection method as a preconditioner of the coupled system."""

from . import krylov
from .poisson import PoissonSolver

VELOCITY_DEFAULTS = {"ksp_type": "preonly", "pc_type": "gamg"}
POISSON_DEFAULTS = {"ksp_type": "preonly", "pc_type": "gamg", "mg_coarse_sub_pc_type": "svd"}


class ProjectionPC:
    """PETSc python PC: K0 solved approximately by the projection method.

    A0 u* = f, then a Poisson problem for the pressure.  Exact in a periodic box with exact inner
    solvers; walls leave a splitting error that the outer iteration removes.

    Parameters
    ----------
    pair : FluidPair
    operators : Operators
    prefix : str
        Options prefix; the solvers inside have <prefix>velocity_ and <prefix>poisson_.
    """

    def __init__(self, pair, operators, prefix):
        self.pair = pair
        self._velocity = krylov.create(
            pair.fluid.matrix, prefix + "velocity_", VELOCITY_DEFAULTS)
        self._poisson = PoissonSolver(operators, prefix + "poisson_", POISSON_DEFAULTS)
        layout = pair.layout
        self._given, *self._source = layout.joint()
        self._answer, *self._found = layout.joint()
        self._slope, self._excess = layout.velocity.duplicate(), layout.pressure.duplicate()

    def setUp(self, pc):
        """Follow the time step.  Collective."""
        self._velocity.setOperators(self.pair.fluid.matrix)

    def apply(self, pc, x, y):
        """y = approximately K0^{-1} x.  Collective."""
        pair, fluid, excess = self.pair, self.pair.fluid, self._excess
        interval, scale = fluid.interval, pair.scale
        (force, source), (velocity, pressure) = self._source, self._found
        x.copy(self._given)
        force.stateIncrease()  # it is part of that vector, and an inner solver may ask for its norm
        velocity.set(0.0)
        advice = krylov.advice(self._velocity)
        krylov.solve(self._velocity, force, velocity, "velocity", advice)

        # (theta dt) Laplacian phi = div u* less what the source asks for, with div = -G^T
        pair.gradient.multTranspose(velocity, excess)
        excess.axpby(1 / (scale * interval), -1 / interval, source)
        pressure.set(0.0)
        self._poisson.solve(excess, pressure)

        # u = u* - theta dt grad phi,  p = rho phi - mu (div u* less its source)
        pair.gradient.mult(pressure, self._slope)
        velocity.axpy(-interval, self._slope)
        pressure.axpby(-fluid.mu * interval / scale, fluid.rho / scale, excess)
        self._answer.copy(y)

    def view(self, pc, viewer):
        """Show the inner solvers."""
        self._velocity.view(viewer)
        self._poisson.ksp.view(viewer)

    def destroy(self, pc):
        """Free the inner solvers; PETSc calls this.  Collective."""
        self._velocity.destroy()
        self._poisson.destroy()
        for vector in (*self._source, *self._found, self._given, self._answer):
            vector.destroy()
        self._slope.destroy()
        self._excess.destroy()
