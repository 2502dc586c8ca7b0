"""Whether an object of the user's is a law of membrane forces."""

import numpy as np

from ...errors import InputError

NEEDED = "name", "linear", "stress", "columns", "weights"
COVER = "forget", "energy"  # needed with `cover`
SHIFT = 1e-3  # of the curves' size: how far the markers are moved for the check
EXACT = 1e-6  # relative defect of the differences, far above round-off and below any formula's


def check_law(law, others, markers):
    """Refuse what is no law, or whose weights are not exact.  On the rank with the markers.

    Parameters
    ----------
    law
        See `petscib.membranes.laws`.
    others : list of laws
        Whose names are taken.
    markers : ndarray, shape (M, 2)

    Raises
    ------
    InputError
    """
    kind = type(law).__name__
    needed = NEEDED + (COVER if hasattr(law, "cover") else ())
    missing = [name for name in needed if not hasattr(law, name)]
    if missing:
        raise _refused(kind, f"has no {missing[0]}", "an object with " + ", ".join(needed))
    if not str(law.name).isidentifier() or law.name in [one.name for one in others]:
        raise _refused(kind, f"its name is {law.name!r}", "a word that no other law has")
    size = np.ptp(markers, axis=0).max()
    moved = markers + SHIFT * size * np.random.default_rng(0).standard_normal(markers.shape)
    if hasattr(law, "cover"):
        law.cover(markers, moved)
    none = np.zeros(0)  # the stretching, of which only the tension knows
    change = law.stress(moved, none) - law.stress(markers, none)
    weights, columns = law.weights(markers, moved), law.columns
    if np.shape(weights) != np.shape(columns) or len(columns) != len(change):
        raise _refused(
            kind, f"{len(change)} stresses, weights of shape {np.shape(weights)} and columns of "
            f"shape {np.shape(columns)}", "as many stresses as rows, weights of the columns' shape")
    told = np.sum(weights * (moved - markers).ravel()[columns], axis=1)
    if not np.linalg.norm(told - change) <= EXACT * np.linalg.norm(change):
        raise _refused(
            kind, "its weights do not turn the change of the markers into that of the stresses",
            "weights(before, after) with stress(after) - stress(before) = C (after - before)")


def _refused(kind, why, allowed):
    return InputError(f"laws: {kind}: {why}; allowed: {allowed}")
