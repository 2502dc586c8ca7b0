"""Records of a study, one dict a run, and what is asked of many of them."""

import numpy as np


def select(records, **wanted):
    """The records that have these entries."""
    return [one for one in records if all(one[name] == value for name, value in wanted.items())]


def power(values, errors):
    """The power of some values with which errors change, by a fit; None for fewer than two.

    Parameters
    ----------
    values, errors : sequence of float
        Of the same length; where an error is 0 or None there is none.
    """
    known = [(np.log(value), np.log(abs(error))) for value, error in zip(values, errors) if error]
    return float(np.polyfit(*zip(*known), 1)[0]) if len(known) > 1 else None
