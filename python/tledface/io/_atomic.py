"""Writing a file under a temporary name until it is whole."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tledface.errors import InputError

# Of a disk that is full, and of limits: the user's share of it, the size of a file.
NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


def as_path(given: object, what: str) -> Path:
    """The path of a file to read or write; raises InputError for what is none."""
    if not isinstance(given, (str, os.PathLike)) or not str(given) or "\0" in str(given):
        raise InputError(f"{what}: got {given!r}; allowed: the path of a file")
    return Path(given)


def check_folder(path: Path, what: str) -> None:
    """Raise InputError unless the folder that would hold ``path`` exists and is writable."""
    folder = path.parent
    if not folder.is_dir():
        raise InputError(f"{what} {path}: there is no folder {folder}; make it first")
    if not os.access(folder, os.W_OK):
        raise InputError(f"{what} {path}: the folder {folder} is not writable; choose another")


def check_new_folder(path: Path, what: str) -> None:
    """Raise InputError unless ``path`` is a folder or can be made one."""
    check_folder(path, what)
    if path.exists() and not path.is_dir():
        raise InputError(f"{what} {path}: is a file; give a folder")


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name == "nt":
        return  # a folder cannot be opened there; its names are kept in order anyway
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def atomic_path(path: Path, what: str, *, durable: bool = False) -> Iterator[Path]:
    """Give a temporary path beside ``path``; rename it on success, remove it on failure.

    ``durable``: the file and its name are on the disk before it replaces another one.
    """
    check_folder(path, what)
    if os.path.isdir(path):  # Path.is_dir raises for a name that is too long
        raise InputError(f"{what} {path}: is a folder; give the name of a file in it")
    part = path.with_name(f"{path.stem}.part{path.suffix}")
    try:
        part.touch()
    except OSError as error:
        if error.errno in NO_ROOM:
            raise
        raise InputError(
            f"{what} {path}: cannot be made there ({error.strerror}); choose another place or name"
        ) from None
    try:
        yield part
        if durable:
            sync(part)
        os.replace(part, path)
        if durable:
            sync(path.parent)
    except OSError as error:
        if error.filename is None and error.errno is not None:  # of a write
            error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)
