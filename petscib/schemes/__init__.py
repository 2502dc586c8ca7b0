"""Time stepping schemes, by name."""

from dataclasses import dataclass

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
    """

    startup: int = 0
    picard_rtol: float = 1e-9
    picard_max_it: int = 100


def _geometric(problem, theta, controls):
    membrane = problem.membrane
    # Without tension there is no tangent to average, and only Crank-Nicolson iterates on where
    # the markers are.
    if membrane is None or (theta == BACKWARD_EULER and not membrane.sigma0):
        return Coupled(problem, theta)
    return Geometric(problem, theta, controls)


SCHEMES = {
    "ep": lambda problem, controls=Controls(): Explicit(problem),
    "mbe": lambda problem, controls=Controls(): Modified(problem, BACKWARD_EULER),
    "mcn": lambda problem, controls=Controls(): Modified(problem, CRANK_NICOLSON),
    "be": lambda problem, controls=Controls(): Coupled(problem, BACKWARD_EULER),
    "cn": lambda problem, controls=Controls(): Coupled(problem, CRANK_NICOLSON),
    "gbe": lambda problem, controls=Controls(): _geometric(problem, BACKWARD_EULER, controls),
    "gcn": lambda problem, controls=Controls(): _geometric(problem, CRANK_NICOLSON, controls),
}


def create(name, problem, controls=Controls()):
    """The scheme of this name for a problem.  Collective."""
    scheme = SCHEMES[name](problem, controls)
    return Startup(scheme, controls.startup) if controls.startup else scheme
