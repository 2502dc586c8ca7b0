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
        iterations = krylov.solve(
            self.ksp,
            self._rhs,
            solution,
            "pressure Poisson",
            "try -poisson_ksp_max_it, -poisson_pc_type or -fft",
        )
        self.null_space.remove(solution)
        return iterations

    def destroy(self):
        """Free the solver.  Collective."""
        self.ksp.destroy()
        self._rhs.destroy()
