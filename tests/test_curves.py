"""Curves of markers: who follows whom, and differences along all of them at once."""
import dense
import numpy as np
import pytest

from petscib.membranes.curves import Curves

COUNTS, SPACINGS, CLOSED = (9, 6, 12), (0.2, 0.3, 0.1), (True, False, True)
PERIOD = (0.0, 0.0), (0.0, 0.0), (2.0, -1.0)  # the last crosses a periodic box


@pytest.fixture
def curves():
    return Curves(COUNTS, SPACINGS, CLOSED, PERIOD)


@pytest.fixture
def markers():
    return np.random.default_rng(1).standard_normal((sum(COUNTS), 2))


def each(values):
    """Parts of an array over the markers, cut by hand."""
    return values[:9], values[9:15], values[15:]


def edges(part, closed, period):
    """Differences of neighbours, one by one."""
    joined = [part[k] - part[k - 1] for k in range(1, len(part))]
    return [part[0] + period - part[-1], *joined] if closed else joined


def test_numbers_of_markers_and_half_points(curves):
    assert curves.count == 3
    assert curves.starts.tolist() == [0, 9, 15, 27]
    assert curves.edge_starts.tolist() == [0, 9, 14, 26]
    assert curves.owner.tolist() == [0] * 9 + [1] * 6 + [2] * 12
    assert curves.ds.tolist() == [0.2] * 9 + [0.3] * 6 + [0.1] * 12
    assert curves.edge_ds.tolist() == [0.2] * 9 + [0.3] * 5 + [0.1] * 12
    assert curves.closed.tolist() == [True] * 9 + [False] * 6 + [True] * 12
    assert curves.encloses.tolist() == [True, False, False]


def test_neighbours(curves):
    assert curves.before[[0, 1, 9, 10, 15]].tolist() == [8, 0, 9, 9, 26]
    assert curves.after[[8, 7, 14, 13, 26]].tolist() == [0, 8, 14, 14, 15]
    assert curves.edges[[0, 1, 9, 13, 14]].tolist() == [
        [8, 0], [0, 1], [9, 10], [13, 14], [26, 15]]
    assert [[9, 10, 11], [12, 13, 14]] == curves.triples[[9, 12]].tolist()
    assert len(curves.triples) == 9 + 4 + 12
    assert curves.triples[[0, 8, -1]].tolist() == [[8, 0, 1], [7, 8, 0], [25, 26, 15]]


def test_differences_along_each_curve(curves, markers):
    expected = [edge for part, closed, period in zip(each(markers), CLOSED, PERIOD)
                for edge in edges(part, closed, np.array(period))]
    np.testing.assert_allclose(curves.edge_vectors(markers), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        curves.stretching(markers), np.hypot(*np.transpose(expected)) / curves.edge_ds, rtol=1e-14)


def test_chords(curves, markers):
    found = each(curves.chords(markers))
    for part, chords, closed, period in zip(each(markers), found, CLOSED, PERIOD):
        for k in range(1, len(part) - 1):
            np.testing.assert_allclose(chords[k], part[k + 1] - part[k - 1], rtol=0, atol=1e-15)
        if closed:
            np.testing.assert_allclose(chords[0], part[1] - part[-1] + period, atol=1e-15)
            np.testing.assert_allclose(chords[-1], part[0] - part[-2] + period, atol=1e-15)
        else:
            np.testing.assert_array_equal(chords[[0, -1]], [part[1] - part[0], part[-1] - part[-2]])


def test_one_closed_curve_has_the_differences_of_the_paper(markers):
    curves = Curves([27], [0.2])
    table = dense.to_half_points(27, 0.2)
    np.testing.assert_allclose(curves.edge_vectors(markers) / 0.2, table @ markers, atol=1e-13)


def test_sums_and_parts(curves):
    at_markers, at_half = np.arange(27.0) ** 2, np.arange(26.0) ** 2
    assert curves.sums(at_markers).tolist() == [part.sum() for part in each(at_markers)]
    pairs = np.stack((at_markers, -at_markers), axis=1)
    assert curves.sums(pairs).tolist() == [[s, -s] for s in curves.sums(at_markers)]
    assert curves.edge_sums(at_half).tolist() == [
        at_half[:9].sum(), at_half[9:14].sum(), at_half[14:].sum()]
    assert [len(part) for part in curves.parts(at_markers)] == list(COUNTS)
    assert [len(part) for part in curves.edge_parts(at_half)] == [9, 5, 12]
    assert curves.spread(np.array([3.0, 4.0, 5.0])).tolist() == [3.0] * 9 + [4.0] * 6 + [5.0] * 12
    curves.parts(at_markers)[1][:] = -1.0  # a view
    assert (at_markers[9:15] == -1.0).all()


def test_a_rank_without_markers():
    curves, nothing = Curves([], []), np.zeros((0, 2))
    assert curves.count == 0 and curves.edges.shape == (0, 2) and curves.triples.shape == (0, 3)
    assert curves.edge_vectors(nothing).shape == (0, 2) == curves.chords(nothing).shape
    assert curves.stretching(nothing).shape == curves.sums(nothing[:, 0]).shape == (0,)
    assert curves.parts(nothing) == [] == curves.edge_parts(nothing)
