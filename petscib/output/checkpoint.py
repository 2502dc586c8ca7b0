"""Checkpoint files: the whole state in natural order, whatever the number of ranks."""

import json
import os

import h5py
import numpy as np

FORMAT_VERSION = 1


def gather(comm, box, block, shape):
    """Natural-order array of the given shape on rank 0, None elsewhere.  Collective."""
    parts = comm.gather((box, block))
    if comm.rank:
        return None
    whole = np.empty(shape)
    for part_box, part in parts:
        whole[part_box] = part
    return whole


def save(path, problem, state, settings, reference):
    """Write a checkpoint under a temporary name, flush it, and rename it.  Collective.

    Parameters
    ----------
    path : str
    problem : Problem
    state : State
    settings : Settings
        Stored whole, as JSON.
    reference : dict or None
        Initial area and perimeter of the vesicle.
    """
    grid = problem.grid
    comm = grid.comm.tompi4py()
    u, v = grid.velocity_blocks(state.velocity)
    fields = {
        "u": gather(comm, grid.u_box, u, grid.u_index.shape),
        "v": gather(comm, grid.v_box, v, grid.v_index.shape),
        "p": gather(comm, grid.p_box, grid.pressure_block(state.pressure), grid.p_index.shape),
    }
    if comm.rank == 0:
        temporary = f"{path}.part"
        with h5py.File(temporary, "w") as file:
            file.attrs["format_version"] = FORMAT_VERSION
            file.attrs["step"] = state.step
            file.attrs["time"] = state.time
            file.attrs["dt"] = settings.ts_dt
            file.attrs["scheme"] = settings.scheme
            file.attrs["options"] = json.dumps(settings.to_dict())
            for name, values in fields.items():
                file.create_dataset(f"fluid/{name}", data=values)
            if problem.membrane is not None:
                vesicle = file.create_group("vesicle_0")
                vesicle["X"] = state.markers
                vesicle["stretch"] = state.stretch
                vesicle["rest_stretch"] = problem.membrane.rest_stretch
                vesicle.attrs["ds"] = problem.membrane.ds
                for name, value in reference.items():
                    vesicle.attrs[f"initial_{name}"] = value
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    comm.Barrier()
