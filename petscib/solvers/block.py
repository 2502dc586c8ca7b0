"""The tube's block of an implicit system, solved with the membrane's force as an unknown.

With the stiffness W = C^T C and B = (theta dt ds / (dx dy))^{1/2} C J, the momentum matrix is
A = A0 + B^T B.  Instead of A w = r the factorisation solves

    [ -1   B  ] [ f ]   [ g ]
    [ B^T  A0 ] [ w ] = [ r ],    with g = 0: f = B w.

This has few entries, where B^T B joins every face to all others that its markers see; and the
stiffness no longer magnifies round-off, because it is not added to A0.  The matrix is
quasidefinite: in any order its pivots keep their signs, so that L D L^T exists without pivoting.
"""

import numpy as np
from numpy.linalg import norm
from petsc4py import PETSc

from .cholesky import Cholesky

MOST_REFINEMENTS = 4
SMALL_CHANGE = 1e-7  # in a refinement; its square is beyond round-off


def upper_part(matrix):
    """Entries (row, column, value) on and above the diagonal of a sequential matrix."""
    starts, columns, values = matrix.getValuesCSR()
    rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    upper = columns >= rows
    return rows[upper], columns[upper], values[upper]


def tube_blocks(fluid, tube):
    """Blocks of the fluid matrix: a tube's faces among themselves, and with the shell's.

    Collective; each rank gets those of its own tube (sequential).
    """
    faces = PETSc.IS().createGeneral(tube.faces, comm=PETSc.COMM_SELF)
    shell = PETSc.IS().createGeneral(tube.shell_faces, comm=PETSc.COMM_SELF)
    return (
        fluid.createSubMatrices([faces], [faces])[0],
        fluid.createSubMatrices([faces], [shell])[0],
    )


class TubeBlock:
    """B, and A0 if it is wanted, among the faces of a tube.  Not collective.

    Parameters
    ----------
    tube : Tube
    fluid : PETSc.Mat, optional
        A0_tt (sequential).

    Attributes
    ----------
    root : PETSc.Mat
        (theta dt ds / (dx dy))^{1/2} C (sequential).
    positions : ndarray, shape (markers, 2)
        Of the markers, in cells.
    """

    def __init__(self, tube, fluid=None):
        self.size = len(tube.faces)
        self.fluid = fluid
        self.root = self.interpolation = None
        if self.size:
            self.move(tube)
            self._face, self._marker = self.interpolation.createVecs()

    def move(self, tube):
        """Take new positions of the markers in a tube of the same faces."""
        # Left to Python, what is dropped in each pass would pile up until the end of the step.
        if self.interpolation is not None:
            self.interpolation.destroy()
        self.interpolation = tube.interpolation()
        self.positions = tube.stencil.positions

    def set(self, root):
        """Take the membrane's stiffness."""
        if self.size:
            self.root = root
            self._force = root.createVecLeft()

    def interpolate(self, velocity):
        """J w for an array w over the faces: components of markers interleaved."""
        if not self.size:
            return np.empty(0)
        self._face.getArray()[:] = velocity
        self.interpolation.mult(self._face, self._marker)
        return self._marker.getArray(readonly=True).copy()

    def spread_markers(self, values):
        """J^T times an array over the markers' components."""
        if not self.size:
            return np.empty(0)
        self._marker.getArray()[:] = values
        self.interpolation.multTranspose(self._marker, self._face)
        return self._face.getArray(readonly=True).copy()

    def forces_of(self, velocity):
        """B w for an array w over the faces."""
        if not self.size:
            return np.empty(0)
        self.interpolate(velocity)
        self.root.mult(self._marker, self._force)
        return self._force.getArray(readonly=True).copy()

    def spread(self, force):
        """B^T f as an array over the faces."""
        if not self.size:
            return np.empty(0)
        self._force.getArray()[:] = force
        self.root.multTranspose(self._force, self._marker)
        return self.spread_markers(self._marker.getArray(readonly=True))

    def multiply(self, velocity, force):
        """A0 w + B^T f for arrays w over the faces and f."""
        spread = self.spread(force)
        product = self.fluid.createVecLeft()
        self._face.getArray()[:] = velocity
        self.fluid.mult(self._face, product)
        return product.getArray(readonly=True) + spread


