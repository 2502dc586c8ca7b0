"""What petscib runs on: the versions, and what must fit together."""

import os
import platform

import h5py
import mpi4py
import numpy as np
import petsc4py
import scipy
from mpi4py import MPI
from petsc4py import PETSc

from . import __version__
from .errors import InputError

# Where launchers say how many ranks they have started: Open MPI, and MPICH and its kin.
_WORLD_SIZES = "OMPI_COMM_WORLD_SIZE", "PMI_SIZE"


def versions():
    """Name to version of petscib and of what it runs on."""
    return {
        "petscib": __version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "petsc4py": petsc4py.__version__,
        "mpi": _mpi(),
        "mpi4py": mpi4py.__version__,
        "h5py": h5py.__version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "python": platform.python_version(),
    }


def _mpi():
    """Name and version of the MPI library."""
    first = MPI.Get_library_version().strip("\0").splitlines()[0].split(",")[0]
    return " ".join(first.split())


def check():
    """Refuse a PETSc or an MPI that petscib cannot run on.

    Raises
    ------
    InputError
        On all ranks.
    """
    if PETSc.ScalarType != np.float64:
        raise InputError(
            f"this PETSc computes with {np.dtype(PETSc.ScalarType).name}; needed: one configured "
            "for real numbers in double precision, which is PETSc's default"
        )
    for name in _WORLD_SIZES:
        started = os.environ.get(name, "")
        if started.isdecimal() and int(started) > 1 and MPI.COMM_WORLD.size == 1:
            raise InputError(
                f"the launcher has started {started} ranks, but each sees itself alone: it "
                f"belongs to another MPI than mpi4py, which uses {_mpi()}"
            )
