"""Progress on the terminal (standard error): a bar with the time left, or nothing."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self

__all__ = ["ProgressBar", "spinner"]


def _shown(quiet: bool) -> bool:
    return not quiet and sys.stderr.isatty()


class ProgressBar:
    """A bar from 0 to ``total`` with elapsed time and time left; silent where no one looks."""

    def __init__(self, label: str, total: float, *, quiet: bool = False) -> None:
        """Prepare the bar; it appears on entering."""
        self._progress = None
        if _shown(quiet):
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                Progress,
                TaskProgressColumn,
                TextColumn,
                TimeElapsedColumn,
                TimeRemainingColumn,
            )

            self._progress = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TaskProgressColumn(),
                TextColumn("elapsed"),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
                console=Console(stderr=True),
            )
            self._task = self._progress.add_task(label, total=total, note="")

    def __enter__(self) -> Self:
        """Show the bar."""
        if self._progress is not None:
            self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the bar as it stands."""
        if self._progress is not None:
            self._progress.stop()

    def update(self, done: float, note: str = "") -> None:
        """Move the bar to ``done`` (in the unit of ``total``)."""
        if self._progress is not None:
            self._progress.update(self._task, completed=done, note=note)


@contextmanager
def spinner(label: str, *, quiet: bool = False) -> Iterator[None]:
    """Show that work of unknown length goes on."""
    if not _shown(quiet):
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(label):
        yield
