"""Smoothed delta functions: one-dimensional weight functions and their products.

Every function takes r = distance / grid spacing (array of any shape) and returns the weight
phi(r); the grid sum of phi is one for any offset.
"""

from dataclasses import dataclass
from math import comb, factorial
from typing import Callable

import numpy as np

# How far on the more viscous side of a membrane its stress is read, in grid spacings.  Thereby the
# slip that is left with a contrast (`membranes.mobility.ContrastSlip`) stays positive: at contrasts
# of 18 and 30 it is 0.44 to 0.51 and 0.18 to 0.34 of that without the stresses' part, over kernels
# and directions; at the membrane itself -0.20 to 0.36 and -0.33 to 0.25, half a cell away 0.13 to
# 0.68 and -0.59 to 0.32 (`kink.stress_work`; tests/test_contrast.py).
STRESS_SHIFT = 0.25


def yang(r):
    """Smoothed four-point function, support |r| < 2.5 (Yang, Zhang, Li & He 2009)."""
    r = np.abs(r)
    square = r * r
    # Both outer pieces have the same function of the distance to their middle.
    s = np.clip(np.sqrt(2) * (r - np.where(r < 1.5, 1.0, 2.0)), -1, 1)
    arc = s * np.sqrt(1 - s * s) + np.arcsin(s)
    near = (3 / 8 + np.pi / 32) - square / 4
    middle = 1 / 4 - arc / 8
    far = (17 / 16 - np.pi / 64) - 3 / 4 * r + square / 8 + arc / 16
    return np.where(r < 1.5, np.where(r < 0.5, near, middle), np.where(r < 2.5, far, 0.0))


def peskin4(r):
    """Four-point function, support |r| < 2 (Peskin 2002)."""
    r = np.abs(r)
    near = (3 - 2 * r + np.sqrt(np.maximum(1 + 4 * r - 4 * r**2, 0))) / 8
    far = (5 - 2 * r - np.sqrt(np.maximum(-7 + 12 * r - 4 * r**2, 0))) / 8
    return np.select([r < 1, r < 2], [near, far], 0.0)


def roma3(r):
    """Three-point function, support |r| < 1.5 (Roma, Peskin & Berger 1999)."""
    r = np.abs(r)
    near = (1 + np.sqrt(np.maximum(1 - 3 * r**2, 0))) / 3
    far = (5 - 3 * r - np.sqrt(np.maximum(1 - 3 * (1 - r) ** 2, 0))) / 6
    return np.select([r < 0.5, r < 1.5], [near, far], 0.0)


def bspline(order):
    """Cardinal B-spline of the given order (degree order - 1), support |r| < order / 2."""

    def weight(r):
        r = np.minimum(np.abs(r), order / 2)  # the even half, where the powers cancel least
        terms = (
            (-1) ** k * comb(order, k) * np.maximum(order / 2 - r - k, 0) ** (order - 1)
            for k in range((order + 1) // 2 + 1)
        )
        return sum(terms) / factorial(order - 1)

    return weight


@dataclass(frozen=True)
class Kernel:
    """Product of two one-dimensional functions.

    Attributes
    ----------
    along, across : callable
        Weight in the velocity component's own direction and in the other one.
    along_radius, across_radius : float
        Half widths of their supports, in grid spacings.
    """

    along: Callable
    along_radius: float
    across: Callable
    across_radius: float

    @property
    def reach(self):
        """Distance, in grid spacings, that a marker must keep from the walls."""
        return max(self.along_radius, self.across_radius)

    @property
    def stress_reach(self):
        """The same where stresses are interpolated too: from faces half a cell further away."""
        return max(self.reach, self.across_radius + 0.5 + STRESS_SHIFT)


def _isotropic(weight, radius):
    return Kernel(weight, radius, weight, radius)


def _composite(order):
    """A MAC velocity interpolated with it is divergence-free at every point."""
    return Kernel(bspline(order), order / 2, bspline(order - 1), (order - 1) / 2)


KERNELS = {
    "yang": _isotropic(yang, 2.5),
    "peskin4": _isotropic(peskin4, 2.0),
    "roma3": _isotropic(roma3, 1.5),
    **{f"bspline{order}{order - 1}": _composite(order) for order in (3, 4, 5, 6)},
}
