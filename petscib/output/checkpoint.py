"""Checkpoint files: the whole state of a run, from which it continues as if nothing had happened.

One HDF5 file a save: ``checkpoint-<step, 8 digits>.h5``, and ``final.h5`` at the end.  It appears
under its name only when complete.  All fields are in natural order, whatever the number of ranks:
row index y, column index x; m x n cells of size dx x dy on the box a <= x <= b, c <= y <= d.

Attributes of the root:

==================  ==============================================================================
format_version      2; files of version 1, which have one closed vesicle or none, are read too
petscib_version     of the program that wrote it
step, time          of the state
dt                  time step to go on with (-ts_dt unless -ts_adapt or -ts_rtol has changed it)
good_steps          accepted steps since `dt` last changed
scheme              name of the scheme
options             every option as JSON, names to values; ``given`` lists those the user gave
solver_options      the options under the solvers' prefixes that the user gave, names to texts, JSON
largest_energy      largest energy of any row so far: the scale of the ledger's residual
wall_seconds        of the run so far, restarts included
==================  ==============================================================================

Datasets, all of 8-byte floats, with attributes ``unit`` and ``location``:

========================  ===============  ========================================================
/fluid/u                  (n, m + 1)       x-velocity; entry (j, i) at (a + i dx, c + (j + 1/2) dy)
/fluid/v                  (n + 1, m)       y-velocity; entry (j, i) at (a + (i + 1/2) dx, c + j dy)
/fluid/p                  (n, m)           pressure at the cell centres, mean zero
/vesicle_0/X              (M, 2)           markers, x and y
/vesicle_0/stretch        (M,)             |X_s| at half points; entry k lies between k - 1 and k
/vesicle_0/rest_stretch   (M,)             |X_s| without tension, at half points
/vesicle_0/tension        (M,)             sigma at half points, in the stage of the step
/vesicle_0/target         (M, 2)           where tethers hold the markers, if any are held
========================  ===============  ========================================================

Other vesicles are in /vesicle_1, /vesicle_2 and so on.  An open curve has M - 1 half points, entry
k between k and k + 1.

With ``-periodic x`` u lacks the last column, which would be the first again, and with
``-periodic y`` v its last row; markers that have crossed such a side go on outside the box.  The
group /fluid has the attributes
``domain`` (a, b, c, d) and ``spacing`` (dx, dy); /vesicle_0 has ``ds``, the markers' parameter
step, ``initial_area`` and ``initial_perimeter``, to which the errors in diagnostics.csv refer (nan
where no area is enclosed), ``closed`` (0 or 1), and ``period`` (x, y), how far beyond the last
marker the first is found again (0, 0 but for lines across a periodic box).

/history holds what a scheme carries from step to step besides (`State.history`): a dataset for an
array of the markers or half points, a group with u and v for a velocity, a group with p for a
pressure, an attribute for a number.  /fluid/p jumps across membranes that keep their area;
/history/bare_pressure, from which a restart goes on, does not.
"""

import json
from dataclasses import dataclass, field

import h5py
import numpy as np
from petsc4py import PETSc

from .. import __version__
from ..agreement import everywhere
from ..errors import InputError
from ..membranes.curves import Curves
from ..pressure import BARE
from ..problem import State
from .files import explain
from .hdf5 import Dataset, write_hdf5

FORMAT_VERSION = 2
READABLE = 1, 2
_NUMBERS = ("step", "time", "dt", "good_steps", "largest_energy", "wall_seconds")


@dataclass
class Progress:
    """What a run knows beside the state.  Equal on all ranks.

    Attributes
    ----------
    dt, good_steps
        Of the `StepSize`.
    largest_energy : float
        Largest energy of any row of diagnostics so far.
    wall_seconds : float
        Time spent so far, restarts included.
    reference : dict of str to list of float
        Initial area and perimeter of each vesicle; empty without any.
    solver_options : dict of str to str
        What the user gave under the solvers' prefixes.
    """

    dt: float = None
    good_steps: int = 0
    largest_energy: float = 0.0
    wall_seconds: float = 0.0
    reference: dict = field(default_factory=dict)
    solver_options: dict = field(default_factory=dict)


