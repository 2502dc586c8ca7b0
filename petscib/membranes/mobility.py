"""How markers move besides being carried by the interpolated velocity.

The smoothed delta function rounds off the kink that a tangential force makes in the velocity; the
markers slip by what is missing then.  And of the interpolated velocity, the part that would change
the area a membrane encloses is left out.
"""

import numpy as np

from ..coupling import kink
from ..coupling.kernels import STRESS_SHIFT
from .geometry import signed_area

# Least share of the kink correction that is left with a contrast, from which solvers live: without
# one, steps at contrasts of 100 and 1000 took 160 and 700 to 1000 iterations, with this 40 and 75
# (the table of docs/contrast.md); it acts above contrasts of 70 only.
LEAST_SLIP = 0.1


def _frames(curves, markers, grid):
    """Chords' lengths, unit tangents and normals on their right, and spacings h_n along these."""
    chord = curves.chords(markers)
    length = np.hypot(*chord.T)
    tangent = chord / length[:, None]
    normal = tangent[:, ::-1] * (1, -1)
    return length, tangent, normal, np.hypot(*(normal * (grid.dx, grid.dy)).T)


class Slip:
    """The kink correction K: a velocity along the membrane for a force on the markers.

    U = J w + K F, K = C(m) h_n / (2 mu |X_s|) t t^T with F the force per ds, t the unit chord at
    a marker, n its normal, h_n = |(n_x dx, n_y dy)| and C the factor of `coupling.kink`.

    Parameters
    ----------
    curves : Curves
    markers : ndarray, shape (M, 2)
        Where the chords are taken: at the step's start, or in its middle.
    grid : Grid
    kernel : Kernel
    mu : float or ndarray, shape (M,)
        Viscosity.

    Attributes
    ----------
    tangent : ndarray, shape (M, 2)
        t.
    length : ndarray, shape (M,)
        What of the curve a marker stands for, |X_s| ds.
    mobility : ndarray, shape (M,)
        Velocity along t for a force along t on the marker.
    """

    def __init__(self, curves, markers, grid, kernel, mu):
        length, self.tangent, self._right, self.spacing = _frames(curves, markers, grid)
        ends = (curves.after == np.arange(len(markers))) | (
            curves.before == np.arange(len(markers)))
        self.length = length * np.where(ends, 1.0, 0.5)
        self._directions = self._right * (grid.dx, grid.dy) / self.spacing[:, None]
        thickness = kink.thickness(kink.constants(kernel), self._directions) * self.spacing / 2
        self.mobility = thickness / (mu * self.length)

    def velocity(self, force):
        """K f, shape (M, 2), for a force on the markers (per marker, not per ds)."""
        along = self.mobility * np.einsum("ki,ki->k", self.tangent, force)
        return along[:, None] * self.tangent


class ContrastSlip(Slip):
    """The kink correction where the viscosity inside is another, with what J' needs.

    K = (k + 2 b c |1 / mu_o - 1 / mu_i| - c^2 (1 / mu_o - 1 / mu_i)^2 W / h_n) t t^T / |X_s|.

    k = C h_n / 2 (1 / mu_o + 1 / mu_i) / 2 is the kink correction for the mean of both sides, c
    that of J' (see `coupling.stress`), and the rest the slip that the stresses which J' spreads
    make up for: b = `kink.stress_ahead`, W = `kink.stress_work`.  At least LEAST_SLIP of k is left.

    Parameters
    ----------
    curves, markers, grid, kernel
        As in Slip.
    outer : float
        Viscosity of the fluid around.
    inner : ndarray, shape (V,)
        That inside of each membrane.

    Attributes
    ----------
    normal : ndarray, shape (M, 2)
        Outward.
    per_stress : ndarray, shape (M,)
        c (1 / mu_o - 1 / mu_i).
    """

    def __init__(self, curves, markers, grid, kernel, outer, inner):
        inner = inner[: curves.count]  # none where there are no markers
        super().__init__(curves, markers, grid, kernel,
                         curves.spread(2 / (1 / outer + 1 / inner)))
        side = curves.spread(np.sign(signed_area(markers, curves)))
        self.normal = side[:, None] * self._right
        straight, diagonal = curves.spread(np.array([
            kink.stress_work(kernel, *sorted((1 / value, 1 / outer))) for value in inner
        ]).reshape(-1, 2)).T
        thickness, ahead, work = (
            kink.thickness(constants, self._directions) for constants in (
                kink.contrast_constants(kernel), kink.stress_ahead(kernel), (straight, diagonal)))
        self.per_stress = (
            thickness * self.spacing / 2 * curves.spread(1 / outer - 1 / inner))
        made_up = (2 * ahead * np.abs(self.per_stress)
                    - self.per_stress**2 * work / self.spacing)
        self.mobility = np.maximum(
            self.mobility + made_up / self.length, LEAST_SLIP * self.mobility)


def stress_places(curves, markers, grid, outer, inner):
    """Where the stress at each marker is read: a little on the more viscous side of the membrane.

    Parameters
    ----------
    curves : Curves
    markers : ndarray, shape (M, 2)
    grid : Grid
    outer : float
    inner : ndarray, shape (V,)
        Viscosities.

    Returns
    -------
    ndarray, shape (M, 2)
    """
    _, _, normal, spacing = _frames(curves, markers, grid)
    outward = curves.spread(
        np.sign(signed_area(markers, curves)) * np.sign(outer - inner[: curves.count]))
    return markers + (STRESS_SHIFT * outward * spacing)[:, None] * normal


class AreaProjector:
    """Pi = 1 - N N^T / |N|^2 for each membrane around an area: velocities that keep that area.

    N is the gradient of the area with respect to the markers, half the chord turned by a quarter,
    and `dual` is N / |N|^2.

    Parameters
    ----------
    curves : Curves
    markers : ndarray, shape (M, 2)
    """

    def __init__(self, curves, markers):
        self.curves = curves
        chord = curves.chords(markers) * curves.spread(curves.encloses)[:, None]
        self.normal = np.stack((chord[:, 1], -chord[:, 0]), axis=1) / 2
        square = curves.sums(np.einsum("ki,ki->k", self.normal, self.normal))
        square[square == 0] = 1.0  # of curves around no area N is zero
        self.dual = self.normal / curves.spread(square)[:, None]

    def component(self, values):
        """N . q / |N|^2 of each membrane for values (M, 2) at the markers."""
        return self.curves.sums(np.einsum("ki,ki->k", self.dual, values))

    def project(self, values):
        """Pi q, shape (M, 2)."""
        if self.curves.count == 1:  # the usual case, several times an iteration
            return values - np.vdot(self.dual, values) * self.normal
        return values - self.curves.spread(self.component(values))[:, None] * self.normal


def restore_areas(curves, markers, target):
    """Shift markers along N until each membrane around an area has the signed area `target`.

    The area is quadratic in the shift s: that of X + s D is that of X plus s plus s^2 times that
    of D, with D = N / |N|^2.
    """
    direction = AreaProjector(curves, markers).dual
    area, bend = (signed_area(values, curves) for values in (markers, direction))
    missing = np.where(curves.encloses, target - area, 0.0)
    bend = np.where(curves.encloses, bend, 0.0)
    # The root that goes to zero with what is missing; nothing can be done for less than a point.
    shift = 2 * missing / (1 + np.sqrt(np.maximum(1 + 4 * missing * bend, 0.0)))
    return markers + curves.spread(shift)[:, None] * direction
