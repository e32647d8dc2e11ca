"""The command line: ``tledface VERB``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tledface.cli.interrupts import kept_waiting

if TYPE_CHECKING:
    from tledface.cli.verbs import app as app

__all__ = ["app", "main"]


def main() -> None:
    """The console script."""
    with kept_waiting():
        from tledface.cli.verbs import app

        app(prog_name="tledface")


def __getattr__(name: str) -> Any:
    # Not before `main`: an interrupt while the verbs are loaded would be a traceback.
    if name != "app":
        raise AttributeError(f"module 'tledface.cli' has no attribute {name!r}")
    from tledface.cli.verbs import app

    return app
