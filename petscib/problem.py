"""What is simulated: the fluid, its walls, the membrane; and the state that moves in time."""

from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from . import guard
from .agreement import on_root
from .coupling.interpolation import Interpolation
from .coupling.stress import CorrectedInterpolation, StressInterpolation
from .events import phase
from .fluid.body_force import BodyForce
from .membranes import mobility
from .membranes.gaps import Gaps
from .solvers.markers import MarkerOperators


@dataclass
class State:
    """The state at one time level.

    Attributes
    ----------
    step : int
    time : float
    velocity : PETSc.Vec
        Over all faces, wall faces included.
    pressure : PETSc.Vec
        Over all cells, mean zero.
    markers : ndarray, shape (M, 2)
        Positions on rank 0; (0, 2) elsewhere.
    stretch : ndarray, shape (H,)
        Stretching |X_s| that the next step starts from, at the half points; rank 0.
    history : dict of str to ndarray, PETSc.Vec or float
        What a scheme wants to find again at the next step besides, such as earlier marker
        positions: arrays on rank 0 (without rows elsewhere), velocity or pressure vectors, and
        numbers that all ranks know.  Every checkpoint holds it.
    """

    step: int
    time: float
    velocity: PETSc.Vec
    pressure: PETSc.Vec
    markers: np.ndarray
    stretch: np.ndarray
    history: dict = field(default_factory=dict)

    def destroy(self):
        """Free its vectors.  Collective."""
        for vector in (self.velocity, self.pressure, *self.history.values()):
            if isinstance(vector, PETSc.Vec):
                vector.destroy()


@dataclass
class Step:
    """What a time step did, for diagnostics and the energy ledger.

    Attributes
    ----------
    dt, theta : float
        Time step, and where in it the stage lies (1: its end, 1/2: its middle).
    start, end : State
        The end has new vectors and arrays; those of the start are untouched.
    stage : PETSc.Vec
        Velocity theta u* + (1 - theta) u^n that the implicit forces saw.
    projection : PETSc.Vec or None
        Pressure increment phi of a projection scheme.
    marker_velocity : ndarray, shape (M, 2)
        U that carried the markers over the step.
    stress : ndarray, shape (R,)
        The membranes' stresses at the stage; None without forces.
    stress_rate : ndarray, shape (R,)
        Rates C U of the membranes' stresses at the stage; None without forces.
    ledger : dict
        Terms of the energy law that are known at the markers (see `energy`), on rank 0; and the
        energy of the stresses that the step predicted.
    transport : PETSc.Vec or None
        What carried momentum along; None without advection.
    viscous : (float, float) or None
        Dissipation, and power of walls, of what the viscosity exceeds its least by, per cell; None
        where it is the same everywhere.
    iterations : dict
        Linear and nonlinear iterations by solver.
    parts : tuple of Step
        The smaller steps that it was made of; empty for a plain step.
    """

    dt: float
    theta: float
    start: State
    end: State
    stage: PETSc.Vec
    projection: PETSc.Vec = None
    marker_velocity: np.ndarray = None
    stress: np.ndarray = None
    stress_rate: np.ndarray = None
    ledger: dict = field(default_factory=dict)
    transport: PETSc.Vec = None
    viscous: tuple = None
    iterations: dict = field(default_factory=dict)
    parts: tuple = ()

    def discard(self):
        """Free the vectors that only this step and its start hold.  Collective."""
        self._free(self.start)

    def undo(self):
        """Free the vectors that only this step and its end hold.  Collective."""
        self._free(self.end)

    def _free(self, state):
        comm = state.velocity.comm
        state.destroy()
        for part in self.parts[:-1]:
            part.end.destroy()
        for step in self.parts or (self,):
            if step.projection is not None:
                step.projection.destroy()
            if step.transport is not None and step.transport is not step.stage:
                step.transport.destroy()
        # petsc4py frees what Python has dropped only on request, on all ranks together.
        PETSc.garbage_cleanup(PETSc.COMM_SELF)
        PETSc.garbage_cleanup(comm)


