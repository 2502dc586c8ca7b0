"""Options for PETSc's solvers: which the user gave, and which of them nothing has read."""

import ctypes
import re

from petsc4py import PETSc

from .petsc_options import SYSTEMS

_PREFIXES = tuple(f"{system}_" for system in SYSTEMS)
# PETSc's errors about what it was told: it cannot do that, an argument is wrong or out of range,
# a type is unknown, a package is missing.
_REFUSALS = 56, 62, 63, 86, 92


def given():
    """Names and texts under the solvers' prefixes, before a solver has added its defaults."""
    return {
        name: text for name, text in PETSc.Options().getAll().items()
        if name.startswith(_PREFIXES)
    }


def refused(words, names):
    """The option whose value PETSc's error quotes, with its value; None if it quotes none.

    Parameters
    ----------
    words : str
        The error, as `errors.ours` has it.
    names : dict of str to str
        Options to choose from, names to texts.
    """
    if words.startswith(tuple(f"PETSc error {code}: " for code in _REFUSALS)):
        for name, text in names.items():
            # PETSc writes -1 as "-1.".
            if text and re.search(rf"(?<![\w.-]){re.escape(text)}(?![\w-]|\.\d)", words):
                return f"-{name} {text}"
            if not text and name.endswith("_type") and words.rstrip().endswith("type"):
                return f"-{name}"
    return None


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
