"""The implicit system without the kink correction, assembled: the paper's literal method.

There the stiffness that the fluid sees has no bound, and only a factorisation of the whole matrix,
anew for each configuration of the membrane, preconditions at every stiffness.  It is for the
paper's tables and for comparison.  The area projector, of low rank, is left to the iteration.
"""

import numpy as np
from petsc4py import PETSc

from . import direct, krylov

SMALL = 1e-9  # times the scale of the pressure's equations: two to three outer iterations


def assembled(fluid, interval, operators):
    """A + theta dt J^T C^T C J / (dx dy) as a parallel sparse matrix.  Collective.

    With the coupled system [[that, s G], [s G^T, 0]], in the order of `LiteralPC`.
    """
    rates = operators.rates
    product = (rates.T @ rates).tocsr()
    product.sort_indices()
    comm = fluid.grid.comm
    stiffness = PETSc.Mat().createAIJ(
        ((product.shape[0], PETSc.DETERMINE),) * 2,
        csr=(product.indptr, product.indices, interval / fluid.grid.cell_area * product.data),
        comm=comm,
    )
    whole = stiffness.ptap(operators.interpolation.matrix)
    fluid.add_to(whole)
    stiffness.destroy()
    if fluid.symmetric:
        whole.setOption(PETSc.Mat.Option.SPD, True)
        return whole
    gradient = fluid.operators.gradient.copy()
    gradient.scale(fluid.scale)
    divergence = PETSc.Mat()
    gradient.transpose(divergence)
    sizes = (fluid.grid.pressure_sizes,) * 2
    corner = PETSc.Mat().createAIJ(sizes, nnz=(1, 0), comm=comm)
    corner.setUp()
    corner.assemble()
    corner.shift(-SMALL * fluid.scale / np.sqrt(fluid.grid.cell_area))
    nest = PETSc.Mat().createNest([[whole, gradient], [divergence, corner]], comm=comm)
    saddle = nest.convert("aij", PETSc.Mat())
    for part in (nest, whole, gradient, divergence, corner):
        part.destroy()
    return saddle


class LiteralPC:
    """PETSc python PC: the assembled coupled matrix, factored.  Collective.

    Parameters
    ----------
    fluid : Stokes
    """

    def __init__(self, fluid):
        prefix, comm = fluid.prefix + "direct_", fluid.grid.comm
        krylov.set_defaults(
            prefix, {"ksp_type": "preonly", **direct.defaults("lu", comm)})
        self.ksp = PETSc.KSP().create(comm=comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setFromOptions()
        self._rhs = self._answer = None

    def factor(self, matrix):
        """Factor the matrix of `assembled`."""
        if self._rhs is None:
            self._answer, self._rhs = matrix.createVecs()
        self.ksp.setOperators(matrix)
        self.ksp.setUp()

    def apply(self, pc, x, y):
        """y = the factor's inverse times x; on each rank, blocks lie one after the other."""
        rhs, first = self._rhs.getArray(), 0
        for block in krylov.blocks_of(x):
            values = block.getArray(readonly=True)
            rhs[first : first + len(values)] = values
            first += len(values)
        krylov.solve(self.ksp, self._rhs, self._answer, "direct",
                     f"try another -{self.ksp.getOptionsPrefix()}pc_factor_mat_solver_type")
        answer, first = self._answer.getArray(readonly=True), 0
        for block in krylov.blocks_of(y):
            values = block.getArray()
            values[:] = answer[first : first + len(values)]
            first += len(values)

    def view(self, pc, viewer):
        """Show the direct solver."""
        self.ksp.view(viewer)

    def destroy(self, pc=None):
        """Free the factor; PETSc calls this too.  Collective."""
        if pc is None:
            for part in (self.ksp, self._rhs, self._answer):
                if part is not None:
                    part.destroy()
