"""The size of the time step: fixed, or changed by factors of two.

With -ts_adapt it is halved when a step fails, and grown back later.  With -ts_rtol it follows the
local error of the markers' positions: -ts_dt is the first time step, a step of too large an error
is repeated with a smaller one, and where the error leaves room, steps grow.  With either, it also
keeps to the limit of stability of explicit advection.

Whatever depends on the time step alone is made anew when it changes, which takes a quarter to half
of the time of a step (64^2, with -fft and with GAMG).  Factors of two, and some patience, keep that
below 3 percent of a run.
"""

from math import ceil, inf, log2

SMALLEST = 1e-3  # of the largest step: below it, halving a failed one once more would not help
# Good steps in a row after a failure.  Where all longer steps fail, a run with 1, 2 and 20 takes
# 2.2, 1.2 and 0.9 times as long (-scene tanktreading -fft -stag_grid_x 32 -ts_dt 0.25
# -picard_max_it 8 -ts_adapt); where none fails again, so many have half the size for nothing.
GROW_AFTER = 5

# With a tolerance, steps lie within these multiples of -ts_dt.  The default one is about the cell
# size over the speed, and 64 times that crosses the box: beyond, only iterations would grow.  An
# impulsive start asks for first steps of about the tolerance, relative to size over speed.
LARGEST_FACTOR, SMALLEST_FACTOR = 64.0, 2.0**-30
# Good steps after which the error is that of the present time step, and the part of the tolerance
# that the error to be expected of the next larger step may take.  By vesicles (0.2, 0.5) that relax
# and tread to t = 2 (32^2, -fft, -ts_rtol 1e-3, gcn and mbe): of mbe's treading steps 27 in 167 are
# repeated, with SETTLED 1 or SHARE 0.9 there are 76 in 211 or 38 in 175, and with 0.9 the error of
# gcn is half as large again; with SETTLED 6 gcn relaxes in 27 steps in place of 17, and with SHARE
# 0.25 steps are up to a third more.
SETTLED = 3
SHARE = 0.5


class StepSize:
    """Decides the time step from what all ranks know alike, hence equally on every rank.

    Parameters
    ----------
    first : float
        -ts_dt.
    adapt : bool
        Whether a failed step may be retried with half of it.
    dt : float, optional
        Where an earlier run had got to.
    good_steps : int
        Steps since `dt` last changed.
    rtol : float, optional
        Largest local error of a step.
    """

    def __init__(self, first, adapt=False, dt=None, good_steps=0, rtol=None):
        self.adapt, self.rtol = adapt, rtol
        self.largest, self.smallest = first, SMALLEST * first
        if rtol is not None:
            self.largest, self.smallest = LARGEST_FACTOR * first, SMALLEST_FACTOR * first
        self.dt = first
        if dt is not None and (adapt or rtol is not None):
            self.dt = min(dt, self.largest)
        self.good_steps = good_steps
        self.longest = inf

    def reject(self, dt):
        """Take note that a step of size `dt` failed.  Returns whether a smaller one may follow."""
        if not (self.adapt and self._shrink(dt, 1)):
            return False
        if self.rtol is not None:
            self.good_steps = SETTLED - GROW_AFTER
        return True

    def allows(self, error):
        """Whether the local error of a step is within the tolerance, if there is any."""
        return self.rtol is None or error <= self.rtol

    def repeat(self, dt, error, order):
        """Take note that a step of size `dt` had too large a local error.

        Parameters
        ----------
        dt, error : float
        order : int
            The error grows as dt^{order + 1}.

        Returns
        -------
        bool
            Whether a smaller one may follow.
        """
        excess = log2(error / self.rtol) / (order + 1)
        return self._shrink(dt, max(1, ceil(excess)))

    def _shrink(self, dt, times):
        """Halve `dt` some times, staying in powers of two: a last step may have been cut short."""
        aim = self.dt
        while aim > dt / 2**times:
            aim /= 2
        if aim < self.smallest:
            return False
        self.dt, self.good_steps = aim, 0
        return True

    def limit(self, longest):
        """Heed a time step beyond which the next step would fail, unless steps are fixed."""
        self.longest = longest
        varies = self.adapt or self.rtol is not None
        while varies and self.dt > longest and self.dt / 2 >= self.smallest:
            self.dt, self.good_steps = self.dt / 2, 0

    def accept(self, error=None, order=1):
        """Take note of a good step, and of its local error where there is a tolerance."""
        self.good_steps += 1
        if self.rtol is None:
            grow = self.good_steps >= GROW_AFTER
        else:
            grow = self.good_steps >= SETTLED and (
                error * 2 ** (order + 1) <= SHARE * self.rtol)
        larger = min(2 * self.dt, self.largest)
        if grow and self.dt < larger <= self.longest:
            self.dt, self.good_steps = larger, 0
