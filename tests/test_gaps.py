"""Distances between membranes and to walls, and membranes that have crossed."""
from types import SimpleNamespace

import numpy as np
import pytest

from petscib.membranes import gaps, geometry, shapes
from petscib.membranes.curves import Curves
from petscib.membranes.gaps import Gaps

BOX = (-1.0, 1.0, -1.0, 1.0)


def grid(periodic=(False, False)):
    return SimpleNamespace(domain=BOX, periodic=periodic)


def gap_of(parts, periodic=(False, False), closed=None, periods=None):
    spacings = [geometry.perimeter(part) / len(part) for part in parts]
    curves = Curves([len(part) for part in parts], spacings, closed, periods)
    return Gaps(curves, grid(periodic)).measure(np.concatenate(parts))


def to_edges(points, polygon):
    """Smallest distance of points to a closed polygon's edges, all of them looked at."""
    along = np.roll(polygon, -1, axis=0) - polygon
    towards = points[:, None] - polygon
    part = np.clip((towards * along).sum(axis=2) / (along**2).sum(axis=1), 0, 1)
    return np.linalg.norm(towards - part[:, :, None] * along, axis=2).min()


def by_brute_force(one, other, periodic=(False, False)):
    """Smallest distance between two polygons and all images of the second."""
    images = [other + (i, j) for i in (-2, 0, 2) for j in (-2, 0, 2)
              if (i == 0 or periodic[0]) and (j == 0 or periodic[1])]
    return min(min(to_edges(one, image), to_edges(image, one)) for image in images)


@pytest.mark.parametrize("periodic", [(False, False), (True, False), (False, True), (True, True)])
def test_the_smallest_of_all_distances(periodic):
    generator = np.random.default_rng(7)
    for _ in range(12):
        parts = []
        for cx in (-0.55, 0.0, 0.55):
            for cy in (-0.5, 0.5):
                move = generator.uniform(-0.05, 0.05, 2) + 2 * np.array(periodic) * \
                    generator.integers(-2, 3, 2)
                axes, angle = generator.uniform(0.06, 0.2, 2), generator.uniform(0, 180)
                parts.append(shapes.ellipse(axes, (cx, cy) + move, angle,
                                            int(generator.integers(20, 50))))
        found = gap_of(parts, periodic)
        home = [part - 2 * np.array(periodic) * np.round(part.mean(axis=0) / 2) for part in parts]
        pairs = {(i, j): by_brute_force(home[i], home[j], periodic)
                 for i in range(6) for j in range(i + 1, 6)}
        nearest = min(pairs, key=pairs.get)
        walls = [1 - abs(part[:, axis]).max() for part in home for axis in (0, 1)
                 if not periodic[axis]]
        assert found.distance == pytest.approx(min([pairs[nearest], *walls]), abs=1e-12)
        if pairs[nearest] < min(walls, default=np.inf):
            assert found.between == found.distance and found.pair == nearest
        assert found.crossed is None


def test_between_markers_the_edge_is_nearer():
    square = np.array([[0.0, 0], [0.2, 0], [0.4, 0], [0.4, 0.2], [0.4, 0.4], [0.2, 0.4], [0, 0.4],
                       [0, 0.2]])
    tip = shapes.ellipse((0.05, 0.2), (0.1, -0.25), 0, 40)  # points at the middle of an edge
    assert gap_of([square, tip]).between == pytest.approx(0.05, abs=1e-12)
    assert gap_of([tip, square]).between == pytest.approx(0.05, abs=1e-12)


def test_one_membrane_has_walls_only():
    part = shapes.ellipse((0.1, 0.2), (0.3, 0.0), 0, 40)
    found = gap_of([part])
    assert found.distance == pytest.approx(0.6) and found.pair is None
    assert gap_of([part], (True, False)).distance == pytest.approx(0.8)


