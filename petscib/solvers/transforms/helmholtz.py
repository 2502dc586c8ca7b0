"""Fast direct solver of the fluid's momentum system, a - b Laplacian on the velocity."""

from .bases import given_places, velocity_fields
from .diagonal import DiagonalSolver
from .windows import HelmholtzWindow


class HelmholtzTransform:
    """The inverse of A0 = a - b Laplacian, the Laplacian that of `Operators`.  Collective.

    Faces on walls are coupled to no others: their equation is a x = r.

    Parameters
    ----------
    grid : Grid
    """

    def __init__(self, grid):
        self.grid = grid
        self.coefficients = None
        fields, vector = velocity_fields(grid), grid.velocity_vector()
        self._solver = DiagonalSolver(grid, fields, vector)
        self._walls = given_places(fields, vector)
        vector.destroy()

    def set_coefficients(self, a, b):
        """Set a > 0 (density/time) and b > 0 (viscosity)."""
        if (a, b) != self.coefficients:
            self.coefficients = a, b
            self._solver.set_operator(a, b)

    def solve(self, rhs, velocity):
        """Set velocity = A0^{-1} rhs.  They may be the same velocity vector."""
        on_walls = rhs.getArray(readonly=True)[self._walls]
        self._solver.solve(rhs, velocity)
        velocity.getArray()[self._walls] = on_walls / self.coefficients[0]

    def window(self, faces):
        """R A0^{-1} R^T with the present coefficients (see `HelmholtzWindow`).

        Parameters
        ----------
        faces : list of (ndarray, ndarray)
            Rows and columns of the faces of u and of v, on rank 0 (empty elsewhere); on no wall.
        """
        return HelmholtzWindow(self.grid, *self.coefficients, faces)

    def destroy(self):
        """Free vectors and scatters.  Collective."""
        self._solver.destroy()
