"""What pictures are made of: the files of a run, read back and prepared.

Nothing here is collective: rank 0 alone, or a program of its own, looks at the files.
"""

import json
import os
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from ..schemes.registry import SCHEMES
from . import tables
from .files import CHECKPOINTS, named


class Fields(NamedTuple):
    """Staggered fields of one file: u (n, m+1), v (n+1, m), without the last if periodic."""

    u: np.ndarray
    v: np.ndarray
    outlines: list
    tensions: list  # along the outlines, an entry for each of their edges
    time: float
    domain: tuple


def read_table(folder):
    """The diagnostics, empty if there are none."""
    path = os.path.join(folder, "diagnostics.csv")
    return tables.read(path) if os.path.exists(path) else {}


def read_moments(folder):
    """List of (time, [(vesicle, X), ...]) in order of time; broken outlines are left out."""
    path = os.path.join(folder, "outlines.csv")
    if not os.path.exists(path):
        return []
    moments = {}
    for step, time, vesicle, X in tables.read_outlines(path):
        if np.isfinite(X).all() and len(X):
            moments.setdefault(step, (time, []))[1].append((vesicle, X))
    return [moments[step] for step in sorted(moments)]


def saved_files(folder):
    """Checkpoints and the final file, newest first."""
    return sorted(named(folder, *CHECKPOINTS), key=os.path.getmtime, reverse=True)


def read_options(folder):
    """The options of the run, from its summary or its newest saved file; empty if neither."""
    path = os.path.join(folder, "summary.json")
    if os.path.exists(path):
        with _named_in_errors(path), open(path) as file:
            return json.load(file).get("options", {})
    for path in saved_files(folder)[:1]:
        import h5py

        with _named_in_errors(path), h5py.File(path, "r") as file:
            return json.loads(file.attrs.get("options", "{}"))
    return {}


def is_at_rest(options):
    """Whether nothing drives the fluid from outside."""
    flows = options.get("flow") != "rest" and options.get("shear_rate") != 0
    return not flows and not any(options.get("body_force", ()))


@contextmanager
def _named_in_errors(path):
    """The libraries' messages for an unreadable file do not say which one it is."""
    try:
        yield
    except (OSError, ValueError, KeyError) as error:
        raise ValueError(f"{path}: cannot be read: {error}") from error


def read_fields(folder):
    """Fields of the newest saved file, or None if there is none."""
    paths = saved_files(folder)
    if not paths:
        return None
    import h5py

    with _named_in_errors(paths[0]), h5py.File(paths[0], "r") as file:
        if "fluid/u" not in file or "fluid/v" not in file:
            return None
        options = json.loads(file.attrs.get("options", "{}"))
        outlines, tensions = [], []
        while f"vesicle_{len(outlines)}/X" in file:
            vesicle = file[f"vesicle_{len(outlines)}"]
            closed = vesicle.attrs.get("closed", 1)
            period = vesicle.attrs.get("period", 0.0) if closed else None
            outlines.append(_to_its_end(vesicle["X"][:], period))
            tension = vesicle["tension"][:] if "tension" in vesicle else np.zeros(
                len(outlines[-1]) - 1)  # in files of an earlier petscib
            # Entry k of a closed curve lies between markers k - 1 and k.
            tensions.append(np.roll(tension, -1) if closed else tension)
        # At the end of a step Crank-Nicolson leaves oscillations from cell to cell that it does not
        # damp; in the middle, where its equations hold, there are none.
        theta = SCHEMES[options["scheme"]].theta if "scheme" in options else 1.0
        velocity = file["history/stage" if theta < 1 and "history/stage" in file else "fluid"]
        return Fields(
            velocity["u"][:],
            velocity["v"][:],
            outlines,
            tensions,
            float(file.attrs.get("time", np.nan)),
            tuple(options.get("domain", (-1.0, 1.0, -1.0, 1.0))),
        )


def outlines(folder, options):
    """The moments of `read_moments` as they are drawn: in the box, and each to its end."""
    return to_their_ends(in_the_box(read_moments(folder), options), options)


