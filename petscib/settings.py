"""The frozen record of option values, and what must hold between them.

`petscib.options` declares the options and judges each value by itself; here are the values that
follow from others (the time step from the grid) and the combinations that cannot be run. Checks
that need the contents of a marker file belong to whoever reads the file.
"""

import os
import re

import numpy as np

from petscib.coupling.kernels import KERNELS
from petscib.errors import InputError
from petscib.fluid.flows import FLOWS, VARIES
from petscib.membranes.shapes import ellipse_perimeter
from petscib.schemes.registry import SCHEMES
from petscib.vesicles import OWN, of, split

# The widest marker spacing, in cells. Prototypes were sound from 0.2 to 2 cells; wider and fluid
# passes between the markers.
WIDEST_SPACING = 2.0
# The fewest markers of a closed membrane: its fourth difference spans 5 of them.
FEWEST_MARKERS = 8


class Settings:
    """Every option's value, as attributes named like the options. Frozen.

    Pure data, equal on all ranks. Built by `petscib.options.read`.

    Attributes
    ----------
    given : frozenset of str
        Names of the options the user gave; the rest are defaults of the scene or the table.
    """

    def __init__(self, values, given):
        self.__dict__.update(values, given=frozenset(given))

    def __setattr__(self, name, value):
        raise AttributeError(f"settings are frozen: {name} cannot be set")

    def __delattr__(self, name):
        raise AttributeError(f"settings are frozen: {name} cannot be deleted")

    def __eq__(self, other):
        return isinstance(other, Settings) and self.__dict__ == other.__dict__

    def __repr__(self):
        return "Settings({})".format(", ".join(f"{k}={v!r}" for k, v in self.__dict__.items()))

    def vesicle(self, number):
        """The values of one vesicle, a `vesicles.Vesicle`."""
        return of(self.__dict__, number)

    def each_vesicle(self):
        """Those of all."""
        return [self.vesicle(number) for number in range(self.vesicles)]

    @property
    def has_contrast(self):
        """Whether the viscosity inside any vesicle is another than outside."""
        return any(vesicle.viscosity_contrast != 1 for vesicle in self.each_vesicle())

    @property
    def reach(self):
        """Cells between markers and walls at least, by the delta function."""
        kernel = KERNELS[self.delta]
        wide = self.kink_correction and self.has_contrast
        return kernel.stress_reach if wide else kernel.reach

    @property
    def line_axis(self):
        """Direction of lines across the box, 0 for x: the first in which it is periodic."""
        return 0 if "x" in self.periodic else 1

    def to_dict(self):
        """Every value and, under ``given``, the sorted names the user gave; fit for JSON."""
        record = {k: list(v) if isinstance(v, tuple) else v for k, v in self.__dict__.items()}
        return dict(record, given=sorted(self.given))


def given_text(record):
    """Option text (name to text) of what the user gave, from a `Settings.to_dict` record."""
    return {name: text_of(record[name]) for name in record["given"]}


