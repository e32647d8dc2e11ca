"""HDF5 files on a disk that may be full, or under a limit of file sizes.

HDF5 keeps what it could not write, tries again when the process ends, and crashes there. So it gets
a file that never fails it: from the first error on nothing more is written, as if the process had
been killed at that moment, and `GuardedFile.check` raises that error with the name of the file.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from tledface.io import _lock

__all__ = ["GuardedFile", "opened"]


class GuardedFile:
    """A file for h5py, which calls the methods of a Python file on it.

    Args:
        path: The file; locked as HDF5 locks what it opens by name.
        mode: "w" for a new one, "r+" for one that is there.

    Raises:
        BlockingIOError: another process has it.
        OSError: it cannot be opened.
    """

    def __init__(self, path: Path, mode: str) -> None:
        """Open it."""
        self._path = path
        self._error: OSError | None = None
        self._told = False
        # Not cut short on the way: until it is locked it may be another process's.
        new = os.O_CREAT if mode == "w" else 0
        self._handle = os.open(path, os.O_RDWR | new | getattr(os, "O_BINARY", 0), 0o666)
        try:
            if os.name != "nt":  # there a lock keeps readers off too
                _lock.lock(self._handle)
            if mode == "w":
                os.ftruncate(self._handle, 0)
        except BaseException:
            os.close(self._handle)
            raise

    def check(self) -> None:
        """Raise the first error in writing, once."""
        if self._error is not None and not self._told:
            self._told = True
            raise self._error

    @contextmanager
    def checked(self) -> Iterator[None]:
        """Raise an error in writing at the end of the context, before what HDF5 makes of it."""
        try:
            yield
        except Exception:
            self.check()
            raise
        self.check()

    def close(self) -> None:
        """Close it, after HDF5 has."""
        os.close(self._handle)

    # -- what h5py calls -------------------------------------------------------------------------

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place."""
        return os.lseek(self._handle, offset, whence)

    def tell(self) -> int:
        """The place."""
        return os.lseek(self._handle, 0, os.SEEK_CUR)

    def read(self, size: int) -> bytes:
        """The next bytes; h5py knows a file by this."""
        return os.read(self._handle, size)

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer, with zeros where an error kept the file short."""
        view = memoryview(buffer).cast("B")
        done = 0
        while done < len(view) and (got := os.read(self._handle, len(view) - done)):
            view[done : done + len(got)] = got
            done += len(got)
        if self._error is None:
            return done
        view[done:] = bytes(len(view) - done)
        return len(view)

    def write(self, data: Any) -> int:
        """Take all of it."""
        view = memoryview(data).cast("B")

        def put() -> None:
            left = view
            while left:
                left = left[os.write(self._handle, left) :]

        self._try(put)
        return len(view)

    def truncate(self, size: int) -> int:
        """Set the size."""
        self._try(lambda: os.ftruncate(self._handle, size))
        return size

    def flush(self) -> None:
        """Nothing waits here."""

    def _try(self, work: Callable[[], None]) -> None:
        # What comes after an error may count what was lost in it, so it is not written either.
        if self._error is None:
            try:
                work()
            except OSError as error:
                self._error = OSError(error.errno, error.strerror, str(self._path))


@contextmanager
def opened(path: Path, mode: str) -> Iterator[h5py.File]:
    """An HDF5 file to write into, "w" or "r+".

    Raises:
        OSError: not all of it could be written.
    """
    raw = GuardedFile(path, mode)
    try:
        with raw.checked(), h5py.File(raw, mode) as file:
            yield file
    finally:
        raw.close()
