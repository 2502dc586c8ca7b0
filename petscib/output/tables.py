"""Append-only tables of a run: one line a row, written by rank 0, readable while it grows.

A run that is killed can tear at most the last line. Readers ignore a line without its newline, and
:meth:`Table.resume` removes it. Numbers are written with the fewest digits that read back to the
same double; an empty field means that the quantity does not apply.
"""

import os
from collections.abc import Mapping
from numbers import Integral

import numpy as np

from .files import replacing

OUTLINE_KEYS = ("step", "time", "vesicle")


class Table:
    """A comma-separated text file that grows by whole lines. Not collective: rank 0 only.

    Parameters
    ----------
    path : str or path
        File to start; an older one of this name is replaced.
    columns : sequence of str
        Names for the header line.
    """

    def __init__(self, path, columns):
        self._attach(path, columns, "w")
        self._write_fields(self.columns)

    @classmethod
    def resume(cls, path, columns, step):
        """Continue the table of an earlier run from one of its steps.

        Rows of later steps and a torn last line are dropped. The shortened table is written under
        a temporary name and renamed, so a crash here loses nothing. A file that does not exist, or
        that was torn within its header, is started anew.

        Parameters
        ----------
        path : str or path
        columns : sequence of str
            The columns of this run; one of them is ``step``.
        step : int
            Last step to keep.

        Returns
        -------
        Table

        Raises
        ------
        ValueError
            If the file's columns differ from `columns`, or a line inside it is damaged.
        """
        columns = list(columns)
        lines = _fields(path) if os.path.exists(path) else iter(())
        header = next(lines, None)
        if header is None:
            return cls(path, columns)
        if header != columns:
            raise ValueError(f"{path}: {_difference(header, columns)}")
        key = columns.index("step")
        with replacing(path) as shortened, open(shortened, "w", newline="\n") as file:
            file.write(",".join(header) + "\n")
            for row in lines:
                if _numbers(path, [row[key]])[0] <= step:
                    file.write(",".join(row) + "\n")
        table = cls.__new__(cls)
        table._attach(path, columns, "a")
        return table

    def _attach(self, path, columns, mode):
        self.path = os.fspath(path)
        self.columns = list(columns)
        self._file = open(self.path, mode, newline="\n")

    def write(self, row):
        """Append one row and hand it to the operating system at once.

        Parameters
        ----------
        row : mapping of column name to number, or sequence of numbers in column order
            None, or a column missing from the mapping, gives an empty field. A NaN is a number
            that went wrong and is written as ``nan``.

        Raises
        ------
        ValueError
            If a mapping has a name that is no column, or a sequence has the wrong length.
        """
        if isinstance(row, Mapping):
            unknown = [name for name in row if name not in self.columns]
            if unknown:
                raise ValueError(f"{self.path}: no such column: {', '.join(unknown)}")
            row = [row.get(name) for name in self.columns]
        elif len(row) != len(self.columns):
            raise ValueError(f"{self.path}: {len(row)} numbers for {len(self.columns)} columns")
        self._write_fields([_text(value) for value in row])

    def _write_fields(self, fields):
        try:
            self._file.write(",".join(fields) + "\n")
            self._file.flush()
        except OSError as error:  # which does not know the file's name
            raise OSError(error.errno, error.strerror, self.path) from None

    def sync(self):
        """Wait until all rows are on the disk."""
        os.fsync(self._file.fileno())

    def close(self):
        """Close the file. May be called twice."""
        self._file.close()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.close()


def outline_columns(markers):
    """Columns of ``outlines.csv`` for vesicles of up to `markers` markers."""
    return [*OUTLINE_KEYS, *(f"{axis}{k}" for k in range(markers) for axis in "xy")]


def outline_row(step, time, vesicle, X, markers):
    """Row of ``outlines.csv`` for one outline.

    Parameters
    ----------
    step : int
    time : float
    vesicle : int
    X : ndarray, shape (M, 2)
        Marker positions.
    markers : int
        Marker count of the largest vesicle, as given to :func:`outline_columns`. The row of a
        smaller one ends in empty fields, so that the file stays rectangular.

    Returns
    -------
    list
    """
    coordinates = np.asarray(X, dtype=float).ravel().tolist()
    return [step, time, vesicle, *coordinates, *[None] * (2 * markers - len(coordinates))]


def read(path):
    """Read a table.

    Returns
    -------
    dict of str to ndarray of float, shape (rows,)
        In column order; NaN where a field is empty. Without columns if even the header is torn.

    Raises
    ------
    ValueError
        If a line inside the file is damaged; it is named.
    """
    lines = _fields(path)
    header = next(lines, [])
    rows = [_numbers(path, row) for row in lines]
    values = np.array(rows, dtype=float).reshape(len(rows), len(header))
    return {name: values[:, column] for column, name in enumerate(header)}


def read_outlines(path):
    """Read ``outlines.csv``.

    Returns
    -------
    list of (step, time, vesicle, X)
        In file order; X is an ndarray of shape (M, 2).

    Raises
    ------
    ValueError
        If this is not a table of outlines, or a line inside it is damaged.
    """
    lines = _fields(path)
    header = next(lines, None)
    if header is None:
        return []
    if tuple(header[:3]) != OUTLINE_KEYS:
        raise ValueError(f"{path}: not a table of outlines, its header begins with {header[:3]}")
    outlines = []
    for row in lines:
        while row[-1] == "":
            row.pop()
        step, time, vesicle, *coordinates = _numbers(path, row)
        outlines.append((int(step), time, int(vesicle), np.array(coordinates).reshape(-1, 2)))
    return outlines


def _fields(path):
    """Yield the fields of each whole line, header first; an unfinished last line is left out."""
    with open(path, newline="\n") as file:
        width = None
        for number, line in enumerate(file, 1):
            if not line.endswith("\n"):
                return
            fields = line[:-1].split(",")
            width = width or len(fields)
            if len(fields) != width:
                raise ValueError(
                    f"{path}, line {number}: {len(fields)} fields, the header has {width}"
                )
            yield fields


def _numbers(path, fields):
    try:
        return [float(field) if field else np.nan for field in fields]
    except ValueError as error:
        raise ValueError(f"{path}, row of step {fields[0]}: {error}") from None


def _text(value):
    if value is None:
        return ""
    if isinstance(value, float) or not isinstance(value, Integral):
        return repr(float(value))
    return str(int(value))


def _difference(found, expected):
    """Say in words how the columns of a file differ from those expected."""
    parts = []
    for word, names in (
        ("lacks", [name for name in expected if name not in found]),
        ("has in addition", [name for name in found if name not in expected]),
    ):
        if names:
            more = f" and {len(names) - 4} more" if len(names) > 4 else ""
            parts.append(f"{word} {', '.join(names[:4])}{more}")
    detail = " and ".join(parts) or "has them in another order"
    return f"the file's columns are not those of this run: it {detail}"
