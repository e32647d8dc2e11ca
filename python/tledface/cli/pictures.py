"""The verb about pictures: render."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tledface.cli.common import AsJson, Quiet, give

__all__ = ["render"]


def render(
    source: Annotated[
        Path,
        typer.Argument(metavar="MODEL|DIR", help="A model made by `build`, or a run's folder."),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="DIR", help="The folder for the pictures."),
    ],
    view: Annotated[
        list[str] | None,
        typer.Option(
            metavar="VIEW",
            help="front (from -y, +z up), back, side (from +x), top; may be given several times.",
            show_default="front and side; as the run's own picture",
        ),
    ] = None,
    cut: Annotated[
        list[str] | None,
        typer.Option(
            metavar="AXIS=PLACE",
            help='Cut a model there, as x=0 or "z=1550 mm" (mm without a unit); may be given '
            "several times.",
            show_default="x through the middle",
        ),
    ] = None,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Draw a model (tissues, fibres, boundary nodes, cuts) or the skin at the end of a run."""
    from tledface.errors import InputError
    from tledface.model import Model
    from tledface.model_picture import model_pictures
    from tledface.progress import spinner
    from tledface.run_picture import run_pictures

    cuts = [_plane(text) for text in cut] if cut else None
    if source.is_dir():
        if cuts is not None:
            raise InputError(
                f"--cut: {source} is a run's folder, which has no tissues; give a model file"
            )
        with spinner("drawing", quiet=quiet or json):
            files = run_pictures(source, output, views=view)
    elif source.suffix.lower() == ".toml":
        raise InputError(
            f"render {source}: is a scene; `tledface build {source} -o MODEL.h5` makes a model to "
            "draw"
        )
    else:
        with spinner("drawing", quiet=quiet or json):
            files = model_pictures(Model.load(source), output, views=view, cuts=cuts)
    give(
        "\n".join(f"wrote {path}" for path in files),
        {"pictures": [str(path) for path in files]},
        as_json=json,
        quiet=quiet,
    )


def _plane(text: str) -> tuple[str, float]:
    """Axis and place (m) of a cut."""
    from tledface import units
    from tledface.errors import InputError

    axis, equals, place = (part.strip() for part in text.partition("="))
    if axis not in ("x", "y", "z") or not equals:
        raise InputError(f"--cut: got {text!r}; allowed: an axis and a place, as x=0 or z=1550")
    return axis, units.parse(place, "length", bare=1e-3, key="--cut")
