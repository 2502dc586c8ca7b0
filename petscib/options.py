"""The options: one table, from which validation, ``-help`` and the table in docs/options.md come.

`read` turns PETSc's option database, as text, into a frozen `Settings`. A value given by the user
wins over the scene's, and that over the table's default. This module needs neither PETSc nor MPI.
"""

import difflib
import math
import re
import textwrap
from dataclasses import dataclass, replace
from typing import Any

from petscib import scenes
from petscib.coupling.kernels import KERNELS
from petscib.errors import InputError
from petscib.fluid.flows import FLOWS
from petscib.own import Function, Points, is_own
from petscib.schemes.registry import SCHEMES
from petscib.settings import NOWHERE, Settings, check, check_domain, resolve, text_of
from petscib.vesicles import OWN, split

# Magnitudes that the sums and products of a run can hold, in whatever units.
SMALLEST, LARGEST = 1e-60, 1e60
LARGEST_INTEGER = 2**31 - 1  # PETSc's integers have 32 bits unless it was built otherwise

# --- kinds of values: each parses a text (ValueError says what is wrong) and says what it allows


@dataclass(frozen=True)
class Number:
    """A finite number in a range."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    symbol: str = "X"
    noun = "number"
    pattern = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"

    @property
    def allowed(self):
        """What is allowed, in words."""
        bounds = []
        if math.isfinite(self.low):
            bounds.append(("above " if self.open_low else "from ") + text_of(self.low))
        if math.isfinite(self.high) and self.high != LARGEST_INTEGER:
            bounds.append(("and below " if self.open_high else "to ") + text_of(self.high))
        return " ".join([self.noun, *bounds])

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        # float() and int() also take "1_000" and foreign digits, which no one means.
        if not re.fullmatch(self.pattern, text, re.ASCII):
            raise ValueError(f"not a {self.noun}")
        value = self.convert(text)
        if not math.isfinite(value):
            raise ValueError("too large")
        below = value <= self.low if self.open_low else value < self.low
        above = value >= self.high if self.open_high else value > self.high
        if below or above:
            raise ValueError("out of range")
        return value

    def convert(self, text):
        """The number of a text of the right form."""
        return float(text)


@dataclass(frozen=True)
class Whole(Number):
    """A whole number in a range."""

    low: int = 0
    high: int = LARGEST_INTEGER
    symbol: str = "N"
    noun = "whole number"
    pattern = r"[+-]?\d{1,18}"

    def convert(self, text):
        """The number of a text of the right form."""
        return int(text)


@dataclass(frozen=True)
class Numbers:
    """A comma list of numbers, one for each of the names."""

    names: tuple[str, ...]
    each: Number = Number()

    @property
    def symbol(self):
        """How -help shows a value."""
        return ",".join(self.names)

    @property
    def allowed(self):
        """What is allowed, in words."""
        return f"{self.symbol}, each a {self.each.allowed}"

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        parts = text.split(",")
        if len(parts) != len(self.names):
            raise ValueError(f"not {len(self.names)} values with commas between (and no blanks)")
        return tuple(self.each.parse(part) for part in parts)


@dataclass(frozen=True)
class Choice:
    """One of several names, in any case, as PETSc reads its own."""

    names: tuple[str, ...]
    symbol: str = "NAME"

    @property
    def allowed(self):
        """What is allowed, in words."""
        return ", ".join(self.names)

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        if text.lower() not in self.names:
            raise ValueError("no such choice")
        return text.lower()


class SceneName(Choice):
    """A scene's name, or a file of the user's that has one."""

    @property
    def allowed(self):
        """What is allowed, in words."""
        return super().allowed + ", or FILE.py with a scene of one's own"

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        return text if text.lower().endswith(".py") else super().parse(text)


class OrFunction:
    """What another kind takes, or from a script a function (x, y, t); comes before that kind."""

    def parse(self, text):
        """The value of a text or a callable; a ValueError says what is wrong with it."""
        if callable(text):
            return text if isinstance(text, Function) else Function(text, self.option)
        if text.startswith("function "):
            raise ValueError("known only to the script that has it")
        return super().parse(text)


class Flow(OrFunction, Choice):
    """A flow's name, or from a script a function (x, y, t) -> (u, v)."""

    option = "flow"


