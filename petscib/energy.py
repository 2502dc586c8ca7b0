"""Energies, and the ledger that checks the discrete energy law of a step.

The law of every implicit scheme, with w the stage velocity theta u* + (1 - theta) u^n (u* is
u^{n+1} in the coupled schemes), U that of the markers and f the forces on them at the stage, reads

    E^{n+1} - E^n = - rho (theta - 1/2) |u* - u^n|^2          inertia
                    - rho dt^2 / 2 |grad phi|^2                projection
                    - mu dt |grad w|^2                         viscous
                    - dt w . rho N(U) w                        advection
                    - dt f . K f                               kink
                    - dt^2 (theta - 1/2) |C U|^2               tension, bending: law by law
                    + wall power + body power + reset.

In the advection term U is the transport, and N(U) U stands for N(U) w where it is explicit; the
implicit one is zero unless fluid passes through walls (see `fluid.advection`).

Law by law, |C U|^2 is sigma0 |T U|^2 for the tension and c_b |D_ss U|^2 for bending.  The reset is
the energy put in when the stretching and the markers that the step predicted are replaced by those
carried on.  Theorems 3.1 and 3.2 of Hu & Lai are the case of walls at rest without correction.
"""

from dataclasses import astuple, dataclass, fields


@dataclass
class Energies:
    """Kinetic, tension and bending energy; equal on all ranks."""

    kinetic: float
    tension: float = 0.0
    bending: float = 0.0

    @property
    def total(self):
        """Their sum E."""
        return sum(astuple(self))


def measure(problem, state):
    """The energies of a state (Hu & Lai, eq. 3.17).  Collective."""
    operators, grid = problem.operators, problem.grid
    squares = state.velocity.dot(state.velocity) - operators.wall_faces / 2
    kinetic = problem.rho / 2 * grid.cell_area * squares
    if not problem.acted_on:
        return Energies(kinetic)
    membranes = problem.membranes
    local = membranes.energies(membranes.stress(state.markers, state.stretch))
    return Energies(kinetic, **grid.comm.tompi4py().bcast(local))


@dataclass
class Ledger:
    """Terms of the energy law over one step: changes of energy, dissipation negative.

    Attributes
    ----------
    inertia, projection, viscous, advection, kink, tension, bending, wall_power, body_power, reset :
        float
        The terms above.
    change : float
        E^{n+1} - E^n.
    """

    inertia: float = 0.0
    projection: float = 0.0
    viscous: float = 0.0
    advection: float = 0.0
    kink: float = 0.0
    tension: float = 0.0
    bending: float = 0.0
    wall_power: float = 0.0
    body_power: float = 0.0
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
    operators = problem.operators
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

    if problem.advection is not None:
        ledger.advection = -dt * area * problem.advection.power(step.transport, stage)
    if problem.body_force is not None:
        ledger.body_power = dt * area * stage.dot(problem.body_force)

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
        terms = _membrane_terms(problem.membranes, step, excess)
        for name, value in problem.grid.comm.tompi4py().bcast(terms).items():
            setattr(ledger, name, value)
    return ledger


def _membrane_terms(membranes, step, excess):
    """Dissipation by slip and by each law, and the reset; on the rank with the markers."""
    dt, rate = step.dt, step.stress_rate
    stress = membranes.stress(step.start.markers, step.start.stretch)
    carried = membranes.stress(step.end.markers, step.end.stretch)
    predicted = stress + dt * rate
    terms = {"kink": -dt * step.slip_power}
    terms["reset"] = (carried @ carried - predicted @ predicted) / 2
    for name, energy in membranes.energies(rate).items():
        terms[name] = -2 * excess * dt**2 * energy
    return terms
