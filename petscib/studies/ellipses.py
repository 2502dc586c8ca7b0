"""Ellipses by their reduced area, and the markers that keep them point-symmetric."""

from functools import cache

import numpy as np

from ..membranes.shapes import ellipse_perimeter


def reduced_area(axes):
    """4 pi A / L^2, which is 1 for a circle."""
    return 4 * np.pi**2 * axes[0] * axes[1] / ellipse_perimeter(axes) ** 2


@cache
def ellipse_axes(reduced, perimeter):
    """Half axes (rx, ry), rx <= ry, of the ellipse of a reduced area and a perimeter."""
    low, high = 0.0, 1.0
    for _ in range(60):  # halvings, beyond round-off
        ratio = (low + high) / 2
        if reduced_area((ratio, 1.0)) < reduced:
            low = ratio
        else:
            high = ratio
    long_axis = perimeter / ellipse_perimeter((ratio, 1.0))
    return ratio * long_axis, long_axis


def even_markers(axes, cells, box=1.0, spacing=0.5):
    """An even number of markers: the vesicle is its own half turn, and stays so.

    Parameters
    ----------
    axes : (float, float)
    cells : int
        Across the box.
    box : float
        Its half width.
    spacing : float
        About how many cells apart.
    """
    return 2 * round(ellipse_perimeter(axes) / (2 * spacing * 2 * box / cells))
