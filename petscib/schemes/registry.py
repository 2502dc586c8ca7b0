"""The schemes: what the rest of the program knows of each, one record each.

Options, checks, studies and pictures read them here, without PETSc; a scheme's own module is only
loaded to make it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

BACKWARD_EULER, CRANK_NICOLSON = 1.0, 0.5


@dataclass(frozen=True)
class Scheme:
    """A time stepping scheme.

    Attributes
    ----------
    name : str
        What ``-scheme`` takes.
    words : str
        What it is, in a few words.
    theta : float
        1 for backward Euler, 1/2 for Crank-Nicolson.
    coupled : bool
        Whether velocity and pressure are solved for together; else one after the other.
    make : callable
        From problem, solvers and controls, see `making`, to the scheme.
    implicit : bool
        Whether the membranes' forces are: then the energy law of `petscib.energy` holds, and kink
        correction and area projector are on by default.
    order : int
        In time, with vesicles.
    startup : int
        First steps that are taken as damped half steps by default.
    style : dict
        Of its lines in pictures; the colours are those of Okabe and Ito.
    """

    name: str
    words: str
    theta: float
    coupled: bool
    make: Callable[..., Any]
    style: dict
    implicit: bool = True
    order: int = 1
    startup: int = 0


def _class(module, name, *parameters):
    """Maker of a class of a module here, with some parameters between problem and solvers."""
    def make(problem, solvers, controls):
        kind = getattr(import_module(f".{module}", __package__), name)
        return kind(problem, *parameters, solvers)

    return make


def _geometric(theta):
    def make(problem, solvers, controls):
        from .coupled import Coupled
        from .geometric import Geometric

        membranes = problem.membranes
        # With linear laws and no projector there is nothing to average, and only Crank-Nicolson
        # iterates on where the markers are.
        if membranes is None or (
            theta == BACKWARD_EULER and membranes.linear and not problem.conserve_area
        ):
            return Coupled(problem, theta, solvers)
        return Geometric(problem, theta, solvers, controls)

    return make


_SCHEMES = (
    Scheme("ep", "explicit forces, then projection", BACKWARD_EULER, False,
           _class("explicit", "Explicit"), dict(color="#777777", marker="x"), implicit=False),
    Scheme("mbe", "modified backward Euler, then projection", BACKWARD_EULER, False,
           _class("modified", "Modified", BACKWARD_EULER), dict(color="#0072B2", marker="o")),
    Scheme("mcn", "modified Crank-Nicolson, then projection", CRANK_NICOLSON, False,
           _class("modified", "Modified", CRANK_NICOLSON), dict(color="#56B4E9", marker="s")),
    Scheme("be", "backward Euler", BACKWARD_EULER, True,
           _class("coupled", "Coupled", BACKWARD_EULER), dict(color="#E69F00", marker="^")),
    Scheme("cn", "Crank-Nicolson", CRANK_NICOLSON, True,
           _class("coupled", "Coupled", CRANK_NICOLSON), dict(color="#D55E00", marker="v"),
           startup=1),
    Scheme("gbe", "backward Euler with the averaged tangent", BACKWARD_EULER, True,
           _geometric(BACKWARD_EULER), dict(color="#009E73", marker="D")),
    Scheme("gcn", "Crank-Nicolson with the averaged tangent", CRANK_NICOLSON, True,
           _geometric(CRANK_NICOLSON), dict(color="#CC79A7", marker="P"), order=2, startup=1),
)

SCHEMES = {scheme.name: scheme for scheme in _SCHEMES}
IMPLICIT = tuple(name for name, scheme in SCHEMES.items() if scheme.implicit)
