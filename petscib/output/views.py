"""Pictures of what is where: outlines, fields, the membranes' tension, and animations.

They are drawn from outlines and saved fields, as `plots` says.
"""

from typing import NamedTuple

import numpy as np

from . import saved
from .style import GREY, MARKED_POINT, SKY, VESICLE_COLOURS, path_of, picture

PANELS = 8  # times at which outlines are shown
FEW = 4  # vesicles whose stars do not hide them
FRAMES = 150  # of an animation at most, which are ten seconds of it
FRAMES_PER_SECOND = 15


def plot_outlines(folder, output=None):
    """``outlines.png``: the vesicles at up to eight times, marker 0 as a star (paper, Fig. 2)."""
    options = saved.read_options(folder)
    moments = saved.outlines(folder, options)
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
    with picture(path_of(folder, output, "outlines.png"), *size) as figure:
        shared = len(set(boxes)) == 1
        axes = figure.subplots(rows, columns, squeeze=False, sharex=shared, sharey=shared)
        for axis, (time, outlines), box in zip(axes.flat, panels, boxes):
            _draw_sides(axis, options)
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
    with picture(path_of(folder, output, "fields.png"), width, height) as figure:
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
    outlines = saved.newest_in_the_box(fields)
    box = _common_box([list(enumerate(outlines))])
    # A few edges, as at the tips of a thin vesicle, would otherwise set the whole scale.
    low, high = np.quantile(np.concatenate(fields.tensions), [0.01, 0.99])
    scale = dict(cmap="plasma", clim=(low, high if high > low else low + 1.0))
    shape = box.height / box.width
    width = 4.4 if shape > 0.5 else 7.0
    size = width + 1.4, width * shape + 0.7
    with picture(path_of(folder, output, "tension.png"), *size) as figure:
        axis = figure.subplots()
        for X, tension in zip(outlines, fields.tensions):
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
    moments = saved.outlines(folder, options)
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
    with picture(path_of(folder, output, name), width, height, save=False) as figure:
        axis = figure.subplots()
        with writer.saving(figure, figure.path, dpi=100):
            for time, outlines in frames:
                axis.clear()
                _draw_sides(axis, options)
                _draw_outlines(axis, outlines)
                box.frame(axis)
                axis.set(xlabel="$x$", ylabel="$y$")
                axis.set_title(f"$t = {_time_text(time, times[-1])}$")
                writer.grab_frame()
        return figure.path


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


def _finite_max(values, quantile=1.0):
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, quantile)) if finite.size else 0.0


def _draw_sides(axis, options):
    """The sides of the box, as far as they are in view: walls as lines, periodic ones dashed."""
    if "domain" not in options:
        return
    a, b, c, d = options["domain"]
    along_x, along_y = ("--" if name in options.get("periodic", "none") else "-" for name in "xy")
    for x, y, style in (((a, a), (c, d), along_x), ((b, b), (c, d), along_x),
                        ((a, b), (c, c), along_y), ((a, b), (d, d), along_y)):
        axis.plot(x, y, color=GREY, linestyle=style, linewidth=1.0)


def _draw_outlines(axis, outlines):
    """The outlines of a moment, each in its colour; marker 0 as a star, as in the paper."""
    size = 11 if len(outlines) <= FEW else 4
    for vesicle, X in outlines:
        _draw_outline(axis, X, VESICLE_COLOURS[vesicle % len(VESICLE_COLOURS)], size)


def _draw_outline(axis, X, colour, star=0):
    """An outline from `saved`, with a star of some size at marker 0."""
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


def _colour_bar(figure, axis, image, label):
    """A colour bar as high as its panel."""
    place = axis.inset_axes([1.04, 0.0, 0.05, 1.0])
    figure.colorbar(image, cax=place, label=label, extend="neither")
