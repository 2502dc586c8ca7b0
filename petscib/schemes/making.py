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
        if self.problem.viscosity is None:
            return self._fluid(Momentum, self._helmholtz)
        from ..solvers.varying import VaryingMomentum

        return self._fluid(VaryingMomentum, self._helmholtz)

    def stokes(self):
        """Of velocity and pressure together."""
        if self.problem.viscosity is None:
            return self._fluid(Stokes, self._saddle_point)
        from ..solvers.varying import VaryingStokes

        return self._fluid(VaryingStokes, self._helmholtz)

    # Transforms are loaded only where they are asked for.

    def _helmholtz(self):
        from ..solvers.transforms.diagonal import HelmholtzTransform

        return HelmholtzTransform(self.problem.grid)

    def _saddle_point(self):
        from ..solvers.transforms.saddle_point import StokesTransform

        return StokesTransform(self.problem.grid, self.problem.operators)

    def _fluid(self, kind, transform):
        problem = self.problem
        implicit = problem.advection is not None and problem.advection.implicit
        return kind(problem.operators, problem.rho, problem.viscosity or problem.mu,
                    transform() if self.fft else None, problem.advection if implicit else None)

    def poisson(self):
        """Of the pressure's Poisson problem."""
        return poisson_solver(self.problem.operators, self.fft)


def create(name, problem, controls=Controls()):
    """The scheme of this name for a problem.  Collective."""
    scheme = SCHEMES[name].make(problem, Solvers(problem, controls), controls)
    return Startup(scheme, controls.startup) if controls.startup else scheme
