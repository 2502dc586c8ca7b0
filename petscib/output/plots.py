"""Pictures of a run, made from its files alone: of a finished folder, or of one still growing.

Each ``plot_*`` function takes the folder of a run, writes one picture into `output` (the same
folder by default) and returns its path, or None if the data for it are not there. They raise
ImportError without matplotlib, and ValueError for a damaged file. Rank 0 only, not collective.
"""

import os
from itertools import cycle
from typing import NamedTuple

import numpy as np

from . import saved
from .style import (
    BLUE,
    GREEN,
    GREY,
    MARKED_POINT,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    VESICLE_COLOURS,
    picture,
)

LAW_COLOURS = VERMILLION, GREEN, ORANGE, PURPLE, GREY
SOLVES = (
    ("momentum", BLUE, "o"),
    ("poisson", ORANGE, "s"),
    ("coupled", VERMILLION, "^"),
    ("picard", GREEN, "D"),
)
#: Ledger terms that can only take energy away, in stacking order, before those of the laws; all
#: others can have any sign.
DISSIPATION = (
    ("viscous", "viscosity", BLUE),
    ("inertia", "numerical: inertia", SKY),
    ("projection", "numerical: projection", "#F0E442"),
    ("kink", "kink correction", "#000000"),
)
SUPPLY_NAMES = {"wall_power": "walls", "body_power": "body force", "load_power": "loads",
                "reset": "stretching reset"}
