"""The tube's block of the momentum matrix, and its direct solution in velocities."""

import numpy as np
from petsc4py import PETSc

from .cholesky import Cholesky

TARGET = 1e-13  # relative error to which solves with the block are refined
MOST_REFINEMENTS = 5


class TubeBlock:
    """A_tt = A0_tt + scale J_t^T W J_t, among the faces of a tube, on rank 0.

    As sigma0 dt grows, round-off in a factorisation of A_tt reaches every velocity, soft motions
    included.  Residuals from this product form do not spread so: what W magnifies stays a
    tension along the membrane.  Iterative refinement with them restores full accuracy.

    Parameters
    ----------
    tube : Tube
    fluid : PETSc.Mat
        A0_tt (sequential).
    """

    def __init__(self, tube, fluid):
        self.size = len(tube.faces)
        self.fluid = fluid
        self.interpolation = tube.interpolation() if self.size else None
        self.stiffness, self.scale = None, 0.0

    def set(self, stiffness, scale):
        """Take a membrane stiffness W and the factor of J^T W J."""
        self.stiffness, self.scale = stiffness, scale

    def multiply(self, velocity):
        """A_tt times an array over the faces."""
        w, result = self.fluid.createVecs()
        w.getArray()[:] = velocity
        self.fluid.mult(w, result)
        seen = self.interpolation.createVecLeft()
        self.interpolation.mult(w, seen)
        force = self.stiffness.apply(seen.getArray(readonly=True).reshape(-1, 2))
        seen.getArray()[:] = self.scale * force.ravel()
        self.interpolation.multTransposeAdd(seen, result, result)
        return result.getArray(readonly=True)

    def refinements(self):
        """How many refinements bring round-off in a factorisation down to the target."""
        fluid = self.fluid.getDiagonal().getArray(readonly=True).max()
        membrane = self.stiffness.membrane
        stiff = self.scale * (
            4 * membrane.sigma0 / membrane.ds**2 + 16 * membrane.bending / membrane.ds**4
        )
        error = np.finfo(float).eps * (1 + stiff / fluid)
        if error >= 0.1:
            return MOST_REFINEMENTS
        return min(max(int(np.ceil(np.log(TARGET) / np.log(error))) - 1, 0), MOST_REFINEMENTS)

    def refine(self, solve, rhs):
        """Answer of the approximate solver `solve` to `rhs`, refined."""
        answer = solve(rhs)
        for _ in range(self.refinements()):
            answer += solve(rhs - self.multiply(answer))
        return answer


class TubeVelocity:
    """Direct solver of A_tt w = r on rank 0.

    Parameters
    ----------
    prefix : str
        Options prefix of the Cholesky factorisation.
    """

    def __init__(self, prefix):
        self.cholesky = Cholesky(prefix)
        self.block = None

    def factor(self, block):
        """Factor a block whose stiffness has been set."""
        self.block = block
        if not block.size:
            return
        matrix = block.stiffness.matrix().ptap(block.interpolation)
        matrix.scale(block.scale)
        # The other way round, the sum would replace the inside of a matrix that PETSc's
        # routine for submatrices has marked as its own, and destroying it would crash.
        matrix.axpy(1.0, block.fluid, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        self.cholesky.factor(matrix)

    def solve(self, rhs):
        """Answer as a new array; empty where the block is."""
        if not self.block.size:
            return np.empty(0)
        return self.block.refine(self.cholesky.solve, rhs)

    def destroy(self):
        """Free the factor."""
        self.cholesky.destroy()
