"""The tube: the cells and faces near the membrane."""

import numpy as np
from petsc4py import PETSc

LAYERS = 2


def dilate(mask):
    """Add the neighbours in the four directions."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    grown[:, 1:] |= mask[:, :-1]
    grown[:, :-1] |= mask[:, 1:]
    return grown


def _faces_of(cells):
    """Masks of the x-faces and y-faces of the cells in a mask."""
    u = np.zeros((cells.shape[0], cells.shape[1] + 1), dtype=bool)
    v = np.zeros((cells.shape[0] + 1, cells.shape[1]), dtype=bool)
    u[:, :-1] |= cells
    u[:, 1:] |= cells
    v[:-1] |= cells
    v[1:] |= cells
    return u, v


class Tube:
    """The cells around all faces that the markers see, and their faces.

    The implicit membrane force acts within it, so that the equations of the fluid alone couple
    it to the rest of the grid.  Lives where the markers do; elsewhere it is empty.  Not collective.

    Parameters
    ----------
    grid : Grid
    stencil : Stencil
    layers : int
        Layers of faces beyond those that the markers see.

    Attributes
    ----------
    origin : (int, int)
        First cell row and column of the window that holds the tube.
    u, v : ndarray of bool
        The tube's faces on the window; wall faces are never among them.
    inner : ndarray of bool
        The tube's cells on the window all of whose faces are in the tube.
    faces, cells : ndarray of int
        PETSc numbers of these faces (u before v, each in natural order) and cells.
    shell_faces, shell_cells : ndarray of int
        PETSc numbers of the faces and cells outside that the fluid's equations couple to them.
    """

    def __init__(self, grid, stencil, layers=LAYERS):
        self.grid = grid
        self.stencil = stencil
        window = self._window(grid, stencil, layers)
        self.origin = top, left = window[0].start, window[1].start
        seen = np.zeros((window[0].stop - top, window[1].stop - left), dtype=bool)
        for (rows, columns, _), along in ((stencil.u, (0, 1)), (stencil.v, (1, 0))):
            seen[rows - top, columns - left] = True  # the cell after the face, and that before it
            seen[rows - top - along[0], columns - left - along[1]] = True
        cells = seen
        for _ in range(layers - 1):
            cells = dilate(cells)

        u_window = (window[0], slice(left, window[1].stop + 1))
        v_window = (slice(top, window[0].stop + 1), window[1])
        u_free, v_free = self._free(grid, u_window, v_window)
        self.u, self.v = _faces_of(cells)
        self.u &= u_free
        self.v &= v_free
        self.inner = cells & u_free[:, :-1] & u_free[:, 1:] & v_free[:-1] & v_free[1:]
        u_index, v_index = grid.u_index[u_window], grid.v_index[v_window]
        p_index = grid.p_index[window]
        self.faces = np.concatenate((u_index[self.u], v_index[self.v]))
        self.cells = p_index[self.inner]

        u_shell = dilate(self.u) & ~self.u & u_free
        v_shell = dilate(self.v) & ~self.v & v_free
        touching = self.u[:, :-1] | self.u[:, 1:] | self.v[:-1] | self.v[1:]
        self.shell_faces = np.concatenate((u_index[u_shell], v_index[v_shell]))
        self.shell_cells = p_index[touching & ~self.inner]

    @staticmethod
    def _window(grid, stencil, layers):
        """Rows and columns of cells that hold the tube and its shell."""
        u_rows, u_columns, _ = stencil.u
        v_rows, v_columns, _ = stencil.v
        if not len(u_rows):
            return slice(0, 0), slice(0, 0)
        margin = layers + 1
        return (
            slice(
                max(min(u_rows.min(), v_rows.min() - 1) - margin, 0),
                min(max(u_rows.max(), v_rows.max()) + 1 + margin, grid.n),
            ),
            slice(
                max(min(u_columns.min() - 1, v_columns.min()) - margin, 0),
                min(max(u_columns.max(), v_columns.max()) + 1 + margin, grid.m),
            ),
        )

    @staticmethod
    def _free(grid, u_window, v_window):
        """Masks of the faces on the windows that are not on a wall."""
        u_columns = np.arange(u_window[1].start, u_window[1].stop)
        v_rows = np.arange(v_window[0].start, v_window[0].stop)
        u_rows = u_window[0].stop - u_window[0].start
        v_columns = v_window[1].stop - v_window[1].start
        return (
            np.tile((u_columns > 0) & (u_columns < grid.m), (u_rows, 1)),
            np.tile(((v_rows > 0) & (v_rows < grid.n))[:, None], (1, v_columns)),
        )

    def has_faces_of(self, other):
        """Whether it consists of the same faces as another tube, in the same window."""
        return (
            self.origin == other.origin
            and np.array_equal(self.u, other.u)
            and np.array_equal(self.v, other.v)
            and np.array_equal(self.inner, other.inner)
        )

    def face_positions(self):
        """Rows and columns in natural order of the tube's faces: for u and for v."""
        return [
            tuple(place + start for place, start in zip(np.nonzero(mask), self.origin))
            for mask in (self.u, self.v)
        ]

    def face_numbers(self):
        """Numbers of the tube's faces on the window (-1 elsewhere): tables for u and for v."""
        u = np.full(self.u.shape, -1, dtype=PETSc.IntType)
        v = np.full(self.v.shape, -1, dtype=PETSc.IntType)
        count = np.count_nonzero(self.u)
        u[self.u] = np.arange(count)
        v[self.v] = np.arange(count, len(self.faces))
        return u, v

    def interpolation(self):
        """Interpolation matrix of the stencil with the tube's faces as columns (sequential)."""
        markers = len(self.stencil.u[0])
        return PETSc.Mat().createAIJ(
            (2 * markers, len(self.faces)),
            csr=self.stencil.csr(*self.face_numbers(), self.origin),
            comm=PETSc.COMM_SELF,
        )