SUPPLY_STYLES = (":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (7, 2)), (0, (3, 1, 1, 1)))

PANELS = 8
FEW = 4  # vesicles whose stars do not hide them
FRAMES = 150
FRAMES_PER_SECOND = 15


def plot_all(folder, output=None):
    """Draw every picture that the files of `folder` allow.

    Returns
    -------
    list of str
        Paths written.

    Raises
    ------
    ImportError
        Without matplotlib.
    ValueError
        If a table is damaged.
    """
    import matplotlib  # noqa: F401  (say so at once, whatever files there are)

    pictures = (
        plot_outlines,
        plot_inclination,
        plot_conservation,
        plot_energy,
        plot_ledger,
        plot_fields,
        plot_tension,
    )
    paths = [plot(folder, output) for plot in pictures]
    return [path for path in paths if path is not None]


def plot_outlines(folder, output=None):
    """``outlines.png``: the vesicles at up to eight times, marker 0 as a star (paper, Fig. 2)."""
    options = saved.read_options(folder)
    moments = saved.to_their_ends(saved.in_the_box(saved.read_moments(folder), options), options)
    if not moments:
        return None
    times = np.array([time for time, _ in moments])
    wanted = np.linspace(times[0], times[-1], PANELS)
    chosen = sorted({int(np.argmin(abs(times - time))) for time in wanted})
    panels = [moments[k] for k in chosen]
    columns = min(len(panels), 4)
    rows = -(-len(panels) // columns)
    boxes = _boxes([outlines for _, outlines in panels])
    size = (2.4 * columns + 0.8, rows * (2.3 * boxes[0].height / boxes[0].width + 0.45) + 0.4)
    with picture(_path(folder, output, "outlines.png"), *size) as figure:
        shared = len(set(boxes)) == 1
        axes = figure.subplots(rows, columns, squeeze=False, sharex=shared, sharey=shared)
        for axis, (time, outlines), box in zip(axes.flat, panels, boxes):
            _draw_outlines(axis, outlines)
            box.frame(axis)
            axis.locator_params(nbins=4)
            axis.set_title(f"$t = {_time_text(time, times[-1])}$")
        for axis in axes.flat[len(panels) :]:
            axis.set_visible(False)
        for column in range(columns):
            lowest = axes[(len(panels) - 1 - column) // columns, column]
            lowest.set_xlabel("$x$")
            lowest.tick_params(labelbottom=True)
        for axis in axes[:, 0]:
            axis.set_ylabel("$y$", rotation=0, labelpad=8)
        return figure.path


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
    with picture(_path(folder, output, "inclination.png"), 6.0, 2.6 * len(panels) + 0.4) as figure:
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axis, (label, values) in zip(axes, panels):
            for vesicle, series in enumerate(values.T):
                colour = VESICLE_COLOURS[vesicle % len(VESICLE_COLOURS)]
                _line(axis, table["time"], series, color=colour, label=f"vesicle {vesicle}")
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
    with picture(_path(folder, output, "conservation.png"), 6.0, 2.6 * rows + 0.4) as figure:
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
            style = dict(linestyle="none", marker=symbol, markersize=size, markeredgewidth=0)
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
    with picture(_path(folder, output, "energy.png"), 6.0, 5.6) as figure:
        axes = figure.subplots(2, 1, sharex=True)
        for axis, positive in zip(axes, (False, True)):
            line = dict(color="black", label="total", positive=positive)
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
    with picture(_path(folder, output, "ledger.png"), 8.2, 3.6 + 1.8 * (rows - 1)) as figure:
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


def plot_fields(folder, output=None):
    """``fields.png``: speed with streamlines, and vorticity, of the newest saved fields."""
    fields = saved.read_fields(folder)
    if fields is None:
        return None
    a, b, c, d = fields.domain
    rows, columns = (1, 2) if b - a < 1.6 * (d - c) else (2, 1)
    panel_width = 3.4 if columns == 2 else 6.0
    width = columns * (panel_width + 1.6)
    height = rows * (panel_width * (d - c) / (b - a) + 0.5) + 0.4
    with picture(_path(folder, output, "fields.png"), width, height) as figure:
        axes = figure.subplots(rows, columns, sharex=True, sharey=True)
        u, v = saved.centre_velocity(fields.u, fields.v)
        speed = np.hypot(u, v)
        image = axes[0].imshow(
            speed, origin="lower", extent=fields.domain, cmap=_light_blues(), vmin=0,
            vmax=_finite_max(speed) or 1.0, interpolation="bicubic",
        )
        _colour_bar(figure, axes[0], image, r"speed $|\mathbf{u}|$ (length/time)")
        if _finite_max(speed) > 0:
            _draw_streamlines(axes[0], fields.domain, u, v)
        vorticity, x, y = saved.corner_vorticity(fields)
        # A few corners beside the membrane would otherwise set the whole scale.
        limit = _finite_max(abs(vorticity), quantile=0.998) or 1.0
        image = axes[1].pcolormesh(
            x, y, vorticity, cmap="RdBu_r", vmin=-limit, vmax=limit, rasterized=True,
            shading="gouraud",
        )
        _colour_bar(figure, axes[1], image, r"vorticity $\omega$ (1/time)")
        for axis in axes:
            for X in fields.outlines:
                for shift in saved.periodic_shifts(fields, X):
                    _draw_outline(axis, X + shift, "black")
            axis.set(xlim=(a, b), ylim=(c, d), aspect="equal", xlabel="$x$", ylabel="$y$")
            axis.set_title(f"$t = {_time_text(fields.time, fields.time)}$")
            axis.label_outer()
            axis.locator_params(nbins=5)
        return figure.path


def plot_tension(folder, output=None):
    """``tension.png``: the membranes of the newest saved file, coloured by their tension."""
    from matplotlib.collections import LineCollection

    fields = saved.read_fields(folder)
    if fields is None or not any(np.any(tension) for tension in fields.tensions):
        return None
    box = _common_box([list(enumerate(fields.outlines))])
    # A few edges, as at the tips of a thin vesicle, would otherwise set the whole scale.
    low, high = np.quantile(np.concatenate(fields.tensions), [0.01, 0.99])
    scale = dict(cmap="plasma", clim=(low, high if high > low else low + 1.0))
    shape = box.height / box.width
    width = 4.4 if shape > 0.5 else 7.0
    with picture(_path(folder, output, "tension.png"), width + 1.4, width * shape + 0.7) as figure:
        axis = figure.subplots()
        for X, tension in zip(fields.outlines, fields.tensions):
            edges = np.stack((X[:-1], X[1:]), axis=1)
            image = LineCollection(edges, array=tension, linewidths=3.5, capstyle="round", **scale)
            axis.add_collection(image)
        box.frame(axis)
        axis.set(xlabel="$x$", ylabel="$y$", title=f"$t = {_time_text(fields.time, fields.time)}$")
        axis.locator_params(nbins=5)
        _colour_bar(figure, axis, image, r"tension $\sigma$ (force)")
        return figure.path


def animate(folder, output=None, mp4=False):
    """``animation.gif`` or ``animation.mp4``: the vesicles moving, marker 0 as a star.

    Raises
    ------
    RuntimeError
        If an mp4 is asked for and there is no ffmpeg.
    """
    from matplotlib import animation

    options = saved.read_options(folder)
    moments = saved.to_their_ends(saved.in_the_box(saved.read_moments(folder), options), options)
    if not moments:
        return None
    if mp4 and not animation.FFMpegWriter.isAvailable():
        raise RuntimeError("an mp4 needs the program ffmpeg, which was not found")
    times = np.array([time for time, _ in moments])
    wanted = np.linspace(times[0], times[-1], min(FRAMES, len(moments)))
    frames = [moments[int(np.argmin(abs(times - time)))] for time in wanted]
    box = _common_box([outlines for _, outlines in frames])
    writer_class = animation.FFMpegWriter if mp4 else animation.PillowWriter
    writer = writer_class(fps=FRAMES_PER_SECOND)
    name = "animation.mp4" if mp4 else "animation.gif"
    shape = min(max(box.height / box.width, 0.15), 2.0)
    width = 5.0 if shape > 0.7 else 8.0
    height = (width - 0.8) * shape + 0.8
    with picture(_path(folder, output, name), width, height, save=False) as figure:
        axis = figure.subplots()
        with writer.saving(figure, figure.path, dpi=100):
            for time, outlines in frames:
                axis.clear()
                _draw_outlines(axis, outlines)
                box.frame(axis)
                axis.set(xlabel="$x$", ylabel="$y$")
                axis.set_title(f"$t = {_time_text(time, times[-1])}$")
                writer.grab_frame()
        return figure.path


def _path(folder, output, name):
    """Where a picture goes."""
    return os.path.join(folder if output is None else output, name)


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
    columns = [table[name]] if name in table else []
    while f"{name}_{len(columns)}" in table:
        columns.append(table[f"{name}_{len(columns)}"])
    return np.array(columns).T.reshape(len(table.get("time", ())), len(columns))


# Preparing numbers


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


def _finite_max(values, quantile=1.0):
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, quantile)) if finite.size else 0.0


class _Box(NamedTuple):
    """What part of the plane a panel shows."""

    x: float
    y: float
    width: float
    height: float

    def frame(self, axis):
        axis.set(
            xlim=(self.x - self.width / 2, self.x + self.width / 2),
            ylim=(self.y - self.height / 2, self.y + self.height / 2),
            aspect="equal",
        )


def _extents(panels):
    """Corners of what each panel, a list of (vesicle, X), holds: two arrays, shape (panels, 2)."""
    points = [np.concatenate([X for _, X in outlines]) for outlines in panels]
    return np.array([X.min(axis=0) for X in points]), np.array([X.max(axis=0) for X in points])


def _common_box(panels):
    """A box for all panels, with room for the star and without narrow strips."""
    low, high = _extents(panels)
    low_end, high_end, largest = low.min(axis=0), high.max(axis=0), (high - low).max()
    sides = np.maximum(high_end - low_end, 0.6 * largest) + 0.2 * largest
    return _Box(*(low_end + high_end) / 2.0, *sides)


def _boxes(panels):
    """A box for each panel: the same, unless the vesicles travel far and would look small in it."""
    common = _common_box(panels)
    low, high = _extents(panels)
    side = 1.3 * (high - low).max()
    if max(common.width, common.height) <= 1.7 * side:
        return [common] * len(panels)
    return [_Box(*centre, side, side) for centre in (low + high) / 2.0]


def _time_text(time, largest):
    """A time with a number of decimals that suits the longest time of its series."""
    decimals = 2 if largest >= 1 else int(np.ceil(-np.log10(largest))) + 2 if largest > 0 else 0
    return f"{time:.{min(decimals, 8)}f}"


# Drawing


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


def _draw_outlines(axis, outlines):
    """The outlines of a moment, each in its colour; marker 0 as a star, as in the paper."""
    size = 11 if len(outlines) <= FEW else 4
    for vesicle, X in outlines:
        _draw_outline(axis, X, VESICLE_COLOURS[vesicle % len(VESICLE_COLOURS)], size)


def _draw_outline(axis, X, colour, star=0):
    """An outline from `_to_its_end`, with a star of some size at marker 0."""
    axis.plot(*X.T, color=colour, linewidth=1.6)
    if star:
        axis.plot(*X[0], marker="*", markersize=star, color=MARKED_POINT, markeredgewidth=0)


def _light_blues():
    """White to a blue on which thin dark streamlines can still be seen."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("light_blues", ["white", SKY, "#3A8FC4"])


def _draw_streamlines(axis, domain, u, v):
    a, b, c, d = domain
    n, m = u.shape
    # Streamlines need no more than about 100 points a side, and take long on fine grids.
    skip_x, skip_y = max(1, m // 100), max(1, n // 100)
    x = (a + (b - a) / m * (np.arange(m) + 0.5))[::skip_x]
    y = (c + (d - c) / n * (np.arange(n) + 0.5))[::skip_y]
    axis.streamplot(
        x, y, np.nan_to_num(u[::skip_y, ::skip_x]), np.nan_to_num(v[::skip_y, ::skip_x]),
        color="0.3", linewidth=0.6, arrowsize=0.8, density=1.0,
    )


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


def _colour_bar(figure, axis, image, label):
    """A colour bar as high as its panel."""
    place = axis.inset_axes([1.04, 0.0, 0.05, 1.0])
    figure.colorbar(image, cax=place, label=label, extend="neither")
