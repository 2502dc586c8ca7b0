"""Static condensation: the tube's unknowns solved exactly, Krylov iterations on the others.

Cut the symmetric system K x = b into the tube t and the rest e.  With

    S = K_ee - K_et K_tt^{-1} K_te,    S x_e = b_e - K_et K_tt^{-1} b_t,
    x_t = K_tt^{-1} (b_t - K_te x_e),

all that is stiff is in K_tt, which a direct solver factors on rank 0, where the markers live.
Outside K_tt, K is the constant fluid operator K0; a solver for K0 on the whole grid therefore
preconditions S well, whatever the stiffness.  This is the iteration of block elimination with
an exact tube block as preconditioner, at one tube solve an iteration instead of two and without
residuals in which the stiffness magnifies round-off.

Vectors keep the length of the whole system.  The condensed operator neither reads nor writes
tube entries, so a preconditioner may leave anything there.
"""

import numpy as np
from petsc4py import PETSc

from ..events import phase


class TubeAccess:
    """Reads and writes the entries of distributed vectors in a tube and its shell.

    Parameters
    ----------
    vector : PETSc.Vec
        Any vector of the system's layout.
    tube, shell : ndarray of int
        PETSc numbers of the tube's unknowns and of others around it, where arrays of their values
        live: on rank 0, unless stated otherwise, and empty elsewhere.
    """

    def __init__(self, vector, tube, shell=()):
        self.count = len(tube)
        numbers = np.concatenate((tube, shell)).astype(PETSc.IntType)
        self._local = PETSc.Vec().createSeq(len(numbers), comm=PETSc.COMM_SELF)
        index = PETSc.IS().createGeneral(numbers, comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(vector, index, self._local, None)

    def _gather(self, vector):
        self._scatter.scatter(vector, self._local, PETSc.InsertMode.INSERT_VALUES)
        return self._local.getArray()

    def _return(self, vector):
        self._scatter.scatter(
            self._local, vector, PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.REVERSE
        )

    def from_tube(self, vector):
        """Entries of `vector` in the tube as a new array.  Collective."""
        return self._gather(vector)[: self.count].copy()

    def from_shell(self, vector):
        """Entries of `vector` in the shell as a new array.  Collective."""
        return self._gather(vector)[self.count :].copy()

    def set_tube(self, values, vector):
        """Set the tube's entries of `vector` from an array.  Collective."""
        self._gather(vector)[: self.count] = values
        self._return(vector)

    def add_tube(self, values, vector):
        """Add an array over the tube to the entries of `vector`.  Collective."""
        local = self._local.getArray()
        local[: self.count] = values
        local[self.count :] = 0.0
        self._scatter.scatter(
            self._local, vector, PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE
        )

    def destroy(self):
        """Free scatter and work vector.  Collective."""
        self._scatter.destroy()
        self._local.destroy()


class Condensation(TubeAccess):
    """The condensed operator S, its right-hand side and the recovery.

    Parameters
    ----------
    multiply : callable
        Takes vectors x, y and sets y = K0 x, the fluid operator.  Collective.
    vector, tube, shell
        As for `TubeAccess`; the shell has the unknowns that K couples to the tube.
    couplings : list of PETSc.Mat
        K_ts on rank 0 (sequential), in column blocks in the order of `shell`.
    solve_tube : callable
        Takes the array r_t on rank 0 and returns K_tt^{-1} r_t, at least those of its entries
        that K couples to the rest: the first ones, as many as the couplings have rows.
    complete_tube : callable, optional
        The same with all entries; `solve_tube` if not given.
    """

    def __init__(
        self, multiply, vector, tube, shell, couplings, solve_tube, complete_tube=None
    ):
        super().__init__(vector, tube, shell)
        self.multiply = multiply
        self._couplings = [(matrix, *matrix.createVecs()) for matrix in couplings]
        self.solve_tube = solve_tube
        self.complete_tube = complete_tube or solve_tube
        self._vector = vector
        self._work = self._mine = None

    def _prepare_products(self):
        """Find the positions of tube entries in this rank's part of a vector."""
        self._work = self._vector.duplicate()
        self._work.set(0.0)
        self._local.getArray()[: self.count] = 1.0
        self._local.getArray()[self.count :] = 0.0
        self._return(self._work)
        self._mine = np.flatnonzero(self._work.getArray(readonly=True))

    def _times_shell(self, values):
        """K_ts times an array over the shell."""
        result = np.zeros(self.count)
        start = 0
        for matrix, outside, inside in self._couplings:
            stop = start + outside.getSize()
            outside.getArray()[:] = values[start:stop]
            matrix.mult(outside, inside)
            result[: inside.getSize()] += inside.getArray(readonly=True)
            start = stop
        return result

    def _times_tube(self, values):
        """K_st times an array over the tube."""
        parts = [np.empty(0)]
        for matrix, outside, inside in self._couplings:
            inside.getArray()[:] = values[: inside.getSize()]
            matrix.multTranspose(inside, outside)
            parts.append(outside.getArray(readonly=True))
        return np.concatenate(parts)

    def mult(self, x, y):
        """y = S x, with zeros in the tube.  Collective."""
        if self._work is None:
            self._prepare_products()
        local = self._gather(x)
        with phase("tube solve"):
            local[: self.count] = -self.solve_tube(self._times_shell(local[self.count :]))
        x.copy(self._work)
        self._return(self._work)
        self.multiply(self._work, y)
        y.getArray()[self._mine] = 0.0

    def condense(self, rhs, condensed):
        """Set condensed = b_e - K_et K_tt^{-1} b_t, with zeros in the tube.  Collective."""
        local = self._gather(rhs)
        with phase("tube solve"):
            inner = self.solve_tube(local[: self.count])
        local[: self.count] = 0.0
        local[self.count :] -= self._times_tube(inner)
        rhs.copy(condensed)
        self._return(condensed)

    def recover(self, rhs, solution):
        """Set the tube's entries of `solution` from the others.  Collective."""
        rest = self.from_tube(rhs) - self._times_shell(self.from_shell(solution))
        with phase("tube solve"):
            self._local.getArray()[: self.count] = self.complete_tube(rest)
        self._return(solution)

    def destroy(self):
        """Free scatter and work vectors.  Collective."""
        super().destroy()
        if self._work is not None:
            self._work.destroy()
