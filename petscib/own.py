"""What a script or a scene's file gives in place of an option's text: functions and points."""

import os
import traceback

import numpy as np

from .errors import InputError


class Function:
    """A vector field of the user's, a function of (x, y, t).

    Parameters
    ----------
    call : callable
        From arrays x and y of one shape and the time t to two arrays of that shape, or numbers.
    option : str
        Whose value it is, for messages.
    """

    def __init__(self, call, option):
        self.call, self.option = call, option

    def __str__(self):
        return f"function {getattr(self.call, '__name__', type(self.call).__name__)}"

    def __eq__(self, other):
        return isinstance(other, Function) and self.call == other.call

    def __hash__(self):
        return hash(self.call)

    def __call__(self, x, y, time):
        """Its two components at places x, y that are broadcast against each other.

        Raises
        ------
        InputError
            It does not return two finite components.
        """
        x, y = (np.array(part) for part in np.broadcast_arrays(np.asarray(x, float), y))
        values = self.call(x, y, time)
        try:
            u, v = (np.array(np.broadcast_to(np.asarray(part, float), x.shape)) for part in values)
        except (TypeError, ValueError):
            raise self.refused("returns no two arrays of the shape of x and y") from None
        if not (np.isfinite(u).all() and np.isfinite(v).all()):
            raise self.refused("is not finite everywhere in the box")
        return u, v

    def tried(self, x, y, time):
        """The same at the start of a run, where whatever it raises is bad input.

        Raises
        ------
        InputError
            It raises an exception, or does not return two finite components.
        """
        try:
            return self(x, y, time)
        except InputError:
            raise
        except Exception as error:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            where = "" if frame.filename == __file__ else (
                f" ({os.path.basename(frame.filename)}, line {frame.lineno})")
            raise self.refused(f"{type(error).__name__}: {error}{where}") from error

    def refused(self, why, allowed="a function (x, y, t) -> (x component, y component)"):
        """The error to raise where it does not serve."""
        return InputError(f"-{self.option} {self}: {why}; allowed: {allowed}")


class Points:
    """Points along a closed curve, in the place of a file of them.

    Parameters
    ----------
    array : array_like, shape (N, 2)
    name : str
        Of the keyword that has given them, for messages.

    Raises
    ------
    InputError
        These are no numbers.
    """

    allowed = "an array of shape (N, 2), points along a closed curve that does not cross itself"

    def __init__(self, array, name="points"):
        self.name = name
        try:
            self.array = np.array(array, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError(f"{name}: {error}; allowed: {self.allowed}") from None

    def __str__(self):
        return f"array{self.array.shape}".replace(" ", "")

    def __eq__(self, other):
        return isinstance(other, Points) and np.array_equal(self.array, other.array)

    def __hash__(self):
        return hash(self.array.tobytes())


def is_own(value):
    """Whether a value is one of these."""
    return isinstance(value, (Function, Points))
