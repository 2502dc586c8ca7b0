"""Curves from files: the forms that others write, points that repeat, crossings, and the time."""

import codecs
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from petscib.membranes.crossings import find_crossing
from petscib.membranes.curve_files import read_points
from petscib.membranes.splines import Spline

TURN = 2 * np.pi * np.arange(40) / 40
CURVE = np.stack((0.4 * np.cos(TURN), 0.3 * np.sin(TURN)), axis=1)


def rows(points=CURVE, between=" ", form="{!r}"):
    return "".join(between.join(map(form.format, point)) + "\n" for point in points.tolist())


def read(tmp_path, content):
    path = tmp_path / "curve"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_points(str(path))


# ---------------------------------------------------------------- forms

FORMS = {
    "blanks": rows(),
    "many blanks": rows(between="   ").replace("\n", "  \n  "),
    "tabs": rows(between="\t"),
    "commas": rows(between=", "),
    "semicolons": rows(between=" ; "),
    "a comma at the end": rows(between=",").replace("\n", ",\n"),
    "IBAMR": "40   # number of vertices, vertex range\n" + rows(),
    "IB2d, PetIBM": "40\n" + rows(between="\t"),
    "a header": "x,y\n" + rows(between=","),
    "a header of words": '"Points:0" "Points:1"\n'.replace("0", "x").replace("1", "y") + rows(),
    "a header and the number": "X Y\n40\n" + rows(),
    "the number and a header": "40\nX Y\n" + rows(),
    "comments": "# a\n% curve\n! here\n\n" + rows().replace("\n", " # point\n"),
    "Fortran's doubles": rows(form="{:.17E}").replace("E", "D"),
    "Fortran's doubles, small": rows(form="{:.17e}").replace("e", "d"),
    "line ends of DOS": rows().replace("\n", "\r\n"),
    "line ends of old": rows().replace("\n", "\r"),
    "a file's end of DOS": rows() + "\x1a",
    "no last line end": rows().rstrip(),
    "the first point again": rows(np.concatenate((CURVE, CURVE[:1]))),
    "a byte order mark": codecs.BOM_UTF8 + rows().encode(),
    "UTF-16": rows().encode("utf-16"),
    "UTF-16, big-endian": codecs.BOM_UTF16_BE + rows().encode("utf-16-be"),
    "a comment in Latin-1": "# Grenzfl\xe4che\n".encode("latin-1") + rows().encode(),
    "a comment in UTF-8": "# Grenzfl\xe4che \u03b3\n" + rows(),
}


@pytest.mark.parametrize("name", FORMS)
def test_forms(tmp_path, name):
    points, remark = read(tmp_path, FORMS[name])
    np.testing.assert_array_equal(points, CURVE)
    assert remark == ""


@pytest.mark.parametrize("content, message", [
    ("39\n" + rows(), "line 1 announces 39 points, and 40 follow"),
    ("# n\n41\n" + rows(), "line 2 announces 41 points, and 40 follow"),
    (rows(CURVE[:20]) + "40\n" + rows(CURVE[20:]), "line 21 (40) has 1 columns"),
    (rows(CURVE[:20]) + "x y\n" + rows(CURVE[20:]), "line 21 (x y) is not two numbers"),
    ("x y\nx y\n" + rows(), "line 2 (x y) is not two numbers"),
    ("x 0.1\n" + rows(), "line 1 (x 0.1) is not two numbers"),
    (rows(between=" 0.0 "), "has 3 columns instead of x and y"),
    (rows(between=",,"), "has 3 columns instead of x and y"),
    ("0,4; 0,3\n" + rows(), "line 1 (0,4; 0,3) has 4 columns"),
    (rows() + "1_0 2\n", "line 41 (1_0 2) is not two numbers"),
    (rows() + "0x1 2\n", "is not two numbers"),
    (rows() + "\u0661 2\n", "is not two numbers"),
    (rows() + "NaN 2\n", "line 41 (NaN 2) is not finite"),
    (rows() + "1D999 2\n", "line 41 (1D999 2) is not finite"),
    (rows() + "1e200 2\n", "line 41 (1e200 2) is beyond 1e+09"),
    (rows() + "0.1 " + "9" * 100 + "x\n", "line 41 (0.1 9999999999999999999999999"),
    (rows().encode("utf-16-le"), "not a text file"),
])
def test_what_cannot_be_read_is_named_by_its_line(tmp_path, content, message):
    with pytest.raises(ValueError) as caught:
        read(tmp_path, content)
    assert message in str(caught.value) and len(str(caught.value)) < 100


# ---------------------------------------------------------------- points that repeat


@pytest.mark.parametrize("count", [9, 33, 101, 2001])
@pytest.mark.parametrize("form", ["{!r}", "{:.8f}", "{:.8e}"])
@pytest.mark.parametrize("start", [0.0, 0.3, 2.0])
def test_a_closing_point_is_no_kink(tmp_path, count, form, start):
    """Against the curve through the same points without the closing one."""
    turn = np.linspace(start, start + 2 * np.pi, count)
    points = np.stack((0.4 * np.cos(turn), 0.3 * np.sin(turn)), axis=1)
    rest = Spline(points[:-1])
    noisy = points.copy()
    noisy[-1] += 3e-9
    for given_points in (points, noisy):
        found, _ = read(tmp_path, rows(given_points, form=form))
        assert len(found) == count - 1
        spline = Spline(found)
        assert spline.length == pytest.approx(rest.length, rel=1e-6)
        assert abs(spline.markers(50) - rest.markers(50)).max() < 1e-6