class Force(OrFunction, Numbers):
    """A uniform force, or from a script a function (x, y, t) -> (fx, fy)."""

    option = "body_force"


@dataclass(frozen=True)
class Flag:
    """A switch in PETSc's spellings; the option alone means true."""

    symbol: str = "[true]"
    allowed = "true/false, yes/no, on/off, 1/0"

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        if text.lower() in ("", "true", "yes", "on", "1"):
            return True
        if text.lower() in ("false", "no", "off", "0"):
            return False
        raise ValueError("not a switch's value")


@dataclass(frozen=True)
class Path:
    """A file or directory name."""

    symbol: str = "PATH"
    allowed = "a path"

    def parse(self, text):
        """The value of a text; a ValueError says what is wrong with it."""
        return text


class Curve(Path):
    """A file of points, or from a script an array of them."""

    def parse(self, text):
        """The value of a text or an array."""
        return text if isinstance(text, (str, Points)) else Points(text)


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

_ROWS = (
    Option("scene", SceneName(tuple(scenes.SCENES)), scenes.DEFAULT, RUN,
           "named set of defaults; `-scene list` prints them all"),
    Option("fft", Flag(), False, RUN, "fast direct solvers (transforms) under all solves"),
    Option("picard_rtol", FRACTION, 1e-9, RUN, "gbe, gcn: tolerance of the tangent iteration"),
    Option("picard_max_it", Whole(1, 10000), 100, RUN, "gbe, gcn: most tangent iterations a step"),
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
           "where vesicles lie: at their -center, in rows, or anywhere at any angle; the latter "
           "two without overlap"),
    Option("seed", Whole(0), 0, SHAPE, "of the random arrangement"),
    Option("area_fraction", FRACTION, None, SHAPE, "part of the box inside vesicles of an "
           "arrangement: sets their number, or if that is given the size of their axes",
           automatic="by number and axes"),
    Option("shape", Choice(("ellipse", "line", "plate")), "ellipse", SHAPE, "an ellipse; a line "
           "across a periodic box; an open straight line of the length 2 ry"),
    Option("axes", Numbers(("rx", "ry"), POSITIVE), (0.1, 0.5), SHAPE,
           "half axes of the ellipse (rx sin s, ry cos s)", "length"),
    Option("center", Numbers(("x", "y")), (0.0, 0.0), SHAPE, "its centre", "length"),
    Option("angle", Number(-360, 360), 0.0, SHAPE, "its rotation, counter-clockwise", "degrees"),
    Option("amplitude", ANY, 0.0, SHAPE, "of a sine, one wave of which a line across the box "
           "makes", "length"),
    Option("markers", Whole(0, 10**7), 0, SHAPE, "markers, equally spaced in arclength; 0: by "
           "the grid", automatic="0: spacing h/2"),
    Option("marker_file", Curve(), None, SHAPE, "closed curve to use instead of the ellipse: a "
           "text file, x and y of one point a line, also as IBAMR, IB2d and PetIBM write it",
           automatic="none"),

    Option("sigma0", NOT_NEGATIVE, 1e5, MEMBRANE, "tension stiffness", "force"),
    Option("bending", NOT_NEGATIVE, 0.01, MEMBRANE, "bending rigidity", "force length^2"),
    Option("rest_length", NOT_NEGATIVE, None, MEMBRANE,
           "elastic membrane: stretching without tension, where the start has 1",
           automatic="the initial stretching"),
    Option("tether", NOT_NEGATIVE, 0.0, MEMBRANE,
           "stiffness of springs from the markers to where they start", "force/length^2"),
    Option("load", Numbers(("fx", "fy")), (0.0, 0.0), MEMBRANE,
           "given force on the membrane, such as its weight", "force/length"),
    Option("viscosity_contrast", Number(0.01, 1000), 1.0, MEMBRANE,
           "viscosity inside over that outside"),
    Option("contact", NOT_NEGATIVE, 0.0, MEMBRANE, "strength K of a repulsion between membranes "
           "and from walls, with the energy K/2 (1 - distance/range)^4 per length^2; 0: none",
           "force/length"),
    Option("contact_range", Number(0.1, 100), 2.0, MEMBRANE, "its range", "cells"),
    Option("delta", Choice(tuple(KERNELS)), "yang", MEMBRANE,
           "smoothed delta function between markers and grid"),
    Option("kink_correction", Flag(), None, MEMBRANE, "let markers slip by what smoothing takes "
           "from the velocity: second order in space", automatic="true; false for ep"),
    Option("conserve_area", Flag(), None, MEMBRANE, "keep the area that a membrane encloses",
           automatic="true; false for ep"),
    Option("stretch", Choice(("recompute", "evolve")), "recompute", MEMBRANE,
           "stretching from the markers at each step, or as a variable of its own"),

    Option("scheme", Choice(tuple(SCHEMES)), "mbe", TIME,
           "; ".join(f"{name}: {scheme.words}" for name, scheme in SCHEMES.items())),
    Option("startup", Whole(0, 1000), None, TIME,
           "first steps taken as two backward Euler half steps",
           automatic="1 for cn and gcn, else 0"),
    Option("ts_dt", POSITIVE, None, TIME, "time step", "time",
           automatic="the scene's multiple of min(dx, dy) / speed of flow or membrane, as "
           "`-scene list` explains"),
    Option("ts_max_time", POSITIVE, 1.0, TIME, "end time", "time"),
    Option("ts_max_steps", Whole(), None, TIME, "most steps", automatic="no limit"),
    Option("ts_rtol", FRACTION, None, TIME, "choose the time step, from ts_dt on, by the error "
           "that it makes in the markers' positions, relative to the vesicle's size; at most 64 "
           "ts_dt, and as explicit advection allows", automatic="none: fixed time steps"),
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
    Option("checkpoint_keep", Whole(1), 2, OUTPUT, "how many checkpoints stay"),
)

