"""The fluid's part of the coupled system: velocity and pressure together."""

from .momentum import Momentum
from .poisson import poisson_solver

POISSON_DEFAULTS = {"ksp_type": "preonly", "pc_type": "gamg", "mg_coarse_sub_pc_type": "svd"}


class Stokes(Momentum):
    """K0 = [[A0, s G], [s G^T, 0]] on velocities and pressures.  Collective.

    The factor s makes residuals of div w = 0 as large as those of the momentum equation for the
    same error in the velocity; the pressures among the unknowns are p / s.  The preconditioner is
    the projection method: A0 u* = f, then a Poisson problem for the pressure.  It would be exact in
    a periodic box with exact inner solvers; walls leave a splitting error that the outer iteration
    removes.

    Parameters
    ----------
    operators : Operators
    rho, mu : float
    transform : StokesTransform, optional
        Exact inverse; without it, multigrid.
    advection : Advection, optional
        As in Momentum.
    """

    name, prefix = "coupled", "coupled_"
    share = 0.5
    # GMRES with 30 vectors would stall at long time steps, where some 50 iterations are needed.
    defaults = {
        "ksp_type": "fgmres", "ksp_rtol": 1e-6, "ksp_max_it": 500, "ksp_gmres_restart": 60,
        "pc_type": "python",
    }
    symmetric = False
    fast = False  # whether transforms solve the preconditioner's Poisson problem

    def __init__(self, operators, rho, mu, transform=None, advection=None):
        super().__init__(operators, rho, mu, transform, advection)
        self._poisson = None
        self._slope = self.grid.velocity_vector()
        self._excess = self.grid.pressure_vector()

    @property
    def scale(self):
        """The factor s: A0's response to an error in one velocity, times the cell's width."""
        width = min(self.grid.dx, self.grid.dy)
        return self.rho * width / self.interval + self.mu / width

    def elimination_pays(self, interval):
        """Never: the system is indefinite."""
        return False

    def blocks(self):
        """New vectors of the unknowns."""
        return [self.grid.velocity_vector(), self.grid.pressure_vector()]

    def load(self, unknowns, velocity, pressure):
        """Take first guesses over into the unknowns."""
        velocity.copy(unknowns[0])
        pressure.copy(unknowns[1])
        unknowns[1].scale(1 / self.scale)

    def store(self, unknowns, velocity, pressure):
        """Set velocity and pressure; the latter of zero mean."""
        unknowns[0].copy(velocity)
        unknowns[1].copy(pressure)
        pressure.scale(self.scale)
        pressure.shift(-pressure.sum() / pressure.getSize())

    def set_source(self, rhs):
        """Set the right-hand side of div w = 0: what flows through the walls."""
        if self.operators.wall_flux is not None:
            self.operators.wall_flux.copy(rhs[1])
            rhs[1].scale(self.scale)

    def mult(self, x, y):
        """y = K0 x for lists of blocks."""
        super().mult(x, y)
        x[1].copy(self._excess)
        self._excess.scale(self.scale)
        gradient = self.operators.gradient
        gradient.multAdd(self._excess, y[0], y[0])
        gradient.multTranspose(x[0], y[1])
        y[1].scale(self.scale)

    def solve(self, rhs, velocity, pressure=None):
        """Solve for velocity and pressure, unless it is None, exactly by transforms."""
        self.transform.solve(rhs, self.operators.wall_flux, velocity, pressure)

    def precondition(self, rhs, answer):
        """Set answer to about K0^{-1} rhs, lists of blocks."""
        interval, scale, excess = self.interval, self.scale, self._excess
        (force, source), (velocity, pressure) = rhs, answer
        self.precondition_velocity(force, velocity)
        if self._poisson is None:
            self._poisson = poisson_solver(
                self.operators, self.fast, self.prefix + "poisson_", POISSON_DEFAULTS)
        gradient = self.operators.gradient

        # (theta dt) Laplacian phi = div u* less what the source asks for, with div = -G^T
        gradient.multTranspose(velocity, excess)
        excess.axpby(1 / (scale * interval), -1 / interval, source)
        pressure.set(0.0)
        self._poisson.solve(excess, pressure)

        # u = u* - theta dt grad phi,  p = rho phi - mu (div u* less its source)
        gradient.mult(pressure, self._slope)
        velocity.axpy(-interval, self._slope)
        mu = self.viscosity_of(excess)
        pressure.axpby(-mu * interval / scale, self.rho / scale, excess)

    def viscosity_of(self, cells):
        """The factor that makes values at cells the viscosity times these; they may change."""
        return self.mu

    def view(self, viewer):
        """Show what preconditions."""
        super().view(viewer)
        if self._poisson is not None and self._poisson.ksp is not None:
            self._poisson.ksp.view(viewer)

    def destroy(self):
        """Free matrix and solvers.  Collective."""
        super().destroy()
        for part in (self._poisson, self._slope, self._excess):
            if part is not None:
                part.destroy()
