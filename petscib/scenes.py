"""The scenes: named sets of option defaults, one declaration each.

A scene is chosen by ``-scene NAME``; options given by the user win over it. To add one, add a
`Scene` to the tuple below: ``-scene list``, ``-help`` and the checks follow by themselves.
"""

import os
import runpy
import textwrap
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from .errors import InputError
from .settings import text_of

# Of the main job: the treading frequency is 1.6 percent off the truth with mbe, 1.2 with be.
CFL_OF_OTHERS = 0.25
_FILE = "a file of Python in which scene = petscib.Scene(name, summary, dict(option=value, ...))"


@dataclass(frozen=True)
class Scene:
    """A named set of option defaults.

    Parameters
    ----------
    name : str
        What ``-scene`` takes.
    summary : str
        One line for ``-scene list``.
    settings : mapping of str to value
        Option name to typed value; every name must be in the option table.
    cfl : float
        The time step when ``-ts_dt`` is not given, in units of h / V: h = min(dx, dy), so that
        refining the grid refines the time step too, and V the speed of `derived.typical_speed`.
    laws : tuple of callables
    measures : mapping of str to callable
        The same as of `petscib.Simulation`, for scenes in files of the user's.
    """

    name: str
    summary: str
    settings: Mapping[str, Any]
    cfl: float = 1.0
    laws: tuple = ()
    measures: Mapping[str, Any] = field(default_factory=dict)

    def cfl_of(self, scheme):
        """The time step of a scheme in these units, also of one that the scene does not choose.

        Schemes of first order need shorter steps than gcn for the same accuracy.
        """
        own = self.settings.get("scheme", scheme)
        return self.cfl if scheme in (own, "gcn") else min(self.cfl, CFL_OF_OTHERS)


_SCENES = (
    Scene(
        "tanktreading",
        "a thin vesicle turns its membrane in shear flow (Hu & Lai, section 4.3)",
        dict(flow="shear", shear_rate=1.0, axes=(0.1, 0.5), sigma0=1e5, bending=0.01,
             scheme="gcn", delta="bspline43", ts_max_time=10.0),
        cfl=4.0,
    ),
    Scene(
        "tumbling",
        "a thin vesicle of 15 times the viscosity inside turns over and over in shear flow",
        dict(flow="shear", shear_rate=1.0, axes=(0.1, 0.3), viscosity_contrast=15.0,
             stag_grid_x=96, sigma0=1e5, bending=0.01, scheme="gcn", delta="bspline43",
             ts_max_time=15.0),
        cfl=4.0,
    ),
    Scene(
        "relaxation",
        "an elliptical vesicle relaxes in fluid at rest (Hu & Lai, section 4.1)",
        dict(flow="rest", axes=(0.2, 0.5), sigma0=1e5, bending=0.01, scheme="cn",
             ts_max_time=0.125),
        cfl=0.25,
    ),
    Scene(
        "stiff",
        "a nearly inextensible thin vesicle in fluid at rest (Hu & Lai, section 4.2)",
        dict(flow="rest", axes=(0.1, 0.5), sigma0=1e9, bending=0.01, scheme="gcn",
             ts_max_time=1.0),
    ),
    Scene(
        "elastic",
        "a stretched elastic membrane contracts to a circle in fluid at rest",
        dict(flow="rest", axes=(0.3, 0.5), sigma0=10.0, bending=0.0, rest_length=0.5,
             scheme="cn", delta="bspline43", ts_max_time=1.0),
    ),
    Scene(
        "extension",
        "a vesicle is drawn out along x by an extensional flow",
        dict(flow="extensional", shear_rate=1.0, axes=(0.4, 0.25), sigma0=1e5, bending=0.01,
             scheme="cn", delta="bspline43", ts_max_time=2.0),
    ),
    Scene(
        "poiseuille",
        "an off-centre vesicle is carried along a channel",
        dict(flow="poiseuille", shear_rate=1.0, domain=(-1.0, 3.0, -1.0, 1.0),
             stag_grid_x=128, axes=(0.2, 0.3), center=(-0.4, 0.3), sigma0=1e5, bending=0.01,
             scheme="cn", delta="bspline43", ts_max_time=1.5),
    ),
    Scene(
        "pair",
        "two vesicles pass each other in shear flow",
        # An even number of markers: one vesicle is the other turned by half a turn.
        dict(flow="shear", shear_rate=1.0, vesicles=2, axes=(0.15, 0.25), markers=122,
             sigma0=1e5, bending=0.01, vesicle_0_center=(-0.4, 0.12),
             vesicle_1_center=(0.4, -0.12), stag_grid_x=96, scheme="gcn", delta="bspline43",
             ts_max_time=5.0),
        cfl=4.0,
    ),
    Scene(
        "channel",
        "a body force drives three vesicles along a periodic channel",
        dict(domain=(0.0, 3.0, -0.5, 0.5), periodic="x", body_force=(8.0, 0.0), stag_grid_x=144,
             vesicles=3, axes=(0.15, 0.25), vesicle_0_center=(0.5, 0.12),
             vesicle_1_center=(1.5, -0.06), vesicle_2_center=(2.5, 0.0), sigma0=1e5,
             bending=0.01, scheme="gbe", delta="bspline43", ts_max_time=3.0),
        cfl=4.0,
    ),
    Scene(
        "suspension",
        "12 vesicles between sheared walls, in a box periodic along them",
        dict(flow="shear", shear_rate=1.0, domain=(0.0, 4.0, -1.0, 1.0), periodic="x",
             stag_grid_x=192, arrangement="random", seed=1, vesicles=12, axes=(0.17, 0.28),
             sigma0=1e4, bending=0.01, contact=100.0, scheme="gcn", delta="bspline43",
             ts_max_time=4.0),
        cfl=2.0,
    ),
    Scene(
        "settling",
        "a vesicle sinks by its weight",
        dict(domain=(-1.0, 1.0, -2.0, 1.0), stag_grid_x=64, axes=(0.2, 0.3), center=(0.1, 0.4),
             angle=30.0, load=(0.0, -4.0), sigma0=1e5, bending=0.01, scheme="gcn",
             delta="bspline43", ts_max_time=3.0),
        cfl=4.0,
    ),
    Scene(
        "ripple",
        "a stretched elastic membrane across a periodic box swings back",
        # The images of a box of height 1 would change the decay rate by 0.4 percent, and the
        # smoothing of bspline43 by 0.3 more than bspline32 does.
        dict(domain=(0.0, 1.0, -0.75, 0.75), periodic="xy", mu=0.1, shape="line", amplitude=0.05,
             sigma0=1.0, rest_length=0.0, bending=0.0, scheme="gcn", delta="bspline32",
             ts_max_time=1.5),
    ),
    Scene(
        "driven",
        "Poiseuille flow without a vesicle: a steady state, which the coupled schemes keep",
        dict(flow="poiseuille", shear_rate=1.0, vesicles=0, scheme="be", ts_max_time=1.0),
        cfl=0.5,
    ),
    Scene(
        "inertia",
        "a vesicle in shear flow at a Reynolds number of 10, by the radius of its area",
        dict(flow="shear", shear_rate=1.0, rho=80.0, mu=1.0, axes=(0.25, 0.5), sigma0=1e5,
             bending=0.01, advection="implicit", scheme="gcn", ts_max_time=10.0),
    ),
    Scene(
        "cavity",
        "fluid under a sliding lid at a Reynolds number of rho / mu (Ghia, Ghia & Shin 1982)",
        dict(flow="cavity", shear_rate=1.0, domain=(0.0, 1.0, 0.0, 1.0), rho=1.0, mu=0.01,
             vesicles=0, advection="implicit", scheme="be", ts_max_time=25.0),
        cfl=4.0,
    ),
    Scene(
        "cylinder",
        "a circle held by tethers in a stream, at a Reynolds number of 40 by its diameter",
        # With diameter and speed 1 and rho = 2, drag and lift are the coefficients.
        dict(flow="stream", shear_rate=0.0625, domain=(-8.0, 16.0, -8.0, 8.0), stag_grid_x=192,
             rho=2.0, mu=0.05, axes=(0.5, 0.5), markers=25, sigma0=0.0, bending=0.0, tether=1e4,
             advection="implicit", scheme="be", delta="bspline43", ts_max_time=24.0),
        cfl=0.8,
    ),
    Scene(
        "taylor-green",
        "vortices decay in a periodic box: an exact solution of the Navier-Stokes equations",
        dict(flow="taylor-green", shear_rate=1.0, periodic="xy", mu=0.01, vesicles=0,
             advection="implicit", scheme="cn", ts_max_time=2.0),
    ),
)