class Problem:
    """All that is constant in time, and the pieces of the equations that schemes share.

    Parameters
    ----------
    grid : Grid
    operators : Operators
    rho, mu : float
        Density and viscosity.
    membranes : Membranes or None
        None: fluid alone.
    kernel : Kernel
        Smoothed delta function.
    evolve : bool
        Keep the stretching as a variable of its own (Hu & Lai, eq. 3.7) instead of taking it
        from the markers at each step.
    kink_correction : bool
        Whether markers slip by what smoothing takes from the velocity (see `mobility`).
    areas : ndarray, shape (V,), optional
        Signed areas that the membranes are to keep, on rank 0; None leaves them free.
    body_force : (float, float) or own.Function
        Force per unit area on the fluid, the same everywhere or a function of place and time.
    advection : Advection, optional
        None: creeping flow, whose momentum is not carried along.
    viscosity : Viscosity, optional
        None where it is the same everywhere.

    Attributes
    ----------
    body_force : BodyForce or None
        The same on the faces; None where there is none.
    gaps : Gaps or None
        How near the membranes are, for rank 0.
    """

    def __init__(self, grid, operators, rho, mu, membranes=None, kernel=None, evolve=False,
                 kink_correction=True, areas=None, body_force=(0.0, 0.0),
                 advection=None, viscosity=None):
        self.grid = grid
        self.operators = operators
        self.rho, self.mu = rho, mu
        self.membranes = membranes
        self.kernel = kernel
        self.evolve = evolve
        self.kink_correction = kink_correction
        self.areas = areas
        self.gaps = None if membranes is None else Gaps(membranes.curves, grid)
        self.body_force = None
        if callable(body_force) or any(body_force):
            self.body_force = BodyForce(operators, body_force)
        self.advection, self.viscosity = advection, viscosity

    @property
    def curves(self):
        """The curves of the membranes, or None."""
        return self.membranes and self.membranes.curves

    @property
    def acted_on(self):
        """Whether membranes exert forces on the fluid."""
        return self.membranes is not None and (self.membranes.act or self.loaded)

    @property
    def loaded(self):
        """Whether given forces act on membranes."""
        return self.membranes is not None and bool(self.membranes.loads)

    @property
    def least_mu(self):
        """The least viscosity anywhere."""
        return self.mu if self.viscosity is None else self.viscosity.least

    @property
    def conserve_area(self):
        """Whether membranes keep their areas."""
        return self.areas is not None

    @property
    def slips(self):
        """Whether interpolation is corrected for what smoothing does to the velocity."""
        return self.kink_correction and (self.acted_on or self.viscosity is not None)

    @property
    def reach(self):
        """Distance, in grid spacings, that a marker must keep from the walls."""
        if self.viscosity is not None and self.slips:
            return self.kernel.stress_reach
        return self.kernel.reach

    def place_viscosity(self, markers):
        """Have the viscosity change at these markers, where it does at all.  Collective.

        Raises
        ------
        SolveError
            On all ranks: as `interpolation`, or the solve for the indicator has failed.
        """
        if self.viscosity is not None:
            with phase("viscosity"):
                on_root(self.grid.comm.tompi4py(), lambda: guard.check_markers(self, markers))
                self.viscosity.place(markers)

    def interpolation(self, markers):
        """The matrix J at these marker positions.  Collective.

        Raises
        ------
        SolveError
            On all ranks: a marker is too near a wall, or beyond it.
        """
        with phase("interpolation assembly"):
            on_root(self.grid.comm.tompi4py(), lambda: guard.check_markers(self, markers))
            stresses = None
            if self.viscosity is not None and self.slips:
                places = mobility.stress_places(
                    self.membranes.curves, markers, self.grid, self.mu, self.viscosity.inner)
                stresses = StressInterpolation(self.viscosity, self.kernel, places)
            return Interpolation(self.grid, self.kernel, markers, stresses)

    def operators_between(self, before, after, interpolation):
        """What acts at the markers on the way between two configurations.

        Parameters
        ----------
        before, after : ndarray, shape (M, 2)
            The same array twice for an instant.
        interpolation : Interpolation

        Returns
        -------
        MarkerOperators
            C changes stresses by exactly the difference between the two; chords and normals are
            those of their mean.
        """
        with phase("marker operators"):
            curves = self.membranes.curves
            middle = before if after is before else (before + after) / 2
            slip = projector = None
            if self.slips:
                interpolation, slip = self._corrected(interpolation, middle)
            if self.conserve_area:
                projector = mobility.AreaProjector(curves, middle)
            return MarkerOperators(
                interpolation, self.membranes.rates(before, after), slip, projector)

    def _corrected(self, interpolation, markers):
        """J, or J' where the viscosity varies, and the slip at some markers."""
        place = self.membranes.curves, markers, self.grid, self.kernel
        if self.viscosity is None:
            return interpolation, mobility.Slip(*place, self.mu)
        slip = mobility.ContrastSlip(*place, self.mu, self.viscosity.inner)
        return CorrectedInterpolation(interpolation, slip), slip

    def operators_at(self, markers):
        """What acts at these markers; None without membranes.  Collective."""
        if self.membranes is None:
            return None
        return self.operators_between(markers, markers, self.interpolation(markers))

    def stress(self, state):
        """Stresses m of the membranes in a state, (R,) on rank 0; None where no membrane acts."""
        if not self.acted_on:
            return None
        self.membranes.cover(state.markers, state.markers)
        return self.membranes.stress(state.markers, state.stretch, state.time)

    def tension(self, state):
        """Tension at the half points, shape (H,) on rank 0: that of the step's stage, if known.

        At the ends of steps Crank-Nicolson leaves oscillations that its stages do not have.
        """
        return self.membranes.tension(state.stretch, state.history.get("stress"))

    def stress_drift(self, state, dt):
        """Change of the stresses over a step with the markers at rest, where tethers are moved."""
        membranes = self.membranes
        return (membranes.stress(state.markers, state.stretch, state.time + dt)
                - membranes.stress(state.markers, state.stretch, state.time))

    def transport(self, state, ahead):
        """The velocity expected a time `ahead` of a state, to carry momentum along.

        Returns
        -------
        PETSc.Vec or None
            A new vector; None without advection.
        """
        if self.advection is None:
            return None
        velocity = state.velocity.copy()
        if ahead and "velocity_rate" in state.history:
            velocity.axpy(ahead, state.history["velocity_rate"])
        return velocity

    def fluid_rhs(self, state, interval, rhs, transport=None):
        """Set rhs = rho / (theta dt) u^n + mu (walls' part of the Laplacian) + body force.

        Less the part of advection that does not depend on the solution, with a transport.
        """
        viscosity, mu = self.viscosity, self.mu
        state.velocity.copy(rhs)
        rhs.scale(self.rho / interval)
        if viscosity is not None:
            viscosity.add_wall_force(rhs)
            mu = viscosity.least
        if self.operators.wall_source is not None:
            rhs.axpy(mu, self.operators.wall_source)
        if self.body_force is not None:
            rhs.axpy(1.0, self.body_force.at(state.time + interval))
        if transport is not None:
            self.advection.load(rhs, transport)

    def account(self, state, dt, theta, operators, stage, motion, load_power=0.0):
        """What the energy law asks of the markers' part of a step: fields of the Step.

        Parameters
        ----------
        state : State
            The step's start.
        dt, theta : float
        operators : MarkerOperators
        stage : Stage
        motion : ndarray, shape (M, 2)
            U at the stage.
        load_power : float
            Power of given forces on the fluid.
        """
        if not self.acted_on:
            return {}
        membranes = self.membranes
        rate, stress = operators.rate(motion), self.stress(state)
        change = dt * rate
        force = operators.force(stage.stress) + stage.load
        slip = operators.slip_velocity(force)
        work = dt * (load_power + np.sum(stage.load * slip))
        if membranes.move:
            drift = self.stress_drift(state, dt)
            change = change + drift
            work += (stress + theta * change) @ drift
        predicted = stress + change
        return {"stress_rate": rate, "ledger": {
            "kink": -dt * np.sum(force * slip),
            "load_power": work,
            "predicted": predicted @ predicted / 2,
            "laws": {name: (1 - 2 * theta) * energy
                     for name, energy in membranes.by_law(change).items()},
        }}

    def keep_areas(self, markers):
        """Move markers back to where their membranes have the areas they are to keep."""
        if not self.conserve_area:
            return markers
        return mobility.restore_areas(self.membranes.curves, markers, self.areas)

    def next_stretch(self, state, dt, markers, stress_rate):
        """The stretching to carry on with: evolved, or that of the new markers."""
        if self.evolve:
            tension = self.membranes.law("tension")
            rate = stress_rate[self.membranes.rows["tension"]]
            return state.stretch + dt * tension.stretch_rate(rate)
        return self.membranes.curves.stretching(markers)
