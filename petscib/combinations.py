"""What must hold between option values: combinations that cannot be run are refused.

Checks that need the content of a marker file belong to who reads the file (`petscib.outlines`).
"""

import os

import numpy as np

from .errors import InputError
from .fluid.flows import VARIES
from .membranes.shapes import ellipse_perimeter
from .own import Function, Points, is_own
from .schemes.registry import SCHEMES
from .settings import NOWHERE, as_given, text_of
from .vesicles import OWN, split

# The widest marker spacing, in cells.  Wider, and fluid passes between the markers: where the area
# is not kept, that of a treading vesicle changes by 0.5, 0.3, 3.5 and 11 percent with 1, 1.5, 2 and
# 2.5 cells (-scene tanktreading -axes 0.25,0.5 -stag_grid_x 48 -fft -ts_max_time 7 -conserve_area
# false with -markers 58, 38, 30 and 24); where it is, inclination / pi is right to 1e-3 up to 3.
WIDEST_SPACING = 2.0
USUAL_SPACING = 0.5  # cells between markers, where their number is not given
# The fewest markers of a membrane: its fourth difference spans 5 of them, which show no shape yet.
FEWEST_MARKERS = 8
# Times, over the end time, at which a flow of the user's must be the same.
_TIMES = 0.0, 0.31, 0.77, 1.0


def check(settings, shape_options):
    """Refuse combinations that cannot be run.

    Parameters
    ----------
    settings : Settings
    shape_options : iterable of str
        Names of the options that describe the vesicle and its membrane.

    Raises
    ------
    InputError
    """
    _check_choices(settings)
    _check_vesicles(settings, shape_options)
    _check_files(settings)
    if settings.restart is None and settings.arrangement == "none":
        for vesicle in settings.each_vesicle():
            if vesicle.marker_file is None:
                _check_place(settings, vesicle)


def check_domain(domain):
    """Refuse an empty, inverted or needle-thin box, before anything is divided by its size."""
    a, b, c, d = domain
    if not min(b - a, d - c) > 1e-6 * max(map(abs, domain)):
        raise InputError(f"-domain {text_of(domain)}: the box is empty or too thin; allowed: "
                         "a,b,c,d with a < b and c < d, each side above 1e-6 of the largest entry")


def _check_place(settings, vesicle):
    """Refuse a shape that leaves the box, feels a wall, or is too coarsely marked."""
    if vesicle.shape == "line":
        _check_line(settings, vesicle)
        return
    angle, (rx, ry) = np.radians(vesicle.angle), vesicle.axes
    if vesicle.shape == "plate":
        rx, perimeter = 0.0, 2 * ry
    else:
        perimeter = ellipse_perimeter((rx, ry))
    # X = center + R(angle) (rx sin s, ry cos s): the amplitudes of x and y over s.
    half_sizes = np.hypot(
        (rx * np.cos(angle), rx * np.sin(angle)), (ry * np.sin(angle), ry * np.cos(angle))
    )
    low, high = vesicle.center - half_sizes, vesicle.center + half_sizes
    check_curve(settings, vesicle, low, high, perimeter, ("center", "axes", "angle"))


def _check_line(settings, vesicle):
    names = vesicle.option("shape"), "periodic"
    if settings.periodic == "none":
        _refuse(settings, names, "a line goes across a periodic box, and this one has walls",
                "-periodic x, y or xy, or another shape")
    a, b, c, d = settings.domain
    along = settings.line_axis
    low, high = np.subtract(vesicle.center, abs(vesicle.amplitude)), np.add(
        vesicle.center, abs(vesicle.amplitude))
    low[along], high[along] = ((a, b), (c, d))[along]
    check_curve(settings, vesicle, low, high, high[along] - low[along], ("center", "amplitude"))


def check_curve(settings, vesicle, low, high, perimeter, names):
    """Refuse a curve that leaves the box, feels a wall, or is too coarsely marked.

    Parameters
    ----------
    settings : Settings
    vesicle : Vesicle
    low, high : (float, float)
        Corners of the rectangle that just holds the curve.
    perimeter : float
    names : tuple of str
        The options that gave the curve, by their common names.

    Raises
    ------
    InputError
    """
    names = tuple(map(vesicle.option, names))
    _check_room(settings, names, low, high)
    _check_markers(settings, vesicle, names, perimeter)


