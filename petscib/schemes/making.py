"""Schemes and the solvers that they ask for, made for a problem."""

from dataclasses import dataclass

from ..solvers.momentum import Momentum
from ..solvers.poisson import poisson_solver
from ..solvers.stokes import Stokes
from .registry import SCHEMES
from .startup import Startup


@dataclass(frozen=True)
class Controls:
    """What a scheme lets its user set.

    Attributes
    ----------
    startup : int
        Number of first steps that are taken by backward Euler half steps.
    picard_rtol : float
    picard_max_it : int
        When the tangent of the geometric schemes has converged, and when it has failed to.
    fft : bool
        Whether transforms solve the fluid's equations exactly.
    dt : float
        The usual time step, by which solvers are chosen.
    """

    startup: int = 0
    picard_rtol: float = 1e-9
    picard_max_it: int = 100
    fft: bool = False
    dt: float = 0.0


class Solvers:
    """Makes the fluid's solvers that a scheme asks for.  Collective.

    Parameters
    ----------
    problem : Problem
    controls : Controls
    """

    def __init__(self, problem, controls):
        self.problem, self.fft, self.dt = problem, controls.fft, controls.dt

    def momentum(self):
        """Of the momentum system."""
        if self.problem.viscosity is not None:
            return self._varying("VaryingMomentum")
        return self._fluid(Momentum, self._helmholtz)

    def stokes(self):
        """Of velocity and pressure together."""
        if self.problem.viscosity is not None:
            return self._varying("VaryingStokes")

        def transform():
            from ..solvers.transforms.saddle_point import StokesTransform

            return StokesTransform(self.problem.grid, self.problem.operators)

        return self._fluid(Stokes, transform)

    def _helmholtz(self):
        from ..solvers.transforms.diagonal import HelmholtzTransform

        return HelmholtzTransform(self.problem.grid)

    def _varying(self, name):
        from ..solvers import varying

        return self._fluid(getattr(varying, name), self._helmholtz, self.problem.viscosity)

    def _fluid(self, kind, transform, viscosity=None):
        problem, advection = self.problem, self.problem.advection
        if advection is not None and not advection.implicit:
            advection = None
        return kind(problem.operators, problem.rho,
                    problem.mu if viscosity is None else viscosity,
                    transform() if self.fft else None, advection)

    def poisson(self):
        """Of the pressure's Poisson problem."""
        return poisson_solver(self.problem.operators, self.fft)


def create(name, problem, controls=Controls()):
    """The scheme of this name for a problem.  Collective."""
    scheme = SCHEMES[name].make(problem, Solvers(problem, controls), controls)
    return Startup(scheme, controls.startup) if controls.startup else scheme
