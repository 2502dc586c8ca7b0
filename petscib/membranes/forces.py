"""Membrane forces and their linearisation: tension and bending.

All arrays live on rank 0; the other ranks call the same functions with M = 0.
"""

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from . import geometry


@dataclass
class Membrane:
    """Elastic properties of one closed membrane.

    Attributes
    ----------
    ds : float
        Parameter step (arclength of the initial curve per marker).
    sigma0 : float
        Elastic coefficient; the tension is sigma0 (|X_s| - rest_stretch) (Hu & Lai, eq. 4.3).
    bending : float
        Bending rigidity c_b.
    rest_stretch : ndarray, shape (M,)
        Stretching without tension, at the half points.
    """

    ds: float
    sigma0: float
    bending: float
    rest_stretch: np.ndarray

    @property
    def acts(self):
        """Whether it exerts forces; without, its markers only drift with the fluid."""
        return bool(self.sigma0 or self.bending)

    def tangent(self, markers):
        """Unit tangent at the half points, along which tension acts; None without tension."""
        return geometry.unit_tangent(markers, self.ds) if self.sigma0 else None

    def stretch_rate(self, velocity, tangent):
        """Rate of stretching by a velocity of the markers; None without tension."""
        if not self.sigma0:
            return None
        return geometry.surface_divergence(velocity, tangent, self.ds)

    def tension(self, stretch):
        """Tension sigma at the half points."""
        return self.sigma0 * (stretch - self.rest_stretch)

    def tension_force(self, tension, tangent):
        """Force density D_s (sigma tau) at the markers (eq. 2.4)."""
        return geometry.to_markers(tension[:, None] * tangent, self.ds)

    def bending_force(self, markers):
        """Force density -c_b D_s^4 X at the markers (eq. A.2)."""
        curvature = geometry.second_difference(markers, self.ds)
        return -self.bending * geometry.second_difference(curvature, self.ds)

    def force(self, markers, stretch, tangent):
        """Tension and bending together."""
        if not self.sigma0:
            return self.bending_force(markers)
        force = self.tension_force(self.tension(stretch), tangent)
        if self.bending:
            force += self.bending_force(markers)
        return force

    def tension_energy(self, stretch):
        """sigma0 / 2 times the squared norm of the excess stretching (eq. 3.17)."""
        if not self.sigma0:
            return 0.0
        return self.sigma0 / 2 * self.ds * np.sum((stretch - self.rest_stretch) ** 2)

    def bending_energy(self, markers):
        """c_b / 2 times the squared norm of D_s D_s X."""
        if not self.bending:
            return 0.0
        return self.bending / 2 * self.ds * np.sum(
            geometry.second_difference(markers, self.ds) ** 2
        )

    def stiffness(self, tangent, reset=None):
        """Linear part of the force for a given tangent field (see `Stiffness`)."""
        return Stiffness(self, tangent, reset)


