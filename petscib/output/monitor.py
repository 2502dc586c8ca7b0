"""Progress of a run on standard error. Rank 0 only; nothing here is collective.

A monitor is told where the run starts, gets each row of the diagnostics table, and is closed at
the end. It never decides anything.
"""

import math
import sys
from time import monotonic

from .rows import entry, is_number

LINES_BETWEEN_HEADERS = 25
REDRAW_SECONDS = 0.1

# Log columns: title, width, format, diagnostics column.
LOG_COLUMNS = (
    ("step", 7, ".0f", "step"),
    ("time", 10, ".4g", "time"),
    ("dt", 9, ".2e", "dt"),
    ("cfl", 8, ".2g", "cfl"),
    ("max speed", 10, ".3g", "max_speed"),
    ("diverg.", 9, ".1e", "max_divergence"),
    ("area err.", 10, ".1e", "area_error"),
    ("perim. err.", 12, ".1e", "perimeter_error"),
    ("mom.", 5, ".0f", "momentum_iterations"),
    ("poi.", 5, ".0f", "poisson_iterations"),
    ("cpl.", 5, ".0f", "coupled_iterations"),
)


class Monitor:
    """The silent monitor (``none``), and what the others share.

    Parameters
    ----------
    stream : text stream, optional
        Where to write; standard error by default.
    """

    def __init__(self, stream=None):
        self.stream = sys.stderr if stream is None else stream

    def start(self, step, time, end_time, max_steps):
        """Begin at a step and time: 0 and 0, or those of the checkpoint of a restarted run.

        Parameters
        ----------
        step : int
        time : float
        end_time : float or None
            Time at which the run ends.
        max_steps : int or None
            Number of the last step, counted from time 0. Whichever end comes first counts.
        """
        self._ends = (end_time, max_steps)
        self._began = monotonic()
        self._first_fraction = self._fraction(time, step)

    def update(self, row):
        """Take note of a finished step.

        Parameters
        ----------
        row : mapping of str to number
            A row of the diagnostics table; None or a missing entry means "does not apply".
        """

    def write(self, line):
        """Print a line, such as a warning, without disturbing the display."""
        print(line, file=self.stream, flush=True)

    def close(self):
        """Finish the display, if it has begun. May be called twice."""

    def _fraction(self, time, step):
        """Part of the run that is done, 0 to 1; 0 if it has no end."""
        parts = [
            done / end for done, end in zip((time, step), self._ends) if is_number(end) and end > 0
        ]
        return min(max(parts, default=0.0), 1.0)

    def _seconds_left(self, fraction):
        """Estimate from the part done since this start; None before there is one."""
        done = fraction - self._first_fraction
        return (monotonic() - self._began) * (1.0 - fraction) / done if done > 0 else None


class LogMonitor(Monitor):
    """Aligned plain lines, for log files and batch jobs.

    A line comes after every twentieth of the run, and every 2 seconds of wall time. In long runs
    the 2 seconds grow to a hundredth of the time so far, at most a minute. The first and the last
    step always have theirs.
    """

    _last_row = None

    def start(self, step, time, end_time, max_steps):
        """Begin; a restarted run says where."""
        super().start(step, time, end_time, max_steps)
        self._lines = 0
        self._printed_at = None
        self._printed_fraction = 0.0
        if step > 0:
            self.write(f"restarted at step {step}, time {time:.6g} ({self._first_fraction:.0%})")

    def update(self, row):
        """Take note of a step, and print its line when one is due."""
        self._last_row = dict(row)
        if self._is_due(row):
            self._print_last_row()

    def close(self):
        """Print the line of the last step."""
        if self._last_row is not None:
            self._print_last_row()

    def _is_due(self, row):
        if self._printed_at is None:
            return True
        now = monotonic()
        interval = max(2.0, min((now - self._began) / 100.0, 60.0))
        part = _twentieth(self._fraction(row["time"], row["step"]))
        return now - self._printed_at >= interval or part > _twentieth(self._printed_fraction)

    def _print_last_row(self):
        row, self._last_row = self._last_row, None
        self._printed_at = monotonic()
        self._printed_fraction = self._fraction(row["time"], row["step"])
        if self._lines % LINES_BETWEEN_HEADERS == 0:
            titles = "".join(f"{title:>{width}}" for title, width, _, _ in LOG_COLUMNS)
            self.write(f"{titles}  done      left")
        self._lines += 1
        cells = "".join(
            f"{_cell(entry(row, name), form):>{width}}" for _, width, form, name in LOG_COLUMNS
        )
        left = _clock(self._seconds_left(self._printed_fraction))
        self.write(f"{cells}  {self._printed_fraction:4.0%}  {left:>8}")


