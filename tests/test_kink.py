"""The factor of the kink correction, against the integral that defines it and a straight line."""

import numpy as np
import pytest

from petscib.coupling.interpolation import Interpolation
from petscib.coupling.kernels import KERNELS, bspline
from petscib.coupling.kink import constants, thickness
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides
from petscib.membranes.curves import Curves
from petscib.membranes.mobility import Slip
from petscib.solvers.transforms.saddle_point import StokesTransform

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
        found = thickness(constants(KERNELS[name]), np.array([np.cos(angle), np.sin(angle)]))
        assert abs(found - integral(KERNELS[name], angle)) < bound


def test_rule_takes_an_array_of_normals_and_is_even_and_symmetric():
    kernel = KERNELS["bspline43"]
    normals = np.array([[1, 0], [0, -1], [0.6, 0.8], [-0.8, 0.6], [0.5**0.5, -(0.5**0.5)]])
    found = thickness(constants(kernel), normals)
    assert found[0] == found[1] == constants(kernel)[0]
    assert found[2] == pytest.approx(found[3], rel=1e-14)
    assert found[4] == pytest.approx(constants(kernel)[1], rel=1e-14)


# ---------------------------------------------------------------- a straight line

FRICTION, MU = 3.0, 0.7  # rho / (theta dt) and the viscosity
BOX = np.array([2.0, 2.0])
OFFSETS = (np.arange(5) + 0.3) / 5  # in cells


def errors_on_a_line(kernel, cells, winding):
    """Error of the markers' speed along a line, in units of h_n f / (2 mu), corrected and not.

    The line closes in itself in a box that is periodic both ways, after going around it `winding`
    times in x and y, and exerts a uniform tangential force f = 1.  Each row holds the errors of all
    markers of one of several lines, shifted against the grid.
    """
    grid = Grid(cells, (0.0, BOX[0], 0.0, BOX[1]), periodic=(True, True))
    transform = StokesTransform(grid, Operators(grid, Sides(grid)))
    transform.set_coefficients(FRICTION, MU)
    along = winding * BOX
    length = np.hypot(*along)
    tangent = along / length
    count = int(np.ceil(2 * length / min(grid.dx, grid.dy)))
    ds = length / count
    spacing = np.hypot(tangent[1] * grid.dx, tangent[0] * grid.dy)

    # w'' - k^2 w = - delta / mu across lines that are repeated at equal distances
    decay = np.sqrt(FRICTION / MU)
    exact = 1 / (2 * MU * decay * np.tanh(decay * BOX.prod() / length / 2))
    force = np.tile(ds * tangent, (count, 1))
    rhs, velocity, pressure = grid.velocity_vector(), grid.velocity_vector(), grid.pressure_vector()
    found = []
    for offset in OFFSETS:
        markers = np.outer(np.arange(count) * ds, tangent) + offset * np.array([grid.dx, -grid.dy])
        interpolation = Interpolation(grid, kernel, markers)
        rhs.set(0.0)
        interpolation.spread_add(force, rhs)
        transform.solve(rhs, None, velocity, pressure)
        carried = interpolation.interpolate(velocity)
        slip = Slip(Curves([count], [ds], [False]), markers, grid, kernel, MU).velocity(force)
        found.append([(carried + slip) @ tangent - exact, carried @ tangent - exact])
        interpolation.destroy()
    transform.destroy()
    return np.array(found).transpose(1, 0, 2) * 2 * MU / spacing


def to_no_spacing(coarse, middle, fine):
    """Extrapolated from spacings 4 h, 2 h and h, of what has a first and a second order in h."""
    return (coarse - 6 * middle + 8 * fine) / 3


def check_line(name, cells, winding, bound):
    kernel, (left, missing) = KERNELS[name], np.transpose([
        errors_on_a_line(KERNELS[name], tuple(scale * np.array(cells)), np.array(winding)).mean(
            axis=(1, 2)) for scale in (1, 2, 4)])
    assert abs(to_no_spacing(*left)) <= bound
    assert -to_no_spacing(*missing) >= constants(kernel)[0] - bound
    assert left[1] <= 0.6 * left[0] or abs(left[1]) <= 0.1  # the second order in h that is left


@pytest.mark.parametrize("winding", [(1, 0), (0, 1), (1, 1), (-1, 1), (2, 1), (-3, 2)])
@pytest.mark.parametrize("name", KERNELS)
def test_markers_on_a_straight_line_move_as_they_must(name, winding):
    """At 0, 90, 45, 135, 27 and 146 degrees to square cells."""
    check_line(name, (8, 8), winding, max(5e-3, PRINTED[name][2]))


@pytest.mark.parametrize("winding", [(1, 0), (0, 1), (1, 1), (1, 2)])
@pytest.mark.parametrize("name, bound", [("yang", 5e-3), ("bspline43", 0.02)])
def test_markers_on_a_straight_line_over_oblong_cells(name, bound, winding):
    """There the rule for directions between those of the axes is less close."""
    check_line(name, (12, 16), winding, bound)


def test_every_marker_of_a_line_moves_alike_with_smooth_kernels():
    for winding in ((1, 0), (1, 1), (2, 1)):
        left, _ = errors_on_a_line(KERNELS["yang"], (32, 32), np.array(winding))
        assert np.ptp(left) <= 5e-3
