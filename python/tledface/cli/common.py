"""What every verb shares: options, output, and errors as one line with an exit code."""

from __future__ import annotations

import difflib
import json
import sys
import warnings
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from tledface.cli.interrupts import verb_begins
from tledface.errors import InputError, SimulationError

__all__ = ["AsJson", "Device", "Force", "Group", "Quiet", "give"]

Device = Annotated[
    str,
    typer.Option(
        "--device",
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


# Typer brings its own click or takes the installed one; this is the right class either way.
_UsageError: type[Exception] = typer.BadParameter.__bases__[0]


class Group(TyperGroup):
    """The verbs; an error of the user's ends as one line on standard error, never a traceback."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the options before the verb."""
        given = list(args)
        try:
            return super().parse_args(ctx, args)
        except _UsageError as error:
            if not given:
                raise  # which shows the help
            _say(f"error: {_usage(error)}")
        raise typer.Exit(2)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the verb; an unknown one is an InputError that lists them."""
        verbs = self.list_commands(ctx)
        if args[0] not in verbs:
            near = difflib.get_close_matches(args[0], verbs, n=1, cutoff=0.6)
            hint = f"nearest: {near[0]}; " if near else ""
            raise InputError(f"{args[0]!r}: no such verb; {hint}allowed: {', '.join(verbs)}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run a verb: exit code 2 for bad input, 1 for a simulation that cannot go on.

        130 for one that the keyboard interrupts.
        """
        try:
            verb_begins()
            with warnings.catch_warnings():
                warnings.showwarning = _show_warning
                return super().invoke(ctx)
        except KeyboardInterrupt as error:
            _say(str(error) or "interrupted")
            raise typer.Exit(130) from None
        except _UsageError as error:
            code, line = 2, _usage(error)
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
        _say(f"error: {line}")
        raise typer.Exit(code)


def give(text: str, values: dict[str, Any], *, as_json: bool, quiet: bool) -> None:
    """Print a result: as JSON, as text, or not at all."""
    if as_json:
        print(json.dumps(values))
    elif not quiet:
        print(text)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    _say(f"warning: {message}")


def _say(line: str) -> None:
    print(f"tledface: {' '.join(line.split())}", file=sys.stderr)


def _usage(error: Any) -> str:
    message = error.format_message().rstrip(".")
    verb = getattr(error.ctx, "command_path", "tledface")
    return f"{message[:1].lower()}{message[1:]}; `{verb} --help` shows what it takes"
