"""The size of the time step: fixed, or halved when need be and grown back (-ts_adapt)."""

SMALLEST = 1e-3  # of the largest step: below it, halving once more would not help
GROW_AFTER = 5  # good steps in a row


class StepSize:
    """Decides the time step from what all ranks know alike, hence equally on every rank.

    Parameters
    ----------
    largest : float
        -ts_dt.
    adapt : bool
        Whether a failed step may be retried with half of it.
    dt : float, optional
        Where an earlier run had got to.
    good_steps : int
        Steps since `dt` last changed.
    """

    def __init__(self, largest, adapt=False, dt=None, good_steps=0):
        self.largest = largest
        self.adapt = adapt
        self.dt = min(dt or largest, largest) if adapt else largest
        self.good_steps = good_steps

    def reject(self, dt):
        """Take note that a step of size `dt` failed.  Returns whether a smaller one may follow."""
        if not self.adapt or dt / 2 < SMALLEST * self.largest:
            return False
        self.dt, self.good_steps = dt / 2, 0
        return True

    def limit(self, longest):
        """Heed a time step beyond which the next step would fail."""
        while self.adapt and self.dt > longest and self.dt / 2 >= SMALLEST * self.largest:
            self.dt, self.good_steps = self.dt / 2, 0

    def accept(self):
        """Take note of a good step."""
        self.good_steps += 1
        if self.dt < self.largest and self.good_steps >= GROW_AFTER:
            self.dt, self.good_steps = min(2 * self.dt, self.largest), 0