@dataclass
class Header:
    """What `read_header` finds in a file beside the arrays.  Plain data.

    Attributes
    ----------
    path : str
    step : int
    time : float
    options : dict
        As `Settings.to_dict` gives it.
    progress : Progress
    vesicles : list of SavedCurve
    """

    path: str
    step: int
    time: float
    options: dict
    progress: Progress
    vesicles: list = field(default_factory=list)


@dataclass(frozen=True)
class SavedCurve:
    """How the markers of a saved vesicle are joined."""

    markers: int
    ds: float
    closed: bool
    period: tuple


def name_of(step):
    """Name of the checkpoint of a step."""
    return f"checkpoint-{step:08d}.h5"


def save(path, problem, state, settings, progress):
    """Write a checkpoint.  Collective.

    Parameters
    ----------
    path : str
    problem : Problem
    state : State
    settings : Settings
    progress : Progress

    Raises
    ------
    OutputError
        On all ranks.
    """
    grid = problem.grid
    comm = grid.comm.tompi4py()
    attributes = {
        "/": {
            "format_version": FORMAT_VERSION,
            "petscib_version": __version__,
            "step": state.step,
            "time": state.time,
            "dt": progress.dt,
            "good_steps": progress.good_steps,
            "scheme": settings.scheme,
            "options": json.dumps(settings.to_dict()),
            "solver_options": json.dumps(progress.solver_options),
            "largest_energy": progress.largest_energy,
            "wall_seconds": progress.wall_seconds,
        },
        "/fluid": {"domain": grid.domain, "spacing": (grid.dx, grid.dy)},
    }
    datasets = [
        *_velocity("fluid", grid, state.velocity),
        _pressure("fluid", grid, state.pressure),
    ]
    if problem.membranes is not None:
        _add_vesicles(problem, state, progress, comm, attributes, datasets)
    for name, value in state.history.items():
        if isinstance(value, float):
            attributes.setdefault("/history", {})[name] = value
        else:
            datasets += _history(f"history/{name}", grid, comm, value)
    write_hdf5(path, comm, datasets, attributes)


def _add_vesicles(problem, state, progress, comm, attributes, datasets):
    """Add what there is to write of each vesicle.  Collective."""
    constants = problem.membranes.constants
    curves = constants.curves
    length, ratio = {"unit": "length", "location": "markers k"}, {
        "unit": "1", "location": "half points k - 1/2"}
    arrays = [
        ("X", curves.starts, state.markers, length),
        ("stretch", curves.edge_starts, state.stretch, ratio),
        ("rest_stretch", curves.edge_starts, constants.rest_stretch, ratio),
        ("tension", curves.edge_starts, problem.tension(state), {
            "unit": "force", "location": ratio["location"]}),
    ]
    if constants.target is not None:
        arrays.append(("target", curves.starts, constants.target, length))
    for k, first in enumerate(curves.starts[:-1]):
        attributes[f"/vesicle_{k}"] = {
            "ds": curves.ds[first], "closed": int(curves.closed[first]),
            "period": curves.periods[k],
            **{f"initial_{name}": values[k] for name, values in progress.reference.items()},
        }
        for name, starts, values, words in arrays:
            shape = (starts[k + 1] - starts[k], *values.shape[1:])
            mine = slice(starts[k], starts[k + 1]) if comm.rank == 0 else slice(0)
            datasets.append(Dataset(f"vesicle_{k}/{name}", values[mine], shape, **words))


def _velocity(group, grid, vector):
    u, v = grid.velocity_blocks(vector)
    unit = "length/time"
    return [
        Dataset(f"{group}/u", u, grid.u_index.shape, grid.u_box, unit=unit, location="x-faces"),
        Dataset(f"{group}/v", v, grid.v_index.shape, grid.v_box, unit=unit, location="y-faces"),
    ]


def _pressure(group, grid, vector):
    return Dataset(
        f"{group}/p", grid.pressure_block(vector), grid.p_index.shape, grid.p_box,
        unit="force/length", location="cell centres",
    )


