"""The tube: the unknowns near the membrane, and a preconditioner that solves them exactly.

The implicit membrane force is stiff but touches only faces within the kernel's reach of a
marker.  These faces and two more layers form the tube; its block of the matrix is factored on
rank 0, where the markers live.  The Schur complement on the other unknowns differs little from
that of the constant fluid operator, and is preconditioned by a solver for the fluid operator
alone, restricted to them.
"""

import numpy as np
from petsc4py import PETSc

from . import krylov

LAYERS = 2


def dilate(mask):
    """Add the neighbours in the four directions."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    grown[:, 1:] |= mask[:, :-1]
    grown[:, :-1] |= mask[:, 1:]
    return grown


class Tube:
    """The faces near the markers of a stencil, and the shell of faces next to them.

    Lives on rank 0; elsewhere it is empty.  Not collective.

    Parameters
    ----------
    grid : Grid
    stencil : Stencil
    layers : int
        Layers of neighbours added to the faces that the markers see.

    Attributes
    ----------
    origin : (int, int)
        First cell row and column of the window that holds the tube.
    u, v : ndarray of bool
        Tube faces on the window.
    faces, shell : ndarray of int
        PETSc numbers of the tube's faces, and of the faces outside that touch it.
    """

    def __init__(self, grid, stencil, layers=LAYERS):
        self.stencil = stencil
        u_rows, u_columns, _ = stencil.u
        v_rows, v_columns, _ = stencil.v
        if not len(u_rows):
            self.faces = self.shell = np.empty(0, dtype=PETSc.IntType)
            self.u = self.v = np.empty((0, 0), dtype=bool)
            self.origin = (0, 0)
            return
        margin = layers + 1
        top = max(min(u_rows.min(), v_rows.min()) - margin, 0)
        left = max(min(u_columns.min(), v_columns.min()) - margin, 0)
        bottom = min(max(u_rows.max() + 1, v_rows.max()) + margin, grid.n)
        right = min(max(u_columns.max(), v_columns.max() + 1) + margin, grid.m)
        self.origin = (top, left)
        self.u = np.zeros((bottom - top, right - left + 1), dtype=bool)
        self.v = np.zeros((bottom - top + 1, right - left), dtype=bool)
        self.u[u_rows - top, u_columns - left] = True
        self.v[v_rows - top, v_columns - left] = True
        u_walls = np.isin(np.arange(left, right + 1), (0, grid.m))
        v_walls = np.isin(np.arange(top, bottom + 1), (0, grid.n))

        def grow():
            u, v = dilate(self.u), dilate(self.v)
            u[:, u_walls] = False
            v[v_walls, :] = False
            return u, v

        for _ in range(layers):
            self.u, self.v = grow()
        u_shell, v_shell = grow()
        u_index = grid.u_index[top:bottom, left : right + 1]
        v_index = grid.v_index[top : bottom + 1, left:right]
        self.faces = np.concatenate((u_index[self.u], v_index[self.v]))
        self.shell = np.concatenate((u_index[u_shell & ~self.u], v_index[v_shell & ~self.v]))

    def interpolation(self):
        """Interpolation matrix of the stencil with the tube's faces as columns (sequential)."""
        count = np.count_nonzero(self.u)
        u = np.full(self.u.shape, -1, dtype=PETSc.IntType)
        v = np.full(self.v.shape, -1, dtype=PETSc.IntType)
        u[self.u] = np.arange(count)
        v[self.v] = count + np.arange(len(self.faces) - count)
        markers = len(self.stencil.u[0])
        return PETSc.Mat().createAIJ(
            (2 * markers, len(self.faces)),
            csr=self.stencil.csr(u, v, self.origin),
            comm=PETSc.COMM_SELF,
        )


def direct_solver():
    """Name of the best sparse Cholesky package that this PETSc has."""
    for package, solver in (("suitesparse", "cholmod"), ("mumps", "mumps")):
        if PETSc.Sys.hasExternalPackage(package):
            return solver
    return "petsc"


