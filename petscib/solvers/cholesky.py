"""Sparse symmetric factorisation of a matrix in marker space, on one rank."""

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix, triu

from . import direct, krylov
from .product import numbered

# Stiff membranes make indefinite matrices, for which CHOLMOD has only its LDL^T.
CHOLMOD_DEFAULTS = {"mat_cholmod_factor": "simplicial"}


def _whole(upper):
    """The symmetric matrix whose upper triangle has these entries, zeros among them kept."""
    numbers = numbered(upper)
    whole = (numbers + triu(numbers, 1).T).tocsr()
    whole.sort_indices()
    values = upper.data[whole.data.astype(int) - 1]
    return csr_matrix((values, whole.indices, whole.indptr), whole.shape)


class Cholesky:
    """Direct solver of a sequential symmetric matrix, positive definite or quasidefinite.

    Not collective.  On ranks where the matrix is empty, so are right-hand sides and solutions.

    Parameters
    ----------
    prefix : str
        Options prefix.

    Attributes
    ----------
    trouble : str
        Why the last solve failed, or empty.
    """

    def __init__(self, prefix):
        self.prefix = prefix
        self.trouble = ""
        self._matrix = None
        krylov.set_defaults(
            prefix,
            {"ksp_type": "preonly", **direct.defaults("cholesky", PETSc.COMM_SELF),
             **CHOLMOD_DEFAULTS},
        )
        # Now, as the defaults may be gone from PETSc's database when the first matrix comes.
        self.ksp = PETSc.KSP().create(comm=PETSc.COMM_SELF)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setFromOptions()

    def factor(self, matrix):
        """Factor; a matrix with the entries of the last one keeps its symbolic factorisation.

        Parameters
        ----------
        matrix : scipy.sparse.csr_matrix
            Its upper triangle, with sorted columns.
        """
        if not matrix.shape[0]:
            return
        if self.ksp.getPC().getFactorSolverType() == "petsc":  # which orders only whole matrices
            matrix = _whole(matrix)
        csr = matrix.indptr, matrix.indices, matrix.data
        if self._matrix is None or not all(
                new is old or np.array_equal(new, old) for new, old in zip(csr, self._places)):
            self._release()
            create = PETSc.Mat().createSBAIJ
            if self.ksp.getPC().getFactorSolverType() == "petsc":
                create = PETSc.Mat().createAIJ
            self._matrix = create(matrix.shape, 1, csr=csr, comm=PETSc.COMM_SELF)
            self._places = csr[:2]
            self._solution, self._rhs = self._matrix.createVecs()
        else:
            self._matrix.setValuesCSR(*csr)
            self._matrix.assemble()
        self.ksp.setOperators(self._matrix)

    def solve(self, rhs):
        """The solution, a new array; NaN where the factorisation failed."""
        if not len(rhs):
            return np.empty(0)
        self._rhs.getArray()[:] = rhs
        self.ksp.solve(self._rhs, self._solution)
        self.trouble = krylov.reason_name(self.ksp) if self.ksp.getConvergedReason() < 0 else ""
        if self.trouble:
            return np.full(len(rhs), np.nan)
        return self._solution.getArray(readonly=True).copy()

    def _release(self):
        if self._matrix is not None:
            self.ksp.reset()
            for part in (self._matrix, self._solution, self._rhs):
                part.destroy()
            self._matrix = None

    def destroy(self):
        """Free the factor."""
        self._release()
        if self.ksp is not None:
            self.ksp.destroy()
            self.ksp = None