SCENES = {scene.name: scene for scene in _SCENES}
DEFAULT = _SCENES[0].name


def find(name):
    """The scene of a name, or of a file that ends in .py.

    Raises
    ------
    InputError
        The file has none.
    """
    if name in SCENES:
        return SCENES[name]
    try:
        changed = os.stat(name).st_mtime_ns
    except OSError as error:
        raise InputError(f"-scene {name}: {error.strerror}; allowed: {_FILE}") from None
    return _load(name, changed)


@lru_cache
def _load(path, changed):
    """The scene of a file, which is run only once until it changes."""
    try:
        scene = runpy.run_path(path).get("scene")
    except Exception as error:
        place = [frame.lineno for frame in traceback.extract_tb(error.__traceback__)
                 if frame.filename == path]
        line = getattr(error, "lineno", None) or (place[-1] if place else "?")
        raise InputError(f"-scene {path}: line {line}: {type(error).__name__}: {error}; allowed: "
                         f"{_FILE}") from None
    if not isinstance(scene, Scene):
        raise InputError(f"-scene {path}: it has no scene; allowed: {_FILE}")
    return replace(scene, name=path)


_HEAD = """\
Scenes (-scene NAME); options given on the command line win over a scene's.
Time steps are given in units of h / V, with h = min(dx, dy) and V the largest of these speeds:
the top speed of the background flow in the box; that of a vesicle driven by its bending, the
smaller of 100 bending / (mu L^2) and sqrt(1000 bending / (rho L^3)), L half the shorter side of
the box; that of waves on a line stretched across the box, sqrt(pi tension / (rho length)).
Where nothing moves, V = mu / (rho L).
"""


def listing():
    """The text of ``-scene list``: every scene with its settings as options, 100 columns."""
    blocks = [_HEAD]
    for scene in _SCENES:
        options = [f"-{name} {text_of(value)}" for name, value in scene.settings.items()]
        mark = " (default)" if scene.name == DEFAULT else ""
        # A blank inside one option must not be a place to break the line.
        wrapped = textwrap.fill("  ".join(option.replace(" ", "\0") for option in options), 100,
                                initial_indent="    ", subsequent_indent="    ",
                                break_long_words=False, break_on_hyphens=False)
        blocks.append(f"{scene.name}{mark}: {scene.summary}\n" + wrapped.replace("\0", " ")
                      + f"\n    time step, unless -ts_dt is given: {_steps(scene)}\n")
    return "\n".join(blocks)


def _steps(scene):
    others = scene.cfl_of("")
    best = " and ".join(dict.fromkeys((scene.settings.get("scheme", "gcn"), "gcn")))
    more = f" with {best}, {others:g} h / V with other schemes" if others < scene.cfl else ""
    return f"{scene.cfl:g} h / V{more}"
