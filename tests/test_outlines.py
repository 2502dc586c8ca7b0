"""The membranes that a run starts with."""
import numpy as np
import pytest
from petsc4py import PETSc

from petscib import options, outlines
from petscib.errors import InputError
from petscib.fluid.grid import Grid
from petscib.own import Points

BOX = {"flow": "rest", "domain": "-2,2,-1,1", "stag_grid_x": "64", "stag_grid_y": "32"}
H = 1 / 16


def begun(**words):
    """Settings, grid and first outlines."""
    settings = options.read({**BOX, **words})
    periodic = "x" in settings.periodic, "y" in settings.periodic
    grid = Grid((64, 32), settings.domain, PETSc.COMM_SELF, periodic)
    return settings, grid, outlines.first(settings, grid)


def test_a_circle_has_two_markers_a_cell():
    _, _, (one,) = begun(axes="0.5,0.5", center="0.25,-0.1")
    assert one.length == pytest.approx(np.pi, rel=1e-14)
    assert len(one.markers) == round(np.pi / (H / 2)) and one.closed and one.period == (0.0, 0.0)
    assert one.ds == one.length / len(one.markers)
    radii = np.hypot(*(one.markers - (0.25, -0.1)).T)
    np.testing.assert_allclose(radii, 0.5, rtol=1e-14)
    chords = np.hypot(*(one.markers - np.roll(one.markers, 1, axis=0)).T)
    np.testing.assert_allclose(chords, chords[0], rtol=1e-12)


def test_open_and_periodic_ones():
    _, _, (plate,) = begun(shape="plate", axes="0.1,0.3", center="0.5,0", angle="90")
    assert not plate.closed and plate.length == pytest.approx(0.6)
    assert plate.ds == plate.length / (len(plate.markers) - 1)
    np.testing.assert_allclose(plate.markers[[0, -1]], [(0.2, 0), (0.8, 0)], atol=1e-15)
    _, _, (line,) = begun(shape="line", amplitude="0", periodic="x", center="0,0.25", markers="50")
    assert line.closed and line.period == (4.0, 0.0) and line.length == pytest.approx(4.0)
    np.testing.assert_allclose(line.markers, np.stack(
        (-2 + 0.08 * np.arange(50), np.full(50, 0.25)), axis=1), atol=1e-12)
    assert line.ds == pytest.approx(0.08)


def test_given_points_become_even_markers():
    """Thinned or refined to the count; the curve through the points of a circle is one."""
    angle = np.sort(np.random.default_rng(2).uniform(0, 2 * np.pi, 300))
    points = 0.4 * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    for count in (40, 500):
        settings = options.read({**BOX, "marker_file": Points(points), "markers": str(count)})
        one, = outlines.first(settings, Grid((64, 32), settings.domain, PETSc.COMM_SELF))
        assert one.markers.shape == (count, 2)
        assert one.length == pytest.approx(0.8 * np.pi, rel=1e-3)
        chords = np.hypot(*(one.markers - np.roll(one.markers, 1, axis=0)).T)
        np.testing.assert_allclose(chords, chords.mean(), rtol=1e-3)


PLACES = {"vesicles": "2", "vesicle_0_center": "-0.8,0", "vesicle_1_center": "0.7,0.1",
          "axes": "0.3,0.4"}


def test_curves_laws_and_rest_of_several():
    """Each vesicle's own numbers at its own markers; laws that nobody asks for are not there."""
    settings, grid, parts = begun(
        **PLACES, vesicle_0_markers="60", vesicle_1_markers="50", sigma0="7", bending="0",
        vesicle_1_sigma0="9", vesicle_1_bending="0.5", vesicle_1_rest_length="0.25",
        vesicle_0_load="0,3")
    curves = outlines.curves_of(parts)
    assert curves.starts.tolist() == [0, 60, 110]
    markers = np.concatenate([one.markers for one in parts])
    stretch = curves.stretching(markers)
    rest = outlines.rest_of(settings, curves, stretch)
    assert (rest[:60] == stretch[:60]).all() and (rest[60:] == 0.25).all()
    laws, loads = outlines.laws_of(settings, grid, curves, rest, markers)
    assert [law.name for law in laws] == ["tension", "bending"] and len(loads) == 1
    tension = laws[0].tension(stretch)
    np.testing.assert_allclose(tension[:60], 0.0, atol=1e-12)
    np.testing.assert_allclose(tension[60:], 9 * (stretch[60:] - 0.25))
    laws, loads = outlines.laws_of(
        *begun(**PLACES, sigma0="0", bending="0", tether="2", contact="5")[:2],
        curves, rest, markers)
    assert [law.name for law in laws] == ["tether", "contact", "wall_contact"] and not loads


@pytest.mark.parametrize("words, text", [
    (dict(vesicle_1_center="-0.4,0"), "-vesicle_1_center -0.4,0: vesicle 1 meets vesicle 0"),
    (dict(vesicle_1_center="-0.8,0.02", vesicle_1_axes="0.1,0.1"), "vesicle 1 meets vesicle 0"),
    (dict(arrangement="random", vesicles="40", vesicle_0_center=None, vesicle_1_center=None),
     "-arrangement random: ")])
def test_places_that_do_not_do(words, text):
    with pytest.raises(InputError) as caught:
        begun(**{name: text for name, text in {**PLACES, **words}.items() if text})
    assert text in str(caught.value) and "allowed: " in str(caught.value)
