"""Pictures of what changes in time: inclination, conservation, energies, the energy ledger.

All are drawn from the table of diagnostics, as `plots` says.
"""

from itertools import cycle

import numpy as np

from . import saved
from .rows import entries
from .style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    VESICLE_COLOURS,
    path_of,
    picture,
)

LAW_COLOURS = VERMILLION, GREEN, ORANGE, PURPLE, GREY
SOLVES = (
    ("momentum", BLUE, "o"),
    ("poisson", ORANGE, "s"),
    ("coupled", VERMILLION, "^"),
    ("picard", GREEN, "D"),
)
# Ledger terms that can only take energy away, in stacking order, before those of the laws; all
# others can have any sign.
DISSIPATION = (
    ("viscous", "viscosity", BLUE),
    ("inertia", "numerical: inertia", SKY),
    ("projection", "numerical: projection", "#F0E442"),
    ("kink", "kink correction", "#000000"),
)
SUPPLY_NAMES = {"wall_power": "walls", "body_power": "body force", "load_power": "loads",
                "reset": "stretching reset"}
# Dashes let the line of a vesicle that moves alike be seen below.
VESICLE_LINES = "-", (0, (4, 4)), (0, (1, 1.5))
SUPPLY_STYLES = (":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (7, 2)), (0, (3, 1, 1, 1)))


def plot_inclination(folder, output=None):
    """``inclination.png``: inclination and treading frequency over time, in a flow."""
    table = saved.read_table(folder)
    if saved.is_at_rest(saved.read_options(folder)):
        return None
    panels = [
        (label, values)
        for label, values in (
            (r"inclination $\theta/\pi$", _half_turns(_vesicle_columns(table, "inclination"))),
            (r"treading frequency $f$ (1/time)", _vesicle_columns(table, "treading_frequency")),
        )
        if np.isfinite(values).any()
    ]
    if not panels:
        return None
    size = 6.0, 2.6 * len(panels) + 0.4
    with picture(path_of(folder, output, "inclination.png"), *size) as figure:
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axis, (label, values) in zip(axes, panels):
            for vesicle, series in enumerate(values.T):
                style = dict(color=VESICLE_COLOURS[vesicle % len(VESICLE_COLOURS)],
                             ls=VESICLE_LINES[vesicle % len(VESICLE_LINES)])
                _line(axis, table["time"], series, label=f"vesicle {vesicle}", **style)
            axis.set_ylabel(label)
            axis.set_ylim(_robust_limits(values))
        if 1 < panels[0][1].shape[1] <= len(VESICLE_COLOURS):
            axes[0].legend(ncol=2)
        _time_axis(axes[-1], table["time"])
        return figure.path


def plot_conservation(folder, output=None):
    """``conservation.png``: area and perimeter error, and the iterations of each step."""
    table = saved.read_table(folder)
    errors = [
        (name, colour, _largest(_vesicle_columns(table, f"{name}_error")))
        for name, colour in (("area", BLUE), ("perimeter", VERMILLION))
    ]
    # Errors that are all zero, as in the first row of a run, have no place on a log axis.
    errors = [error for error in errors if np.any(error[2][np.isfinite(error[2])])]
    solves = []
    for name, colour, symbol in SOLVES:
        counts = _column(table, f"{name}_iterations")
        if np.nansum(counts) > 0:
            solves.append((name, colour, symbol, counts))
    if not errors and not solves:
        return None
    rows = bool(errors) + bool(solves)
    with picture(path_of(folder, output, "conservation.png"), 6.0, 2.6 * rows + 0.4) as figure:
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        for name, colour, error in errors:
            _line(axes[0], table["time"], error, positive=True, color=colour, label=name)
        if errors:
            axes[0].set_ylabel("relative error")
            _log_axis(axes[0], [error for _, _, error in errors])
            axes[0].legend(ncol=2)
        for name, colour, symbol, counts in solves:
            label = {"poisson": "Poisson", "picard": "Picard"}.get(name, name)
            size = 3.5 if len(counts) <= 300 else 2.5
            style = dict(linestyle="none", marker=symbol, markersize=size, markeredgewidth=0,
                         clip_on=False)
            axes[-1].plot(table["time"], counts, color=colour, label=label, **style)
        if solves:
            axes[-1].set_ylabel("iterations per step")
            highest = max(np.nanmax(counts) for _, _, _, counts in solves)
            # Room for the legend above, and for the marks of no iteration below.
            axes[-1].set_ylim(-0.06 * highest, 1.35 * highest + 1)
            axes[-1].yaxis.get_major_locator().set_params(integer=True)
            axes[-1].legend(ncol=len(solves), markerscale=2, handletextpad=0.1)
        _time_axis(axes[-1], table["time"])
        return figure.path


def plot_energy(folder, output=None):
    """``energy.png``: the energies over time, above as they add up, below on a log axis."""
    table = saved.read_table(folder)
    parts = [("kinetic", BLUE, _column(table, "kinetic"))]
    parts += [(_words(name), colour, _column(table, f"{name}_energy"))
              for name, colour in _laws(table)]
    parts = [part for part in parts if np.nansum(abs(part[2])) > 0]
    total = _column(table, "energy")
    if not np.isfinite(total).any():
        return None
    with picture(path_of(folder, output, "energy.png"), 6.0, 5.6) as figure:
        axes = figure.subplots(2, 1, sharex=True)
        for axis, positive in zip(axes, (False, True)):
            # Wide, to be seen below a part that is nearly all of it.
            line = dict(color="black", lw=3.0, label="total", positive=positive)
            _line(axis, table["time"], total, **line)
            for name, colour, values in parts:
                _line(axis, table["time"], values, positive=positive, color=colour, label=name)
            axis.set_ylabel("energy")
        if total[np.isfinite(total)].max() > 0:
            axes[0].set_ylim(bottom=0)
        _log_axis(axes[1], [total, *(values for _, _, values in parts)], decades=12)
        axes[0].legend(ncol=2)
        _time_axis(axes[1], table["time"])
        return figure.path


def plot_ledger(folder, output=None):
    """``ledger.png``: where the energy went, and by how much the account fails to close.

    Stacked areas are the energy dissipated so far, term by term. They must reach the black line:
    the energy lost, plus what terms of either sign (moving walls, the reset of the stretching)
    have put in.
    """
    table = saved.read_table(folder)
    terms = {
        name[len("ledger_") :]: np.cumsum(np.nan_to_num(values))
        for name, values in table.items()
        if name.startswith("ledger_") and np.isfinite(values).any()
    }
    change, residual = terms.pop("change", None), terms.pop("residual", None)
    if change is None:
        return None
    laws = [(name, f"numerical: {_words(name)}", colour) for name, colour in _laws(table)]
    areas = [
        (label, colour, -terms.pop(name))
        for name, label, colour in (*DISSIPATION, *laws)
        if np.any(terms.get(name))
    ]
    supplies = {name: values for name, values in terms.items() if np.any(values)}
    if not areas and not supplies and not np.any(change):
        return None
    lost = -change
    rows = 1 if residual is None else 2
    ratios = {"height_ratios": [2.2, 1.0][:rows]}
    time = table["time"]
    with picture(path_of(folder, output, "ledger.png"), 8.2, 3.6 + 1.8 * (rows - 1)) as figure:
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False, gridspec_kw=ratios)[:, 0]
        if areas:
            labels, colours, values = zip(*areas)
            axes[0].stackplot(time, *values, labels=labels, colors=colours, alpha=0.75, lw=0)
        if supplies:
            _line(axes[0], time, lost, color="black", ls="--", lw=1.2, label="lost")
        for (name, values), style in zip(supplies.items(), cycle(SUPPLY_STYLES)):
            label = f"put in: {SUPPLY_NAMES.get(name, _words(name))}"
            _line(axes[0], time, values, color="black", ls=style, lw=1.2, label=label)
        label = "lost + put in" if supplies else "lost"
        _line(axes[0], time, lost + sum(supplies.values()), color="black", label=label)
        axes[0].set_ylabel("energy since the start")
        _ledger_legend(axes[0])
        if residual is not None:
            relative = table["ledger_residual"]
            _line(axes[1], time, relative, positive=True, color=GREY, lw=1.0)
            _log_axis(axes[1], [relative])
            axes[1].set_ylabel("relative residual")
        _time_axis(axes[-1], time)
        return figure.path


