"""Shapes, differences along curves, and what is measured of polygons."""
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from petscib.membranes import geometry, shapes

ANGLES = (-120.0, -90.0, -37.0, 0.0, 25.0, 45.0, 90.0, 135.0, 180.0)


def fine_ellipse(rx, ry, angle=0.0, center=(0.3, -2.0), count=4000):
    return shapes.ellipse((rx, ry), center, angle, count)


def rectangle(width, height, angle, center, backwards=False):
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (width / 2, height / 2)
    corners = corners[::-1] if backwards else corners
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array(center) + corners @ np.array([[c, s], [-s, c]])


def same_axis(angle, expected):
    """Whether two inclinations, in radians and in degrees, are the same axis."""
    return abs(np.sin(angle - np.radians(expected)))


# ---------------------------------------------------------------- shapes


@pytest.mark.parametrize("axes", [(0.1, 0.5), (0.5, 0.1), (0.02, 0.5), (0.3, 0.3)])
def test_ellipse_markers_are_equally_spaced_in_arclength(axes):
    rx, ry = axes
    count = 134
    markers = shapes.ellipse(axes, (0.1, 0.2), 0.0, count) - (0.1, 0.2)
    angle = np.unwrap(np.arctan2(markers[:, 0] / rx, markers[:, 1] / ry))
    arc = rx * special.ellipeinc(angle, 1 - (ry / rx) ** 2)
    length = 4 * rx * special.ellipe(1 - (ry / rx) ** 2)
    assert shapes.ellipse_perimeter(axes) == pytest.approx(length, rel=1e-13)
    assert np.allclose(arc, length * np.arange(count) / count, rtol=0, atol=1e-12 * length)
    assert np.allclose(np.hypot(*(markers / axes).T), 1, rtol=0, atol=1e-14)


def test_ellipse_starts_at_the_top_and_turns_counter_clockwise():
    assert np.allclose(shapes.ellipse((0.1, 0.5), (1, 2), 0, 8)[0], (1, 2.5), rtol=0, atol=1e-15)
    assert np.allclose(shapes.ellipse((0.1, 0.5), (1, 2), 90, 8)[0], (0.5, 2), rtol=0, atol=1e-15)
    assert shapes.ellipse((0.1, 0.5), (0, 0), 0, 8)[1, 0] > 0  # clockwise along the curve


def test_ellipse_with_even_count_is_point_symmetric():
    markers = shapes.ellipse((0.1, 0.5), (0, 0), 0, 134)
    assert np.abs(markers + np.roll(markers, 67, axis=0)).max() <= 4e-15


# ---------------------------------------------------------------- differences


# ---------------------------------------------------------------- measures


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("backwards", [False, True])
def test_rectangle(angle, backwards):
    width, height, center = 3.0, 0.5, (1e3, -2e3)
    markers = rectangle(width, height, angle, center, backwards)
    assert geometry.area(markers) == pytest.approx(width * height, rel=1e-9)
    assert geometry.perimeter(markers) == pytest.approx(2 * (width + height), rel=1e-12)
    assert np.allclose(geometry.centroid(markers), center, rtol=0, atol=1e-9)
    long, short = width**3 * height / 12, height**3 * width / 12
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    expected = (c * c * long + s * s * short, s * s * long + c * c * short, c * s * (long - short))
    assert geometry.second_moments(markers) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert same_axis(geometry.inclination(markers), angle) <= 1e-9


def test_triangle():
    markers = np.array([[0.0, 0.0], [6.0, 0.0], [0.0, 3.0]])
    assert geometry.area(markers) == pytest.approx(9)
    assert geometry.perimeter(markers) == pytest.approx(9 + 45**0.5)
    assert geometry.centroid(markers) == pytest.approx((2, 1))
    # b^3 h / 36, b h^3 / 36, -b^2 h^2 / 72
    assert geometry.second_moments(markers) == pytest.approx((18.0, 4.5, -4.5))


@pytest.mark.parametrize("angle", ANGLES)
def test_ellipse(angle):
    rx, ry = 0.1, 0.5
    markers = fine_ellipse(rx, ry, angle)
    polygon = 2e-6  # relative error of the polygon's area and length
    assert geometry.area(markers) == pytest.approx(np.pi * rx * ry, rel=polygon)
    assert geometry.perimeter(markers) == pytest.approx(shapes.ellipse_perimeter((rx, ry)),
                                                        rel=polygon)
    assert np.allclose(geometry.centroid(markers), (0.3, -2.0), rtol=0, atol=1e-12)
    along, across = np.pi * rx * ry**3 / 4, np.pi * rx**3 * ry / 4
    c, s = np.cos(np.radians(angle + 90)), np.sin(np.radians(angle + 90))
    expected = (c * c * along + s * s * across, s * s * along + c * c * across,
                c * s * (along - across))
    assert geometry.second_moments(markers) == pytest.approx(expected, abs=4 * polygon * along)
    assert same_axis(geometry.inclination(markers), angle + 90) <= 1e-9


@given(angle=st.floats(-360, 360), thin=st.floats(0.01, 0.9))
def test_inclination_stays_in_its_range(angle, thin):
    inclination = geometry.inclination(rectangle(1.0, thin, angle, (0.2, 0.1)))
    assert -np.pi / 2 < inclination <= np.pi / 2
    assert same_axis(inclination, angle) <= 1e-9 / (1 - thin)


def test_inclination_of_an_upright_shape_is_plus_a_right_angle():
    for markers in (rectangle(0.5, 2.0, 0.0, (0, 0)), rectangle(2.0, 0.5, 90.0, (0, 0)),
                    rectangle(0.5, 2.0, 0.0, (0, 0), backwards=True)):
        assert geometry.inclination(markers) == pytest.approx(np.pi / 2, abs=1e-12)


# ---------------------------------------------------------------- treading frequency


@pytest.mark.parametrize("rate", [0.7, -0.7])
@pytest.mark.parametrize("backwards", [False, True])
def test_frequency_of_a_turning_circle_is_its_angular_velocity(rate, backwards):
    count = 200
    markers = fine_ellipse(0.4, 0.4, count=count) - (0.3, -2.0)
    markers = markers[::-1] if backwards else markers
    velocity = rate * np.column_stack((-markers[:, 1], markers[:, 0]))
    polygon = (np.pi / count) / np.sin(np.pi / count)  # the chords are shorter than the arcs
    assert geometry.treading_frequency(markers + 5.0, velocity) == pytest.approx(
        abs(rate) * polygon, rel=1e-12)


def test_frequency_of_motion_of_uneven_speed():
    """2 pi over the time of one turn, which is 2 pi / sqrt(1 - e^2) for the speed 1 + e sin a."""
    markers = fine_ellipse(1.0, 1.0, count=400) - (0.3, -2.0)
    tangent = np.column_stack((-markers[:, 1], markers[:, 0]))
    for e in (0.3, 0.8):
        velocity = (1 + e * markers[:, 1])[:, None] * tangent
        assert geometry.treading_frequency(markers, velocity) == pytest.approx(
            (1 - e * e) ** 0.5, rel=5e-5)


def test_no_frequency_without_treading():
    markers = fine_ellipse(0.4, 0.4, count=100)
    assert np.isnan(geometry.treading_frequency(markers, np.zeros((100, 2))))
    assert np.isnan(geometry.treading_frequency(markers, np.ones((100, 2))))