def _history(path, grid, comm, value):
    if isinstance(value, PETSc.Vec):
        if value.getSize() == grid.p_index.size:
            return [_pressure(path, grid, value)]
        return _velocity(path, grid, value)
    value = np.asarray(value, dtype=float)
    location = "markers or half points"
    return [Dataset(path, value, comm.bcast(value.shape), unit="", location=location)]


def read_header(path):
    """Check that a file is a complete checkpoint, and read all but its arrays.  Not collective.

    Raises
    ------
    InputError
        Naming the file and what is wrong with it.
    """
    try:
        open(path, "rb").close()  # says why, when it is not there or may not be read
        if not h5py.is_hdf5(path):
            raise _unfit(path, "not an HDF5 file, or cut off at its beginning; allowed: a "
                               "checkpoint of petscib")
        with h5py.File(path, "r") as file:
            return _read_header(path, file)
    except (OSError, RuntimeError, KeyError) as failure:
        raise InputError(f"-restart {_why_unreadable(path, failure)}") from None


def _unfit(path, why):
    """The error to raise about a file that cannot be continued from."""
    return InputError(f"-restart {path}: {why}")


def _why_unreadable(path, failure):
    """Why a file could not be opened or read, in one line."""
    if isinstance(failure, BlockingIOError):
        return f"{path}: locked, another program is writing to it"
    # What the system refuses has its number; the rest is HDF5's, or ours, about the content.
    system = getattr(failure, "errno", None) is not None
    return explain(failure, path) + ("" if system else " (a damaged or cut off checkpoint)")


def _read_header(path, file):
    found = file.attrs
    if "format_version" not in found:
        raise _unfit(path, "an HDF5 file, but not a checkpoint of petscib")
    if found["format_version"] not in READABLE:
        raise _unfit(
            path, f"its format version is {found['format_version']}; allowed: "
            f"{' or '.join(map(str, READABLE))}, which is what this petscib reads"
        )
    missing = [name for name in (*_NUMBERS, "options", "solver_options") if name not in found]
    if missing:
        raise _unfit(path, f"damaged, it lacks the attribute {missing[0]}")
    numbers = {name: found[name].item() for name in _NUMBERS}
    if not all(np.isfinite(value) for value in numbers.values()):
        raise _unfit(path, "damaged, not every number in its attributes is finite")
    step, time = numbers.pop("step"), numbers.pop("time")
    try:
        progress = Progress(**numbers, solver_options=json.loads(found["solver_options"]))
        header = Header(path, step, time, json.loads(found["options"]), progress)
        m, n = header.options["stag_grid_x"], header.options["stag_grid_y"]
        periodic = header.options.get("periodic", "none")  # an older file has no such option
        vesicles = header.options["vesicles"]
    except (ValueError, TypeError, KeyError) as failure:
        raise _unfit(path, f"damaged, its options cannot be read: {failure}") from None
    _expect(path, file, "fluid/u", (n, m + ("x" not in periodic)))
    _expect(path, file, "fluid/v", (n + ("y" not in periodic), m))
    _expect(path, file, "fluid/p", (n, m))
    header.vesicles = [_read_curve(path, file, k) for k in range(vesicles)]
    if vesicles:
        progress.reference = {
            name: [file[f"vesicle_{k}"].attrs[f"initial_{name}"].item() for k in range(vesicles)]
            for name in ("area", "perimeter")}
    return header


def _read_curve(path, file, number):
    """How the markers of a saved vesicle are joined; its datasets are checked."""
    name = f"vesicle_{number}"
    _expect(path, file, f"{name}/X", (None, 2))
    group = file[name]
    count, closed = len(group["X"]), bool(group.attrs.get("closed", True))
    for part in ("stretch", "rest_stretch"):
        _expect(path, file, f"{name}/{part}", (count - (not closed),))
    if "target" in group:
        _expect(path, file, f"{name}/target", (count, 2))
    period = tuple(map(float, group.attrs.get("period", (0.0, 0.0))))
    return SavedCurve(count, group.attrs["ds"].item(), closed, period)