class Stiffness:
    """The symmetric positive semidefinite matrix W = sigma0 T^T T + c_b A_h at the markers.

    T takes marker velocities to rates of stretching along the given tangent field; minus W times
    a displacement is the change of the membrane force.

    Parameters
    ----------
    membrane : Membrane
    tangent : ndarray, shape (M, 2)
        At the half points; None without tension.
    reset : ndarray, shape (M,), optional
        Stretching that the tension of the last step was for, less that which the next starts from,
        at the half points: for a first guess.
    """

    def __init__(self, membrane, tangent, reset=None):
        self.membrane = membrane
        self.tangent = tangent
        self.reset = reset

    def apply(self, displacement):
        """W times an (M, 2) array."""
        membrane = self.membrane
        if not membrane.sigma0:
            return -membrane.bending_force(displacement)
        stretch = membrane.stretch_rate(displacement, self.tangent)
        result = -membrane.tension_force(membrane.sigma0 * stretch, self.tangent)
        if membrane.bending:
            result -= membrane.bending_force(displacement)
        return result

    def root(self):
        """C with W = C^T C as a sequential sparse matrix, components of markers interleaved.

        A row for the tension at each half point, then for each component of the bending moment
        at each marker; none for what the membrane lacks.
        """
        membrane = self.membrane
        count = len(membrane.rest_stretch)
        marker = np.arange(count)
        columns, values = [], []
        if membrane.sigma0:
            pair = np.stack((marker - 1, marker), axis=1) % max(count, 1)
            edge = np.sqrt(membrane.sigma0) / membrane.ds * self.tangent
            columns.append((2 * pair[:, :, None] + np.arange(2)).reshape(count, 4))
            values.append(np.concatenate((-edge, edge), axis=1))
        if membrane.bending:
            triple = np.stack((marker - 1, marker, marker + 1), axis=1) % max(count, 1)
            second = np.sqrt(membrane.bending) / membrane.ds**2 * np.array([1.0, -2.0, 1.0])
            for component in (0, 1):
                columns.append(2 * triple + component)
                values.append(np.tile(second, (count, 1)))
        return _from_rows(2 * count, columns, values)

    def first_rates(self, interval):
        """First guess of C times the markers' velocities over the next `interval`."""
        membrane, count = self.membrane, len(self.membrane.rest_stretch)
        rates = np.zeros(count * (bool(membrane.sigma0) + 2 * bool(membrane.bending)))
        if self.reset is not None:
            rates[:count] = np.sqrt(membrane.sigma0) / interval * self.reset
        return rates

    def matrix(self, comm=PETSc.COMM_SELF):
        """W as a sparse matrix, 2M x 2M, components interleaved.

        Collective on `comm`; each rank owns the rows of the markers it holds.
        """
        membrane = self.membrane
        if membrane.bending:
            fourth = membrane.bending / membrane.ds**4 * np.array([1.0, -4.0, 6.0, -4.0, 1.0])
        if not membrane.sigma0:  # then the two components do not see each other
            count = len(membrane.rest_stretch)
            marker = np.arange(count)[:, None] + np.arange(-2, 3)
            columns = 2 * (marker % count)[:, None] + np.arange(2)[:, None]
            return _assemble(columns, np.broadcast_to(fourth, columns.shape), comm)
        count = len(self.tangent)
        reach = 2 if membrane.bending else 1
        blocks = np.zeros((count, 2 * reach + 1, 2, 2))
        edge = membrane.sigma0 / membrane.ds**2 * np.einsum(
            "ki,kj->kij", self.tangent, self.tangent
        )
        ahead = np.roll(edge, -1, axis=0)
        blocks[:, reach - 1] = -edge
        blocks[:, reach] = edge + ahead
        blocks[:, reach + 1] = -ahead
        if membrane.bending:
            blocks += fourth[None, :, None, None] * np.eye(2)
        marker = np.arange(count)[:, None] + np.arange(-reach, reach + 1)
        columns = 2 * (marker % count)[:, :, None] + np.arange(2)
        columns = np.broadcast_to(columns[:, None], (count, 2, 2 * reach + 1, 2))
        return _assemble(columns, blocks.transpose(0, 2, 1, 3), comm)


def _assemble(columns, values, comm):
    """A square sparse matrix from the entries of its rows, shape (M, 2, ...)."""
    rows = 2 * len(columns)
    starts = np.arange(rows + 1, dtype=PETSc.IntType) * (columns[:1].size // 2)
    return PETSc.Mat().createAIJ(
        ((rows, PETSc.DETERMINE),) * 2,
        csr=(starts, columns.ravel().astype(PETSc.IntType), values.ravel()),
        comm=comm,
    )


def _from_rows(width, columns, values):
    """Sequential sparse matrix from blocks of rows with equally many entries each."""
    starts = np.cumsum([0] + [part.shape[1] for part in columns for _ in range(len(part))])
    order = [np.argsort(part, axis=1) for part in columns]
    columns, values = (
        np.concatenate(
            [np.empty(0)]
            + [np.take_along_axis(part, o, axis=1).ravel() for part, o in zip(parts, order)]
        )
        for parts in (columns, values)
    )
    return PETSc.Mat().createAIJ(
        (len(starts) - 1, width),
        csr=(starts.astype(PETSc.IntType), columns.astype(PETSc.IntType), values),
        comm=PETSc.COMM_SELF,
    )
