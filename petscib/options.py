"""The options: one table, and how the values of a run are read from it.

Validation, ``-help`` (`petscib.help`) and docs/options.md come from that table.  `read` turns
PETSc's option database, as text, into a frozen `Settings`.  A value given by the user wins over the
scene's, and that over the table's default.  This module needs neither PETSc nor MPI.
"""

import difflib
import re
from dataclasses import dataclass, replace
from typing import Any

from . import petsc_options, scenes
from .combinations import check, check_domain
from .coupling.kernels import KERNELS
from .derived import resolve
from .errors import InputError, shortened
from .fluid.flows import FLOWS
from .option_kinds import (
    Choice,
    Curve,
    Flag,
    Flow,
    Force,
    Number,
    Numbers,
    Path,
    SceneName,
    Whole,
)
from .own import is_own
from .schemes.registry import SCHEMES
from .settings import NOWHERE, Settings, text_of
from .vesicles import OWN, split


@dataclass(frozen=True)
class Option:
    """One row of the table.

    `default` is a typed value; `automatic` says in words what an unset default (or 0) leads to.
    """

    name: str
    kind: Any
    default: Any
    group: str
    help: str
    unit: str = ""
    automatic: str = ""

    @property
    def default_text(self):
        """The default as -help shows it."""
        return self.automatic or text_of(self.default)


# --- the table

RUN, FLUID, SHAPE, MEMBRANE, TIME, OUTPUT = GROUPS = (
    "Run", "Fluid and background flow", "Shape of the vesicles", "Membrane", "Scheme and time",
    "Results")

ANY, POSITIVE, NOT_NEGATIVE = Number(), Number(0, open_low=True), Number(0)
FRACTION = Number(0, 1, open_low=True, open_high=True)
CELLS = Whole(8, 2**15)