def _expect(path, file, name, shape):
    """Refuse a file without a dataset of that shape (None: any length)."""
    dataset = file.get(name)
    if not isinstance(dataset, h5py.Dataset):
        raise _unfit(path, f"damaged, it has no dataset {name}")
    wrong = len(dataset.shape) != len(shape) or any(
        want not in (None, have) for want, have in zip(shape, dataset.shape)
    )
    if wrong or dataset.dtype.kind != "f":
        raise _unfit(
            path, f"{name} is an array of {dataset.dtype} and shape {dataset.shape}; allowed: "
            f"floats of shape {str(shape).replace('None', 'any')}"
        )


def load_membranes(header, comm):
    """The membranes, on rank 0; arrays without rows elsewhere.  Collective.

    Returns
    -------
    curves : Curves
    markers, stretch, rest_stretch, target : ndarray
        Of all one after the other; without tethers the targets are the markers.

    Raises
    ------
    InputError
        On all ranks.
    """
    found = {"X": [np.zeros((0, 2))], "target": [np.zeros((0, 2))],
             "stretch": [np.zeros(0)], "rest_stretch": [np.zeros(0)]}

    def read(file):
        for k in range(len(header.vesicles) if comm.rank == 0 else 0):
            group = file[f"vesicle_{k}"]
            for name, parts in found.items():
                parts.append(_finite(group[name if name in group else "X"]))

    _on_file(header.path, comm, read)
    mine = header.vesicles if comm.rank == 0 else []
    curves = Curves(*zip(*((one.markers, one.ds, one.closed, one.period) for one in mine))
                    ) if mine else Curves([], [])
    return (curves, *(np.concatenate(found[name])
                      for name in ("X", "stretch", "rest_stretch", "target")))


def load_state(header, grid, markers, stretch):
    """The state, each rank reading its own part of the fields.  Collective.

    Raises
    ------
    InputError
        On all ranks, when a field cannot be read or is not finite.
    """
    comm = grid.comm.tompi4py()
    parts, history = {}, {}

    def read(file):
        parts.update(_read_parts(file["fluid"], grid))
        if "history" in file:
            history.update((name, value.item()) for name, value in file["history"].attrs.items())
        for name, item in file.get("history", {}).items():
            if isinstance(item, h5py.Group):
                history[name] = _read_parts(item, grid)
            else:
                whole = _finite(item)
                history[name] = whole if comm.rank == 0 else whole[:0]

    _on_file(header.path, comm, read)
    # Only now, with all ranks agreed: making vectors is collective.
    velocity, pressure = grid.velocity_vector(), grid.pressure_vector()
    grid.set_velocity(velocity, parts["u"], parts["v"])
    grid.set_pressure(pressure, parts["p"])
    for name, item in history.items():
        if isinstance(item, dict):
            history[name] = _vector(item, grid)
    if BARE in history:
        pressure.destroy()
        pressure = history.pop(BARE)
    return State(header.step, header.time, velocity, pressure, markers, stretch, history)


def _read_parts(group, grid):
    """Read this rank's parts of the fields in a group, by name."""
    boxes = {"u": grid.u_box, "v": grid.v_box, "p": grid.p_box}
    return {name: _finite(group[name], boxes[name]) for name in group}


def _vector(parts, grid):
    """A pressure or velocity vector from its parts.  Collective."""
    if "p" in parts:
        vector = grid.pressure_vector()
        grid.set_pressure(vector, parts["p"])
    else:
        vector = grid.velocity_vector()
        grid.set_velocity(vector, parts["u"], parts["v"])
    return vector


def _finite(dataset, box=...):
    values = dataset[box]
    if not np.isfinite(values).all():
        raise ValueError(f"not every entry of {dataset.name} is finite")
    return values


def _on_file(path, comm, read):
    """Let every rank read from the file; trouble on any is raised on all.  Collective."""

    def action():
        try:
            with h5py.File(path, "r") as file:
                read(file)
        except (OSError, RuntimeError, KeyError, ValueError) as failure:
            raise _unfit(path, failure) from None

    everywhere(comm, action)
