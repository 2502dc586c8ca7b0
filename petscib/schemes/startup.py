"""A damped start: backward Euler half steps before a scheme that does not damp."""

from ..problem import Step


class Startup:
    """Replaces each of the first steps by two half steps of the backward Euler sibling.

    The initial flow need not fit the stiff membrane; Crank-Nicolson would carry the misfit along
    as an oscillation.  The half steps have the same theta dt, hence the same fluid matrix.

    Parameters
    ----------
    scheme, sibling
        The scheme, and backward Euler in its place at the start.
    count : int
        Number of steps replaced.
    """

    def __init__(self, scheme, sibling, count):
        self.scheme = scheme
        self.sibling = sibling
        self.count = count
        self.advice = scheme.advice

    def step(self, state, dt):
        """Take one step from `state`.  Collective.  Returns a Step."""
        if state.step >= self.count:
            return self.scheme.step(state, dt)
        first = self.sibling.step(state, dt / 2)
        second = self.sibling.step(first.end, dt / 2)
        second.end.step = state.step + 1
        iterations = {
            name: count + second.iterations[name] for name, count in first.iterations.items()
        }
        return Step(
            dt,
            second.theta,
            state,
            second.end,
            second.stage,
            second.projection,
            second.stretch_rate,
            second.marker_velocity,
            iterations,
            parts=(first, second),
        )

    def destroy(self):
        """Free the solvers."""
        self.scheme.destroy()
        self.sibling.destroy()
