"""Pictures of a run, made from its files alone: of a finished folder, or of one still growing.

Each ``plot_*`` function, of `histories` and `views`, takes the folder of a run, writes one picture
into `output` (the same folder by default) and returns its path, or None if the data for it are not
there. They raise ImportError without matplotlib, and ValueError for a damaged file. Rank 0 only,
not collective.
"""

from .histories import plot_conservation, plot_energy, plot_inclination, plot_ledger
from .views import plot_fields, plot_outlines, plot_tension


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