class BarMonitor(Monitor):
    """One line that is redrawn in place, for terminals. Needs tqdm.

    Besides time, step, and time taken and left it shows the iterations of the last step: m for
    momentum, p for Poisson, c for coupled.
    """

    _bar = None

    def start(self, step, time, end_time, max_steps):
        """Begin with what is done already."""
        super().start(step, time, end_time, max_steps)
        from tqdm import tqdm

        class Bar(tqdm):
            monitor_interval = 0  # no helper thread beside MPI

        restarted = f", restarted at {self._first_fraction:.0%}" if step > 0 else ""
        self._bar = Bar(
            total=1.0,
            initial=self._first_fraction,
            file=self.stream,
            dynamic_ncols=True,
            bar_format="{percentage:3.0f}%|{bar}| {desc} [{elapsed}<{remaining}" + restarted + "]",
        )
        self._drawn_at = -math.inf
        self.update({"step": step, "time": time})

    def update(self, row):
        """Move the bar."""
        time, step = row["time"], row["step"]
        end_time = self._ends[0]
        end = f"/{end_time:g}" if is_number(end_time) else ""
        counts = [
            (letter, entry(row, f"{solve}_iterations"))
            for letter, solve in (("m", "momentum"), ("p", "poisson"), ("c", "coupled"))
        ]
        iterations = "".join(
            f" {letter}{count:.0f}" for letter, count in counts if is_number(count))
        text = f"t {time:.4g}{end} step {step}" + (f" iter{iterations}" if iterations else "")
        self._bar.n = self._fraction(time, step)
        self._bar.set_description_str(text, refresh=False)
        if monotonic() - self._drawn_at >= REDRAW_SECONDS:
            self._bar.refresh()
            self._drawn_at = monotonic()

    def write(self, line):
        """Print a line above the bar."""
        if self._bar is None:
            super().write(line)
        else:  # tqdm takes the bar off the screen, prints the line, and draws the bar again below
            self._bar.write(line, file=self.stream)

    def close(self):
        """Finish the bar."""
        if self._bar is None:
            return
        if not self._bar.disable:
            self._bar.refresh()
        self._bar.close()


def create(name=None, stream=None):
    """Make a monitor.

    Parameters
    ----------
    name : {'bar', 'log', 'none'}, optional
        By default a bar on a terminal, log lines elsewhere.
    stream : text stream, optional
        Standard error by default.

    Returns
    -------
    Monitor

    Raises
    ------
    ValueError
        For another name.
    """
    monitor = Monitor(stream)
    if name is None:
        name = "bar" if monitor.stream.isatty() else "log"
    if name == "none":
        return monitor
    if name == "log":
        return LogMonitor(stream)
    if name != "bar":
        raise ValueError(f"no monitor {name!r}: bar, log or none")
    try:
        import tqdm  # noqa: F401
    except ImportError:
        monitor.write("the progress bar needs tqdm, which is not installed: plain lines instead")
        return LogMonitor(stream)
    return BarMonitor(stream)


def _twentieth(fraction):
    """Number of whole twentieths done; rounding must not make one late."""
    return int(20.0 * fraction + 1e-9)


def _cell(value, form):
    return "-" if value is None else format(float(value), form)


def _clock(seconds):
    if seconds is None:
        return "--:--"
    minutes, seconds = divmod(int(round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes:02d}:{seconds:02d}"