@pytest.mark.parametrize("copies, lines", [
    ({17: 1}, "the point of line 19 "), ({0: 1}, "the point of line 2 "),
    ({39: 1}, "the point of line 41 "), ({17: 2}, "2 points all but repeat others"),
    ({0: 2, 9: 1, 30: 3}, "6 points all but repeat others, and are left out (lines 2, 3, 13, ...)"),
])
@pytest.mark.parametrize("noise", [0.0, 1e-12, 1e-5])
def test_repeated_points_are_left_out_and_that_is_said(tmp_path, copies, lines, noise):
    random = np.random.default_rng(2)
    repeats = np.ones(len(CURVE), dtype=int)
    for index, more in copies.items():
        repeats[index] += more
    points = np.repeat(CURVE, repeats, axis=0)
    first = np.concatenate(([True], np.diff(np.repeat(np.arange(40), repeats)) > 0))
    points[~first] += noise * random.standard_normal(((~first).sum(), 2))
    found, remark = read(tmp_path, rows(points))
    np.testing.assert_array_equal(found, CURVE)
    assert lines in remark


def test_uneven_points_all_stay(tmp_path):
    """Dense where the curve bends, as airfoils have it, and a plate of long thin edges."""
    turn = 2 * np.pi * np.arange(60) / 60
    cosine = np.stack((0.5 * np.cos(turn), 0.02 * np.sin(turn)), axis=1)
    grading = 1.3 ** np.minimum(np.arange(40), np.arange(40)[::-1])
    graded = np.concatenate(([0], 2 * np.pi * np.cumsum(grading)[:-1] / grading.sum()))
    for points in (cosine, 0.3 * np.stack((np.cos(graded), np.sin(graded)), axis=1)):
        found, remark = read(tmp_path, rows(points))
        np.testing.assert_array_equal(found, points)
        assert remark == ""


def test_points_that_round_off_cannot_tell_apart(tmp_path):
    """Eight of them: no neighbours tell that they are the same."""
    points = CURVE * 1e8
    points[20:28] = points[20] + [0, -5e-9] * np.arange(8)[:, None]
    found, _ = read(tmp_path, rows(points))
    with pytest.raises(ValueError, match="too close together"):
        Spline(found)


# ---------------------------------------------------------------- crossings


def crossing_by_all_pairs(points):
    """The first two edges, by exact rational arithmetic, that meet without being neighbours."""
    from fractions import Fraction

    points = [tuple(map(Fraction, point)) for point in points]
    count = len(points)

    def side(a, b, p):
        area = (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
        return (area > 0) - (area < 0)

    for k in range(count):
        for m in range(k + 2, count - (k == 0)):
            a, b, c, d = (points[n % count] for n in (k, k + 1, m, m + 1))
            boxes = all(max(min(a[i], b[i]), min(c[i], d[i]))
                        <= min(max(a[i], b[i]), max(c[i], d[i])) for i in (0, 1))
            if boxes and side(a, b, c) * side(a, b, d) <= 0 and side(c, d, a) * side(c, d, b) <= 0:
                return k, m
    return None


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=3, max_size=14))
def test_crossings_of_small_polygons(points):
    """Whole numbers: touching, collinear and repeated points are common, and there is no error."""
    assert find_crossing(np.array(points, dtype=float)) == crossing_by_all_pairs(points)


@pytest.mark.parametrize("count", [3, 7, 8, 9, 100, 1023, 1024, 1025])
def test_a_star_does_not_cross_itself_until_two_points_are_exchanged(count):
    turn = 2 * np.pi * np.arange(count) / count
    radius = 1 + 0.5 * np.cos(7 * turn)
    points = radius[:, None] * np.stack((np.cos(turn), np.sin(turn)), axis=1)
    assert find_crossing(points) is None and find_crossing(points[::-1]) is None
    if count > 7:
        points[[2, 5]] = points[[5, 2]]
        assert find_crossing(points) == crossing_by_all_pairs(points.tolist())


def test_many_crossings_are_found_part_by_part(monkeypatch):
    from petscib.membranes import crossings

    points = np.random.default_rng(0).standard_normal((300, 2))
    whole = find_crossing(points)
    monkeypatch.setattr(crossings, "_MOST", 50)
    one, other = find_crossing(points)
    assert whole == crossing_by_all_pairs(points.tolist())
    assert other - one > 1 and crossing_by_all_pairs(points[[one, one + 1, other, other + 1]])


# ---------------------------------------------------------------- time


def test_the_time_grows_as_the_number_of_points(tmp_path):
    """Quadratic work would take sixteen times as long, and did take 42 s for the second."""
    seconds = []
    for count in (12_500, 50_000):
        turn = 2 * np.pi * np.arange(count) / count
        radius = 0.3 + 0.1 * np.cos(20 * turn)
        points = radius[:, None] * np.stack((np.cos(turn), np.sin(turn)), axis=1)
        text = rows(points)
        began = time.process_time()
        found, _ = read(tmp_path, text)
        Spline(found).markers(2000)
        seconds.append(time.process_time() - began)
        assert len(found) == count
    assert seconds[1] < 5 and seconds[1] < 8 * max(seconds[0], 0.1)
