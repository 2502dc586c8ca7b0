"""Checks on a new state before it is accepted, and on markers before the fluid meets them."""

import numpy as np

from .errors import SolveError, WallError

NEAR = 1.0  # vesicle radii beyond a wall's reach: as far as the flow may carry it in a step


def check(problem, state):
    """Refuse a state that is not finite, or whose markers came too near a wall.  Not collective.

    Raises
    ------
    SolveError
        On the ranks that see what went wrong, naming it.
    """
    for name, vector in (("velocity", state.velocity), ("pressure", state.pressure)):
        if not np.isfinite(vector.getArray(readonly=True)).all():
            raise SolveError(f"the {name} is no longer finite")
    check_markers(problem, state.markers)


def check_markers(problem, markers):
    """Refuse markers that are not finite, or too near a wall to see the fluid.  Not collective.

    Raises
    ------
    SolveError
        On the rank that has the markers.
    """
    if not len(markers):
        return
    if not np.isfinite(markers).all():
        raise SolveError("the markers are no longer finite")
    a, b, c, d = problem.grid.domain
    low, high = np.array([a, c]), np.array([b, d])
    reach = problem.kernel.reach * np.array([problem.grid.dx, problem.grid.dy])
    gaps = np.stack((markers - low, high - markers)) - reach
    gaps[:, :, np.array(problem.grid.periodic)] = np.inf
    if (gaps >= 0).all():
        return
    side, marker, axis = np.unravel_index(np.argmin(gaps), gaps.shape)
    wall = f"{'xy'[axis]} = {problem.grid.domain[2 * axis + side]:.4g}"
    where = ", ".join(f"{x:.4g}" for x in markers[marker])
    radius = np.ptp(markers, axis=0).min() / 2
    if gaps.min() > -NEAR * radius and (np.ptp(markers, axis=0) < high - low).all():
        raise WallError(
            f"the vesicle has come to the wall {wall}, where the box ends: marker {marker} is at "
            f"({where}), and the delta function reaches {reach[axis]:.3g}"
        )
    raise SolveError(f"marker {marker} was thrown to ({where}), beyond the wall {wall}")
