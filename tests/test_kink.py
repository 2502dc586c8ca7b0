"""The factor of the kink correction, against the integral that defines it."""

import numpy as np
import pytest

from petscib.coupling.kernels import KERNELS, bspline
from petscib.coupling.kink import constants, thickness

# C0, C45 and what the rule may differ from the integral between 0 and 45 degrees. (0.333334 is one
# third, rounded from a quadrature: hence a whole unit of the last digit as tolerance.)
PRINTED = {
    "yang": (0.827382, 0.853291, 4e-4),
    "peskin4": (0.761984, 0.789264, 5e-4),
    "roma3": (0.532311, 0.575567, 1.5e-3),
    "bspline32": (0.333334, 0.463610, 8.5e-3),
    "bspline43": (0.466667, 0.566579, 4e-3),
    "bspline54": (0.569048, 0.653531, 2.5e-3),
    "bspline65": (0.655644, 0.730205, 2e-3),
}


def transform(weight, radius, q):
    """Fourier transform of a weight, by Gauss's rule on every half cell of its support."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    edges = np.arange(0, 2 * radius)[:, None] / 2
    x = (edges + 0.25 + 0.25 * nodes).ravel()
    w = np.tile(weights / 4, len(edges))
    return 2 * np.cos(np.multiply.outer(q, x)) @ (w * weight(x))


def integral(kernel, angle, end=300.0, panels=300):
    """t . C t of the formula; beyond `end` only the first term of the integrand is left."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    q = ((np.arange(panels)[:, None] + (nodes + 1) / 2) * end / panels).ravel()
    weights = np.tile(weights / 2 * end / panels, panels)
    normal = np.array([np.cos(angle), np.sin(angle)])
    tangent = np.array([-normal[1], normal[0]])
    along = [transform(kernel.along, kernel.along_radius, q * n) for n in normal]
    across = [transform(kernel.across, kernel.across_radius, q * n) for n in normal]
    phi = np.array([along[0] * across[1], across[0] * along[1]])
    d = 2 * np.sin(np.multiply.outer(normal, q) / 2)
    lam = np.sum(d**2, axis=0)
    smoothed = tangent[:, None] * phi
    projected = np.sum(smoothed**2, axis=0) - np.sum(smoothed * d, axis=0) ** 2 / lam
    return 2 / np.pi * (weights @ (1 / q**2 - projected / lam) + 1 / end)


@pytest.mark.parametrize("name", KERNELS)
def test_constants_are_the_printed_table_and_the_integral(name):
    found = constants(KERNELS[name])
    np.testing.assert_allclose(found, PRINTED[name][:2], rtol=0, atol=1e-6)
    expected = [integral(KERNELS[name], 0.0), integral(KERNELS[name], np.pi / 4)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("order", [3, 4, 5, 6])
def test_constants_of_splines_are_sums_of_splines(order):
    """The autocorrelation of a B-spline is the one of twice its order."""

    def mean_distance(twice):
        j = np.arange(-order * 2, order * 2 + 1)
        return np.sum(np.abs(j) * bspline(twice)(j))

    expected = mean_distance(2 * (order - 1)), mean_distance(2 * (2 * order - 1)) / np.sqrt(2)
    found = constants(KERNELS[f"bspline{order}{order - 1}"])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", KERNELS)
def test_rule_between_the_two_directions(name):
    *_, bound = PRINTED[name]
    for degrees in (10.0, 22.5, 35.0, 60.0):
        angle = np.deg2rad(degrees)
        found = thickness(KERNELS[name], np.array([np.cos(angle), np.sin(angle)]))
        assert abs(found - integral(KERNELS[name], angle)) < bound


def test_rule_takes_an_array_of_normals_and_is_even_and_symmetric():
    kernel = KERNELS["bspline43"]
    normals = np.array([[1, 0], [0, -1], [0.6, 0.8], [-0.8, 0.6], [0.5**0.5, -(0.5**0.5)]])
    found = thickness(kernel, normals)
    assert found[0] == found[1] == constants(kernel)[0]
    assert found[2] == pytest.approx(found[3], rel=1e-14)
    assert found[4] == pytest.approx(constants(kernel)[1], rel=1e-14)
