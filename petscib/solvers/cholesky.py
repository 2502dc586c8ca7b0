"""Sparse symmetric factorisation of a sequential matrix."""

import numpy as np
from petsc4py import PETSc

from . import krylov

# Stiff membranes make indefinite matrices, for which CHOLMOD has only its LDL^T.
CHOLMOD_DEFAULTS = {"mat_cholmod_factor": "simplicial"}


def direct_solver():
    """Name of the best sparse Cholesky package that this PETSc has."""
    for package, solver in (("suitesparse", "cholmod"), ("mumps", "mumps")):
        if PETSc.Sys.hasExternalPackage(package):
            return solver
    return "petsc"


class Cholesky:
    """Direct solver of a sequential symmetric matrix, positive definite or quasidefinite.

    Not collective.  On ranks where the matrix is empty, so are right-hand sides and answers.

    Parameters
    ----------
    prefix : str
        Options prefix.
    """

    def __init__(self, prefix):
        self.prefix = prefix
        self.ksp = None
        krylov.set_defaults(
            prefix,
            {
                "ksp_type": "preonly",
                "pc_type": "cholesky",
                "pc_factor_mat_solver_type": direct_solver(),
                **CHOLMOD_DEFAULTS,
            },
        )

    def factor(self, matrix):
        """Factor; the matrix last given, changed in value, keeps its symbolic factorisation."""
        if not matrix.getSize()[0]:
            return
        if self.ksp is None:
            self.ksp = PETSc.KSP().create(comm=PETSc.COMM_SELF)
            self.ksp.setOptionsPrefix(self.prefix)
            self.ksp.setFromOptions()
        elif matrix.getSize()[0] != self._rhs.getSize():
            self.ksp.reset()
        if self.ksp.getPC().getFactorSolverType() == "petsc" and matrix.getType() != "seqaij":
            matrix = matrix.convert("seqaij", PETSc.Mat())  # for which PETSc has orderings
        self.ksp.setOperators(matrix)
        self.ksp.setUp()
        self._solution, self._rhs = matrix.createVecs()

    def solve(self, rhs):
        """Answer as a new array."""
        if not len(rhs):
            return np.empty(0)
        self._rhs.getArray()[:] = rhs
        self.ksp.solve(self._rhs, self._solution)
        return self._solution.getArray(readonly=True).copy()

    def destroy(self):
        """Free the factor."""
        if self.ksp is not None:
            self.ksp.destroy()
            self.ksp = None
