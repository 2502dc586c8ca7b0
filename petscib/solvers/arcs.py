"""The tube's factorisations shared out among the ranks, to precondition the membrane's force.

Each rank takes an arc of the membrane, a little longer than its share, and factors the tube around
it.  The sum of what the arcs answer is an additive Schwarz preconditioner of 1 + B H B^T (see
`force`): with overlapping arcs it costs a few iterations more than the whole tube.  On one rank the
arc is the whole membrane; so it is on rank 0, the others having none, when the membrane is so stiff
that the energy law asks for more than the iteration can give (see `TubeArcs.correct`).
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..events import phase
from .block import TubeBlock, TubeDirect, tube_blocks
from .condensation import TubeAccess
from .stream import divergence_free_basis
from .tube import Tube

OVERLAP = 16  # markers that an arc has beyond its share, at either end
SHORTEST = 4 * OVERLAP  # share of markers for which another arc is worth while
# Relative change of the membrane's matrix beyond which a factorisation of it is made anew: what a
# stale one costs in iterations would then be more than what it saves.
LARGE_DRIFT = 0.01
# Ratio of the membrane's stiffness to the fluid's beyond which it is not cut; with the default
# spacing and viscosity it is 5e8 for sigma0 = 1e9 and dt = h.  At ten times more, the defect of the
# energy law would pass 1e-6.
STIFFEST = 1e9


def share_markers(count, ranks, whole):
    """For each rank the numbers of the markers of its arc, those of its own share marked.

    With `whole`, the first rank has all.  Returns a list of (markers, own), integers and booleans.
    """
    arcs = 1 if whole else max(1, min(ranks, count // SHORTEST))
    shares = []
    for rank in range(ranks):
        start, stop = (count * (rank + i) // arcs if rank < arcs else 0 for i in (0, 1))
        reach = OVERLAP if 1 < arcs and rank < arcs else 0
        places = np.arange(start - reach, stop + reach)
        shares.append((places % max(count, 1), (start <= places) & (places < stop)))
    return shares


def take_rows(root, markers, own):
    """Rows of C that belong to an arc, on the rank that has C.

    Returns
    -------
    rows : ndarray of int
    own : ndarray of bool
        Whether a row is of the arc's own share.
    csr : (starts, columns, values)
        These rows of C, with columns numbered along the arc.
    """
    starts, columns, values = root.getValuesCSR()
    place = np.full(root.getSize()[1] // 2, -1)
    place[markers] = np.arange(len(markers))
    along = place[columns // 2]
    rows = np.flatnonzero(np.minimum.reduceat(along, starts[:-1]) >= 0)
    widths = np.diff(starts)
    chosen = np.zeros(len(widths), dtype=bool)
    chosen[rows] = True
    chosen = np.repeat(chosen, widths)
    first = along[starts[rows]]
    return rows, own[first], (
        np.concatenate(([0], np.cumsum(widths[rows]))).astype(PETSc.IntType),
        (2 * along + columns % 2)[chosen].astype(PETSc.IntType),
        values[chosen],
    )


class TubeArcs:
    """An arc of the membrane on each rank, with the tube around it.  Collective.

    Parameters
    ----------
    grid : Grid
    fluid : FluidMatrix
    vector : PETSc.Vec
        Any velocity vector.
    prefix : str
        Options prefix of the factorisations.
    layers : int
        Layers of faces in a tube beyond those that the markers see.
    solenoidal : bool
        Whether the velocities are without divergence.
    """

    def __init__(self, grid, fluid, vector, prefix, layers, solenoidal):
        self.grid, self.fluid = grid, fluid
        self.comm = grid.comm.tompi4py()
        self.layers, self.solenoidal = layers, solenoidal
        self.direct = TubeDirect(prefix)
        self._vector = vector
        self._tube = self._access = self._rows = self._root = None
        self._factored = False

    def place(self, tube, block, ratio, changed):
        """Take new positions of the markers.

        Parameters
        ----------
        tube : Tube
            Around all markers, on rank 0.
        block : TubeBlock
            Of that tube, in its present place: on one rank it is the arc's too.
        ratio : float
            Of the membrane's stiffness to the fluid's.
        changed : bool
            Whether the fluid matrix has.
        """
        if changed:
            self._release_rows()
        if self.comm.size > 1:
            parts = None
            if self.comm.rank == 0:
                stencil = tube.stencil
                self._shares = share_markers(
                    len(stencil.positions), self.comm.size, ratio > STIFFEST)
                parts = [stencil.select(markers) for markers, _ in self._shares]
            tube = Tube(self.grid, self.comm.scatter(parts), self.layers)
            block = None
        same = not changed and self._tube is not None and tube.has_faces_of(self._tube)
        self._tube = tube
        if self.comm.allreduce(same, MPI.LAND):
            if block is None and self.direct.block.size:
                self.direct.block.move(tube)
            self.direct.move()
            return
        self._release()
        matrix, self._coupling = tube_blocks(self.fluid.matrix, tube)
        self._access = TubeAccess(self._vector, tube.faces, tube.shell_faces)
        self._weights = self._shares_of_faces()
        if block is None:
            block = TubeBlock(tube)
        block.fluid = matrix
        basis = divergence_free_basis(tube) if self.solenoidal and block.size else None
        self.direct.set_block(block, basis)
        self._factored = False

    def _shares_of_faces(self):
        """One over the number of tubes that a face is in."""
        if self.comm.size == 1:
            return 1.0
        count = self._vector.duplicate()
        count.set(0.0)
        self._access.add_tube(1.0, count)
        shares = 1.0 / self._access.from_tube(count)
        count.destroy()
        return shares

    def set_root(self, root, forces):
        """Take the membrane's stiffness.

        Parameters
        ----------
        root : PETSc.Mat
            C with its factor, on rank 0.
        forces : PETSc.Vec
            Any vector of the membrane's forces, all on rank 0.
        """
        if self.comm.size > 1:
            parts = None
            if self.comm.rank == 0:
                parts = [take_rows(root, *share) for share in self._shares]
            rows, own, csr = self.comm.scatter(parts)
            shape = len(rows), 2 * len(self._tube.stencil.positions)
            if self._root is not None:
                self._root.destroy()
            self._root = root = PETSc.Mat().createAIJ(shape, csr=csr, comm=PETSc.COMM_SELF)
        else:
            rows, own = np.arange(forces.getSize()), np.ones(forces.getSize(), dtype=bool)
        self.direct.block.set(root)
        if self._rows is None:
            self._own = own
            self._part = PETSc.Vec().createSeq(len(rows), comm=PETSc.COMM_SELF)
            index = PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
            self._rows = PETSc.Scatter().create(forces, index, self._part, None)

    def factor(self):
        """Factor, unless there is a factorisation that will do.  Not collective."""
        if not self._factored or self.direct.drift() > LARGE_DRIFT:
            self.direct.factor()
            self._factored = True

    def age(self):
        """Let the next factorisation be made anew."""
        self._factored = False

    def precondition(self, x, y):
        """Set y to the preconditioner times x, vectors of forces."""
        self._rows.scatter(x, self._part)
        with phase("tube solve"):
            self._part.getArray()[:] = self.direct.precondition(
                self._part.getArray(readonly=True))
        y.set(0.0)
        self._add(y)

    def _add(self, vector):
        self._rows.scatter(self._part, vector, PETSc.InsertMode.ADD_VALUES,
                           PETSc.ScatterMode.REVERSE)

    def add_forces(self, rhs, velocity, slope, forces):
        """Add to the membrane's forces what is missing when its surroundings move as given.

        Parameters
        ----------
        rhs : PETSc.Vec
            Of the momentum equations, less the forces.
        velocity : PETSc.Vec
            Is read around the tube.
        slope : PETSc.Vec or None
            Part of the right-hand side that a pressure balances there.
        forces : PETSc.Vec
        """
        access, (outside, inside) = self._access, self._coupling.createVecs()
        outside.getArray()[:] = access.from_shell(velocity)
        self._coupling.mult(outside, inside)
        rest = access.from_tube(rhs) - inside.getArray(readonly=True)
        if slope is not None:
            rest -= access.from_tube(slope)
        self._rows.scatter(forces, self._part)
        known = self._part.getArray(readonly=True).copy()
        with phase("tube solve"):
            self._part.getArray()[:] = np.where(self._own, self.direct.force(rest, known), 0.0)
        self._add(forces)

    def correct(self, defect, velocity):
        """Change the velocities in the tube such that B u - f grows by a small defect.

        Exactly so with one arc just factored; with several, the more nearly the farther from their
        ends; with an older factorisation, but for a part as small as LARGE_DRIFT.  The change is
        without divergence in the tubes only, not in the cells around them.

        Parameters
        ----------
        defect : PETSc.Vec
            Of forces; on return the change of f.
        velocity : PETSc.Vec
        """
        self._rows.scatter(defect, self._part)
        with phase("tube solve"):
            force, shift = self.direct.correction(self._part.getArray(readonly=True))
        self._part.getArray()[:] = np.where(self._own, force, 0.0)
        defect.set(0.0)
        self._add(defect)
        self._access.add_tube(self._weights * shift, velocity)

    def _release(self):
        if self._access is not None:
            self._access.destroy()
            self._coupling.destroy()

    def _release_rows(self):
        if self._rows is not None:
            self._rows.destroy()
            self._part.destroy()
            self._rows = None

    def destroy(self):
        """Free factors, scatters and vectors.  Collective."""
        self._release()
        self._release_rows()
        self.direct.destroy()
