"""A damped start: backward Euler half steps before a scheme that does not damp."""

from copy import copy
from dataclasses import replace


class Startup:
    """Replaces each of the first steps by two half steps of backward Euler.

    The initial flow need not fit the stiff membrane; Crank-Nicolson would carry the misfit along
    as an oscillation.  The half steps have the same theta dt, hence the same solvers.

    Parameters
    ----------
    scheme
        One with a `theta`.
    count : int
        Number of steps replaced.
    """

    def __init__(self, scheme, count):
        self.scheme = scheme
        self.damped = copy(scheme)
        self.damped.theta = 1.0
        self.count = count
        self.advice = scheme.advice

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        if state.step >= self.count:
            return self.scheme.step(state, dt)
        first = self.damped.step(state, dt / 2)
        second = self.damped.step(first.end, dt / 2)
        second.end.step = state.step + 1
        iterations = {
            name: count + second.iterations[name] for name, count in first.iterations.items()
        }
        return replace(second, dt=dt, start=state, iterations=iterations, parts=(first, second))

    def forget(self):
        """Drop what depends on earlier steps and is in no checkpoint."""
        self.scheme.forget()

    def destroy(self):
        """Free the solvers."""
        self.scheme.destroy()
