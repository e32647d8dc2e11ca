"""Verbs about the machine: doctor, bench."""

from __future__ import annotations

from typing import Annotated

import typer

from tledface.cli.common import AsJson, Device, Quiet, give

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
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Measure element steps per second on the flat block, beside the copy bandwidth."""
    if model:
        from tledface import bench_model

        bench_model.main(json=json, quiet=quiet)
        return
    from tledface.bench import main

    main(device=device, json=json, quiet=quiet)
