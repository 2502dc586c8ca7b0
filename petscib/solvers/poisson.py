"""Neumann problem for the pressure increment."""

from petsc4py import PETSc

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
    transform : PoissonTransform, optional
        Exact solver in place of an iteration.
    """

    def __init__(self, operators, prefix="poisson_", defaults=DEFAULTS, transform=None):
        self.transform = transform
        self._rhs = operators.grid.pressure_vector()
        self.ksp = None
        if transform is None:
            matrix = operators.pressure_laplacian
            self.null_space = matrix.getNullSpace()
            self.ksp = krylov.create(matrix, prefix, defaults)

    def solve(self, source, solution):
        """Solve for `solution` (first guess on entry).  Collective.

        Returns
        -------
        int
            Iterations.
        """
        source.copy(self._rhs)
        self._rhs.scale(-1)  # the assembled matrix is minus the Laplacian
        if self.transform is not None:
            self.transform.solve(self._rhs, solution)
            return 1
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
        for part in (self.ksp, self.transform, self._rhs):
            if part is not None:
                part.destroy()


def poisson_solver(operators, fft, prefix="poisson_", defaults=DEFAULTS):
    """The solver of a run: by transforms, loaded only then, or by an iteration.  Collective.

    A preconditioner that the user has chosen goes before the transforms.
    """
    if not fft or PETSc.Options(prefix).hasName("pc_type"):
        return PoissonSolver(operators, prefix, defaults)
    from .transforms.diagonal import PoissonTransform

    return PoissonSolver(operators, transform=PoissonTransform(operators.grid))
