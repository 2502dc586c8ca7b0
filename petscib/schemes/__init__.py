"""Time stepping schemes, by name."""

from dataclasses import dataclass

from ..solvers.momentum import Momentum
from ..solvers.poisson import poisson_solver
from ..solvers.stokes import Stokes
from .coupled import Coupled
from .explicit import Explicit
from .geometric import Geometric
from .modified import Modified
from .startup import Startup

BACKWARD_EULER, CRANK_NICOLSON = 1.0, 0.5


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
        def transform():
            from ..solvers.transforms.helmholtz import HelmholtzTransform

            return HelmholtzTransform(self.problem.grid)

        return self._fluid(Momentum, transform)

    def stokes(self):
        """Of velocity and pressure together."""
        def transform():
            from ..solvers.transforms.stokes import StokesTransform

            return StokesTransform(self.problem.grid, self.problem.operators)

        return self._fluid(Stokes, transform)

    def _fluid(self, kind, transform):
        problem, advection = self.problem, self.problem.advection
        if advection is not None and not advection.implicit:
            advection = None
        return kind(problem.operators, problem.rho, problem.mu, transform() if self.fft else None,
                    advection)

    def poisson(self):
        """Of the pressure's Poisson problem."""
        return poisson_solver(self.problem.operators, self.fft)


def _geometric(problem, theta, solvers, controls):
    membranes = problem.membranes
    # With linear laws and no projector there is nothing to average, and only Crank-Nicolson iterates
    # on where the markers are.
    if membranes is None or (
        theta == BACKWARD_EULER and membranes.linear and not problem.conserve_area
    ):
        return Coupled(problem, theta, solvers)
    return Geometric(problem, theta, solvers, controls)


SCHEMES = {
    "ep": lambda problem, solvers, controls: Explicit(problem, solvers),
    "mbe": lambda problem, solvers, controls: Modified(problem, BACKWARD_EULER, solvers),
    "mcn": lambda problem, solvers, controls: Modified(problem, CRANK_NICOLSON, solvers),
    "be": lambda problem, solvers, controls: Coupled(problem, BACKWARD_EULER, solvers),
    "cn": lambda problem, solvers, controls: Coupled(problem, CRANK_NICOLSON, solvers),
    "gbe": lambda *given: _geometric(given[0], BACKWARD_EULER, *given[1:]),
    "gcn": lambda *given: _geometric(given[0], CRANK_NICOLSON, *given[1:]),
}


def create(name, problem, controls=Controls()):
    """The scheme of this name for a problem.  Collective."""
    scheme = SCHEMES[name](problem, Solvers(problem, controls), controls)
    return Startup(scheme, controls.startup) if controls.startup else scheme
