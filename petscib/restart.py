"""Restarts: which checkpoint to continue from, and with which options.

The options come from the file, and those given now win, except for the few that the saved state
depends on.
"""

import os
import sys

from . import options
from .agreement import on_root
from .errors import InputError
from .output import checkpoint, files
from .own import is_own
from .settings import as_given, given_text, text_of
from .vesicles import split

LATEST = "latest"
# What the saved state was made with.  Everything else (scheme, delta function, fluid, membrane
# constants, time step, ...) acts from the next step on.  The flow is here because the velocities
# on the walls' faces are part of the state; rest_length, because the rest stretching is.
FIXED = (
    "scene", "stag_grid_x", "stag_grid_y", "domain", "periodic", "flow", "shear_rate", "vesicles",
    "vesicle_file", "arrangement", "seed", "area_fraction", "shape", "axes", "center", "angle",
    "amplitude", "markers", "marker_file", "rest_length",
)


def merge(database, comm):
    """The options of a run, with those of the checkpoint if -restart is given.  Collective.

    Parameters
    ----------
    database : dict of str to str or None
        PETSc's option database.
    comm : mpi4py communicator

    Returns
    -------
    dict
        In the same form, the options for the solvers among them.

    Raises
    ------
    InputError
        On all ranks: no such checkpoint, a bad one, or an option that cannot change.
    """
    now = {name.lower(): text for name, text in database.items()}
    if not now.get("restart"):
        return database
    header = on_root(comm, lambda: _locate(now))
    _refuse_changes(now, header)
    output = now.get("output") or os.path.dirname(header.path) or "."
    saved = _saved_options(header, output, {
        name: value for name, value in now.items() if not isinstance(value, (str, type(None)))})
    return {**header.progress.solver_options, **saved, **now, "output": output,
            "restart": header.path}


def _locate(now):
    """Header of the checkpoint meant by -restart and -output.  Rank 0 only."""
    if now["restart"] != LATEST:
        return checkpoint.read_header(now["restart"])
    asked = {name: now[name] for name in ("scene", "output") if now.get(name)}
    return _latest(options.read(asked).output)


def _latest(folder):
    """Header of the complete checkpoint of the highest step in a folder."""
    headers = []
    for path in files.named(folder, *files.CHECKPOINTS):
        try:
            headers.append(checkpoint.read_header(path))
        except InputError as error:
            why = str(error).removeprefix("-restart ")
            print(f"petscib: skipped: {why}", file=sys.stderr, flush=True)
    if not headers:
        raise InputError(
            f"-restart {LATEST}: no complete checkpoint in {folder}; allowed: a file, or {LATEST} "
            "with the -output (or -scene) of a run that has left one"
        )
    return max(headers, key=lambda header: header.step)


def _saved_options(header, output, own):
    """Option texts that give the file's settings again, but for where it read and wrote.

    Functions and points of the script's stand in the place of theirs.
    """
    paths = "restart", "output"
    record = {name: value for name, value in header.options.items() if name not in paths}
    record["given"] = [name for name in record["given"] if name not in paths]
    try:
        texts = {**given_text(record), **own, "restart": header.path, "output": output}
        fresh = options.read(texts).to_dict()
    except InputError as error:
        raise InputError(f"-restart {header.path}: {error}") from None
    # A scene's or the table's default may have changed since the file was written.
    moved = {name for name, value in record.items()
             if name in options.TABLE and value is not None and fresh[name] != value}
    record["given"] = sorted(moved.union(record["given"]))
    return given_text(record)


def _refuse_changes(now, header):
    for name in sorted(now, key=lambda name: FIXED.index(name) if name in FIXED else len(FIXED)):
        number, base = split(name)
        common = name if number is None else base
        if common not in FIXED:
            continue
        text = "" if now[name] is None else now[name]
        value = options.value_of(options.option_of(name), text)
        # An older file lacks some.
        saved = header.options.get(common, options.TABLE[common].default)
        saved = header.options.get(name, saved)
        saved = tuple(saved) if isinstance(saved, list) else saved
        if value != saved and not (is_own(value) and str(value) == saved):
            allowed = f"{text_of(saved)}, or no -{name}" if saved is not None else f"no -{name}"
            raise InputError(
                f"{as_given(name, value)}: a restart cannot change it, and {header.path} was made "
                f"with {text_of(saved)}; allowed: {allowed}"
            )
