"""The direct factorisations that this PETSc has, named as in ``-pc_factor_mat_solver_type``."""

from petsc4py import PETSc

from ..errors import InputError

SERIAL = {"cholesky": "cholmod", "lu": "umfpack"}
PARALLEL = "mumps", "superlu_dist"
# Percent of workspace beyond MUMPS's estimate, which saddle points and long time steps exceed: 20
# fail on 12 x 10 cells, and at sigma0 = 1e13.
MUMPS_DEFAULTS = {"mat_mumps_icntl_14": 100}


def serial(kind):
    """Package for a sequential matrix.  Not collective.

    Parameters
    ----------
    kind : {"cholesky", "lu"}
    """
    package = SERIAL[kind]
    # Up to 3.18 all packages of SuiteSparse went by its name.
    return package if _has(package) or _has("suitesparse") else "petsc"


def parallel():
    """Package for a matrix on several ranks, for Cholesky and LU.  Not collective.

    Raises
    ------
    InputError
        This PETSc has none; so on all ranks.
    """
    for package in PARALLEL:
        if _has(package):
            return package
    raise InputError(
        "this PETSc has no direct solver for several ranks, neither MUMPS nor SuperLU_DIST; "
        "needed: one of them, or a run on one rank"
    )


def _has(package):
    return PETSc.Sys.hasExternalPackage(package)


def defaults(kind, comm):
    """Options that choose the best factorisation for a matrix on a communicator.

    Parameters
    ----------
    kind : {"cholesky", "lu"}
    comm : PETSc.Comm

    Raises
    ------
    InputError
        As `parallel`.
    """
    package = serial(kind) if comm.size == 1 else parallel()
    return {"pc_type": kind, "pc_factor_mat_solver_type": package, **MUMPS_DEFAULTS}
