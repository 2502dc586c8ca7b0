"""The local error of a time step, from the path of the markers (-ts_rtol).

A scheme of order p makes in one step the error C dt^{p+1} X^(p+1), C = 1/2 for backward Euler and
1/12 for Crank-Nicolson (p = 2).  That derivative of the path X(t) is told by how far the step's
result lies from the polynomial through the p + 1 positions before it:

    X^{n+1} - prediction = X^(p+1) / (p + 1)! prod_j (t^{n+1} - t^j),    j = n, ..., n - p.

It is a line for schemes of first order, and a parabola for gcn.  A first step has nothing but its
start to go by: half its length is its error, as for a membrane that starts to move in its course.
"""

from math import factorial

import numpy as np

from .membranes import geometry

CONSTANTS = 1 / 2, 1 / 2, 1 / 12  # by p
# In a state's history: positions of the markers before it, and when; on rank 0.
PATH, TIMES = "path", "path_times"


def prediction(times, path, time):
    """The polynomial through earlier positions, at a later time.

    Parameters
    ----------
    times : ndarray, shape (K,)
    path : ndarray, shape (K, M, 2)
    time : float

    Returns
    -------
    ndarray, shape (M, 2)
    """
    gaps = times[:, None] - times
    np.fill_diagonal(gaps, 1.0)
    factors = np.tile(time - times, (len(times), 1))
    np.fill_diagonal(factors, 1.0)
    return np.tensordot((factors / gaps).prod(axis=1), path, axes=1)


class LocalError:
    """Measures steps, and keeps the path in the states' histories.

    Parameters
    ----------
    problem : Problem
        With membranes.
    order : int
        Of the scheme; its damped first steps are of first order.
    """

    def __init__(self, problem, order):
        self.order = order
        self.curves = problem.membranes.curves
        self.comm = problem.grid.comm.tompi4py()

    def measure(self, step):
        """Local error of a step, the largest of all markers.  Collective.

        Parameters
        ----------
        step : Step
            The path is added to the history of its end.

        Returns
        -------
        error : float
            Relative to the size of a marker's vesicle, the radius of the circle of its perimeter.
        order : int
            Of the power dt^{p+1} with which it grows.
        """
        start, end = step.start, step.end
        before = [start, *(part.end for part in step.parts[:-1])]
        times, path = np.zeros(0), np.zeros((0, *start.markers.shape))
        if len(start.markers):
            times = np.array([state.time for state in before])
            path = np.stack([state.markers for state in before])
            if PATH in start.history:
                times = np.concatenate((start.history[TIMES], times))
                path = np.concatenate((start.history[PATH], path))
        kept = (1 if step.parts else self.order) + 1
        times, path = times[-kept:], path[-kept:]
        end.history[TIMES], end.history[PATH] = times, path
        found = self._found(step, times, path) if len(path) else None
        return self.comm.bcast(found)

    def _found(self, step, times, path):
        """Error and order on rank 0."""
        end = step.end
        size = self.curves.spread(geometry.perimeter(end.markers, self.curves) / (2 * np.pi))
        order = len(path) - 1
        missed = geometry.length(end.markers - prediction(times, path, end.time)) / size
        parts = len(step.parts) or 1
        steps = end.time - times
        share = parts * CONSTANTS[order] * factorial(order + 1) * steps[-1] ** (order + 1)
        return float(missed.max() * share / steps.prod()), order
