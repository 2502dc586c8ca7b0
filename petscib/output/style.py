"""The look of all pictures, and the figure that they are drawn in."""

import os
from contextlib import contextmanager

from .files import replacing

STYLE = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 12,
    "axes.labelsize": 13,
    "axes.titlesize": 13,
    "axes.linewidth": 0.8,
    "axes.grid": False,
    "lines.linewidth": 1.5,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "legend.frameon": False,
    "legend.fontsize": 11,
    "savefig.dpi": 150,
}

# Colours of Okabe and Ito, told apart by colour-blind readers too.
BLUE, VERMILLION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, GREY = "#56B4E9", "#CC79A7", "#777777"
VESICLE_COLOURS = (BLUE, GREEN, PURPLE, ORANGE, SKY, GREY)
MARKED_POINT = VERMILLION


@contextmanager
def picture(path, width, height, save=True):
    """A figure of a size in inches, written to a PNG file when the block ends.

    The pyplot interface and its global state stay untouched. The file appears under its name only
    when complete.

    Parameters
    ----------
    path : str
        Also the figure's attribute ``path``.
    width, height : float
    save : bool
        Whether it is written.

    Raises
    ------
    ImportError
        Without matplotlib.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        figure.path = path
        yield figure
        if save:
            with replacing(path) as part:
                figure.savefig(part, format="png", bbox_inches="tight", pad_inches=0.06)


def path_of(folder, output, name):
    """Where a picture of a run's folder goes: there, or into another folder."""
    return os.path.join(folder if output is None else output, name)
