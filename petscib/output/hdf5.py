"""HDF5 files whose datasets are spread over the ranks: written whole, or not at all."""

import errno
import os
from contextlib import suppress

import h5py
import numpy as np

from ..errors import OutputError
from .files import PART, by_root, explain, replacing


class Dataset:
    """One dataset of a file, spread over the ranks or held by rank 0.

    Parameters
    ----------
    path : str
        Inside the file.
    values : ndarray
        This rank's part.
    shape : tuple of int, optional
        Of the whole; that of `values` by default (rank 0 holds it all, and others know its shape).
    box : tuple of slices, optional
        Where this rank's part lies.
    **attributes
        Equal on all ranks, such as unit and location.
    """

    def __init__(self, path, values, shape=None, box=None, **attributes):
        self.path = path
        self.values = np.asarray(values)
        self.shape = self.values.shape if shape is None else tuple(shape)
        self.box = box
        self.attributes = attributes

    @property
    def size(self):
        """Bytes of the whole."""
        return int(np.prod(self.shape)) * self.values.dtype.itemsize


def write_hdf5(path, comm, datasets, attributes):
    """Write an HDF5 file under a temporary name, flush it, and rename it.  Collective.

    With an h5py that has MPI the ranks write their parts themselves; otherwise rank 0 collects
    them.  The file is the same.

    Parameters
    ----------
    path : str
    comm : mpi4py communicator
    datasets : list of Dataset
        In the same order on all ranks.
    attributes : dict of str to dict
        Attributes by group; equal on all ranks.

    Raises
    ------
    OutputError
        On all ranks; no file of the temporary name is left.
    """
    temporary = path + PART
    room = sum(dataset.size + 4096 for dataset in datasets) + 4 * len(str(attributes)) + 65536
    # Parallel HDF5 may abort or hang when the disk fills while it writes: see to it first.
    by_root(comm, lambda: _reserve(temporary, room))
    together = comm.size > 1 and h5py.get_config().mpi
    trouble = ""
    if together:
        trouble = _write(temporary, datasets, attributes, driver="mpio", comm=comm)
    else:
        whole = [_collect(comm, dataset) for dataset in datasets]
        if comm.rank == 0:
            trouble = _write(temporary, whole, attributes)
    trouble = next(filter(None, comm.allgather(trouble)), "")

    def finish():
        with replacing(path):
            if trouble:
                raise OSError(trouble)

    by_root(comm, finish, lambda why: OutputError(f"{path}: {trouble}" if trouble else why))


def _reserve(path, room):
    """See whether there is room for a file of that many bytes; OSError if not."""
    try:
        with open(path, "wb") as file:
            if hasattr(os, "posix_fallocate"):  # not on macOS
                os.posix_fallocate(file.fileno(), 0, room)
    except OSError as failure:
        if failure.errno in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):
            return  # this file system cannot tell
        with suppress(OSError):
            os.unlink(path)
        raise OSError(failure.errno, failure.strerror, path) from None


def _write(path, datasets, attributes, **driver):
    """Write what this rank holds.  Returns what went wrong, or an empty text.

    Collective when the driver is parallel: then a rank whose own part fails must carry on to the
    end, where all ranks close the file together.
    """
    trouble = ""
    try:
        # Attributes of any length need this format: the options of hundreds of vesicles are long.
        with h5py.File(path, "w", libver=("v108", "latest"), **driver) as file:
            for name, entries in attributes.items():
                file.require_group(name).attrs.update(entries)
            for dataset in datasets:
                target = file.create_dataset(dataset.path, dataset.shape, dataset.values.dtype)
                target.attrs.update(dataset.attributes)
                if not dataset.values.size:
                    continue
                try:
                    target[dataset.box or ...] = dataset.values
                except (OSError, RuntimeError) as failure:
                    trouble = trouble or explain(failure, dataset.path)
            file.flush()
    except (OSError, RuntimeError) as failure:
        trouble = trouble or explain(failure, path)
    return trouble


def _collect(comm, dataset):
    """The whole of a dataset on rank 0; elsewhere it as it was.  Collective."""
    if dataset.box is None or comm.size == 1:
        return dataset
    parts = comm.gather((dataset.box, dataset.values))
    if comm.rank:
        return dataset
    whole = np.empty(dataset.shape, dataset.values.dtype)
    for box, values in parts:
        whole[box] = values
    return Dataset(dataset.path, whole, **dataset.attributes)
