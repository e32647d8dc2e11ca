"""What every verb shares: options, output, and errors as one line with an exit code."""

from __future__ import annotations

import json
import sys
import warnings
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from tledface.errors import InputError, SimulationError

__all__ = ["AsJson", "Device", "Force", "Group", "Quiet", "give"]

Device = Annotated[
    str,
    typer.Option(
        metavar="DEVICE",
        help="auto (a working GPU, else native), native (CPU, needs no driver), opencl (the "
        "first that works) or opencl:N.",
    ),
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output, nothing else.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no report.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an earlier run in the folder.")]


class Group(TyperGroup):
    """The verbs; an error of the user's ends as one line on standard error, never a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run a verb: exit code 2 for bad input, 1 for a simulation that cannot go on."""
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _show_warning
                return super().invoke(ctx)
        except InputError as error:
            code, line = 2, str(error)
        except SimulationError as error:
            code, line = 1, str(error)
        except MemoryError:
            code, line = 1, "out of memory; use larger voxels or fewer elements"
        except BrokenPipeError:
            raise
        except OSError as error:
            code, line = 2, f"{error.filename or 'file'}: {error.strerror or error}"
        print(f"tledface: error: {' '.join(line.split())}", file=sys.stderr)
        raise typer.Exit(code)


def give(text: str, values: dict[str, Any], *, as_json: bool, quiet: bool) -> None:
    """Print a result: as JSON, as text, or not at all."""
    if as_json:
        print(json.dumps(values))
    elif not quiet:
        print(text)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"tledface: warning: {' '.join(str(message).split())}", file=sys.stderr)
