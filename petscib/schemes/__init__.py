"""Time stepping schemes, by name."""

from .registry import IMPLICIT, SCHEMES, Scheme

__all__ = ["IMPLICIT", "SCHEMES", "Controls", "Scheme", "Solvers", "create"]


def __getattr__(name):
    """What needs PETSc is loaded only when it is asked for."""
    if name in __all__:
        from . import making

        return getattr(making, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
