"""The folder of a run: made when the run starts, never mixed with other files.

``run.json`` in it says that it is one, what the run was and which files it wrote. While a process
runs into it that process holds ``run.lock``, and others are refused.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tledface.errors import InputError
from tledface.io import _lock
from tledface.io._atomic import atomic_path

__all__ = ["RUN_FILE", "OutputFolder"]

RUN_FILE = "run.json"
_LOCK_FILE = "run.lock"


class OutputFolder:
    """A run's folder.

    Making one only checks ``path``: it must be absent, empty, or (with ``force``) the folder of an
    earlier run, whose files are then replaced, and no process may be running into it. Raises
    InputError otherwise.
    """

    def __init__(self, path: str | Path, *, force: bool = False) -> None:
        """Check the folder; nothing is written."""
        self.path = Path(path)
        self._force = force
        if self.path.exists() and not self.path.is_dir():
            raise InputError(f"output {self.path}: is a file; give a folder that is new or empty")
        if _lock.is_held(self.path / _LOCK_FILE):
            raise self._taken()
        self._earlier = self._check_files()
        nearest = next(parent for parent in [self.path, *self.path.parents] if parent.exists())
        if not nearest.is_dir():
            raise InputError(
                f"output {self.path}: {nearest} is a file, which holds no folder; give another"
            )
        if not os.access(nearest, os.W_OK):
            raise InputError(f"output {self.path}: {nearest} is not writable; give another folder")

    @contextmanager
    def held(self) -> Iterator[None]:
        """Make the folder, and let no other process run into it within the context.

        A folder that is made and stays empty is removed at the end.
        Raises InputError: another process does, or the folder was filled since it was checked.
        """
        made = not self.path.exists()
        self.path.mkdir(parents=True, exist_ok=True)
        lock = self.path / _LOCK_FILE
        try:
            handle = _lock.acquire(lock)
        except BlockingIOError:
            raise self._taken() from None
        try:
            self._earlier = self._check_files()
            yield
        finally:
            _lock.release(lock, handle)
            if made:
                with suppress(OSError):  # of a folder that is not empty
                    self.path.rmdir()

    def free(self) -> float:
        """Bytes that a run may fill: free ones, and those of an earlier run that it replaces."""
        nearest = next(parent for parent in [self.path, *self.path.parents] if parent.exists())
        usage = shutil.disk_usage(nearest)
        if usage.total == 0:
            return math.inf  # the file system does not tell
        earlier = [file.stat() for file in self._replaced() if file.is_file()]
        return usage.free + 512 * sum(found.st_blocks for found in earlier)  # sparse ones

    def _replaced(self) -> list[Path]:
        """The files of the earlier run, there or not."""
        named = (self.path / str(name) for name in (self._earlier or {}).get("files", []))
        return [file for file in named if file.parent == self.path]

    def _taken(self) -> InputError:
        return InputError(
            f"output {self.path}: another process is running into it; wait for its end, or end it"
        )

    def _check_files(self) -> dict[str, Any] | None:
        """What the folder says of an earlier run that may be replaced; raises InputError else."""
        earlier = earlier_run(self.path)
        # A kill right at the start leaves nothing but the lock's file.
        if self.path.is_dir() and any(x.name != _LOCK_FILE for x in self.path.iterdir()):
            if earlier is None:
                raise InputError(
                    f"output {self.path}: holds files that are no tledface run; give a folder "
                    "that is new or empty"
                )
            if not self._force:
                raise InputError(f"output {self.path}: {_earlier_text(self.path, earlier)}")
        return earlier

    def begin(self, about: dict[str, Any], files: Sequence[str] = ()) -> None:
        """Make the folder, remove an earlier run's files, and mark it as a run in progress.

        ``files``: names the run may make, so that what it leaves when it is killed is known.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        for file in self._replaced():
            file.unlink(missing_ok=True)
        self._earlier = None
        self.write({**about, "state": "running", "files": list(files)})

    def write(self, about: dict[str, Any]) -> None:
        """Write ``run.json``: what the run is, its state and its files (names in the folder)."""
        with atomic_path(self.path / RUN_FILE, "output") as part:
            part.write_text(
                json.dumps({"tledface": version("tledface"), **about}, indent=2) + "\n",
                encoding="utf-8",
            )


def _earlier_text(path: Path, earlier: dict[str, Any]) -> str:
    from tledface.run_checkpoints import how_to_resume

    if earlier.get("state") != "finished" and (go_on := how_to_resume(path)):
        return f"holds an unfinished run; {go_on}, --force starts again, or give another folder"
    return "holds an earlier run; --force replaces it, or give another folder"


def earlier_run(path: Path) -> dict[str, Any] | None:
    """What ``run.json`` says in a run's folder; None if it is not one."""
    try:
        about = json.loads((path / RUN_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return about if isinstance(about, dict) and "tledface" in about else None
