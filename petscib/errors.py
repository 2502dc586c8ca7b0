"""The ways a run ends early, each with one line for the user and its own exit status."""


class Error(Exception):
    """What petscib raises: a message of one line, whatever text of the user's it quotes."""

    def __init__(self, message):
        super().__init__("".join(letter if letter.isprintable() else "?" for letter in message))


class InputError(Error):
    """What the user asked for cannot be run: one line, exit status 2."""

    exit_status = 2


class SolveError(Error):
    """A solve failed, or the physics did: one line, exit status 3."""

    exit_status = 3


class WallError(SolveError):
    """The membrane has come to where the box ends; a smaller time step would not help."""


class CrossingError(SolveError):
    """Membranes have crossed: what they enclose means nothing any more."""


class Crash(SolveError):
    """An unforeseen exception, after which the solvers cannot be used any more."""


class OutputError(Error):
    """Results could not be written, as on a full disk: one line, exit status 3."""

    exit_status = 3


# PETSc's error codes for an unknown type of a solver, and for a missing matrix package.
_NOT_THERE = 86, 92


def ours(error):
    """The error of ours that an exception amounts to.  Not collective.

    What a Python callback of PETSc raises arrives inside an error of PETSc's since 3.19, as its
    cause.  Only texts are taken over: the exception holds on to PETSc's objects, which must not
    outlive PETSc.
    """
    while _is_petsc(error) and (error.__cause__ or error.__context__):
        error = error.__cause__ or error.__context__
    if isinstance(error, Error):
        return type(error)(str(error))
    if _is_petsc(error):
        # Its text is the stack of C functions, then what is wrong; each line begins "[rank] ".
        words = str(error).splitlines()[-1].rpartition("] ")[2]
        text = f"PETSc error {error.ierr}: {words}"
        if error.ierr in _NOT_THERE:
            return InputError(text)
    else:
        text = " ".join(f"{type(error).__name__}: {error}".split())
    return Crash(text)


def _is_petsc(error):
    return hasattr(error, "ierr")


def shortened(text, longest=60):
    """Text of the user's, short enough to be quoted in a message."""
    return text if len(text) <= longest else text[:longest - 3] + "..."