TABLE = {option.name: option for option in (
    Option("scene", SceneName(tuple(scenes.SCENES)), scenes.DEFAULT, RUN,
           "named set of defaults; `-scene list` prints them all"),
    Option("fft", Flag(), False, RUN, "fast direct solvers (transforms) under all solves"),
    Option("picard_rtol", FRACTION, 1e-9, RUN, "gbe, gcn: tolerance of the tangent iteration"),
    Option("picard_max_it", Whole(1, 10000), 100, RUN, "gbe, gcn: largest number of tangent "
           "iterations in a step"),
    Option("ledger", Choice(("none", "record", "warn", "error")), "none", RUN,
           "check the energy law of each step: only record its terms, warn, or end the run when "
           "they do not balance"),
    Option("ledger_tol", FRACTION, 1e-6, RUN,
           "largest ledger residual, relative to the largest energy so far"),
    Option("restart", Path(), None, RUN, "checkpoint to continue from; `latest`: the newest in the "
           "output directory", automatic="none"),

    Option("stag_grid_x", CELLS, 64, FLUID, "cells across"),
    Option("stag_grid_y", CELLS, None, FLUID, "cells up; when only one of the two is given, the "
           "other makes the cells square", automatic="square cells"),
    Option("domain", Numbers(("a", "b", "c", "d"), Number(-1e9, 1e9)), (-1.0, 1.0, -1.0, 1.0),
           FLUID, "box a <= x <= b, c <= y <= d", "length"),
    Option("periodic", Choice(("none", "x", "y", "xy")), "none", FLUID,
           "directions in which the box repeats itself, without walls"),
    Option("rho", POSITIVE, 1.0, FLUID, "density", "mass/area"),
    Option("mu", POSITIVE, 1.0, FLUID, "viscosity", "mass/time"),
    Option("advection", Choice(("none", "explicit", "implicit")), "none", FLUID,
           "whether the flow carries its momentum along (Navier-Stokes), and how that is treated: "
           "explicit is cheaper, implicit stable at any time step"),
    Option("flow", Flow(tuple(FLOWS)), "rest", FLUID,
           "background flow: on the walls, and at the start"),
    Option("shear_rate", ANY, 1.0, FLUID, "rate of the background flow (0 at rest)", "1/time"),
    Option("body_force", Force(("fx", "fy")), (0.0, 0.0), FLUID,
           "uniform force on the fluid, as a pressure gradient would drive it", "force/area"),

    Option("vesicles", Whole(0, 10000), 1, SHAPE, "number of vesicles"),
    Option("vesicle_file", Path(), None, SHAPE, "list of vesicles, one a line: words such as "
           "axes=0.1,0.3 center=0.2,0 for what differs from the common values",
           automatic="none"),
    Option("arrangement", Choice(("none", "lattice", "random")), "none", SHAPE,
           "where vesicles lie: at their -center (none), or without overlap in rows (lattice), "
           "or anywhere at any angle (random)"),
    Option("seed", Whole(0), 0, SHAPE, "number from which the random arrangement is drawn"),
    Option("area_fraction", FRACTION, None, SHAPE, "part of the box that the vesicles of an "
           "arrangement fill: sets their number or, where -vesicles is given, the size of their "
           "axes",
           automatic="by number and axes"),
    Option("shape", Choice(("ellipse", "line", "plate")), "ellipse", SHAPE, "an ellipse; a line "
           "across a periodic box; a plate, which is an open straight line of length 2 ry"),
    Option("axes", Numbers(("rx", "ry"), POSITIVE), (0.1, 0.5), SHAPE,
           "half axes of the ellipse (rx sin s, ry cos s)", "length"),
    Option("center", Numbers(("x", "y")), (0.0, 0.0), SHAPE, "centre of a vesicle", "length"),
    Option("angle", Number(-360, 360), 0.0, SHAPE, "rotation of a vesicle, counter-clockwise",
           "degrees"),
    Option("amplitude", ANY, 0.0, SHAPE, "height of the sine wave that a line across the box has "
           "at the start", "length"),
    Option("markers", Whole(0, 10**7), 0, SHAPE, "number of markers, equally spaced in arclength; "
           "0: by the grid", automatic="0: spacing h/2"),
    Option("marker_file", Curve(), None, SHAPE, "closed curve to use instead of the ellipse: a "
           "text file, x and y of one point a line, also as IBAMR, IB2d and PetIBM write it",
           automatic="none"),

    Option("sigma0", NOT_NEGATIVE, 1e5, MEMBRANE, "tension stiffness", "force"),
    Option("bending", NOT_NEGATIVE, 0.01, MEMBRANE, "bending rigidity", "force length^2"),
    Option("rest_length", NOT_NEGATIVE, None, MEMBRANE,
           "elastic membrane: the stretching at which it has no tension; that of the start is 1",
           automatic="the initial stretching"),
    Option("tether", NOT_NEGATIVE, 0.0, MEMBRANE,
           "stiffness of springs that hold the markers where they start", "force/length^2"),
    Option("load", Numbers(("fx", "fy")), (0.0, 0.0), MEMBRANE,
           "given force on the membrane, such as its weight", "force/length"),
    Option("viscosity_contrast", Number(0.01, 1000), 1.0, MEMBRANE,
           "viscosity inside over that outside"),
    Option("contact", NOT_NEGATIVE, 0.0, MEMBRANE, "strength K of a repulsion between membranes "
           "and from walls, with the energy K/2 (1 - distance/range)^4 per length^2; 0: none",
           "force/length"),
    Option("contact_range", Number(0.1, 100), 2.0, MEMBRANE,
           "range of the repulsion of -contact", "cells"),
    Option("delta", Choice(tuple(KERNELS)), "yang", MEMBRANE,
           "smoothed delta function between markers and grid"),
    Option("kink_correction", Flag(), None, MEMBRANE, "let markers slip by what smoothing takes "
           "from the velocity: second order in space", automatic="true; false for ep"),
    Option("conserve_area", Flag(), None, MEMBRANE, "keep the area that a membrane encloses",
           automatic="true; false for ep"),
    Option("stretch", Choice(("recompute", "evolve")), "recompute", MEMBRANE,
           "stretching: taken from the markers at each step, or a variable of its own"),

    Option("scheme", Choice(tuple(SCHEMES)), "mbe", TIME,
           "; ".join(f"{name}: {scheme.words}" for name, scheme in SCHEMES.items())),
    Option("startup", Whole(0, 1000), None, TIME,
           "number of first steps that are taken as two backward Euler half steps each",
           automatic="1 for cn and gcn, else 0"),
    Option("ts_dt", POSITIVE, None, TIME, "time step", "time",
           automatic="the scene's multiple of min(dx, dy) / speed of flow or membrane, as "
           "`-scene list` explains"),
    Option("ts_max_time", POSITIVE, 1.0, TIME, "end time", "time"),
    Option("ts_max_steps", Whole(), None, TIME, "largest number of steps", automatic="no limit"),
    Option("ts_rtol", FRACTION, None, TIME, "largest error of a step in the markers' positions, "
           "relative to the vesicle's size: the time step follows it, from ts_dt on, up to 64 "
           "ts_dt and as explicit advection allows", automatic="none: fixed time steps"),
    Option("ts_adapt", Flag(), False, TIME, "retry a failed step with half the time step, halve "
           "it before explicit advection makes one fail, and grow it back later"),

    Option("output", Path(), None, OUTPUT, "directory of the results", automatic="out/SCENE"),
    Option("monitor", Choice(("none", "bar", "log")), None, OUTPUT, "progress on the screen",
           automatic="bar on a terminal, else log"),
    Option("diagnostics_every", Whole(1), 1, OUTPUT, "steps between rows of diagnostics.csv"),
    Option("outline_every", Whole(0), 0, OUTPUT, "steps between outlines; 0: by the run's length",
           automatic="0: about 100 a run"),
    Option("plot", Flag(), True, OUTPUT, "draw pictures at the end"),
    Option("xdmf_every", Whole(0), 0, OUTPUT, "steps between fields for ParaView; 0: none"),
    Option("checkpoint_every", Whole(0), 0, OUTPUT, "steps between checkpoints; 0: none"),
    Option("checkpoint_minutes", NOT_NEGATIVE, 0.0, OUTPUT,
           "wall time between checkpoints; 0: none", "minutes"),
    Option("checkpoint_keep", Whole(1), 2, OUTPUT, "number of checkpoints that are kept"),
)}


