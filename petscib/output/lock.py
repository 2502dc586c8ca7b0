"""The claim of a run to its folder, which ends with the run, in whatever way that ends."""

import errno
import fcntl
import os
import socket
import time
from contextlib import suppress

NAME = ".petscib.lock"
# A file system that cannot lock: an old NFS, or Lustre mounted without it.
_CANNOT = errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP


class Lock:
    """Holds a folder against other runs.  Rank 0 only.

    The system drops the lock with the process, after kill -9 too, and heeds it over a network file
    system.  The lock's file says who holds it.

    Parameters
    ----------
    folder : str

    Attributes
    ----------
    holds : bool
        Whether this file system can lock.

    Raises
    ------
    BlockingIOError
        Another run holds the folder; the message says which.
    """

    def __init__(self, folder):
        self._path = os.path.join(folder, NAME)
        while True:
            self._file = open(self._path, "a+")  # it stays open
            self.holds = _try(self._file, fcntl.LOCK_EX, folder)
            if not self.holds or self._is_there():
                break
            self._file.close()  # its holder has removed it in between
        if self.holds:
            now = time.strftime("%Y-%m-%d %H:%M:%S")
            try:
                self._file.truncate(0)
                self._file.write(f"process {os.getpid()} on {socket.gethostname()} since {now}\n")
                self._file.flush()
            except OSError:  # the disk is full
                self.release()
                raise

    def _is_there(self):
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), os.stat(self._path))
        except FileNotFoundError:
            return False

    def release(self):
        """Let others have the folder.  May be called twice."""
        if not self._file.closed:
            if self.holds:
                with suppress(OSError):
                    os.unlink(self._path)
            with suppress(OSError):  # what a full disk has not taken
                self._file.close()


def check(folder):
    """Raise BlockingIOError if a run holds the folder.  Rank 0 only."""
    path = os.path.join(folder, NAME)
    if os.path.exists(path):
        with open(path) as file:
            _try(file, fcntl.LOCK_SH, folder)


def _try(file, how, folder):
    """Lock an open file; whether that can be done at all."""
    try:
        fcntl.flock(file, how | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _CANNOT:
            return False
        file.seek(0)
        holder = " ".join(file.read(200).split()) or "another run"
        file.close()
        why = f"in use by {holder}; allowed: another folder, or to wait for its end"
        raise BlockingIOError(error.errno, why, folder) from None
    return True