def _laws(table):
    """Name and colour of each law of the membranes that has an energy in the table."""
    names = [name[: -len("_energy")] for name in table if name.endswith("_energy")]
    return list(zip(names, cycle(LAW_COLOURS)))


def _words(name):
    return name.replace("_", " ")


def _column(table, name):
    """A column, all NaN if the table does not have it."""
    return table.get(name, np.full(len(table.get("time", ())), np.nan))


def _vesicle_columns(table, name):
    """A quantity of each vesicle, shape (rows, vesicles): name, or name_0, name_1, ..."""
    columns = entries(table, name)
    return np.array(columns).T.reshape(len(table.get("time", ())), len(columns))


def _largest(values):
    """Largest size over the vesicles, shape (rows,)."""
    if values.shape[1] == 0:
        return np.full(len(values), np.nan)
    return np.where(np.isnan(values), -np.inf, abs(values)).max(axis=1)


def _half_turns(angles):
    """Unwrap inclinations, which are known up to half a turn, and divide them by pi.

    A vesicle that settles ends between -1/2 and 1/2; the unwrapped curve of one that tumbles
    starts there.
    """
    turns = np.full(angles.shape, np.nan)
    for vesicle, series in enumerate(angles.T):
        known = np.isfinite(series)
        if known.any():
            curve = np.unwrap(2.0 * series[known]) / (2.0 * np.pi)
            settles = np.ptp(curve) < 1.0
            anchor = curve[-1] if settles else curve[0]
            # ceil(x - 1/2), so that exactly 1/2, an upright vesicle, stays.
            turns[known, vesicle] = curve - np.ceil(anchor - 0.5 - 1e-9)
    return turns


