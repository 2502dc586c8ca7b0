"""What the stages of the last two steps let expect of the next, at whatever time it lies."""

from petsc4py import PETSc

TIME = "stage_time"


def expected(history, name, time, otherwise):
    """What a stage will probably have, extrapolated linearly.

    Parameters
    ----------
    history : dict
        Of the state that the step starts from (`State.history`).
    name : str
        As given to `remembered`.
    time : float
        Of the stage.
    otherwise : ndarray or PETSc.Vec
        In place of what the history does not hold.

    Returns
    -------
    ndarray or PETSc.Vec
        A new one.
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
    """The part of the next history that `expected` asks for.

    Parameters
    ----------
    history : dict
        Of the state that the step has started from.
    time : float
        Of the stage.
    **stage : ndarray or PETSc.Vec
        What it has had, by name; kept.

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
