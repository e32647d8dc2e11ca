"""The two errors that reach a user; each message is one complete line."""

import shlex
from pathlib import Path

from tledface._core import InputError, SimulationError

__all__ = ["InputError", "SimulationError", "in_shell", "shown"]

InputError.__doc__ = (
    "Bad input, a ValueError: what it is, what was got, what is allowed, what to do."
)
SimulationError.__doc__ = (
    "A simulation that cannot go on: its state is not finite, its device fails."
)

_LONGEST = 60


def shown(value: object) -> str:
    """A value that was got, for a message: one line, not a long one."""
    shape = getattr(value, "shape", ())
    if shape:
        return f"an array of shape {shape}"
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def in_shell(path: str | Path) -> str:
    """A path as a word of a command that a message tells, quoted where a shell would split it."""
    text = str(path)
    # shlex takes letters beyond ASCII for unsafe, which no shell does.
    plain = "".join(c if c.isascii() or not c.isalnum() else "a" for c in text)
    return text if shlex.quote(plain) == plain else shlex.quote(text)
