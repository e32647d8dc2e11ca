"""Ctrl-C, which waits while modules are loaded.

Modules may swallow a KeyboardInterrupt (``except BaseException`` around an optional import) or be
left half made by it, and verbs load many, some late. So the signal's handler looks where it came:
within an import it asks for itself again a little later.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["kept_waiting", "verb_begins"]

_AGAIN = 0.02  # s
_IMPORTING = "<frozen importlib"

# Whether there is someone yet who says that a verb was interrupted.
_begun = False


@contextmanager
def kept_waiting() -> Iterator[None]:
    """Let Ctrl-C wait for imports and for a verb to begin, within the context.

    Where the process ignores Ctrl-C or has a handler, or in another thread, nothing changes.
    """
    global _begun
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    _begun = False
    again = signal.signal(signal.SIGALRM, _interrupt)
    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGALRM, again)


def verb_begins() -> None:
    """From here on an interrupt is raised, but within imports."""
    global _begun
    _begun = True


def _interrupt(number: int, frame: FrameType | None) -> None:
    if _begun and not _is_importing(frame):
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        raise KeyboardInterrupt
    signal.setitimer(signal.ITIMER_REAL, _AGAIN)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTING):
            return True
        frame = frame.f_back
    return False