def _check_room(settings, names, low, high):
    """Refuse a curve that meets itself across a periodic side, or feels a wall."""
    a, b, c, d = settings.domain
    dx, dy = settings.spacing
    reach = settings.reach
    placing = *names, "domain", "delta", "stag_grid_x", "stag_grid_y"
    for name, size, period in (("x", high[0] - low[0], b - a), ("y", high[1] - low[1], d - c)):
        if name in settings.periodic and size > period:
            _refuse(settings, (*placing, "periodic"), f"the vesicle is {size:.3g} long in {name} "
                    "and would meet itself across the periodic side",
                    f"at most the period, {period:.3g}")
    for gap, cell, name, wall in ((low[0] - a, dx, "x", a), (b - high[0], dx, "x", b),
                                  (low[1] - c, dy, "y", c), (d - high[1], dy, "y", d)):
        wall = f"{name} = {wall:g}"
        # The slack allows a vesicle placed exactly at the reach, against round-off.
        if name not in settings.periodic and gap < reach * cell * (1 - 1e-9):
            why = (f"the vesicle lies {-gap:.3g} beyond the wall {wall}" if gap < 0 else
                   f"the vesicle comes within {gap:.3g} of the wall {wall}")
            _refuse(settings, placing, why, f"a distance of at least {reach:g} cells "
                    f"({reach * cell:.3g}), the reach of -delta {settings.delta}")


def _check_markers(settings, vesicle, names, perimeter):
    """Refuse markers that are too few, or so far apart that fluid would pass between them."""
    spacing = min(settings.spacing)
    markers = vesicle.markers or round(perimeter / (USUAL_SPACING * spacing))
    fewest = max(FEWEST_MARKERS, int(np.ceil(perimeter / (WIDEST_SPACING * spacing))))
    if markers < fewest:
        sizes = [name for name in names if not name.endswith("center")]
        names = ((vesicle.option("markers"),) if vesicle.markers
                 else (*sizes, "stag_grid_x", "stag_grid_y"))
        _refuse(settings, names, f"{markers} markers on a perimeter of {perimeter:.3g}",
                f"at least {fewest} markers ({FEWEST_MARKERS}, and at most {WIDEST_SPACING:g} "
                "cells apart)")


def _check_choices(settings):
    scheme = f"scheme {settings.scheme}"
    if not SCHEMES[settings.scheme].implicit:
        if settings.stretch == "evolve":
            _refuse(settings, ("stretch", "scheme"), f"{scheme} takes its force from the markers",
                    "recompute, or another scheme")
        if settings.startup > 0:
            _refuse(settings, ("startup", "scheme"), f"{scheme} has no start-up steps",
                    "0, or another scheme")
        if settings.ledger != "none":
            _refuse(settings, ("ledger", "scheme"), f"{scheme} has no energy law",
                    "none, or another scheme")
    if settings.flow == "rest" and settings.shear_rate != 0:
        _refuse(settings, ("shear_rate",), "the flow is rest",
                "0, or another -flow")
    a, b, c, d = settings.domain
    places = np.meshgrid(np.linspace(a, b, 23), np.linspace(c, d, 23))
    if isinstance(settings.body_force, Function):
        settings.body_force.tried(*places, 0.0)
    if isinstance(settings.flow, Function):
        _check_flow(settings, places)
        return
    along = sorted(set(VARIES[settings.flow]) & set(settings.periodic))
    if along:
        fit = [flow for flow, varies in VARIES.items() if not set(varies) & set(settings.periodic)]
        _refuse(settings, ("flow", "periodic"), f"the flow {settings.flow} varies along "
                f"{' and '.join(along)}, where the box is periodic",
                f"-flow {' or '.join(fit)}, or another -periodic")


def _check_flow(settings, places):
    """Refuse a flow of the user's that the sides of the box cannot have."""
    flow = settings.flow
    if "shear_rate" in settings.given:
        _refuse(settings, ("shear_rate",), f"the flow is a {flow}", "no -shear_rate")
    first, *others = (
        np.array(flow.tried(*places, part * settings.ts_max_time)) for part in _TIMES)
    close = 1e-9 * np.abs(first).max()
    if any(np.abs(other - first).max() > close for other in others):
        raise flow.refused(
            "changes in time, and the walls cannot",
            "a flow that is the same at all times, or a -body_force that changes")
    for name, one, other in (("x", first[:, :, 0], first[:, :, -1]),
                             ("y", first[:, 0], first[:, -1])):
        if name in settings.periodic and np.abs(one - other).max() > close:
            raise flow.refused(f"is not the same on both sides in {name}, where the box is "
                               "periodic", "a periodic flow, or another -periodic")


