"""Linear extrapolation from the stages of the last two steps to the next, for first guesses."""

from petsc4py import PETSc

TIME = "stage_time"


def expected(history, name, time, otherwise):
    """A quantity at a stage to come, extrapolated linearly from the last two.

    Parameters
    ----------
    history : dict
        Of the state that the step starts from (`State.history`).
    name : str
        As given to `remembered`.
    time : float
        Of the stage.
    otherwise : ndarray or PETSc.Vec
        Its value where the history holds none.

    Returns
    -------
    ndarray or PETSc.Vec
        A new array or vector.
    """
    value = history.get(name, otherwise).copy()
    rate = history.get(f"{name}_rate")
    if rate is None:
        return value
    ahead = time - history[TIME]
    if isinstance(value, PETSc.Vec):
        value.axpy(ahead, rate)
        return value
    return value + ahead * rate


def remembered(history, time, **stage):
    """Values and rates of change of a stage, as entries of the next state's history for `expected`.

    Parameters
    ----------
    history : dict
        Of the state that the step has started from.
    time : float
        Of the stage.
    **stage : ndarray or PETSc.Vec
        Its quantities by name; kept.

    Returns
    -------
    dict
    """
    found = {TIME: time}
    for name, value in stage.items():
        found[name] = value
        if name in history and TIME in history:  # a file of an earlier petscib lacks the time
            share = 1 / (time - history[TIME])
            if isinstance(value, PETSc.Vec):
                rate = value.copy()
                rate.axpby(-share, share, history[name])
            else:
                rate = share * (value - history[name])
            found[f"{name}_rate"] = rate
    return found
