"""Which direct solver this PETSc offers."""

from petsc4py import PETSc

from ..errors import InputError


def direct_defaults(kind, comm):
    """Options of a factorisation, `kind` "cholesky" or "lu", on a communicator."""
    if comm.size == 1 and kind == "cholesky":
        for package in ("cholmod", "suitesparse"):
            if PETSc.Sys.hasExternalPackage(package):
                return {"pc_type": kind, "pc_factor_mat_solver_type": "cholmod"}
    for package in ("mumps",) if comm.size == 1 or kind == "cholesky" else ("mumps", "superlu_dist"):
        if PETSc.Sys.hasExternalPackage(package):
            return {"pc_type": kind, "pc_factor_mat_solver_type": package}
    if comm.size == 1:
        return {"pc_type": kind, "pc_factor_mat_solver_type": "petsc"}
    raise InputError("no parallel direct solver")
