"""Frames of a run, converted and written in a thread of their own while the simulation goes on."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self

from tledface.snapshot import Snapshot

__all__ = ["IN_FLIGHT", "FrameQueue"]

# Frames that wait or are being written: one on its way while the one before is written.
IN_FLIGHT = 2


class FrameQueue:
    """Writes snapshots in the order they are given, behind the steps.

    The first error ends the writing: no later frame is written, so that the frames there are have
    no gap, and the next call raises it. Leaving the context waits for what is under way, also
    after an error or an interrupt elsewhere, which then goes on.

    Args:
        write: Writes one; called in the thread of the queue.
    """

    def __init__(self, write: Callable[[Snapshot], None]) -> None:
        """Start the thread."""
        self._write = write
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="frames")
        self._under_way: deque[Future[None]] = deque()
        self._failed = False

    def make_room(self) -> None:
        """Wait until one more may be put; raises what went wrong in writing."""
        while self._under_way and (len(self._under_way) >= IN_FLIGHT or self._under_way[0].done()):
            self._await_first()

    def put(self, snapshot: Snapshot) -> None:
        """Have a frame written; raises what went wrong with those before."""
        self.make_room()
        self._under_way.append(self._thread.submit(self._try, snapshot))

    def settle(self) -> None:
        """Wait until all are written; raises what went wrong in writing."""
        while self._under_way:
            self._await_first()

    def __enter__(self) -> Self:
        """Use as a context."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait for the frames under way and end the thread."""
        try:
            if error is None:
                self.settle()
        finally:
            self._end()

    def _end(self) -> None:
        """End the thread after its last frame: an impatient interrupt must not cut a frame."""
        try:
            self._thread.shutdown(wait=True)
        except KeyboardInterrupt:
            self._end()
            raise

    def _await_first(self) -> None:
        # Only what has ended leaves the queue, so that an interrupt here loses sight of nothing.
        first = self._under_way[0]
        try:
            first.result()
        finally:
            if first.done():
                self._under_way.popleft()

    def _try(self, snapshot: Snapshot) -> None:
        if self._failed:
            return
        try:
            self._write(snapshot)
        except BaseException:
            self._failed = True
            raise
