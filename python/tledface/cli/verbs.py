"""The ``tledface`` command and its verbs."""

from __future__ import annotations

from importlib.metadata import version
from typing import Annotated

import typer

from tledface.cli import demos, machine, pictures, scenes
from tledface.cli.common import Group

__all__ = ["app"]

app = typer.Typer(
    name="tledface",
    cls=Group,
    help="Physically based soft tissue and faces, from surfaces to wrinkles.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"tledface {version('tledface')}")
        raise typer.Exit


@app.callback()
def _options(
    show_version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=_print_version, help="Print the version and end."
        ),
    ] = False,
) -> None:
    """Physically based soft tissue and faces, from surfaces to wrinkles."""


for _verb in (
    machine.doctor,
    demos.demo,
    demos.examples,
    scenes.new,
    scenes.check,
    scenes.build,
    scenes.run,
    scenes.resume,
    pictures.render,
    machine.bench,
    scenes.schema,
):
    app.command()(_verb)
