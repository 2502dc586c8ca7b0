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
        force = self.tension_force(self.tension(stretch), tangent)
        if self.bending:
            force += self.bending_force(markers)
        return force

    def tension_energy(self, stretch):
        """sigma0 / 2 times the squared norm of the excess stretching (eq. 3.17)."""
        return self.sigma0 / 2 * self.ds * np.sum((stretch - self.rest_stretch) ** 2)

    def bending_energy(self, markers):
        """c_b / 2 times the squared norm of D_s D_s X."""
        if not self.bending:
            return 0.0
        return self.bending / 2 * self.ds * np.sum(
            geometry.second_difference(markers, self.ds) ** 2
        )

    def stiffness(self, tangent):
        """Linear part of the force for a given tangent field."""
        return Stiffness(self, tangent)


class Stiffness:
    """The symmetric positive semidefinite matrix W = sigma0 T^T T + c_b A_h at the markers.

    T takes marker velocities to rates of stretching along the given tangent field; minus W times
    a displacement is the change of the membrane force.

    Parameters
    ----------
    membrane : Membrane
    tangent : ndarray, shape (M, 2)
        At the half points.
    """

    def __init__(self, membrane, tangent):
        self.membrane = membrane
        self.tangent = tangent

    def apply(self, displacement):
        """W times an (M, 2) array."""
        membrane = self.membrane
        stretch = geometry.surface_divergence(displacement, self.tangent, membrane.ds)
        result = -membrane.tension_force(membrane.sigma0 * stretch, self.tangent)
        if membrane.bending:
            result -= membrane.bending_force(displacement)
        return result

    def matrix(self, comm=PETSc.COMM_SELF):
        """W as a sparse matrix, 2M x 2M, components interleaved.

        Collective on `comm`; each rank owns the rows of the markers it holds.
        """
        membrane = self.membrane
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
            fourth = membrane.bending / membrane.ds**4 * np.array([1.0, -4.0, 6.0, -4.0, 1.0])
            blocks += fourth[None, :, None, None] * np.eye(2)
        marker = np.arange(count)[:, None] + np.arange(-reach, reach + 1)
        columns = 2 * (marker % count)[:, :, None] + np.arange(2)
        columns = np.broadcast_to(columns[:, None], (count, 2, 2 * reach + 1, 2))
        values = blocks.transpose(0, 2, 1, 3)
        width = 2 * (2 * reach + 1)
        starts = np.arange(2 * count + 1, dtype=PETSc.IntType) * width
        return PETSc.Mat().createAIJ(
            ((2 * count, PETSc.DETERMINE),) * 2,
            csr=(starts, columns.ravel().astype(PETSc.IntType), values.ravel()),
            comm=comm,
        )
