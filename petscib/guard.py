"""Checks on a new state before it is accepted, and on markers before the fluid meets them."""

import numpy as np

from .errors import CrossingError, SolveError, WallError

CLOSE = 1.0  # cells between two membranes: less than the delta function reaches from either
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
    check_crossing(problem, state.markers)


def check_markers(problem, markers):
    """Refuse markers that are not finite, fallen together, or too near a wall to see the fluid.

    Not collective.

    Raises
    ------
    SolveError
        On the rank that has the markers.
    """
    if not len(markers):
        return
    if not np.isfinite(markers).all():
        raise SolveError("the markers are no longer finite")
    curves = problem.membranes.curves
    _check_tangents(curves, markers)
    a, b, c, d = problem.grid.domain
    low, high = np.array([a, c]), np.array([b, d])
    reach = problem.reach * np.array([problem.grid.dx, problem.grid.dy])
    gaps = np.stack((markers - low, high - markers)) - reach
    periodic = np.array(problem.grid.periodic)
    gaps[:, :, periodic] = np.inf
    if (gaps >= 0).all():
        return
    side, marker, axis = np.unravel_index(np.argmin(gaps), gaps.shape)
    wall = f"{'xy'[axis]} = {problem.grid.domain[2 * axis + side]:.4g}"
    where = ", ".join(f"{x:.4g}" for x in markers[marker])
    vesicle = int(curves.owner[marker])
    size = np.ptp(curves.parts(markers)[vesicle], axis=0)
    name = f"vesicle {vesicle}" if curves.count > 1 else "the vesicle"
    if gaps.min() > -NEAR * size.min() / 2 and (size < high - low)[~periodic].all():
        raise WallError(
            f"{name} has come to the wall {wall}, where the box ends: marker {marker} is at "
            f"({where}), and the delta function reaches {reach[axis]:.3g}"
        )
    raise SolveError(f"marker {marker} was thrown to ({where}), beyond the wall {wall}")


def _check_tangents(curves, markers):
    """Refuse curves that have no tangent at a marker, or between two."""
    for first, second, vectors in (
            (*curves.edges.T, curves.edge_vectors(markers)),
            (curves.before, curves.after, curves.chords(markers))):
        same = np.flatnonzero(~vectors.any(axis=1))
        if len(same):
            raise SolveError(f"markers {first[same[0]]} and {second[same[0]]} have come to the "
                             "same place")


def check_crossing(problem, markers):
    """Refuse membranes that have crossed each other or images of their own.  Not collective.

    Raises
    ------
    CrossingError
        On the rank that has the markers.
    """
    if not len(markers):
        return
    pair = problem.gaps.measure(markers).crossed
    if pair and pair[0] == pair[1]:
        raise CrossingError(f"the membrane of vesicle {pair[0]} has crossed its own image across "
                            "a periodic side")
    if pair:
        raise CrossingError(f"the membranes of vesicles {pair[0]} and {pair[1]} have crossed")


def near(problem, markers):
    """A warning where the flow between two membranes is not resolved, or an empty text."""
    if not len(markers):
        return ""
    gap = problem.gaps.measure(markers)
    cells = gap.between / max(problem.grid.dx, problem.grid.dy)
    if not cells < CLOSE:
        return ""
    if gap.pair[0] == gap.pair[1]:
        return (f"vesicle {gap.pair[0]} is {cells:.2g} cells from its own image across a periodic "
                f"side; below {CLOSE:g} the flow between them is not resolved")
    return (f"vesicles {gap.pair[0]} and {gap.pair[1]} are {cells:.2g} cells apart; below "
            f"{CLOSE:g} the flow between them is not resolved, and -contact keeps them apart")
