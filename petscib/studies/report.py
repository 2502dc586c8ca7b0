"""What the studies leave: CSV, Markdown tables and pictures."""

import csv
from contextlib import contextmanager

from ..output import style
from ..output.files import replacing
from ..output.style import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION

# Of series that are no schemes, which have looks of their own (`schemes.registry`).
SERIES_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)


def number(value, digits=3):
    """A number for a table: short, and a dash where there is none."""
    if value is None or value != value:
        return "-"
    if value == 0:
        return "0"
    if 0.01 <= abs(value) < 10 ** max(digits, 4):
        return f"{float(f'{value:.{digits}g}'):g}"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def with_range(values, shown=True):
    """A value for a table, and in brackets the least and largest; a dash for None."""
    if values is None:
        return "-"
    value, low, high = values
    return f"{value:.4g}" + (f" ({low:.4g} to {high:.4g})" if shown else "")


def duration(seconds):
    """A time span in words."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def markdown_table(header, rows):
    """A table in Markdown; entries are texts."""
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def write_csv(path, columns, rows):
    """Replace a CSV file; None becomes an empty field."""
    with replacing(path) as part, open(part, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


@contextmanager
def picture(path, width, height, rows=1, columns=1, **keywords):
    """A figure and its array of axes, written to a PNG file when the block ends.

    Parameters
    ----------
    path : str
    width, height : float
        Inches.
    rows, columns : int
    **keywords
        For matplotlib's `Figure.subplots`.
    """
    with style.picture(path, width, height) as figure:
        yield figure, figure.subplots(rows, columns, squeeze=False, **keywords)


def cells_axis(axis, cells):
    """A logarithmic axis of grids, with a tick for each."""
    axis.set_xscale("log")
    axis.set_xlabel("cells across")
    axis.set_xticks(cells, [str(count) for count in cells])
    axis.minorticks_off()


def legend_below(figure, axis, columns):
    """One legend for all panels, under them."""
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=columns)
