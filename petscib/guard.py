"""Checks on a new state before it is accepted."""

import numpy as np
from mpi4py import MPI

from .errors import SolveError


def check(problem, state):
    """Refuse a state that is not finite, or whose markers came too near a wall.  Collective.

    Raises
    ------
    SolveError
        On all ranks, naming what went wrong.
    """
    grid = problem.grid
    finite = np.isfinite(state.velocity.norm()) and np.isfinite(state.pressure.norm())
    why = "" if finite else "the velocity or the pressure is no longer finite"
    if not why and problem.membrane is not None and len(state.markers):
        why = _marker_trouble(problem, state.markers)
    why = grid.comm.tompi4py().allreduce(why, op=MPI.MAX)
    if why:
        raise SolveError(why)


def _marker_trouble(problem, markers):
    if not np.isfinite(markers).all():
        return "the markers are no longer finite"
    a, b, c, d = problem.grid.domain
    low = np.array([a, c])
    high = np.array([b, d])
    reach = problem.kernel.reach * np.array([problem.grid.dx, problem.grid.dy])
    gap = np.minimum(markers - low, high - markers) - reach
    if (gap >= 0).all():
        return ""
    marker, axis = np.unravel_index(np.argmin(gap), gap.shape)
    where = ", ".join(f"{x:.4g}" for x in markers[marker])
    return f"marker {marker} at ({where}) is outside the box or within the delta function's " \
        f"reach of a wall in {'xy'[axis]}"
