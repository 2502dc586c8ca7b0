"""Writing files so that none is ever seen half written, and failing on all ranks alike.

This module needs neither MPI nor HDF5.
"""

import os
import re
from contextlib import contextmanager, suppress

from ..errors import OutputError

# Names of the saved states; "#" stands for digits.
CHECKPOINTS = "checkpoint-#.h5", "final.h5"
PART = ".part"  # added to the name of a file that is being written


def by_root(comm, action, error=OutputError):
    """Do something with files on rank 0; its OSError becomes `error` on every rank.  Collective.

    Returns what `action` does on rank 0, None elsewhere.
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
    temporary = os.fspath(path) + PART
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
