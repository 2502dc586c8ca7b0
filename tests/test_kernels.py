"""The smoothed delta functions and their products."""
from math import asin, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from petscib.coupling import kernels
from petscib.coupling.interpolation import Stencil
from petscib.coupling.kernels import KERNELS
from petscib.fluid.grid import Grid

WEIGHTS = {"yang": (kernels.yang, 2.5), "peskin4": (kernels.peskin4, 2.0),
           "roma3": (kernels.roma3, 1.5),
           **{f"bspline of order {q}": (kernels.bspline(q), q / 2) for q in (2, 3, 4, 5, 6)}}
TOLERANCE = 1e-14

every_weight = pytest.mark.parametrize("weight, radius", WEIGHTS.values(), ids=WEIGHTS)


# ---------------------------------------------------------------- one dimension


@every_weight
@given(offset=st.floats(-1.0, 1.0))
def test_sum_and_first_moment(weight, radius, offset):
    r = np.arange(-6, 7) - offset
    assert weight(r).sum() == pytest.approx(1, abs=TOLERANCE)
    assert (r * weight(r)).sum() == pytest.approx(0, abs=TOLERANCE)


@every_weight
def test_shape(weight, radius):
    r = np.linspace(0, 4, 8001)
    values = weight(r)
    assert np.array_equal(values, weight(-r))
    assert (values >= -TOLERANCE).all()
    assert (np.diff(values) <= TOLERANCE).all()
    assert np.abs(values[r >= radius]).max() <= TOLERANCE
    assert (values[r < 0.98 * radius] > 0).all()


@every_weight
def test_continuity_at_the_joints(weight, radius):
    joints = np.arange(0, 3.5, 0.5)
    assert np.allclose(weight(joints - 1e-12), weight(joints + 1e-12), rtol=0, atol=1e-11)


@given(offset=st.floats(-1.0, 1.0))
def test_sums_that_define_peskins_and_romas_functions(offset):
    r = np.arange(-6, 7) - offset
    four = kernels.peskin4(r)
    assert four[::2].sum() == pytest.approx(1 / 2, abs=TOLERANCE)
    assert (four**2).sum() == pytest.approx(3 / 8, abs=TOLERANCE)
    assert (kernels.roma3(r)**2).sum() == pytest.approx(1 / 2, abs=TOLERANCE)


def test_yang_is_the_four_point_function_averaged_over_a_cell():
    nodes, weights = np.polynomial.legendre.leggauss(40)

    def integral(low, high):
        return (high - low) / 2 * weights @ kernels.peskin4((low + high + (high - low) * nodes) / 2)

    for r in np.linspace(0, 2.5, 61):
        joint = np.floor(r + 0.5)  # the four-point function is smooth between whole numbers
        expected = integral(r - 0.5, joint) + integral(joint, r + 0.5)
        assert kernels.yang(r) == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("r, value", [
    (0, 3 / 8 + pi / 32),
    (0.3, 3 / 8 + pi / 32 - 0.09 / 4),
    (1.0, 1 / 4),
    (1.2, 1 / 4 - 0.025 * sqrt(1.84) - asin(0.2 * sqrt(2)) / 8),
    (2.0, 17 / 16 - pi / 64 - 1),
    (2.2, 17 / 16 - pi / 64 - 1.65 + 0.605 + 0.0125 * sqrt(1.84) + asin(0.2 * sqrt(2)) / 16),
])
def test_values_of_yangs_function(r, value):
    assert kernels.yang(r) == pytest.approx(value, abs=TOLERANCE)
    assert kernels.yang(-r) == kernels.yang(r)


@pytest.mark.parametrize("order, r, value", [
    (2, 0, 1), (2, 0.25, 0.75), (3, 0, 3 / 4), (3, 1, 1 / 8), (4, 0, 2 / 3), (4, 1, 1 / 6),
    (5, 0, 115 / 192), (5, 1, 19 / 96), (5, 2, 1 / 384), (6, 0, 11 / 20), (6, 1, 13 / 60),
    (6, 2, 1 / 120)])
def test_values_of_bsplines(order, r, value):
    assert kernels.bspline(order)(np.array(r)) == pytest.approx(value, abs=TOLERANCE)


