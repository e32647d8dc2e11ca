"""A lock file that one process holds at a time, and that does not outlive it.

The lock is the system's, on the open file: it ends with its process, however that ends, and a file
that a kill leaves behind holds nobody up. Where the system or the file system has no such locks
(some network folders) everybody gets one.
"""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress
from pathlib import Path

__all__ = ["acquire", "is_held", "lock", "release"]

_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP}


def acquire(path: Path) -> int:
    """Take the lock, for `release`; raises BlockingIOError if somebody else holds it."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            lock(handle)
        except BaseException:
            os.close(handle)
            raise
        # Its holder may have removed the file since it was opened: then this locks nothing.
        if _is_at(path, handle):
            return handle
        os.close(handle)


def release(path: Path, handle: int) -> None:
    """Give the lock back and remove its file."""
    # Removed while it is held, so that nobody else's is; Windows removes no open file.
    with suppress(OSError):
        path.unlink()
    os.close(handle)
    if sys.platform == "win32":
        with suppress(OSError):
            path.unlink()


def is_held(path: Path) -> bool:
    """Whether somebody holds the lock now; makes no file."""
    try:
        handle = os.open(path, os.O_RDWR)
    except OSError:
        return False
    try:
        lock(handle)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False


def lock(handle: int) -> None:
    """Lock an open file until it is closed; raises BlockingIOError if somebody else holds it."""
    if sys.platform == "win32":
        import msvcrt

        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            raise BlockingIOError(errno.EWOULDBLOCK, "locked") from None
        return
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise


def _is_at(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False
