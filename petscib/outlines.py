"""The membranes that a run starts with, as the settings say."""

from dataclasses import dataclass

import numpy as np

from .combinations import USUAL_SPACING, check_curve
from .errors import InputError
from .membranes import arrangement, shapes
from .membranes.curves import Curves
from .membranes.gaps import Gaps, contains
from .membranes.laws import Bending, Contact, Load, Tension, Tether, WallContact
from .own import Points
from .settings import as_given

# Cells of fluid that an arrangement leaves between vesicles, twice what `guard` warns of.
MARGIN = 2.0


@dataclass
class Outline:
    """A membrane at the start.

    Attributes
    ----------
    markers : ndarray, shape (M, 2)
    length : float
        Of the curve that the markers are on.
    closed : bool
    period : (float, float)
        How far a line across a periodic box goes before it begins again.
    remark : str
        What the user should know of it.
    """

    markers: np.ndarray
    length: float
    closed: bool = True
    period: tuple = (0.0, 0.0)
    remark: str = ""

    @property
    def ds(self):
        """Parameter step of the markers."""
        return self.length / (len(self.markers) - (not self.closed))


def first(settings, grid):
    """The Outline of each vesicle.  Rank 0 only.

    Raises
    ------
    InputError
        A file is unfit, or vesicles do not go where they should.
    """
    vesicles = settings.each_vesicle()
    if settings.arrangement != "none":
        vesicles = _arranged(settings, grid, vesicles)
    outlines = [_outline(settings, grid, vesicle) for vesicle in vesicles]
    _check_gaps(settings, grid, outlines)
    return outlines


def curves_of(outlines):
    """How the markers of some outlines are joined."""
    return Curves([len(one.markers) for one in outlines], [one.ds for one in outlines],
                  [one.closed for one in outlines], [one.period for one in outlines])


def laws_of(settings, grid, curves, rest, targets):
    """Laws and loads of all membranes; without markers on the ranks that have none.

    Parameters
    ----------
    settings : Settings
    grid : Grid
    curves : Curves
    rest : ndarray, shape (H,)
        Stretching without tension.
    targets : ndarray, shape (M, 2)
        Where tethers hold the markers.

    Returns
    -------
    laws, loads : list
    """
    vesicles = settings.each_vesicle()
    mine = vesicles[: curves.count]  # all of them where the markers are, none elsewhere
    edges, markers = np.diff(curves.edge_starts), np.diff(curves.starts)

    def at(counts, name):
        return np.repeat([getattr(vesicle, name) for vesicle in mine], counts)

    laws, loads = [], []
    if any(vesicle.sigma0 for vesicle in vesicles):
        laws.append(Tension(curves, at(edges, "sigma0"), rest))
    if any(vesicle.bending for vesicle in vesicles):
        laws.append(Bending(curves, at(markers, "bending")[curves.triples[:, 1]]))
    if any(vesicle.tether for vesicle in vesicles):
        laws.append(Tether(curves, at(markers, "tether"), targets))
    if settings.contact:
        reach = settings.contact_range * min(grid.dx, grid.dy)
        laws += [law(curves, settings.contact, reach, grid) for law in (Contact, WallContact)]
    if any(any(vesicle.load) for vesicle in vesicles):
        forces = np.array([vesicle.load for vesicle in mine]).reshape(-1, 2)
        loads.append(Load(curves, curves.spread(forces)))
    return laws, loads


def rest_of(settings, curves, stretch):
    """Stretching without tension at the half points: that of the start, unless given."""
    rest = stretch.copy()
    for vesicle, part in zip(settings.each_vesicle(), curves.edge_parts(rest)):
        if vesicle.rest_length is not None:
            part[:] = vesicle.rest_length
    return rest


def _outline(settings, grid, vesicle):
    """Markers of one vesicle, at the usual spacing unless counted."""
    spacing = USUAL_SPACING * min(grid.dx, grid.dy)
    if vesicle.marker_file is not None:
        return _from_file(settings, vesicle, spacing)
    if vesicle.shape == "line":
        axis = settings.line_axis
        start = np.array(vesicle.center)
        start[axis] = grid.domain[2 * axis]
        period = np.zeros(2)
        period[axis] = grid.domain[2 * axis + 1] - grid.domain[2 * axis]
        count = vesicle.markers or round(period[axis] / spacing)
        markers, length = shapes.line(start, start + period, vesicle.amplitude, count)
        return Outline(markers, length, period=tuple(period))
    if vesicle.shape == "plate":
        length = 2 * vesicle.axes[1]
        count = vesicle.markers or round(length / spacing) + 1
        markers = shapes.plate(vesicle.axes[1], vesicle.center, vesicle.angle, count)
        return Outline(markers, length, closed=False)
    length = shapes.ellipse_perimeter(vesicle.axes)
    count = vesicle.markers or round(length / spacing)
    return Outline(shapes.ellipse(vesicle.axes, vesicle.center, vesicle.angle, count), length)