@pytest.mark.parametrize("order", [3, 4, 5, 6])
def test_bspline_is_the_next_lower_one_averaged_over_a_cell(order):
    nodes, weights = np.polynomial.legendre.leggauss(6)
    for r in np.linspace(-3, 3, 49):
        joint = np.round(2 * r) / 2  # half-number joints: cut the interval there
        cuts = np.unique(np.clip([r - 0.5, joint - 0.5, joint, joint + 0.5, r + 0.5],
                                 r - 0.5, r + 0.5))
        lower = kernels.bspline(order - 1)
        expected = sum((b - a) / 2 * weights @ lower((a + b + (b - a) * nodes) / 2)
                       for a, b in zip(cuts, cuts[1:]))
        assert kernels.bspline(order)(r) == pytest.approx(expected, abs=1e-13)


# ---------------------------------------------------------------- products


@pytest.mark.parametrize("name", KERNELS)
def test_radii_are_those_of_the_supports(name):
    kernel = KERNELS[name]
    for weight, radius in ((kernel.along, kernel.along_radius),
                           (kernel.across, kernel.across_radius)):
        r = np.linspace(0, 4, 801)
        assert np.abs(weight(r[r >= radius])).max() <= TOLERANCE
        assert weight(r[r < 0.98 * radius]).min() > 0
    assert kernel.reach == max(kernel.along_radius, kernel.across_radius)


def divergence_at(points, grid, kernel, u, v):
    """Divergence of the interpolated velocity by fourth-order differences."""
    def component(which, shift):
        rows, columns, weights = getattr(Stencil(grid, kernel, points + shift), which)
        return (weights * (u, v)[which == "v"][rows, columns]).sum(axis=(1, 2))

    total = 0
    for which, step in (("u", np.array([grid.dx, 0])), ("v", np.array([0, grid.dy]))):
        h = 0.02 * step
        total += (8 * (component(which, h) - component(which, -h))
                  - component(which, 2 * h) + component(which, -2 * h)) / (12 * h.sum())
    return total


@pytest.fixture(scope="module")
def sample():
    """Grid, random divergence-free faces, and points whose differences cross no joint."""
    grid = Grid((12, 14), (-1, 2, 0, 2))
    random = np.random.default_rng(3)
    psi = random.standard_normal((15, 13))
    cells = np.column_stack((random.integers(4, 8, 50), random.integers(4, 10, 50)))
    places = random.uniform(0.05, 0.45, (50, 2)) + random.integers(0, 2, (50, 2)) / 2
    points = np.array([-1, 0]) + (cells + places) * (grid.dx, grid.dy)
    return grid, np.diff(psi, axis=0) / grid.dy, -np.diff(psi, axis=1) / grid.dx, points


@pytest.mark.parametrize("name", [name for name in KERNELS if name.startswith("bspline")])
def test_composite_bsplines_keep_the_velocity_divergence_free_everywhere(sample, name):
    grid, u, v, points = sample
    # The differences are exact up to degree 4; bspline65 has degree 5.
    tolerance = 1e-5 if name == "bspline65" else 1e-10
    assert np.abs(divergence_at(points, grid, KERNELS[name], u, v)).max() <= tolerance
    assert np.abs(divergence_at(points, grid, KERNELS["yang"], u, v)).max() > 1


@pytest.mark.parametrize("order", [3, 4, 5])
def test_divergence_interpolated_by_composite_bsplines(sample, order):
    """It is the cells' divergence, interpolated by the lower spline both ways."""
    grid, u, v, points = sample
    random = np.random.default_rng(4)
    u, v = u + random.standard_normal(u.shape), v + random.standard_normal(v.shape)
    cells = np.diff(u, axis=1) / grid.dx + np.diff(v, axis=0) / grid.dy
    weight = kernels.bspline(order - 1)
    x, y = grid.p_points()
    expected = [(weight((x - point[0]) / grid.dx) * weight((y - point[1]) / grid.dy) * cells).sum()
                for point in points]
    found = divergence_at(points, grid, KERNELS[f"bspline{order}{order - 1}"], u, v)
    assert np.allclose(found, expected, rtol=0, atol=1e-10)