def in_the_box(moments, options):
    """Move outlines by whole periods of a periodic box, so that their middles are inside."""
    periodic = [name in options.get("periodic", "none") for name in "xy"]
    if not any(periodic):
        return moments
    low, high = np.reshape(options["domain"], (2, 2)).T

    return [(time, [(vesicle, _moved(X, low, high, periodic)) for vesicle, X in outlines])
            for time, outlines in moments]


def newest_in_the_box(fields):
    """The outlines of the newest saved file, moved like those of `in_the_box`."""
    low, high = np.reshape(fields.domain, (2, 2)).T
    return [_moved(X, low, high, _is_periodic(fields)) for X in fields.outlines]


def _moved(X, low, high, periodic):
    periods = np.floor((X.mean(axis=0) - low) / (high - low))
    return X - np.where(periodic, periods * (high - low), 0.0)


def to_their_ends(moments, options):
    """Closed outlines with their first marker again at the end; plates are open."""
    low, high = np.reshape(options.get("domain", (-1.0, 1.0, -1.0, 1.0)), (2, 2)).T
    along = 0 if "x" in options.get("periodic", "none") else 1
    period = np.where(np.arange(2) == along, high - low, 0.0)
    ends = {"line": period, "plate": None}

    def ended(vesicle, X):
        shape = options.get(f"vesicle_{vesicle}_shape", options.get("shape"))
        return _to_its_end(X, ends.get(shape, 0.0))

    return [(time, [(vesicle, ended(vesicle, X)) for vesicle, X in outlines])
            for time, outlines in moments]


def _to_its_end(X, period):
    """A curve with its first marker again at the end, a period further; None leaves it open."""
    return X if period is None else np.append(X, X[:1] + period, axis=0)


def centre_velocity(u, v):
    """Velocity at the cell centres, two arrays of shape (n, m), from that at the faces."""
    u, v = _with_last_faces(u, v)
    return 0.5 * (u[:, 1:] + u[:, :-1]), 0.5 * (v[1:] + v[:-1])


def _with_last_faces(u, v):
    """u of shape (n, m+1) and v of shape (n+1, m), also on a periodic box."""
    n, m = u.shape[0], v.shape[1]
    if u.shape[1] == m:
        u = np.concatenate([u, u[:, :1]], axis=1)
    if v.shape[0] == n:
        v = np.concatenate([v, v[:1]], axis=0)
    return u, v


def _is_periodic(fields):
    """Periodicity in x and in y, as the array shapes tell it."""
    n, m = fields.u.shape[0], fields.v.shape[1]
    return fields.u.shape[1] == m, fields.v.shape[0] == n


def corner_vorticity(fields):
    """Vorticity at the cell corners, shape (n+1, m+1), and the lines that they lie on.

    It is computed at inner corners. Those on a wall repeat their neighbour, those on a periodic
    side have a neighbour across it.
    """
    a, b, c, d = fields.domain
    u, v = _with_last_faces(fields.u, fields.v)
    n, m = u.shape[0], v.shape[1]
    dx, dy = (b - a) / m, (d - c) / n
    periodic_x, periodic_y = _is_periodic(fields)
    v = np.pad(v, ((0, 0), (1, 1)), mode="wrap" if periodic_x else "edge")
    u = np.pad(u, ((1, 1), (0, 0)), mode="wrap" if periodic_y else "edge")
    vorticity = np.diff(v, axis=1) / dx - np.diff(u, axis=0) / dy
    if not periodic_x:
        vorticity[:, 0], vorticity[:, -1] = vorticity[:, 1], vorticity[:, -2]
    if not periodic_y:
        vorticity[0], vorticity[-1] = vorticity[1], vorticity[-2]
    return vorticity, a + dx * np.arange(m + 1), c + dy * np.arange(n + 1)


def periodic_shifts(fields, X):
    """Translations that bring into the box every image of an outline that shows in it."""
    a, b, c, d = fields.domain
    if not np.isfinite(X).all():
        return []
    shifts = []
    for axis, (low, high, periodic) in enumerate(
        zip((a, c), (b, d), _is_periodic(fields))
    ):
        size = high - low
        first = int(np.ceil((low - X[:, axis].max()) / size))
        last = int(np.floor((high - X[:, axis].min()) / size))
        shifts.append([k * size for k in range(first, last + 1)] if periodic else [0.0])
    return [np.array((x, y)) for x in shifts[0] for y in shifts[1]]
