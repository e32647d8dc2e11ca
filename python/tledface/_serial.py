"""One call at a time into a core simulator, whatever threads use it.

The core lets go of Python's lock while it computes; a thread that reads the state meanwhile would
see half a step, or move what the step is using.
"""

from __future__ import annotations

import threading
from typing import Any

from tledface import _core

__all__ = ["serial"]


class _Serial:
    def __init__(self, core: _core.Simulator) -> None:
        object.__setattr__(self, "_inner", core)
        object.__setattr__(self, "_lock", threading.RLock())

    def __getattr__(self, name: str) -> Any:
        with self._lock:
            value = getattr(self._inner, name)
        if not callable(value):
            return value

        def locked(*args: Any, **kwargs: Any) -> Any:
            with self._lock:
                return value(*args, **kwargs)

        return locked

    def __setattr__(self, name: str, value: Any) -> None:
        with self._lock:
            setattr(self._inner, name, value)


def serial(core: _core.Simulator) -> _core.Simulator:
    """Wrap a core simulator so that calls from several threads take turns."""
    wrapped: Any = _Serial(core)
    return wrapped  # type: ignore[no-any-return]