def _check_vesicles(settings, shape_options):
    count = settings.vesicles
    for name in sorted(settings.given):
        number, base = split(name)
        if number is not None and number >= count:
            why, allowed = {
                0: ("there is no vesicle (vesicles is 0)", f"-vesicles 1, or no -{name}"),
                1: ("the only vesicle is number 0", f"-vesicle_0_{base}, or more -vesicles"),
            }.get(count, (
                f"the last of {count} vesicles is number {count - 1}",
                f"-vesicle_0_{base} to -vesicle_{count - 1}_{base}, or more -vesicles"))
            _refuse(settings, (name,), why, allowed)
    if count == 0:
        for name in shape_options:
            if name in settings.given and getattr(settings, name):
                _refuse(settings, (name,), "there is no vesicle (vesicles is 0)",
                        f"-vesicles 1, or no -{name}")
        if settings.ts_rtol is not None:
            _refuse(settings, ("ts_rtol",), "there is no vesicle to tell the error by "
                    "(vesicles is 0)", "-vesicles 1, or no -ts_rtol")
        return
    _check_arrangement(settings)
    for vesicle in settings.each_vesicle():
        _check_vesicle(settings, vesicle)


def _check_vesicle(settings, vesicle):
    given = {name for name in OWN if vesicle.option(name) in settings.given}
    from_file = vesicle.marker_file is not None
    curve = vesicle.marker_file
    giver = f"the keyword {curve.name}" if isinstance(curve, Points) else "-marker_file"

    def refuse(name, *why):
        _refuse(settings, (vesicle.option(name),), *why)

    if from_file and vesicle.axes is not None:
        refuse("axes", f"{giver} gives the shape already", "one of the two")
    for name in ("center", "angle"):
        if from_file and name in given:
            refuse(name, f"{giver} gives the place already", "one of the two")
    if vesicle.shape != "ellipse" and from_file:
        refuse("shape", f"{giver} gives the shape already", "one of the two")
    if vesicle.shape == "line":
        for name in ("axes", "angle"):
            if name in given:
                refuse(name, "a line goes straight across the box", f"no -{name}")
    elif "amplitude" in given:
        refuse("amplitude", "only a line has one", "-shape line, or no -amplitude")
    if vesicle.shape != "ellipse" and vesicle.viscosity_contrast != 1:
        refuse("viscosity_contrast", f"a {vesicle.shape} has no inside", "1, or another shape")
    if "rest_length" in given and vesicle.sigma0 == 0:
        refuse("rest_length", "has no meaning without tension (sigma0 is 0)",
               "-sigma0 above 0, or no -rest_length")


def _check_arrangement(settings):
    arrangement = settings.arrangement
    if arrangement == "none":
        for name in ("seed", "area_fraction"):
            if name in settings.given:
                _refuse(settings, (name,), "there is no arrangement",
                        f"-arrangement lattice or random, or no -{name}")
        return
    if {"vesicles", "axes", "area_fraction"} <= settings.given:
        _refuse(settings, ("area_fraction",), "-vesicles and -axes say it already",
                "two of the three")
    for vesicle in settings.each_vesicle():
        if vesicle.shape != "ellipse" or vesicle.marker_file is not None:
            _refuse(settings, ("arrangement",), "only ellipses are arranged",
                    "none, or -shape ellipse without -marker_file")
        if settings.area_fraction is not None and "axes" in vesicle.own:
            _refuse(settings, ("area_fraction",), "the vesicles have axes of their own",
                    f"no -{vesicle.option('axes')}, or no -area_fraction")
        for name in ("center", "angle"):
            if vesicle.option(name) in settings.given and (
                    name == "center" or arrangement == "random"):
                _refuse(settings, (vesicle.option(name),), f"-arrangement {arrangement} gives "
                        f"the {'places' if name == 'center' else 'angles'} already",
                        "one of the two")


def _check_files(settings):
    files = {vesicle.option("marker_file") for vesicle in settings.each_vesicle()}
    for name in ("restart", *sorted(files)):
        path = getattr(settings, name)
        needed = name == "restart" or settings.restart is None  # the saved markers suffice
        if path is not None and not is_own(path) and needed and not os.path.isfile(path):
            _refuse(settings, (name,), "no such file", "an existing file")
    if settings.output == NOWHERE:
        for name in ("plot", "xdmf_every", "checkpoint_every", "checkpoint_minutes"):
            if getattr(settings, name):
                _refuse(settings, (name,), "there is no folder to write to",
                        f"output=..., or no {name}")
        return
    folder = settings.output
    while not os.path.exists(folder):
        folder = os.path.dirname(folder) or "."
    if not os.path.isdir(folder):
        _refuse(settings, ("output",), f"{folder} is a file", "a directory, made when missing")
    if not os.access(folder, os.W_OK):
        _refuse(settings, ("output",), f"no permission to write in {folder}",
                "a writable directory")


def _refuse(settings, names, why, allowed):
    """Raise `InputError` for the first of the options that the user gave, or the first of all."""
    name = next((name for name in names if name in settings.given), names[0])
    raise InputError(f"{as_given(name, getattr(settings, name))}: {why}; allowed: {allowed}")
