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
            "--view",
            metavar="VIEW",
            help="front (from -y, +z up), back, side (from +x), other side, top, bottom; of a run "
            "also oblique, a side as -y, or a direction as 0.3,-1,0.2; may be given several times.",
            show_default="front and side; as the run's own picture",
        ),
    ] = None,
    cut: Annotated[
        list[str] | None,
        typer.Option(
            "--cut",
            metavar="AXIS=PLACE",
            help='Cut a model, or a run\'s stress, there, as x=0 or "z=1550 mm" (mm without a '
            "unit); may be given several times.",
            show_default="x through the middle",
        ),
    ] = None,
    stress: Annotated[
        bool,
        typer.Option(
            "--stress", help="Of a run: von Mises stress on the skin and in cuts, before and after."
        ),
    ] = False,
    at: Annotated[
        str | None,
        typer.Option(
            "--at",
            metavar="TIME",
            help='Of a run: the frame to show, as "30 ms", instead of the last.',
            show_default="the last",
        ),
    ] = None,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Draw a model (tissues, fibres, boundary nodes, cuts), or a run's skin or stress."""
    from tledface import units
    from tledface.errors import InputError
    from tledface.model import Model
    from tledface.model_picture import model_pictures
    from tledface.progress import spinner
    from tledface.run_picture import run_pictures

    cuts = [_plane(text) for text in cut] if cut else None
    if source.is_dir():
        if cuts is not None and not stress:
            raise InputError(
                f"--cut: {source} is a run's folder; add --stress for the stress in the cut, or "
                "give a model file for its tissues"
            )
        time = None if at is None else units.parse(at, "time", key="--at")
        with spinner("drawing", quiet=quiet or json):
            files = run_pictures(source, output, views=view, at=time, stress=stress, cuts=cuts)
    elif stress or at is not None:
        raise InputError(
            f"{'--stress' if stress else '--at'}: {source} is not the folder of a run; give one "
            "that `tledface run` made"
        )
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
