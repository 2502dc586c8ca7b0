"""Energies, and the ledger that checks the discrete energy law of a step.

The law of every implicit scheme, with w the stage velocity theta u* + (1 - theta) u^n (u* is
u^{n+1} in the coupled schemes), U that of the markers and f the forces on them at the stage, reads

    E^{n+1} - E^n = - rho (theta - 1/2) |u* - u^n|^2          inertia
                    - rho dt^2 / 2 |grad phi|^2                projection
                    - mu dt |grad w|^2                         viscous (see below)
                    - dt w . rho N(U) w                        advection
                    - dt f . K f                               kink
                    - (theta - 1/2) |dm|^2                     tension, bending, ...: law by law
                    + wall power + body power + load power + reset.

Where the viscosity varies, the viscous term is - dt (mu_min |grad w|^2 + <e, D e>), with the strain
rates e of w and D the weights of `fluid.viscosity`.

In the advection term U is the transport, and N(U) U stands for N(U) w where it is explicit; the
implicit one is zero unless fluid passes through walls (see `fluid.advection`).

dm is the change of a law's stresses that the step predicts: dt C U, and what moved tethers add.
Law by law, |C U|^2 is sigma0 |T U|^2 for the tension and c_b |D_ss U|^2 for bending.  The load
power is that of given forces and of moved tethers.  The reset is the energy put in when the
stretching and the markers that the step predicted are replaced by those carried on.  Theorems 3.1
and 3.2 of Hu & Lai are the case of walls at rest without correction.
"""

from dataclasses import dataclass, field, fields

from .membranes.laws import LAWS


class _ByLaw:
    """The part of a law, by its name, reads like any other: ``energies.tension``."""

    def __getattr__(self, name):
        try:
            return self.__dict__["laws"][name]
        except KeyError:
            raise AttributeError(name) from None


@dataclass
class Energies(_ByLaw):
    """Kinetic energy and that of each law of the membranes; equal on all ranks."""

    kinetic: float
    laws: dict

    @property
    def total(self):
        """Their sum E."""
        return self.kinetic + sum(self.laws.values())


def measure(problem, state):
    """The energies of a state (Hu & Lai, eq. 3.17).  Collective."""
    operators, grid = problem.operators, problem.grid
    squares = state.velocity.dot(state.velocity) - operators.wall_faces / 2
    kinetic = problem.rho / 2 * grid.cell_area * squares
    laws = dict.fromkeys(LAWS, 0.0)
    if problem.acted_on:
        local = problem.membranes.energies(state.markers, state.stretch, state.time)
        laws.update(grid.comm.tompi4py().bcast(local))
    return Energies(kinetic, laws)


@dataclass
class Ledger(_ByLaw):
    """Terms of the energy law over one step: changes of energy, dissipation negative.

    Attributes
    ----------
    inertia, projection, viscous, advection, kink, wall_power, body_power, load_power, reset : float
        The terms above.
    laws : dict of str to float
        Those of each law.
    change : float
        E^{n+1} - E^n.
    """

    inertia: float = 0.0
    projection: float = 0.0
    viscous: float = 0.0
    advection: float = 0.0
    kink: float = 0.0
    laws: dict = field(default_factory=lambda: dict.fromkeys(LAWS, 0.0))
    wall_power: float = 0.0
    body_power: float = 0.0
    load_power: float = 0.0
    reset: float = 0.0
    change: float = 0.0

    def terms(self):
        """All by name, in order; the last is the change."""
        terms = {}
        for entry in fields(self):
            value = getattr(self, entry.name)
            terms.update(value if entry.name == "laws" else {entry.name: value})
        return terms

    def __add__(self, other):
        laws = {name: self.laws.get(name, 0.0) + other.laws.get(name, 0.0)
                for name in {**self.laws, **other.laws}}
        return Ledger(laws=laws, **{
            entry.name: getattr(self, entry.name) + getattr(other, entry.name)
            for entry in fields(self) if entry.name != "laws"
        })

    @property
    def defect(self):
        """What the terms leave unexplained of the change."""
        *terms, change = self.terms().values()
        return change - sum(terms)

    def residual(self, largest_energy):
        """Size of the defect relative to the largest energy so far."""
        return abs(self.defect) / largest_energy if largest_energy else abs(self.defect)

    @staticmethod
    def names():
        """Names of the terms, in order."""
        return list(Ledger().terms())


def balance(problem, step):
    """The ledger of a step of an implicit scheme.  Collective."""
    if step.parts:
        return sum((balance(problem, part) for part in step.parts), Ledger())
    operators = problem.operators
    rho, mu, dt, theta = problem.rho, problem.mu, step.dt, step.theta
    excess_dissipation = excess_power = 0.0
    if step.viscous is not None:
        mu, (excess_dissipation, excess_power) = problem.viscosity.least, step.viscous
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
        ledger.wall_power = dt * area * (mu * (operators.wall_norm - drag) + excess_power)
    ledger.viscous = -dt * area * (mu * gradient + excess_dissipation)

    if problem.advection is not None:
        ledger.advection = -dt * area * problem.advection.power(step.transport, stage)
    if problem.body_force is not None:
        force = problem.body_force.at(start.time + theta * dt)
        ledger.body_power = dt * area * stage.dot(force)

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
        ledger.kink, ledger.load_power, ledger.reset, laws = problem.grid.comm.tompi4py().bcast(
            _at_markers(problem.membranes, step))
        ledger.laws.update(laws)
    return ledger


def _at_markers(membranes, step):
    """Slip, load power, reset and the terms of the laws; on the rank with the markers."""
    end, terms = step.end, step.ledger
    carried = sum(membranes.energies(end.markers, end.stretch, end.time).values())
    return terms["kink"], terms["load_power"], carried - terms["predicted"], terms["laws"]
