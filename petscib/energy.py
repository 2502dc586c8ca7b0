"""Energies, and the ledger that checks the discrete energy law of a step.

The law of every implicit scheme, with w the stage velocity theta u* + (1 - theta) u^n (u* is
u^{n+1} in the coupled schemes) and T its surface divergence, reads

    E^{n+1} - E^n = - rho (theta - 1/2) |u* - u^n|^2          inertia
                    - rho dt^2 / 2 |grad phi|^2                projection
                    - mu dt |grad w|^2                         viscous
                    - sigma0 dt^2 (theta - 1/2) |T|^2          tension
                    - c_b dt^2 (theta - 1/2) |D_ss J w|^2      bending
                    + wall power + reset.

The reset is the energy put in when the stretching and the markers that the step predicted are
replaced by those carried on.  Theorems 3.1 and 3.2 of Hu & Lai are the case of walls at rest.
"""

from dataclasses import astuple, dataclass, fields

import numpy as np

from .membranes import geometry


@dataclass
class Energies:
    """Kinetic, tension and bending energy; equal on all ranks."""

    kinetic: float
    tension: float
    bending: float

    @property
    def total(self):
        """Their sum E."""
        return self.kinetic + self.tension + self.bending


def measure(problem, state):
    """The energies of a state (Hu & Lai, eq. 3.17).  Collective."""
    operators, grid = problem.operators, problem.grid
    squares = state.velocity.dot(state.velocity) - operators.wall_faces / 2
    kinetic = problem.rho / 2 * grid.cell_area * squares
    if not problem.acted_on:
        return Energies(kinetic, 0.0, 0.0)
    local = _membrane_energies(problem.membrane, state.stretch, state.markers)
    tension, bending = grid.comm.tompi4py().bcast(local)
    return Energies(kinetic, tension, bending)


def _membrane_energies(membrane, stretch, markers):
    return membrane.tension_energy(stretch), membrane.bending_energy(markers)


@dataclass
class Ledger:
    """Terms of the energy law over one step: changes of energy, dissipation negative.

    Attributes
    ----------
    inertia, projection, viscous, tension, bending, wall_power, reset : float
        The terms above.
    change : float
        E^{n+1} - E^n.
    """

    inertia: float = 0.0
    projection: float = 0.0
    viscous: float = 0.0
    tension: float = 0.0
    bending: float = 0.0
    wall_power: float = 0.0
    reset: float = 0.0
    change: float = 0.0

    def __add__(self, other):
        return Ledger(*(a + b for a, b in zip(astuple(self), astuple(other))))

    @property
    def defect(self):
        """What the terms leave unexplained of the change."""
        terms = astuple(self)
        return terms[-1] - sum(terms[:-1])

    def residual(self, largest_energy):
        """Size of the defect relative to the largest energy so far."""
        return abs(self.defect) / largest_energy if largest_energy else abs(self.defect)

    @staticmethod
    def names():
        """Names of the terms, in order."""
        return [entry.name for entry in fields(Ledger)]


def balance(problem, step):
    """The ledger of a step of an implicit scheme.  Collective."""
    if step.parts:
        return sum((balance(problem, part) for part in step.parts), Ledger())
    operators, membrane = problem.operators, problem.membrane
    rho, mu, dt, theta = problem.rho, problem.mu, step.dt, step.theta
    area = problem.grid.cell_area
    excess = theta - 0.5  # 1/2 or 0: the schemes are backward Euler or Crank-Nicolson
    start, end, stage = step.start, step.end, step.stage
    work = stage.duplicate()

    ledger = Ledger()
    ledger.change = measure(problem, end).total - measure(problem, start).total

    if excess:  # then theta is 1 and the stage is u*
        work.waxpy(-1.0, start.velocity, stage)
        ledger.inertia = -rho * excess * area * work.dot(work)

    operators.laplacian.mult(stage, work)
    gradient = -stage.dot(work)
    if operators.wall_source is not None:
        drag = stage.dot(operators.wall_source)
        gradient += operators.wall_norm - 2 * drag
        ledger.wall_power = mu * dt * area * (operators.wall_norm - drag)
    ledger.viscous = -mu * dt * area * gradient

    pressure = end.pressure
    if step.projection is not None:
        operators.gradient.mult(step.projection, work)
        ledger.projection = -rho / 2 * dt**2 * area * work.dot(work)
        pressure = step.projection
    if operators.wall_flux is not None:
        factor = rho if step.projection is not None else 1.0
        ledger.wall_power -= factor * dt * area * pressure.dot(operators.wall_flux)
    work.destroy()

    if problem.acted_on:
        terms = _membrane_terms(membrane, step, excess)
        ledger.tension, ledger.bending, ledger.reset = problem.grid.comm.tompi4py().bcast(terms)
    return ledger


def _membrane_terms(membrane, step, excess):
    """Dissipation by tension and bending, and the reset; on the rank with the markers."""
    ds, dt, start, end = membrane.ds, step.dt, step.start, step.end
    tension, bending, stretch = 0.0, 0.0, start.stretch
    if membrane.sigma0:
        tension = -membrane.sigma0 * excess * dt**2 * ds * np.sum(step.stretch_rate**2)
        stretch = stretch + dt * step.stretch_rate
    if membrane.bending:
        bent = geometry.second_difference(step.marker_velocity, ds)
        bending = -membrane.bending * excess * dt**2 * ds * np.sum(bent**2)
    predicted = _membrane_energies(
        membrane,
        stretch,
        start.markers + dt * step.marker_velocity,
    )
    carried = _membrane_energies(membrane, end.stretch, end.markers)
    return tension, bending, sum(carried) - sum(predicted)
