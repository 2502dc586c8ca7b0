"""What is simulated: the fluid, its walls, the membrane; and the state that moves in time."""

from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from .coupling.interpolation import Interpolation
from .events import phase
from .membrane import geometry


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
    stretch : ndarray, shape (M,)
        Stretching |X_s| that the next step starts from, at the half points; rank 0.
    history : dict of str to ndarray or PETSc.Vec
        What a scheme wants to find again at the next step besides, such as earlier marker
        positions: arrays on rank 0 (without rows elsewhere), velocity or pressure vectors.
        Every checkpoint holds it.
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
    stretch_rate : ndarray, shape (M,)
        Surface divergence of the stage velocity along the step's tangent; None without tension.
    marker_velocity : ndarray, shape (M, 2)
        The stage velocity at the markers.
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
    stretch_rate: np.ndarray = None
    marker_velocity: np.ndarray = None
    iterations: dict = field(default_factory=dict)
    parts: tuple = ()

    def discard(self):
        """Free the vectors that only this step and its start hold.  Collective."""
        comm = self.start.velocity.comm
        self.start.destroy()
        for part in self.parts[:-1]:
            part.end.destroy()
        for step in self.parts or (self,):
            if step.projection is not None:
                step.projection.destroy()
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
    membrane : Membrane or None
        None: fluid alone.
    kernel : Kernel
        Smoothed delta function.
    evolve : bool
        Keep the stretching as a variable of its own (Hu & Lai, eq. 3.7) instead of taking it
        from the markers at each step.
    body_force : (float, float)
        Uniform force per unit area on the fluid.

    Attributes
    ----------
    body_force : PETSc.Vec or None
        The same on the faces; None where there is none.
    """

    def __init__(self, grid, operators, rho, mu, membrane=None, kernel=None, evolve=False,
                 body_force=(0.0, 0.0)):
        self.grid = grid
        self.operators = operators
        self.rho, self.mu = rho, mu
        self.membrane = membrane
        self.kernel = kernel
        self.evolve = evolve
        self.body_force = operators.uniform_force(body_force) if any(body_force) else None

    def interpolation(self, markers):
        """The matrix J at these marker positions, or None without a membrane.  Collective."""
        if self.membrane is None:
            return None
        with phase("interpolation assembly"):
            return Interpolation(self.grid, self.kernel, markers, self.membrane.ds)

    @property
    def acted_on(self):
        """Whether a membrane exerts forces on the fluid."""
        return self.membrane is not None and self.membrane.acts

    def fluid_rhs(self, velocity, interval, rhs):
        """Set rhs = rho / (theta dt) u^n + mu (walls' part of the Laplacian) + body force."""
        velocity.copy(rhs)
        rhs.scale(self.rho / interval)
        if self.operators.wall_source is not None:
            rhs.axpy(self.mu, self.operators.wall_source)
        if self.body_force is not None:
            rhs.axpy(1.0, self.body_force)

    def add_force(self, state, tangent, interpolation, rhs):
        """Add the membrane force of a state, spread to the grid.  Collective."""
        with phase("forces"):
            force = self.membrane.force(state.markers, state.stretch, tangent)
            interpolation.spread_add(force, rhs)

    def first_guess(self, state):
        """The stage velocity, extrapolated from the last two steps (a new vector)."""
        history = state.history
        guess = history.get("stage", state.velocity).copy()
        if "stage_change" in history:
            guess.axpy(1.0, history["stage_change"])
        return guess

    @staticmethod
    def next_history(state, stage):
        """What the first guess of the next step is made of; takes the stage over."""
        history = {"stage": stage}
        if "stage" in state.history:
            history["stage_change"] = stage.copy()
            history["stage_change"].axpy(-1.0, state.history["stage"])
        return history

    def next_stretch(self, stretch, stretch_rate, dt, markers):
        """The stretching to carry on with: evolved, or that of the new markers."""
        if self.membrane is None:
            return stretch
        if self.evolve:
            return stretch + dt * stretch_rate
        return geometry.stretching(markers, self.membrane.ds)