TABLE = {option.name: option for option in _ROWS}


def option_of(name):
    """The row of an option, also of one vesicle's own such as vesicle_1_axes; None if unknown."""
    number, base = split(name)
    if number is None:
        return TABLE.get(name)
    return replace(TABLE[base], name=name) if base in OWN else None


# --- what is PETSc's business

SOLVERS = (
    ("momentum_", "implicit velocity of ep, mbe, mcn (CG with GAMG; fgmres: block iteration)"),
    ("poisson_", "pressure projection (CG with GAMG)"),
    ("coupled_", "velocity and pressure together, be, cn, gbe, gcn (FGMRES; CG with -fft)"),
    ("momentum_velocity_", "fluid's solve inside a block iteration; likewise coupled_velocity_"),
    ("coupled_poisson_", "pressure solve inside the preconditioner"),
    ("momentum_advection_", "ksp_rtol and ksp_max_it of implicit advection with -fft; likewise "
     "coupled_advection_"),
    ("momentum_model_", "direct solver in marker space; likewise coupled_model_"),
    ("momentum_stress_", "direct solver of the eliminated membrane stresses"),
    ("coupled_direct_", "direct solver of the whole matrix, without the kink correction"),
)
_SOLVER_WORDS = "momentum", "poisson", "coupled"