def _from_file(settings, vesicle, spacing):
    # What these need of scipy takes some 0.3 s to load: not for an ellipse.
    from .membranes import curve_files
    from .membranes.crossings import find_crossing
    from .membranes.splines import Spline

    given = vesicle.marker_file
    begin = as_given(vesicle.option("marker_file"), given)

    def unfit(why):
        allowed = given.allowed if isinstance(given, Points) else curve_files.ALLOWED
        return InputError(f"{begin}: {why}; allowed: {allowed}")

    try:
        if isinstance(given, Points):
            points, remark = curve_files.points_of(given.array)
        else:
            points, remark = curve_files.read_points(given)
        spline = Spline(points)
    except (OSError, ValueError) as error:
        raise unfit(error) from None
    names = ("marker_file",)
    check_curve(settings, vesicle, points.min(axis=0), points.max(axis=0), spline.length, names)
    markers = spline.markers(vesicle.markers or round(spline.length / spacing))
    # The smooth curve goes a little beyond its points.
    low, high = markers.min(axis=0), markers.max(axis=0)
    check_curve(settings, vesicle, low, high, spline.length, names)
    if find_crossing(markers):
        raise unfit("the smooth curve through the points crosses itself")
    return Outline(markers, spline.length, remark=remark and f"{begin}: {remark}")


def _arranged(settings, grid, vesicles):
    """The vesicles with places, and angles, that an arrangement gives them."""
    cell = np.array((grid.dx, grid.dy))
    box = arrangement.Box(grid.domain, grid.periodic, MARGIN * cell.max(),
                          max(settings.reach, MARGIN) * cell)
    axes = [vesicle.axes for vesicle in vesicles]
    try:
        if settings.arrangement == "random":
            centers, angles = arrangement.random(box, axes, settings.seed)
        else:
            angles = [vesicle.angle for vesicle in vesicles]
            centers, angles = arrangement.lattice(box, axes, angles)
    except arrangement.NoRoom as error:
        raise InputError(
            f"-arrangement {settings.arrangement}: {error}, {MARGIN:g} cells apart; allowed: "
            "fewer -vesicles, smaller -axes or another -seed") from None
    return [vesicle.placed(center, angle)
            for vesicle, center, angle in zip(vesicles, centers.tolist(), angles.tolist())]


def _check_gaps(settings, grid, outlines):
    """Refuse membranes that meet, or of which one is inside another."""
    if len(outlines) < 2:
        return
    markers = np.concatenate([one.markers for one in outlines])
    gap = Gaps(curves_of(outlines), grid).measure(markers)
    pair = gap.crossed or _nested(grid, outlines)
    if pair:
        vesicle = settings.vesicle(pair[1])
        name = vesicle.option("center" if vesicle.marker_file is None else "marker_file")
        raise InputError(
            f"{as_given(name, getattr(settings, name))}: vesicle {pair[1]} meets vesicle "
            f"{pair[0]}; allowed: places apart, as by -vesicle_{pair[1]}_center x,y, or "
            "-arrangement lattice or random")


def _nested(grid, outlines):
    """A pair of which one is inside the other, or None."""
    home = [one.markers + grid.way_home(one.markers.mean(axis=0)) for one in outlines]
    boxes = np.array([(markers.min(axis=0), markers.max(axis=0)) for markers in home])
    for inner in range(len(home)):
        within = ((boxes[:, 0] <= boxes[inner, 0]) & (boxes[inner, 1] <= boxes[:, 1])).all(axis=1)
        for outer in np.flatnonzero(within):
            closed = outlines[outer].closed and not any(outlines[outer].period)
            if outer != inner and closed and contains(home[outer], home[inner][0]):
                return min(inner, outer), max(inner, outer)
    return None