class ForceSystem:
    """Direct solver of the system above, for any symmetric matrix in place of A0.

    Lives on one rank; not collective.

    Parameters
    ----------
    prefix : str
        Options prefix of the factorisation.
    """

    def __init__(self, prefix):
        self.cholesky = Cholesky(prefix)
        self._matrix = None

    def set_fluid(self, matrix):
        """Take the matrix in place of A0."""
        self._release()
        rows, columns, self._fluid_values = upper_part(matrix)
        self._fluid_columns = columns
        self._fluid_widths = np.bincount(rows, minlength=matrix.getSize()[0])

    def factor(self, forces):
        """Factor with B = `forces`; only in value if B changed only in value."""
        starts, columns, values = forces.getValuesCSR()
        if self._matrix is not None and not np.array_equal(columns, self._force_columns):
            self._release()
        self._force_columns = columns
        self.count = count = len(starts) - 1
        columns = np.insert(columns + count, starts[:-1], np.arange(count))
        values = np.insert(values, starts[:-1], -1.0)
        widths = np.concatenate((np.diff(starts) + 1, self._fluid_widths))
        matrix = PETSc.Mat().createSBAIJ(
            len(widths),
            1,
            csr=(
                np.concatenate(([0], np.cumsum(widths))).astype(PETSc.IntType),
                np.concatenate((columns, self._fluid_columns + count)).astype(PETSc.IntType),
                np.concatenate((values, self._fluid_values)),
            ),
            comm=PETSc.COMM_SELF,
        )
        if self._matrix is None:
            self._matrix = matrix
            self._answer, self._residual = matrix.createVecs()
        else:
            matrix.copy(self._matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            matrix.destroy()
        self.cholesky.factor(self._matrix)

    def solve(self, force, rest):
        """The pair f, w for right-hand sides g, r, to full accuracy.  New arrays.

        Iterative refinement removes round-off of the factorisation along soft motions, which
        bending and tension hardly resist.  Each step repeats the relative change of the last.
        """
        rhs = np.concatenate((force, rest))
        answer = self.cholesky.solve(rhs)
        for _ in range(MOST_REFINEMENTS):
            self._answer.getArray()[:] = answer
            self._matrix.mult(self._answer, self._residual)
            change = self.cholesky.solve(rhs - self._residual.getArray(readonly=True))
            answer += change
            velocity = answer[self.count :]
            if norm(change[self.count :]) <= SMALL_CHANGE * norm(velocity):
                break
        return answer[: self.count], velocity

    def answer(self, force, rest):
        """The pair f, w for right-hand sides g, r, without refinement.  New arrays."""
        answer = self.cholesky.solve(np.concatenate((force, rest)))
        return answer[: self.count], answer[self.count :]

    def _release(self):
        if self._matrix is not None:
            self._matrix.destroy()
            self._matrix = None

    def destroy(self):
        """Free the factor."""
        self._release()
        self.cholesky.destroy()


class TubeDirect:
    """Direct solver of a tube's block.

    Lives on one rank; not collective.  Where the tube is empty, so are all arrays.

    Parameters
    ----------
    prefix : str
        Options prefix of the factorisation.

    Attributes
    ----------
    block : TubeBlock
    basis : PETSc.Mat or None
        The velocities are sought among the combinations of its columns; None: among all.
    """

    def __init__(self, prefix):
        self.system = ForceSystem(prefix)
        self.block = self.basis = self._projected = self._forces = None

    def set_block(self, block, basis=None):
        """Take a new tube's block."""
        self.block, self.basis = block, basis
        if not block.size:
            return
        if basis is None:
            self.system.set_fluid(block.fluid)
        else:
            self.system.set_fluid(block.fluid.ptap(basis))
            self._psi, self._w = basis.createVecs()
        self.move()

    def move(self):
        """Take the block's new positions of the markers."""
        if not self.block.size:
            return
        for product in (self._projected, self._forces):
            if product is not None:
                product.destroy()
        self._projected = self._forces = None
        if self.basis is not None:
            self._projected = self.block.interpolation.matMult(self.basis)

    def factor(self):
        """Factor for the block's present stiffness."""
        if self.block.size:
            interpolation = self._projected or self.block.interpolation
            self._forces = self.block.root.matMult(interpolation, result=self._forces)
            self.system.factor(self._forces)
            self._factored_for = self._dependencies()

    def _dependencies(self):
        """What the block depends on besides the tube: C in units of its size, and the markers."""
        entries = self.block.root.getValuesCSR()[2]
        return entries / np.abs(entries).max(), self.block.positions

    def drift(self):
        """Largest change of the block since it was factored: in C, or of a marker in cells."""
        if not self.block.size:
            return 0.0
        pairs = zip(self._factored_for, self._dependencies())
        return max(np.abs(new - old).max() for old, new in pairs)

    def _restrict(self, rhs):
        if self.basis is None:
            return rhs
        self._w.getArray()[:] = rhs
        self.basis.multTranspose(self._w, self._psi)
        return self._psi.getArray(readonly=True)

    def _extend(self, values):
        if self.basis is None:
            return values
        self._psi.getArray()[:] = values
        self.basis.mult(self._psi, self._w)
        return self._w.getArray(readonly=True).copy()

    def solve_forces(self, rhs):
        """Forces f = B w and velocities w with A_tt w = rhs, to full accuracy.  New arrays."""
        if not self.block.size:
            return np.empty(0), np.empty(0)
        force, values = self.system.solve(np.zeros(self.system.count), self._restrict(rhs))
        return force, self._extend(values)

    def solve(self, rhs):
        """The velocities w alone."""
        return self.solve_forces(rhs)[1]

    def force(self, rhs, known):
        """What has to be added to forces that are known: an array, without refinement.

        With the sum f, A0_tt w + B^T f = rhs + B^T known for the velocities w, and f = B w.
        """
        if not self.block.size:
            return np.empty(0)
        return self.system.answer(known, self._restrict(rhs))[0]

    def precondition(self, velocity):
        """(1 + B A0_tt^{-1} B^T)^{-1} times the array `velocity`."""
        return -self._excite(velocity)[0] if self.block.size else np.empty(0)

    def correction(self, defect):
        """Changes of f and w, without force on the fluid, by which B w - f grows by `defect`."""
        if not self.block.size:
            return np.empty(0), np.empty(0)
        force, values = self._excite(defect)
        return force, self._extend(values)

    def _excite(self, force):
        size = self.basis.getSize()[1] if self.basis is not None else self.block.size
        return self.system.answer(force, np.zeros(size))

    def destroy(self):
        """Free the factor."""
        self.system.destroy()
