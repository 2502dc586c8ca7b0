"""Time stepping schemes, by name."""

from .coupled import Coupled
from .explicit import Explicit
from .modified import Modified

BACKWARD_EULER, CRANK_NICOLSON = 1.0, 0.5

SCHEMES = {
    "ep": Explicit,
    "mbe": lambda problem: Modified(problem, BACKWARD_EULER),
    "mcn": lambda problem: Modified(problem, CRANK_NICOLSON),
    "be": lambda problem: Coupled(problem, BACKWARD_EULER),
    "cn": lambda problem: Coupled(problem, CRANK_NICOLSON),
}
