"""The implicit system that every scheme solves: fluid and membrane forces together.

    [ fluid   - S ] [w]   [b]        w: stage velocity, with the pressure in the coupled system
    [ J       ... ] [f] = [..]       f: membrane forces at the stage

With the stresses m of the membranes in place of their forces f = - C^T m (see
`petscib.membranes.laws`) it reads, for one configuration of the membranes,

    A w + J^T Pi C^T m / (dx dy) = b,
    m / (theta dt) = m0 / (theta dt) + C U,    U = Pi J w - K C^T m,

symmetric, with A the momentum matrix or the coupled one.  Four iterations solve it:

`force`
    Where transforms invert A exactly: conjugate gradients for m alone.
`elimination`
    m eliminated: conjugate gradients for w, preconditioned by multigrid for A.  Without the kink
    correction K, where that is no use, by a factorisation of the whole assembled matrix.
`block`
    FGMRES for w and m, preconditioned by multigrid for A and the marker-space model for m.
`alone`
    Without membrane forces.

With implicit advection A is not symmetric.  Where transforms invert the rest of A, `skew` iterates
around these solves; elsewhere advection is part of A, and FGMRES takes the place of conjugate
gradients.

The relative tolerance is that of the power of the error, as the preconditioner tells it: relative
to that of the right-hand side, or in `elimination`, where this is no measure, of the velocity.
"""

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from ..errors import InputError
from .alone import Alone, AloneExact
from .block import Block
from .elimination import Elimination
from .force import Force
from .skew import Skew

# PETSc's Krylov methods for symmetric matrices.
NEED_SYMMETRY = frozenset((
    "cg", "fcg", "pipecg", "pipecgrr", "pipecg2", "pipelcg", "pipeprcg", "pipefcg", "groppcg",
    "nash", "stcg", "gltr", "qcg", "minres", "symmlq", "cr", "pipecr"))


@dataclass
class Stage:
    """What a scheme solves for.

    Attributes
    ----------
    velocity : PETSc.Vec
        w, over all faces.
    pressure : PETSc.Vec
        Over all cells; only the coupled system sets it.
    stress : ndarray
        m, on rank 0; without entries elsewhere.
    load : ndarray, shape (M, 2), or 0
        Given forces on the markers at the stage, which the fluid's right-hand side holds already.
    """

    velocity: PETSc.Vec
    pressure: PETSc.Vec
    stress: np.ndarray
    load: np.ndarray = 0.0


class ImplicitSystem:
    """The implicit system of one kind of fluid solve.  Collective.

    Solves that belong to one time step, with the membranes in almost the same place::

        system.begin(rhs, stage)
        for ...:
            system.update(interval, operators, stress)
            iterations = system.iterate(accuracy)
            ... = system.marker_velocity()
        system.finish()

    Parameters
    ----------
    fluid : Momentum or Stokes
        Owned by the system.
    membranes : Membranes or None
        None, or without forces: the fluid alone.
    kernel : Kernel
    corrected : bool
        Whether the kink correction is on.
    interval : float
        The usual theta dt, by which the default iteration is chosen.
    """

    def __init__(self, fluid, membranes, kernel, corrected, interval):
        self.fluid, self.membranes = fluid, membranes
        self._choice = membranes, kernel, corrected, interval
        self._iteration, self._version = self._choose(*self._choice), None

    def _choose(self, membranes, kernel, corrected, interval):
        """The iteration, with advection around it or part of it."""
        fluid = self.fluid
        iteration = self._choose_symmetric(membranes, kernel, corrected, interval)
        if fluid.advection is None:
            return iteration
        if isinstance(iteration, (Force, AloneExact)):
            return Skew(iteration, fluid)
        name = PETSc.Options(fluid.prefix).getString("ksp_type", "")
        if name in NEED_SYMMETRY:
            raise InputError(
                f"-{fluid.prefix}ksp_type {name}: implicit advection makes the system "
                "unsymmetric; allowed: fgmres, gmres, bcgs and others that do without, or -fft"
            )
        return iteration

    def _choose_symmetric(self, membranes, kernel, corrected, interval):
        fluid = self.fluid
        if membranes is None or not membranes.act:
            return AloneExact(fluid) if fluid.exact else Alone(fluid)
        if not corrected:
            return Elimination(fluid, membranes, kernel, literal=True)
        if fluid.exact:
            return Force(fluid, membranes, kernel)
        default = "cg" if fluid.elimination_pays(interval) else "fgmres"
        method = PETSc.Options(fluid.prefix).getString("ksp_type", default)
        kind = Elimination if fluid.symmetric and "cg" in method else Block
        return kind(fluid, membranes, kernel)

    def begin(self, rhs, stage):
        """Take the right-hand side b of a time step and first guesses.

        Parameters
        ----------
        rhs : PETSc.Vec
            Force per area on the faces, without that of the membranes; kept.
        stage : Stage
            Kept, and set by `finish`.
        """
        self._rhs, self._stage = rhs, stage
        self._iteration.begin(rhs, stage)

    def update(self, interval, operators=None, stress=None):
        """Set the system for theta dt = `interval` and a configuration of the membranes.

        Parameters
        ----------
        interval : float
        operators : MarkerOperators, optional
            Kept until the next call.
        stress : ndarray, optional
            m0, that of the step's start.
        """
        if self.membranes is not None and self.membranes.varies:
            self._follow(stress)
        self._iteration.update(interval, operators, stress)

    def _follow(self, stress):
        """Start anew where the membranes have got other stresses."""
        version = self.fluid.grid.comm.tompi4py().bcast(self.membranes.version)
        if version != self._version:
            self._iteration.destroy()
            self._iteration = self._choose(*self._choice)
            if len(stress) != len(self._stage.stress):  # in the middle of a step
                self._stage.stress = stress
            self._iteration.begin(self._rhs, self._stage)
        self._version = version

    def iterate(self, accuracy=None):
        """Solve so far that the markers' motion holds.  Returns the iterations.

        Parameters
        ----------
        accuracy : float, optional
            In place of the solver's tolerance, which is relative to the power of the right-hand
            side: one relative to the power of the membranes' forces alone, hence of their motion.

        Raises
        ------
        SolveError
            On all ranks.
        """
        return self._iteration.iterate(accuracy)

    def marker_velocity(self):
        """U of the last `iterate`: (M, 2) on rank 0, (0, 2) elsewhere."""
        return self._iteration.marker_velocity()

    def finish(self):
        """Set the stage everywhere."""
        self._iteration.finish()

    def solve(self, rhs, stage, interval, operators=None, stress=None):
        """Solve one configuration.  Returns the iterations."""
        self.begin(rhs, stage)
        self.update(interval, operators, stress)
        iterations = self.iterate()
        self.finish()
        return iterations

    def forget(self):
        """Drop what depends on earlier steps and is in no checkpoint."""
        self._iteration.forget()

    def destroy(self):
        """Free the solvers.  Collective."""
        self._iteration.destroy()
        self.fluid.destroy()
