"""How far vesicles have turned: inclinations counted on through full turns.

An inclination is known only up to half turns; from step to step it is followed to the nearest of
its values.  A half turn is over when the angle has changed by pi since the last one, or since the
run's start; its time is interpolated linearly within the step.
"""

import numpy as np

from .membranes import geometry

# In a state's history, on rank 0: of each vesicle the angle turned to, that of the last half turn,
# the time of the latter, and how long it took (0 before the first).
TURNING = "turning"


def begin(problem, state):
    """Start to count from a state, unless its history holds what came before."""
    angles = _inclinations(problem, state.markers)
    state.history.setdefault(TURNING, np.stack(
        (angles, angles, np.full(len(angles), state.time), np.zeros(len(angles))), axis=1))


def follow(problem, step):
    """Add to the history of a step's end what that of its start becomes."""
    if TURNING not in step.start.history:
        return
    before, start, since, took = step.start.history[TURNING].T
    angles = _inclinations(problem, step.end.markers)
    angles = before + (angles - before + np.pi / 2) % np.pi - np.pi / 2
    turned = angles - start
    over = np.abs(turned) >= np.pi
    goal = start + np.sign(turned) * np.pi
    share = np.divide(goal - before, angles - before, out=np.ones_like(goal), where=over)
    time = step.start.time + share * step.dt
    step.end.history[TURNING] = np.stack((
        angles, np.where(over, goal, start), np.where(over, time, since),
        np.where(over, time - since, took)), axis=1)


def measure(state):
    """Angles in turns, and how long the last half turn took, shapes (V,); on rank 0.

    The latter is not a number before the first.
    """
    turning = state.history[TURNING]
    return turning[:, 0] / (2 * np.pi), np.where(turning[:, 3] > 0, turning[:, 3], np.nan)


def _inclinations(problem, markers):
    curves = problem.membranes.curves
    if not len(markers):
        return np.zeros(0)
    return np.where(curves.encloses, geometry.inclination(markers, curves), 0.0)
