"""Verbs about the machine: doctor, bench."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tledface.cli.common import AsJson, Device, Quiet, give
from tledface.errors import InputError

__all__ = ["bench", "doctor"]


def doctor(json: AsJson = False, quiet: Quiet = False) -> None:
    """Say what is installed, which devices work, and why the others do not; paste-ready."""
    from tledface import doctor as doctor_module

    if json:
        give("", doctor_module.report(), as_json=True, quiet=quiet)
    else:
        give(doctor_module.text(), {}, as_json=False, quiet=quiet)


def bench(
    device: Device = "auto",
    model: Annotated[
        bool,
        typer.Option("--model", help="Measure model creation instead: voxel samples per second."),
    ] = False,
    scene: Annotated[
        list[str] | None,
        typer.Option(
            "--scene",
            metavar="NAME[:V]",
            help="Measure a shipped scene, or all, on every device instead; may be given several "
            "times.",
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option("--data", metavar="PATH", help="With --scene: the mesh of the armadillo."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE.json",
            help="With --scene: write the figures there, and the table as FILE.md beside it.",
        ),
    ] = None,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Measure element steps per second on the flat block, beside the copy bandwidth."""
    if model:
        from tledface import bench_model

        bench_model.main(json=json, quiet=quiet)
        return
    if scene:
        from tledface import bench_scenes

        bench_scenes.main(
            device=device, scenes=scene, data=data, output=output, json=json, quiet=quiet
        )
        return
    if data is not None or output is not None:
        raise InputError("bench: --data and -o go with --scene; add it, or leave them out")
    from tledface.bench import main

    main(device=device, json=json, quiet=quiet)