# Options every PETSc program understands. Names that PETSc would read but that act on nothing
# here (ksp_, pc_, ts_, snes_ without a prefix) are left out on purpose: they would be ignored.
_PETSC_NAMES = (
    "help", "version", "citations", "history", "display", "nox", "nox_warning", "tmp",
    "shared_tmp", "not_shared_tmp", "info", "info_exclude", "malloc", "fp_trap", "python",
    "objects_dump", "get_total_flops", "no_signal_handler", "options_file", "options_file_yaml",
    "options_string_yaml", "options_left", "options_view", "options_monitor",
    "options_monitor_cancel", "options_suppress_deprecated_warnings", "prefix_push",
    "prefix_pop", "skip_petscrc", "start_in_debugger", "stop_for_debugger", "debug_terminal",
    "check_pointer_intensity", "checkfunctionlist", "error_output_none", "error_output_stdout",
    "library_preload", "default_device_type", "build_twosided", "splitreduction_async",
    "blas_num_threads", "stag_ranks_x", "stag_ranks_y",
)
_PETSC_FAMILIES = (
    "log_", "malloc_", "memory_", "mat_", "matmatmult_", "matptap_", "matrart_", "vec_", "dm_",
    "sf_", "is_", "ao_", "petsc_", "petscsf_", "petscsection_", "viewer_", "draw_", "x_",
    "random_", "on_error_", "debugger_", "mpi_", "mpidump", "use_gpu_", "device_",
    "root_device_context_", "cuda_", "hip_", "sycl_", "kokkos_", "omp_", "dll_", "saws_",
    "vecscatter_",
)


def is_petsc(name):
    """Whether an option is PETSc's to read: a solver's prefix, or a general PETSc option."""
    solver = any(name.startswith(word + "_") and len(name) > len(word) + 1
                 for word in _SOLVER_WORDS)
    return solver or name in _PETSC_NAMES or name.startswith(_PETSC_FAMILIES)


# --- reading


