"""What a run warns of on its way, each thing once."""

from . import accuracy, guard

TIME_STEP, GAP, ADVECTION = "time step", "gap", "advection"


class Alerts:
    """Warns of steps and states in which results begin to be inaccurate.  Not collective.

    Parameters
    ----------
    settings : Settings
    problem : Problem
    results : Results
        Which prints them.

    Attributes
    ----------
    said : dict of str to str
        The warnings given so far, by subject.  Those of time step and gap are known to rank 0,
        which has the markers.
    """

    def __init__(self, settings, problem, results):
        self.settings, self.problem, self.results = settings, problem, results
        self.said = {}
        self._fixed_steps = settings.ts_rtol is None  # else the error of a step is known

    def at_start(self, state):
        """Look at the state that a run begins with."""
        if self._fixed_steps:
            self._warn(TIME_STEP, lambda: accuracy.of_flow(
                self.settings, state.markers, self.problem.curves))
        self._warn(GAP, lambda: guard.near(self.problem, state.markers))

    def before_step(self, dt, longest):
        """Look at the next time step, beside the longest that explicit advection allows."""
        if dt > longest:
            self._warn(ADVECTION, lambda: (
                f"explicit advection may be unstable with time steps above {longest:.3g} at this "
                f"speed, and this one is {dt:.3g}; try -advection implicit or -ts_adapt"))

    def after_step(self, step):
        """Look at how far a step has moved the membranes, and how near to each other."""
        if self._fixed_steps:
            self._warn(TIME_STEP, lambda: accuracy.of_step(
                self.settings, step.start.markers, step.end.markers, step.dt,
                self.problem.curves))
        self._warn(GAP, lambda: guard.near(self.problem, step.end.markers))

    def _warn(self, subject, find):
        """Say what is found to say of a subject, unless something has been said of it."""
        if subject not in self.said:
            text = find()
            if text:
                self.said[subject] = text
                self.results.say(f"petscib: {text}")