class BlockElimination:
    """z = P^{-1} r for a symmetric matrix [[K_tt, K_ts], [K_ts^T, ...]] cut into tube and rest.

    P has the exact tube block and couplings, and an approximate Schur complement: the inverse of
    the latter is an `outer` solver on the whole grid, restricted to the unknowns outside.

    Parameters
    ----------
    vector : PETSc.Vec
        Any vector of the system's layout.
    tube, shell : ndarray of int
        PETSc numbers, on rank 0 (empty elsewhere), of the tube's unknowns and of those outside
        that are coupled to them.
    coupling : PETSc.Mat
        K_ts, sequential, on rank 0.
    solve_tube : callable
        Takes the array r_t on rank 0 and returns K_tt^{-1} r_t.
    solve_outer : callable
        Takes vectors s, z and sets z to the outer solver's answer.  Collective.
    """

    def __init__(self, vector, tube, shell, coupling, solve_tube, solve_outer):
        self.count = len(tube)
        self.coupling = coupling
        self.solve_tube = solve_tube
        self.solve_outer = solve_outer
        numbers = np.concatenate((tube, shell))
        self._local = PETSc.Vec().createSeq(len(numbers), comm=PETSc.COMM_SELF)
        index = PETSc.IS().createGeneral(numbers, comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(vector, index, self._local, None)
        self._rest = vector.duplicate()
        self._tube_part = PETSc.Vec().createSeq(self.count, comm=PETSc.COMM_SELF)
        self._shell_part = PETSc.Vec().createSeq(len(shell), comm=PETSc.COMM_SELF)

    def _gather(self, vector):
        self._scatter.scatter(vector, self._local, PETSc.InsertMode.INSERT_VALUES)
        return self._local.getArray()

    def _return(self, vector):
        self._scatter.scatter(
            self._local,
            vector,
            PETSc.InsertMode.INSERT_VALUES,
            PETSc.ScatterMode.REVERSE,
        )

    def destroy(self):
        """Free the scatter and the work vector.  Collective."""
        self._scatter.destroy()
        self._rest.destroy()

    def apply(self, r, z):
        """Set z = P^{-1} r.  Collective."""
        local = self._gather(r)
        inner = self.solve_tube(local[: self.count])
        self._tube_part.getArray()[:] = inner
        self.coupling.multTranspose(self._tube_part, self._shell_part)
        local[: self.count] = 0
        local[self.count :] -= self._shell_part.getArray(readonly=True)
        r.copy(self._rest)
        self._return(self._rest)

        self.solve_outer(self._rest, z)

        local = self._gather(z)
        self._shell_part.getArray()[:] = local[self.count :]
        self.coupling.mult(self._shell_part, self._tube_part)
        local[: self.count] = inner - self.solve_tube(self._tube_part.getArray(readonly=True))
        self._return(z)


class TubeCholesky:
    """Direct solver for the tube's block of the momentum matrix, on rank 0.

    Parameters
    ----------
    prefix : str
        Options prefix.
    """

    def __init__(self, prefix):
        krylov.set_defaults(
            prefix,
            {
                "ksp_type": "preonly",
                "pc_type": "cholesky",
                "pc_factor_mat_solver_type": direct_solver(),
            },
        )
        self.prefix = prefix
        self.ksp = None

    def factor(self, matrix):
        """Factor a new matrix (sequential)."""
        if not matrix.getSize()[0]:
            return
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        self.ksp = PETSc.KSP().create(comm=PETSc.COMM_SELF)
        self.ksp.setOptionsPrefix(self.prefix)
        self.ksp.setOperators(matrix)
        self.ksp.setFromOptions()
        self.ksp.setUp()
        self._rhs, self._solution = matrix.createVecs()

    def solve(self, rhs):
        """Answer as a new array; an empty right-hand side (other ranks) gives an empty one."""
        if not len(rhs):
            return np.empty(0)
        self._rhs.getArray()[:] = rhs
        self.ksp.solve(self._rhs, self._solution)
        return self._solution.getArray(readonly=True).copy()


class TubeSchur:
    """PETSc python PC: block elimination of the tube for the momentum system.

    Its inner solvers have the option prefixes <prefix>tube_ (on rank 0) and <prefix>outer_ (the
    fluid matrix on the whole grid).

    Parameters
    ----------
    operator : MomentumOperator
    grid : Grid
    prefix : str
    """

    def __init__(self, operator, grid, prefix):
        self.operator = operator
        self.grid = grid
        self.cholesky = TubeCholesky(prefix + "tube_")
        defaults = {"ksp_type": "preonly", "pc_type": "gamg"}
        self.outer = krylov.create(operator.fluid.matrix, prefix + "outer_", defaults)
        self.elimination = None

    def setUp(self, pc):
        """Cut out and factor the tube for the operator's present state.  Collective."""
        force = self.operator.force
        fluid = self.operator.fluid.matrix
        tube = Tube(self.grid, force.interpolation.stencil)
        rows = PETSc.IS().createGeneral(tube.faces, comm=PETSc.COMM_SELF)
        shell = PETSc.IS().createGeneral(tube.shell, comm=PETSc.COMM_SELF)
        block, = fluid.createSubMatrices([rows], [rows])
        coupling, = fluid.createSubMatrices([rows], [shell])
        if len(tube.faces):
            product = force.stiffness.matrix().ptap(tube.interpolation())
            product.scale(force.scale)
            # The other way round, the sum would replace the inside of a matrix that PETSc's
            # routine for submatrices has marked as its own, and destroying it would crash.
            product.axpy(1.0, block, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            block = product
        self.cholesky.factor(block)
        if self.elimination is not None:
            self.elimination.destroy()
        self.elimination = BlockElimination(
            self.outer.getOperators()[0].createVecLeft(),
            tube.faces,
            tube.shell,
            coupling,
            self.cholesky.solve,
            self.outer.solve,
        )

    def apply(self, pc, x, y):
        """y = P^{-1} x."""
        self.elimination.apply(x, y)

    def destroy(self, pc):
        """Free the inner solvers; PETSc calls this.  Collective."""
        self.outer.destroy()
        if self.elimination is not None:
            self.elimination.destroy()

    def view(self, pc, viewer):
        """Show the inner solvers."""
        viewer.printfASCII("  tube Schur preconditioner; solver of the fluid matrix:\n")
        self.outer.view(viewer)
        if self.cholesky.ksp is not None:
            viewer.printfASCII("  solver of the tube, on rank 0:\n")
            self.cholesky.ksp.view()
