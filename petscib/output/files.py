"""Writing files so that none is ever seen half written, and failing on all ranks alike."""

import errno
import os
import re
from contextlib import contextmanager, suppress

import h5py
import numpy as np

from ..errors import OutputError

PART = ".part"  # added to the name of a file that is being written


def on_root(comm, action, error=OutputError):
    """Run `action` on rank 0 and return its result there; OSError becomes `error` on every rank.

    Collective.
    """
    result = trouble = None
    if comm.rank == 0:
        try:
            result = action()
        except OSError as failure:
            trouble = explain(failure)
    trouble = comm.bcast(trouble)
    if trouble:
        raise error(trouble)
    return result


def explain(failure, path=None):
    """A file error in one line: which file, and why."""
    name = path or failure.filename or "output"
    # HDF5 hides the system's words in a long message of its own.
    inner = re.search(r"error message = '([^']*)'", str(failure))
    return f"{name}: {inner.group(1) if inner else failure.strerror or failure}"


@contextmanager
def replacing(path):
    """Give a temporary name to write to; when the block succeeds, it becomes `path`, safely.

    The content is on the disk before the name is: after a crash there is the old file or the new
    one.  Rank 0 only.
    """
    temporary = path + PART
    try:
        yield temporary
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise
    folder = os.open(os.path.dirname(path) or ".", os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def write_text(path, text):
    """Replace a text file.  Rank 0 only."""
    with replacing(path) as temporary, open(temporary, "w") as file:
        file.write(text)


def named(folder, *names):
    """Sorted paths of the files in a folder with one of these names; "#" stands for digits."""
    pattern = re.compile("|".join(re.escape(name).replace(r"\#", "[0-9]{8,}") for name in names))
    found = os.listdir(folder) if os.path.isdir(folder) else []
    return sorted(os.path.join(folder, name) for name in found if pattern.fullmatch(name))


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
    on_root(comm, lambda: _reserve(temporary, room))
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

    on_root(comm, finish, lambda why: OutputError(f"{path}: {trouble}" if trouble else why))


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