def read(database, writes=True):
    """The settings asked for.  What `vesicle_files.expand` has to say is in there already.

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
        elif not is_petsc(name.lower()):
            raise InputError(_unknown(name, "" if text is None else str(text)))
    scene = scenes.find(given.get("scene", scenes.DEFAULT))
    values = {option.name: option.default for option in _ROWS}
    values.update(_scene_values(scene), scene=scene.name)
    values.update(given)
    if not writes:
        values["output"] = NOWHERE
    check_domain(values["domain"])
    resolve(values, set(given), scene.cfl_of(values["scheme"]))
    settings = Settings(values, given)
    for name in ("stag_grid_x", "stag_grid_y"):  # one of them may follow from the other
        value_of(TABLE[name], text_of(getattr(settings, name)))
    check(settings, [option.name for option in _ROWS if option.group in (SHAPE, MEMBRANE)
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
            raise InputError(f"-scene {scene.name}: {_unknown(name, shown(value))}")
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
    return value if array or callable(value) or is_own(value) else shown(value)


def shown(value):
    """The text of a value of Python's or numpy's."""
    return text_of(value.tolist() if hasattr(value, "tolist") else value)


def help_asked(arguments):
    """What -help of a command line asks for, None without one, and the rest of the words."""
    words, topic = list(arguments), None
    for place, word in enumerate(words):
        if word.lower() in ("-help", "--help", "-h"):
            after = words[place + 1 : place + 2]
            count = 2 if after and not after[0].startswith("-") else 1
            topic = after[0].lower() if count == 2 else ""
            del words[place : place + count]
            break
    return topic, words


def information(database):
    """The text that ``-help`` or ``-scene list`` asks for, or None when neither is given."""
    asked = {name.lstrip("-").lower(): (text or "").lower() for name, text in database.items()}
    if "help" in asked:
        return help_text(asked["help"])
    return scenes.listing() if asked.get("scene") == "list" else None


def reject_stray_words(arguments):
    """Refuse words that PETSc would silently drop: values cut by blanks, and words on their own.

    Parameters
    ----------
    arguments : list of str
        The command line without the program's name.

    Raises
    ------
    InputError
    """
    words = []  # the option at hand and the values after it
    for word in arguments:
        words = [word] if re.match(r"--?[A-Za-z]", word) else [*words, word]
        name = words[0].lstrip("-").lower()
        option = option_of(name)
        ours = option is not None
        if len(words) > 2 or not words[0].startswith("-") or (ours and len(word.split()) > 1):
            allowed = option.kind.allowed if ours else "-name value"
            raise InputError(f"{_short(' '.join(words))}: one value without blanks may follow "
                             f"an option; allowed: {allowed}")


def value_of(option, text):
    """The value of one option from its text; raises InputError."""
    try:
        if isinstance(text, str) and text == "" and not isinstance(option.kind, Flag):
            raise ValueError("needs a value")
        value = option.kind.parse(text)
        _check_magnitude(option.kind, value)
        return value
    except (ValueError, TypeError) as error:
        text = text if isinstance(text, str) else type(text).__name__
        names = option.kind.names if isinstance(option.kind, Choice) else ()
        near = difflib.get_close_matches(text.lower(), names, 1)
        raise InputError(f"-{option.name} {_short(text)}".rstrip()
                         + f": {error}; allowed: {option.kind.allowed}"
                         + (f"; nearest: {near[0]}" if near else "")) from None


def _check_magnitude(kind, value):
    """Refuse numbers whose powers and quotients a run could not hold."""
    each = getattr(kind, "each", kind)
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, float) and abs(number) > LARGEST:
            raise ValueError(f"its magnitude is above {text_of(LARGEST)}")
        if isinstance(number, float) and each.low == 0 and each.open_low and number < SMALLEST:
            raise ValueError(f"its magnitude is below {text_of(SMALLEST)}")


def _unknown(name, text):
    near = _nearest(name.lstrip("-").lower())
    return (f"-{_short(name)} {_short(text)}".rstrip() + ": unknown option"
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
    for solver in _SOLVER_WORDS:
        if name.startswith(solver) and len(word) > len(solver):
            return f"{solver}_{name[len(solver):]}"
    solver = difflib.get_close_matches(word, _SOLVER_WORDS, 1, 0.75)
    if solver and rest:
        return f"{solver[0]}_{rest}"
    # An option is also known by its name without PETSc's prefix: -dt for -ts_dt.
    known = {option: option for option in (*_PETSC_NAMES, *TABLE)}
    known.update({re.sub("^(ts|stag)_", "", option): option for option in TABLE})
    near = difflib.get_close_matches(name, known, 1, 0.65)
    return known[near[0]] if near else None


def _short(text, longest=60):
    return text if len(text) <= longest else text[:longest - 3] + "..."


# --- showing the table


_TOPICS = dict(zip(("run", "fluid", "shape", "membrane", "time", "results"), GROUPS))
_HEAD = ("petscib: vesicles in viscous flow by energy stable immersed boundary methods.",
         "Usage: [mpiexec -n RANKS] python -m petscib [-option value ...]")


def help_text(topic=""):
    """The text of ``-help``, at most 100 columns.

    Parameters
    ----------
    topic : str
        Empty for a screen that names all options; a group, ``solvers``, the name of an option, or
        ``all``.

    Raises
    ------
    InputError
        There is no such topic.
    """
    topic = topic.lstrip("-")
    if not topic:
        return _overview()
    if topic in _TOPICS:
        lines = _group(_TOPICS[topic])
    elif topic == "solvers":
        lines = _solvers()
    elif topic == "all":
        lines = [*_HEAD, *_notes()]
        for group in GROUPS:
            lines += ["", *_group(group)]
        lines += ["", *_solvers(), "", *_of_petsc()]
    elif option_of(topic) is not None:
        lines = _option_entry(option_of(topic))
    else:
        topics = (*_TOPICS, "solvers", "petsc", "all")
        near = nearest(topic, (*topics, *TABLE))
        raise InputError(f"-help {_short(topic)}: no such topic; allowed: {', '.join(topics)}, or "
                         "an option's name" + (f"; nearest: {near}" if near else ""))
    return "\n".join(lines) + "\n"


def _overview():
    """The screen of ``-help`` alone."""
    lines = [*_HEAD, "", "Scenes are sets of defaults: " + textwrap.fill(
        ", ".join(scenes.SCENES) + ".", 100, initial_indent=" " * 29,
        subsequent_indent="  ").strip(), "", "Options by group (-help GROUP explains them)"]
    for topic, group in _TOPICS.items():
        names = " ".join(f"-{option.name}" for option in _ROWS if option.group == group)
        lines += _entry(topic, names, column=12)
    lines += _entry("solvers", " ".join(f"-{prefix}*" for prefix, _ in SOLVERS), column=12)
    lines += ["", "More"]
    for name, text in (
            ("-scene list", "every scene with its options"),
            ("-help sigma0", "one option"),
            ("-help all", "all that there is to say of all options"),
            ("-help petsc", "PETSc's own help: its options, and those of the solvers of this run"),
            ("-version", "versions of petscib and of what it runs on")):
        lines += _entry(name, text)
    return "\n".join(lines) + "\n"


def _group(group):
    lines = [group]
    for option in _ROWS:
        if option.group == group:
            lines += _option_entry(option)
    if group in (SHAPE, MEMBRANE):
        lines += ["", *textwrap.wrap(
            "With several vesicles, -vesicle_0_axes, -vesicle_1_center and so on give one vesicle "
            "its own value of " + ", ".join(OWN) + ".", 100)]
    return lines


def _option_entry(option):
    unit = f" [{option.unit}]" if option.unit else ""
    plain = isinstance(option.kind, (Flag, Path))
    allowed = "" if plain else f"{option.kind.allowed}; "
    return _entry(f"-{option.name} {option.kind.symbol}",
                  f"{option.help}{unit} ({allowed}default: {option.default_text})")


def _notes():
    return ["Scenes set other defaults than those below (-scene list).",
            f"Switches take {Flag.allowed}; alone they mean true."]


def _solvers():
    lines = ["Solvers: PETSc's ksp_ and pc_ options behind each prefix, as in "
             "-momentum_ksp_rtol 1e-8"]
    for prefix, text in SOLVERS:
        lines += _entry(f"-{prefix}*", text)
    return lines


def _of_petsc():
    lines = ["PETSc"]
    for name, text in (
            ("-options_file PATH", "read options from a file, one `-name value` a line"),
            ("-options_file_yaml PATH", "the same from a YAML file"),
            ("PETSC_OPTIONS", "environment variable with more options"),
            ("-log_view", "time and messages of each part, at the end"),
            ("-options_left", "options that nothing has read"),
            ("-help petsc", "PETSc's own help: its options, and those of the solvers of a run")):
        lines += _entry(name, text)
    return lines


def markdown_table():
    """The table of docs/options.md, in Markdown."""
    lines = []
    for group in GROUPS:
        lines += [f"**{group}**", "", "| option | meaning | allowed | default | unit |",
                  "| --- | --- | --- | --- | --- |"]
        lines += [f"| `-{option.name}` | {option.help} | {option.kind.allowed} | "
                  f"{option.default_text} | {option.unit} |"
                  for option in _ROWS if option.group == group]
        lines.append("")
    return "\n".join(lines)


def _entry(name, text, column=28, width=100):
    """Lines of one help entry: the name, then the text wrapped in its column."""
    wrapped = textwrap.wrap(text, width - column, break_on_hyphens=False)
    first = f"  {name}"
    lines = [first] if len(first) >= column else [first.ljust(column) + wrapped.pop(0)]
    return lines + [" " * column + line for line in wrapped]
