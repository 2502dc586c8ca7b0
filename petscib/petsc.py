"""PETSc's start, of which a user sees one line when it fails."""

import os
import sys
import tempfile
import time
from contextlib import contextmanager

from .errors import InputError, ours

PATIENCE = 5.0  # seconds in which rank 0, to which alone PETSc says why, ends the job


def start(arguments):
    """Start MPI and PETSc.  Collective.

    Parameters
    ----------
    arguments : list of str
        Command line without the program's name.

    Raises
    ------
    InputError
        PETSc cannot read its options.
    """
    import petsc4py
    from mpi4py import MPI  # which PETSc then finds started, even if it fails itself

    failure = None
    with _held_back(2) as words:
        try:
            petsc4py.init([sys.argv[0], *arguments])
        except RuntimeError as error:
            failure = ours(error)
    if failure is not None:
        # Each line begins "[0]PETSC ERROR: ": a frame, the kind of error, what is wrong, advice.
        said = [line.partition("PETSC ERROR: ")[2].strip() for line in words]
        said = [line for line in said if line and not line.startswith("-")]
        why = said[1] if len(said) > 1 else str(failure)
        files = [value for option, value in zip(arguments, arguments[1:])
                 if option.lower().endswith(("-options_file", "-options_file_yaml"))]
        where = f" (given in {', '.join(files)})" if files else ""
        error = InputError(f"PETSc cannot read its options{where}: {why}")
        if MPI.COMM_WORLD.size > 1:  # which may fail as well, or sleep
            if MPI.COMM_WORLD.rank > 0:
                time.sleep(PATIENCE)
            print(f"petscib: {error}", file=sys.stderr, flush=True)
            MPI.COMM_WORLD.Abort(error.exit_status)
        raise error
    sys.stderr.writelines(words)


def started():
    """Whether PETSc has been started in this process."""
    return "petsc4py.PETSc" in sys.modules


def database_of(arguments):
    """The options of some words, names to texts, as PETSc reads them.  PETSc has been started."""
    from petsc4py import PETSc

    options = PETSc.Options().create()
    try:
        options.insertString(" ".join(arguments))
        return options.getAll()
    except PETSc.Error as error:
        raise InputError(f"PETSc cannot read its options: {ours(error)}") from None
    finally:
        options.destroy()


@contextmanager
def _held_back(descriptor):
    """What is written to a file descriptor inside the block, as a list of lines, filled after."""
    words = []
    usual = os.dup(descriptor)
    with tempfile.TemporaryFile("w+", errors="replace") as file:
        os.dup2(file.fileno(), descriptor)
        try:
            yield words
        finally:
            os.dup2(usual, descriptor)
            os.close(usual)
            file.seek(0)
            words += file.readlines()
