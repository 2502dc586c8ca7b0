"""Vesicles and elastic membranes in viscous flow by energy stable immersed boundary methods.

As a library: docs/library.md.
"""

from importlib import import_module

from .output import console

console.replace_missing()  # before anything opens a file

__version__ = "0.2.0"

# Public name: its module, loaded when it is asked for, since petscib must not start MPI before.
_PUBLIC = {
    "Simulation": "library", "Scene": "scenes", "Interrupt": "interrupt",
    "Error": "errors", "InputError": "errors", "SolveError": "errors", "OutputError": "errors",
}
__all__ = [*_PUBLIC]


def __getattr__(name):
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_PUBLIC[name]}", __name__), name)


def __dir__():
    return sorted([*globals(), *_PUBLIC])