def _robust_limits(values):
    """Axis limits that a few wild values (a frequency at the start) do not ruin."""
    finite = values[np.isfinite(values)]
    low, high = np.quantile(finite, [0.02, 0.98])
    if np.ptp(finite) < 3.0 * (high - low):
        low, high = finite.min(), finite.max()
    margin = 0.08 * (high - low) or 0.1 * abs(high) or 0.1
    return low - margin, high + margin


def _line(axis, time, values, positive=False, **style):
    """A line of the finite values; of their sizes, without zeros, for a log axis."""
    values = np.where(np.isfinite(values), values, np.nan)
    if positive:
        values = np.where(values == 0, np.nan, abs(values))
    # A single point is no line and would not be seen.
    few = np.isfinite(values).sum() < 2
    axis.plot(time, values, marker="o" if few else None, **style)


def _log_axis(axis, series, decades=None):
    """Make the y axis logarithmic, for series that may hold no positive value at all."""
    sizes = abs(np.concatenate(series))
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    axis.set_yscale("log")
    if sizes.size == 0:
        axis.set_ylim(1e-16, 1.0)
        return
    low, high = sizes.min(), sizes.max()
    if decades is not None:
        low = max(low, high * 10.0**-decades)
    axis.set_ylim(low / 3.0, high * 8.0)


def _time_axis(axis, time):
    axis.set_xlabel("time $t$")
    if len(time) > 1 and time[-1] > time[0]:
        axis.set_xlim(time[0], time[-1])


def _ledger_legend(axis):
    """Beside the plot: first the lines, then the areas as they lie on each other."""
    handles, labels = axis.get_legend_handles_labels()
    is_line = [not hasattr(handle, "get_facecolor") for handle in handles]
    order = [k for k in range(len(handles)) if is_line[k]][::-1]
    order += [k for k in range(len(handles)) if not is_line[k]][::-1]
    axis.legend(
        [handles[k] for k in order], [labels[k] for k in order],
        loc="upper left", bbox_to_anchor=(1.0, 1.02), handlelength=2.4,
    )
