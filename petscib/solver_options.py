"""Options for PETSc's solvers: which the user gave, and which of them nothing has read."""

import ctypes

from petsc4py import PETSc

from .petsc_options import SYSTEMS

_PREFIXES = tuple(f"{system}_" for system in SYSTEMS)


def given():
    """Names and texts under the solvers' prefixes, before a solver has added its defaults."""
    return {
        name: text for name, text in PETSc.Options().getAll().items()
        if name.startswith(_PREFIXES)
    }


def unread(names):
    """Those of the names that PETSc has not read on this rank.  Not collective.

    petsc4py up to 3.18 does not offer the question, hence PETSc's own function is called.
    """
    used = PETSc.Options().used if hasattr(PETSc.Options, "used") else _used
    return [name for name in names if not used(name)]


def _used(name):
    answer = ctypes.c_int(0)
    library = ctypes.CDLL(PETSc.__file__)
    if library.PetscOptionsUsed(None, name.encode(), ctypes.byref(answer)):
        raise RuntimeError("PetscOptionsUsed failed")
    return bool(answer.value)
