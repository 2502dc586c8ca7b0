"""Fast direct solver of the pressure's Poisson problem."""

from .bases import pressure_field
from .diagonal import DiagonalSolver


class PoissonTransform:
    """Pseudo-inverse of minus the pressure's Laplacian.  Collective.

    Parameters
    ----------
    grid : Grid
    """

    def __init__(self, grid):
        vector = grid.pressure_vector()
        self._solver = DiagonalSolver(grid, [pressure_field(grid)], vector)
        self._solver.set_operator(0.0, 1.0)
        vector.destroy()

    def solve(self, source, solution):
        """Solve G^T G p = source, p of zero mean; the mean of `source` is left out.

        G^T G is `Operators.pressure_laplacian`.  Both are pressure vectors, and may be the same.
        """
        self._solver.solve(source, solution)

    def destroy(self):
        """Free vectors and scatters.  Collective."""
        self._solver.destroy()