@pytest.mark.parametrize("angle", [0, 25, 60, 137])
@pytest.mark.parametrize("periodic", [(True, False), (False, True), (True, True)])
def test_a_membrane_meets_images_of_itself(periodic, angle):
    part = shapes.ellipse((0.1, 0.93), (0.3, 0.0), angle, 80)
    moves = [np.array((2.0 * i, 2.0 * j)) for i in (-1, 0, 1) for j in (-1, 0, 1)
             if (i or j) and (periodic[0] or not i) and (periodic[1] or not j)]
    expected = min(to_edges(part, part + move) for move in moves)
    walls = [1 - abs(part[:, axis]).max() for axis in (0, 1) if not periodic[axis]]
    found = gap_of([part], periodic)
    assert found.distance == pytest.approx(min([expected, *walls]), abs=1e-12)
    assert found.crossed is None
    if expected < min(walls, default=np.inf):
        assert found.between == found.distance and found.pair == (0, 0)
    long = shapes.ellipse((0.1, 1.1), (0.3, 0.0), 0 if periodic[1] else 90, 200)
    assert gap_of([long], periodic).crossed == (0, 0)


@pytest.mark.parametrize("periodic", [(True, False), (True, True)])
def test_a_line_across_the_box_does_not_meet_what_goes_on_with_it(periodic):
    line, _ = shapes.line((-1, 0.2), (1, 0.2), 0.0, 60)
    found = gap_of([line], periodic, periods=[(2, 0)])
    assert found.distance == pytest.approx(2.0 if periodic[1] else 0.8) and not found.crossed


@pytest.mark.parametrize("reach, crossed", [(0.19, None), (0.21, (0, 1)), (0.3, (0, 1))])
def test_crossing(reach, crossed):
    one, other = (shapes.ellipse((reach / 2, 0.3), (x, 0.01 * x), 0, 80) for x in (-0.1, 0.1))
    far = shapes.ellipse((0.05, 0.05), (0.6, 0.6), 0, 20)
    assert gap_of([one, other, far]).crossed == crossed
    assert gap_of([far, one, other]).crossed == (crossed and (1, 2))
    moved = other + (4.0, 0.0)
    assert gap_of([one, moved, far], (True, False)).crossed == crossed


def test_a_vesicle_crosses_the_joint_of_a_line():
    line, _ = shapes.line((-1, 0), (1, 0), 0.0, 60)
    for x in (-1.0, 0.98, 0.4):
        for y, crossed in ((0.15, None), (0.05, (0, 1))):
            part = shapes.ellipse((0.1, 0.1), (x, y), 0, 40)
            found = gap_of([line, part], (True, False), periods=[(2, 0), (0, 0)])
            assert found.crossed == crossed, (x, y)
            if crossed is None:
                assert found.between == pytest.approx(0.05, abs=1e-9)


def test_an_open_curve_has_no_edge_from_end_to_end():
    plate = np.array([[-0.5, 0.0], [-0.3, 0.4], [0, 0.5], [0.3, 0.4], [0.5, 0.0], [0.6, -0.1],
                      [0.7, -0.2], [0.8, -0.3]])
    part = shapes.ellipse((0.05, 0.05), (0.0, 0.0), 0, 40)
    closed, opened = (gap_of([plate, part], closed=[shut, True]) for shut in (True, False))
    assert opened.between > 0.3 > closed.between and opened.crossed is None


def test_asked_again_it_remembers(monkeypatch):
    parts = [shapes.ellipse((0.1, 0.1), (x, 0), 0, 20) for x in (-0.3, 0.3)]
    curves, markers = Curves([20, 20], [0.1, 0.1]), np.concatenate(parts)
    measured = Gaps(curves, grid())
    first = measured.measure(markers)
    monkeypatch.setattr(measured, "_measure", lambda markers: None)
    assert measured.measure(markers) is first
    assert measured.measure(markers.copy()) is None


def test_inside():
    polygon = shapes.ellipse((0.1, 0.5), (0.2, 0.0), 30, 50)
    for backwards in (False, True):
        polygon = polygon[::-1] if backwards else polygon
        assert gaps.contains(polygon, (0.2, 0.0)) and gaps.contains(polygon, (0.0, 0.3))
        assert not gaps.contains(polygon, (0.4, 0.3)) and not gaps.contains(polygon, (0.2, 0.6))