def option_of(name):
    """The row of an option, also of one vesicle's own such as vesicle_1_axes; None if unknown."""
    number, base = split(name)
    if number is None:
        return TABLE.get(name)
    return replace(TABLE[base], name=name) if base in OWN else None


# --- reading


def read(database, writes=True):
    """The settings that the user asks for, from what `vesicle_files.expand` returns.

    Parameters
    ----------
    database : mapping of str to str or None
        PETSc's option database: name without the dash, in any case, to text; None or '' for an
        option without a value. The same on all ranks. Functions and arrays of a script stand in
        the place of some texts.
    writes : bool
        Whether the run leaves files at all.

    Returns
    -------
    Settings

    Raises
    ------
    InputError
        For an option that is nobody's, a bad value, or options that contradict each other.
    """
    given = {}
    for name, text in database.items():
        option = option_of(name.lower())
        if option is not None:
            given[option.name] = value_of(option, "" if text is None else text)
        elif not petsc_options.is_petsc(name.lower()):
            raise InputError(_unknown(name, "" if text is None else str(text)))
    scene = scenes.find(given.get("scene", scenes.DEFAULT))
    values = {option.name: option.default for option in TABLE.values()}
    values.update(_scene_values(scene), scene=scene.name)
    values.update(given)
    if not writes:
        values["output"] = NOWHERE
    check_domain(values["domain"])
    resolve(values, set(given), scene.cfl_of(values["scheme"]))
    settings = Settings(values, given)
    for name in ("stag_grid_x", "stag_grid_y"):  # one of them may follow from the other
        value_of(TABLE[name], text_of(getattr(settings, name)))
    # Three of the options say how something is done, and ask for no vesicle.
    check(settings, [option.name for option in TABLE.values() if option.group in (SHAPE, MEMBRANE)
                     and option.name not in ("delta", "stretch", "contact_range")])
    return settings


def _scene_values(scene):
    """The settings of a scene, as values of options."""
    if scene.name in scenes.SCENES:
        return scene.settings
    values = {}
    for name, value in scene.settings.items():
        option = option_of(name)
        if option is None or option.name == "scene":
            raise InputError(f"-scene {scene.name}: {_unknown(name, text_of(value))}")
        try:
            values[name] = value_of(option, entry_of(option, value))
        except InputError as error:
            raise InputError(f"-scene {scene.name}: {error}") from None
    return values


def entry_of(option, value):
    """What `read` takes for a value of Python's: its text, but for functions and points."""
    if value is None or isinstance(value, str):
        return value
    array = isinstance(option.kind, Curve)
    return value if array or callable(value) or is_own(value) else text_of(value)


def value_of(option, text):
    """The value of one option from its text; raises InputError."""
    try:
        if isinstance(text, str) and text == "" and not isinstance(option.kind, Flag):
            raise ValueError("needs a value")
        return option.kind.parse(text)
    except (ValueError, TypeError) as error:
        text = text if isinstance(text, str) else type(text).__name__
        names = option.kind.names if isinstance(option.kind, Choice) else ()
        near = difflib.get_close_matches(text.lower(), names, 1)
        raise InputError(f"-{option.name} {shortened(text)}".rstrip()
                         + f": {error}; allowed: {option.kind.allowed}"
                         + (f"; nearest: {near[0]}" if near else "")) from None


def _unknown(name, text):
    near = _nearest(name.lstrip("-").lower())
    return (f"-{shortened(name)} {shortened(text)}".rstrip() + ": unknown option"
            + "; allowed: those of -help, and PETSc's own"
            + (f"; nearest: -{near}" if near else ""))


def nearest(name, names):
    """The one of some names that is most like another, or None."""
    near = difflib.get_close_matches(name, names, 1, 0.5)
    return near[0] if near else None


def _nearest(name):
    """The known option most like an unknown one, or None."""
    word, _, rest = name.partition("_")
    number, base = split(name)
    if number is not None:
        return f"vesicle_{number}_{nearest(base, OWN) or OWN[0]}"
    if word in ("ksp", "pc"):
        return "momentum_" + name  # every solve here has a prefix
    for solver in petsc_options.SYSTEMS:
        if name.startswith(solver) and len(word) > len(solver):
            return f"{solver}_{name[len(solver):]}"
    solver = difflib.get_close_matches(word, petsc_options.SYSTEMS, 1, 0.75)
    if solver and rest:
        return f"{solver[0]}_{rest}"
    # An option is also known by its name without PETSc's prefix: -dt for -ts_dt.
    known = {option: option for option in (*petsc_options.GENERAL, *TABLE)}
    known.update({re.sub("^(ts|stag)_", "", option): option for option in TABLE})
    near = difflib.get_close_matches(name, known, 1, 0.65)
    return known[near[0]] if near else None