def text_of(value):
    """The text of a value as one would type it; numbers keep every digit."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (tuple, list)):
        return ",".join(text_of(entry) for entry in value)
    if isinstance(value, float):
        short = re.sub(r"e([+-])0*", "e\\1", f"{value:g}").replace("e+", "e")
        return short if float(short) == value else repr(float(value))  # numpy's say their type
    return str(value)


def typical_speed(values):
    """The speed by which the default time step is chosen.

    It is the top speed of the background flow in the box, or that of a vesicle driven by its
    bending if that is more. With L half the shorter side of the box, the latter is
    100 c_b / (mu L^2), as for a vesicle of the half width L / 10, or the smaller
    sqrt(1000 c_b / (rho L^3)) where inertia holds it back. Waves on a line stretched across the
    box run at sqrt(pi sigma / (rho length)), sigma the tension, without viscosity. Where nothing
    moves, it is the speed mu / (rho L) at which momentum spreads.

    Parameters
    ----------
    values : mapping of str to value
        Of the options.

    Returns
    -------
    float
        In the units of the options: a time step in proportion to h over this speed is the same
        in all systems of units. Infinite or not a number if the values are beyond all measure.
    """
    a, b, c, d = values["domain"]
    eighths = np.arange(9) / 8  # where all flows have their top speed, vortices at quarters
    x, y = np.meshgrid(a + (b - a) * eighths, c + (d - c) * eighths)
    rho, mu = np.float64(values["rho"]), np.float64(values["mu"])
    bending = max((of(values, k).bending for k in range(values["vesicles"])), default=0.0)
    size = min(b - a, d - c) / 2
    with np.errstate(all="ignore"):
        flow = np.abs(FLOWS[values["flow"]](x, y, values["shear_rate"], values["domain"])).max()
        membrane = min(100 * bending / (mu * size**2), np.sqrt(1000 * bending / (rho * size**3)))
        length = b - a if "x" in values["periodic"] else d - c
        waves = np.sqrt(np.pi * _tension_of_lines(values) / (rho * length))
        return float(max(flow, membrane, waves) or mu / (rho * size))


def _tension_of_lines(values):
    """The largest tension at the start in a line across the box; 0 without any."""
    vesicles = [of(values, k) for k in range(values["vesicles"])]
    return max([0.0, *(one.sigma0 * (1 - one.rest_length) for one in vesicles
                       if one.shape == "line" and one.rest_length is not None)])


def resolve(values, given, cfl):
    """Fill in the values that follow from others, in place.

    Parameters
    ----------
    values : dict
        Option name to typed value: table defaults, then the scene, then the user.
    given : set of str
        Names the user gave; none of these is changed.
    cfl : float
        The scene's time step in units of min(dx, dy) / `typical_speed`.

    Raises
    ------
    InputError
        There is no time step for these values.
    """
    a, b, c, d = values["domain"]
    if values["stag_grid_y"] is None or given & {"stag_grid_x", "stag_grid_y"} == {"stag_grid_x"}:
        values["stag_grid_y"] = max(1, round(values["stag_grid_x"] * (d - c) / (b - a)))
    elif given & {"stag_grid_x", "stag_grid_y"} == {"stag_grid_y"}:
        values["stag_grid_x"] = max(1, round(values["stag_grid_y"] * (b - a) / (d - c)))
    derived = {}
    if values["area_fraction"] is not None and values["arrangement"] != "none":
        _fill_box(values, given)
    if values["ts_dt"] is None:
        cells = values["stag_grid_x"], values["stag_grid_y"]
        speed = typical_speed(values)
        dt = cfl * min((b - a) / cells[0], (d - c) / cells[1]) / speed if speed > 0 else 0.0
        if not 0 < dt < np.inf:
            raise InputError("-ts_dt: no default follows from a flow, fluid and membrane of such "
                             "values; allowed: number above 0")
        derived["ts_dt"] = dt
    if values["startup"] is None:
        derived["startup"] = SCHEMES[values["scheme"]].startup
    for name in ("kink_correction", "conserve_area"):
        if values[name] is None:
            derived[name] = SCHEMES[values["scheme"]].implicit
    if values["output"] is None:
        derived["output"] = os.path.join("out", values["scene"])
    if values["flow"] == "rest":
        derived["shear_rate"] = 0.0
    if values["marker_file"] is not None or values["shape"] == "line":
        derived["axes"] = None
    if values["vesicles"] == 0:
        derived.update(axes=None, sigma0=0.0, bending=0.0, rest_length=None)
    values.update({name: value for name, value in derived.items() if name not in given})


def _fill_box(values, given):
    """Number of vesicles, or the size of their axes, from the part of the box that they fill."""
    a, b, c, d = values["domain"]
    rx, ry = values["axes"]
    inside = values["area_fraction"] * (b - a) * (d - c) / (np.pi * rx * ry)
    if "vesicles" in given and "axes" not in given:
        size = np.sqrt(inside / max(values["vesicles"], 1))
        values["axes"] = (size * rx, size * ry)
    elif "vesicles" not in given:
        values["vesicles"] = max(1, round(min(inside, 1e6)))


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
    a, b, c, d = settings.domain
    dx, dy = (b - a) / settings.stag_grid_x, (d - c) / settings.stag_grid_y
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

    spacing = min(dx, dy)
    markers = vesicle.markers or round(perimeter / (0.5 * spacing))
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
    along = sorted(set(VARIES[settings.flow]) & set(settings.periodic))
    if along:
        fit = [flow for flow, varies in VARIES.items() if not set(varies) & set(settings.periodic)]
        _refuse(settings, ("flow", "periodic"), f"the flow {settings.flow} varies along "
                f"{' and '.join(along)}, where the box is periodic",
                f"-flow {' or '.join(fit)}, or another -periodic")


def _check_vesicles(settings, shape_options):
    count = settings.vesicles
    for name in sorted(settings.given):
        number, base = split(name)
        if number is not None and number >= count:
            _refuse(settings, (name,), f"the last of {count} vesicles is number {count - 1}"
                    if count else "there is no vesicle (vesicles is 0)",
                    f"-vesicle_0_{base} to -vesicle_{count - 1}_{base}, or more -vesicles"
                    if count else f"-vesicles 1, or no -{name}")
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

    def refuse(name, *why):
        _refuse(settings, (vesicle.option(name),), *why)

    if from_file and vesicle.axes is not None:
        refuse("axes", "-marker_file gives the shape already", "one of the two")
    for name in ("center", "angle"):
        if from_file and name in given:
            refuse(name, "-marker_file gives the place already", "one of the two")
    if vesicle.shape != "ellipse" and from_file:
        refuse("shape", "-marker_file gives the shape already", "one of the two")
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
        if path is not None and needed and not os.path.isfile(path):
            _refuse(settings, (name,), "no such file", "an existing file")
    folder = os.path.abspath(settings.output)
    while not os.path.exists(folder):
        folder = os.path.dirname(folder)
    if not os.path.isdir(folder):
        _refuse(settings, ("output",), f"{os.path.relpath(folder)} is a file",
                "a directory, made when missing")
    if not os.access(folder, os.W_OK):
        _refuse(settings, ("output",), f"no permission to write in {folder}",
                "a writable directory")


def _refuse(settings, names, why, allowed):
    """Raise `InputError` for the first of the options that the user gave, or the first of all."""
    name = next((name for name in names if name in settings.given), names[0])
    value = text_of(getattr(settings, name))
    raise InputError(f"-{name} {value}: {why}; allowed: {allowed}")
