"""Entries of a row of diagnostics, whatever the number of vesicles."""

import math


def is_number(value):
    """Whether there is a value, and a finite one."""
    return value is not None and math.isfinite(value)


def entries(row, name):
    """The entries of a column: one, or with several vesicles those of name_0, name_1, ...

    Of a table, a mapping of columns, the columns.
    """
    if name in row:
        return [row[name]]
    values = []
    while f"{name}_{len(values)}" in row:
        values.append(row[f"{name}_{len(values)}"])
    return values


def entry(row, name):
    """The entry of a column; with several vesicles the largest in size; None if there is none."""
    return largest(entries(row, name))


def largest(values):
    """The largest in size, None left out; None if there is none."""
    # A NaN is worse than any number and must not hide behind one.
    return max((value for value in values if value is not None),
               key=lambda v: math.inf if math.isnan(v) else abs(v), default=None)
