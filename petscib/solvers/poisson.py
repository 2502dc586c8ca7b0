"""Neumann problem for the pressure increment."""

from . import krylov

DEFAULTS = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-8,
    "ksp_max_it": 500,
    "pc_type": "gamg",
    # The coarsest matrix is singular too; LU would make the preconditioner indefinite.
    "mg_coarse_sub_pc_type": "svd",
}


class PoissonSolver:
    """Solves Laplacian(phi) = f with zero normal derivative, phi of zero mean.

    The matrix is singular; the constants are its null space, and f is projected.

    Parameters
    ----------
    operators : Operators
    prefix : str
        Options prefix.
    defaults : dict, optional
        In place of CG with GAMG.
    """

    def __init__(self, operators, prefix="poisson_", defaults=DEFAULTS):
        self.matrix = operators.pressure_laplacian
        self.matrix.setAttr("grid", operators.grid)  # for PoissonTransform
        self.null_space = self.matrix.getNullSpace()
        self.ksp = krylov.create(self.matrix, prefix, defaults)
        self._rhs = self.matrix.createVecLeft()
        self._residual = self._rhs.duplicate()

    def solve(self, source, solution):
        """Solve for `solution` (first guess on entry).  Collective.

        Returns
        -------
        int
            Iterations.
        """
        source.copy(self._rhs)
        self._rhs.scale(-1)  # the assembled matrix is minus the Laplacian
        self.null_space.remove(self._rhs)
        if self.ksp.getInitialGuessNonzero():
            self._drop_bad_guess(solution)
        self.ksp.solve(self._rhs, solution)
        krylov.check(
            self.ksp, "pressure Poisson", "try -poisson_ksp_max_it, -poisson_pc_type or -fft"
        )
        self.null_space.remove(solution)
        return self.ksp.getIterationNumber()

    def _drop_bad_guess(self, solution):
        """Start from zero where that is nearer.

        After a long step the last pressure can be many orders too large, which PETSc would take
        for divergence before the first iteration.
        """
        self.matrix.mult(solution, self._residual)
        self._residual.aypx(-1, self._rhs)
        if self._residual.norm() > self._rhs.norm():
            solution.set(0.0)

    def destroy(self):
        """Free the solver.  Collective."""
        self.ksp.destroy()
        self._rhs.destroy()
        self._residual.destroy()
