"""The claim of a run to its folder, which ends with the run however that ends."""

import errno
import fcntl
import os
import socket
import time

NAME = ".petscib.lock"
# A file system that cannot lock: an old NFS, or Lustre mounted without it.
_CANNOT = errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP


class Lock:
    """Holds a folder against other runs.  Rank 0 only.

    The system drops the lock with the process, after kill -9 too, and hands it on over a network
    file system.  The file itself stays: who has taken it last can be read in it.

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
        path = os.path.join(folder, NAME)
        self._file = open(path, "a+")  # noqa: SIM115  (it stays open)
        self.holds = True
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in _CANNOT:
                self.holds = False
                return
            self._file.seek(0)
            holder = " ".join(self._file.read(200).split()) or "another run"
            self._file.close()
            raise BlockingIOError(error.errno, f"in use by {holder}; allowed: another folder", folder) from None
        self._file.truncate(0)
        self._file.write(
            f"process {os.getpid()} on {socket.gethostname()} since "
            f"{time.strftime('%Y-%m-%d %H:%M:%S')}\n"
        )
        self._file.flush()

    def release(self):
        """Let others have the folder.  May be called twice."""
        self._file.close()
