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
    comm = problem.grid.comm.tompi4py()
    why = _fluid_trouble(state) or _marker_trouble(problem, state.markers)
    if comm.allreduce(int(bool(why)), op=MPI.MAX):
        raise SolveError(next(filter(None, comm.allgather(why))))


def _fluid_trouble(state):
    for name, vector in (("velocity", state.velocity), ("pressure", state.pressure)):
        if not np.isfinite(vector.getArray(readonly=True)).all():
            return f"the {name} is no longer finite"
    return ""


def _marker_trouble(problem, markers):
    if not len(markers):
        return ""
    if not np.isfinite(markers).all():
        return "the markers are no longer finite"
    a, b, c, d = problem.grid.domain
    low = np.array([a, c])
    high = np.array([b, d])
    reach = problem.kernel.reach * np.array([problem.grid.dx, problem.grid.dy])
    gap = np.minimum(markers - low, high - markers) - reach
    gap[:, problem.grid.periodic] = np.inf
    if (gap >= 0).all():
        return ""
    marker, axis = np.unravel_index(np.argmin(gap), gap.shape)
    where = ", ".join(f"{x:.4g}" for x in markers[marker])
    return f"marker {marker} at ({where}) is outside the box or within the delta function's " \
        f"reach of a wall in {'xy'[axis]}"
