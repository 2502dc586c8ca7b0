"""The force on the fluid that is given from outside."""


class BodyForce:
    """A given force per unit area on all faces but those of walls.

    Parameters
    ----------
    operators : Operators
    force : (float, float) or own.Function
        The same everywhere, or a function of place and time.
    """

    def __init__(self, operators, force):
        self._operators, self._force = operators, force
        self._time, self._vector = None, None if callable(force) else operators.force(*force)

    def at(self, time):
        """The force on the faces at a time, a PETSc.Vec that is good until the next call."""
        if callable(self._force) and time != self._time:
            grid = self._operators.grid
            u = self._force(*grid.u_points(grid.u_box), time)[0]
            v = self._force(*grid.v_points(grid.v_box), time)[1]
            if self._vector is not None:
                self._vector.destroy()
            self._vector, self._time = self._operators.force(u, v), time
        return self._vector
