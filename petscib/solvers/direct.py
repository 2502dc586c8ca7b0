"""Which direct solver this PETSc offers."""

from petsc4py import PETSc

from ..errors import InputError


# Percent of workspace beyond MUMPS's estimate, which saddle points and long time steps exceed: 20
# fail on 12 x 10 cells, 30 at sigma0 = 1e13.
MUMPS_DEFAULTS = {"mat_mumps_icntl_14": 100}


def direct_defaults(kind, comm):
    """Options that choose the best factorisation that this PETSc has.

    Parameters
    ----------
    kind : str
        "cholesky" or "lu".
    comm : PETSc.Comm
        Of the matrix.

    Raises
    ------
    InputError
        On several ranks, when there is no parallel one.
    """
    def choose(package, **more):
        return {"pc_type": kind, "pc_factor_mat_solver_type": package, **more}

    if comm.size == 1 and kind == "cholesky" and any(
        map(PETSc.Sys.hasExternalPackage, ("cholmod", "suitesparse"))  # by PETSc's version
    ):
        return choose("cholmod")
    if PETSc.Sys.hasExternalPackage("mumps"):
        return choose("mumps", **MUMPS_DEFAULTS)
    if comm.size == 1:
        return choose("petsc")
    if kind == "lu" and PETSc.Sys.hasExternalPackage("superlu_dist"):
        return choose("superlu_dist")
    raise InputError(
        "-kink_correction false: this PETSc has no parallel direct solver (MUMPS); allowed: one "
        "rank, or -kink_correction true"
    )
