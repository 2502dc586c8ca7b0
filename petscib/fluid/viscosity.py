"""A viscosity that is another inside of membranes.

The indicator I of a membrane's inside has the gradient - N, its normal elements N spread to the
grid as a force is; hence

    Laplacian I = - div F[N],

with I = 0 in a corner cell of the box, clipped to [0, 1].  The viscosity is the harmonic mean

    1 / mu = (1 - I) / mu_o + I / mu_i

at cells; at corners 1 / mu is the mean of four, so that a shear across the grid's lines meets as
much of 1 / mu as a sharp membrane would give it.  Viscous forces are

    mu_min Laplacian u - E^T D (E u + e_walls),    D = weights (mu - mu_min),

with the strain rates e = E u of `strain`.  For velocities without divergence this is div (2 mu e),
as - mu Laplacian and E^T D E with all of mu in D are the same there where mu is constant.  The
matrix is symmetric and definite for any mu.
"""

import numpy as np

from ..coupling.interpolation import Interpolation
from ..membranes.geometry import signed_area
from ..membranes.mobility import AreaProjector
from .strain import Strain


class Viscosity:
    """mu(x) of one configuration of the membranes.  Collective.

    Parameters
    ----------
    operators : Operators
    kernel : Kernel
    curves : Curves
        On rank 0; of no curves elsewhere.
    outer : float
        Viscosity of the fluid around.
    inner : ndarray, shape (V,)
        That inside of each membrane, on all ranks.
    poisson : PoissonSolver
        For the indicator; owned.

    Attributes
    ----------
    least : float
        mu_min.
    cells, faces : PETSc.Vec
        mu at cells, and at faces the mean of the cells beside them.
    stresses : PETSc.Vec
        Stress over strain rate at the places of the strain rates: 2 mu and mu.
    version : int
        Number of calls of `place`, by which solvers know that mu has changed.
    """

    def __init__(self, operators, kernel, curves, outer, inner, poisson):
        self.operators, self.grid = operators, operators.grid
        self.kernel, self.curves, self.poisson = kernel, curves, poisson
        self.outer, self.inner = float(outer), np.asarray(inner, float)
        self.least, self.most = min(outer, *inner), max(outer, *inner)
        self.strain = Strain(operators)
        self._to_strain, self._to_faces = self.strain.averages()
        grid = self.grid
        self.cells, self.faces = grid.pressure_vector(), grid.velocity_vector()
        self._source, self._indicator = grid.pressure_vector(), grid.pressure_vector()
        self._force = grid.velocity_vector()
        self.stresses, self._excess, self._rates = (self.strain.vector() for _ in range(3))
        self.version = 0

    @property
    def at_membranes(self):
        """Viscosity that long waves along each membrane feel, and short ones, shapes (V,).

        Long waves feel the mean of both sides.  Short ones lie within the smoothed layer, where the
        mean is that of 1 / mu.
        """
        return (self.outer + self.inner) / 2, 2 / (1 / self.outer + 1 / self.inner)

    def place(self, markers):
        """Follow the membranes.  Collective.

        Parameters
        ----------
        markers : ndarray, shape (M, 2)

        Raises
        ------
        SolveError
            On all ranks.
        """
        fluidity = np.full(self.cells.getLocalSize(), 1 / self.outer)
        for value in np.unique(self.inner[self.inner != self.outer]):
            indicator = self.indicator(markers, self.inner == value)
            fluidity += (1 / value - 1 / self.outer) * indicator
        # Where membranes come near each other, the sum of their indicators may be above 1.
        self.cells.getArray()[:] = np.clip(fluidity, 1 / self.most, 1 / self.least)
        self._to_strain.mult(self.cells, self.stresses)
        self.stresses.reciprocal()
        self.cells.reciprocal()
        self._to_faces.mult(self.cells, self.faces)
        weights = self.strain.weights
        self.stresses.copy(self._excess)
        self._excess.shift(-self.least)
        self._excess.pointwiseMult(self._excess, weights)
        self.stresses.pointwiseMult(self.stresses, weights)
        self.version += 1

    def indicator(self, markers, which):
        """1 inside of some membranes, 0 outside: this rank's part, in the order of its vectors.

        Parameters
        ----------
        markers : ndarray, shape (M, 2)
        which : ndarray of bool, shape (V,)
        """
        grid, curves, area = self.grid, self.curves, 0.0
        normals = np.zeros((0, 2))
        if curves.count:
            areas = np.where(which, signed_area(markers, curves), 0.0)
            normals = AreaProjector(curves, markers).normal
            normals = normals * curves.spread(np.sign(areas))[:, None]
            area = np.abs(areas).sum()
        interpolation = Interpolation(grid, self.kernel, markers)
        self._force.set(0.0)
        interpolation.spread_add(-normals, self._force)
        interpolation.destroy()
        self.operators.divergence.mult(self._force, self._source)
        self._indicator.set(0.0)
        self.poisson.solve(self._source, self._indicator)
        values = self._indicator.getArray(readonly=True)
        if all(grid.periodic):  # without a place that no membrane reaches; the mean is zero
            a, b, c, d = grid.domain
            zero = -grid.comm.tompi4py().bcast(area) / ((b - a) * (d - c))
        else:
            place = grid.p_index[0, 0] - self._indicator.getOwnershipRange()[0]
            mine = values[place] if 0 <= place < len(values) else 0.0
            zero = grid.comm.tompi4py().allreduce(mine)
        return np.clip(values - zero, 0.0, 1.0)

    def add_force(self, velocity, vector, factor=-1.0):
        """Add a multiple of E^T D E u to a vector.

        Parameters
        ----------
        velocity, vector : PETSc.Vec
        factor : float
            -1 for the viscous force of mu - mu_min with walls at rest, 1 for its part of the
            momentum matrix.
        """
        rates = self._rates
        self.strain.matrix.mult(velocity, rates)
        self._add_stresses(rates, vector, factor)

    def add_wall_force(self, vector):
        """Add what moving walls add to the viscous force of mu - mu_min."""
        if self.strain.walls is not None:
            self.strain.walls.copy(self._rates)
            self._add_stresses(self._rates, vector, -1.0)

    def _add_stresses(self, rates, vector, factor):
        rates.pointwiseMult(rates, self._excess)
        if factor != 1.0:
            rates.scale(factor)
        self.strain.matrix.multTransposeAdd(rates, vector, vector)

    def powers(self, velocity):
        """Dissipation <e, D e> and power of the walls <e_walls, D e>, of mu - mu_min, per cell."""
        strain, rates = self.strain, self._rates
        strain.matrix.mult(velocity, rates)
        if strain.walls is not None:
            rates.axpy(1.0, strain.walls)
        stresses = rates.copy()
        stresses.pointwiseMult(stresses, self._excess)
        dissipation = rates.dot(stresses)
        power = strain.walls.dot(stresses) if strain.walls is not None else 0.0
        stresses.destroy()
        return dissipation, power

    def matrix(self):
        """E^T D E as a new assembled matrix."""
        scaled = self.strain.matrix.copy()
        scaled.diagonalScale(L=self._excess)
        product = self.strain.matrix.transposeMatMult(scaled)
        scaled.destroy()
        return product

    def destroy(self):
        """Free vectors, matrices and solver.  Collective."""
        for part in (self.strain, self._to_strain, self._to_faces, self.cells, self.faces,
                     self._source, self._indicator, self._force, self.stresses, self._excess,
                     self._rates, self.poisson):
            part.destroy()
