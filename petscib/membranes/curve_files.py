"""Closed curves from text files, as other immersed boundary codes write them.

Read are one point a line, with blanks, tabs, commas or semicolons between x and y; before the
points their number (IBAMR, IB2d, PetIBM), a line of names, or both; comments after #, % or !;
Fortran's exponents; UTF-8, UTF-16 with its byte order mark, and Latin-1.
"""

import codecs
import re

import numpy as np
from scipy.ndimage import median_filter

from ..errors import shortened
from .crossings import find_crossing

FEWEST_POINTS = 8  # fewer would not show a shape
LARGEST = 1e9  # coordinate: no box is larger
# A point this much closer to the one before it than its neighbours are to each other, is the same
# point but for rounding, or at least draws no part of the curve.
_SAME = 0.01
_NEIGHBOURS = 7  # gaps, of which the median is what is usual there

ALLOWED = (
    "a text file, x and y of one point a line with blanks, tabs, commas or semicolons between "
    "(before them at most their number and a line of names; comments after #, % or !), along a "
    "closed curve that does not cross itself"
)

_NUMBER = re.compile(
    r"[+-]?((\d+\.?\d*|\.\d+)([ed][+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.IGNORECASE
)


def read_points(path):
    """Points of a closed curve from a text file.

    The last point may repeat the first. Points that repeat the one before them but for rounding
    are left out.

    Parameters
    ----------
    path : str

    Returns
    -------
    points : ndarray, shape (N, 2)
    remark : str
        What was left out, in words; an empty text if nothing was.

    Raises
    ------
    ValueError
        For anything that is not a simple closed curve, with the line at fault.
    """
    return _simple(*_parse(_text(path)), "line")


def points_of(array):
    """The same from an array; ValueErrors name the row at fault, counted from 0."""
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"its shape is {array.shape} instead of (N, 2)")
    wrong = np.flatnonzero(~(np.abs(array) <= LARGEST).all(axis=1))
    if len(wrong):
        raise ValueError(f"row {wrong[0]} is not finite, or beyond {LARGEST:g}")
    return _simple(array, np.arange(len(array)), "row")


def _simple(points, lines, word):
    """What `read_points` returns, from points and the numbers of their lines or rows."""
    if len(points) > 1 and (points[0] == points[-1]).all():
        points, lines = points[:-1], lines[:-1]
    kept = _distinct(points)
    left_out, points, lines = np.delete(lines, kept), points[kept], lines[kept]
    if len(points) < FEWEST_POINTS:
        raise ValueError(f"{len(points)} points, and a closed curve needs {FEWEST_POINTS}")
    _, index, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    first = index[place.ravel()]
    twice = np.flatnonzero(first != np.arange(len(points)))
    if len(twice):
        raise ValueError(f"the point of {word} {lines[first[twice[0]]]} again in {word} "
                         f"{lines[twice[0]]}")
    crossing = find_crossing(points)
    if crossing:
        one, other = lines[list(crossing)]
        raise ValueError(f"the curve crosses itself, after {word}s {one} and {other}")
    return points, _remark(left_out, word)


def _text(path):
    with open(path, "rb") as file:
        content = file.read()
    utf16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    text = text.rstrip("\x1a")  # DOS ended files with it
    if re.search("[\0-\x08\x0e-\x1f]", text):
        raise ValueError("not a text file")
    return text


def _parse(text):
    """Points, shape (N, 2), and the numbers of their lines."""
    points, lines = [], []
    count = names = None
    for number, line in enumerate(re.split("\r\n|\r|\n", text), 1):
        line = re.split("[#%!]", line, maxsplit=1)[0].strip().rstrip(",;")
        if not line:
            continue
        words = re.split(r"\s*[,;]\s*|\s+", line)
        if not points and count is None and len(words) == 1 and words[0].isdecimal():
            count = number, int(words[0])
        elif not points and names is None and not any(map(_NUMBER.fullmatch, words)):
            names = number
        else:
            points.append(_point(line, words, number))
            lines.append(number)
    if count is not None and count[1] != len(points):
        raise ValueError(f"line {count[0]} announces {count[1]} points, and {len(points)} follow")
    return np.array(points).reshape(-1, 2), np.array(lines, dtype=int)


def _point(line, words, number):
    shown = shortened(line, 40)
    if len(words) != 2:
        raise ValueError(f"line {number} ({shown}) has {len(words)} columns instead of x and y")
    if not all(map(_NUMBER.fullmatch, words)):
        raise ValueError(f"line {number} ({shown}) is not two numbers")
    point = [float(word.lower().replace("d", "e")) for word in words]
    if not np.isfinite(point).all():
        raise ValueError(f"line {number} ({shown}) is not finite")
    if max(map(abs, point)) > LARGEST:
        raise ValueError(f"line {number} ({shown}) is beyond {LARGEST:g}")
    return point


def _distinct(points):
    """Numbers of the points that remain when those that repeat another are left out."""
    kept = np.arange(len(points))
    while len(kept) >= FEWEST_POINTS:
        steps = np.roll(points[kept], -1, axis=0) - points[kept]
        gaps = np.hypot(*steps.T)
        usual = median_filter(gaps, _NEIGHBOURS, mode="wrap")
        same = np.flatnonzero(gaps < _SAME * usual)
        if not len(same):
            break
        # Of two the second goes, but the first point of the file stays.
        kept = np.delete(kept, np.minimum(same + 1, len(kept) - 1))
    return kept


def _remark(lines, word):
    if not len(lines):
        return ""
    shown = ", ".join(map(str, lines[:3])) + (", ..." if len(lines) > 3 else "")
    if len(lines) == 1:
        return f"the point of {word} {shown} all but repeats another, and is left out"
    return f"{len(lines)} points all but repeat others, and are left out ({word}s {shown})"
