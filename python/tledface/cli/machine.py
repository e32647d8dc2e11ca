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
    workload: Annotated[
        list[str] | None,
        typer.Option(
            "--workload",
            metavar="NAME",
            help="Measure this body beside the roofline instead: flat-block, face, armadillo, "
            "dense-block or sparse-shell (16 million elements each); may be given several times.",
        ),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="All of those: some minutes, 11 GB of memory.")
    ] = False,
    sizes: Annotated[
        bool,
        typer.Option("--sizes", help="The cost of an element from 100 000 to 16 million of them."),
    ] = False,
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
            help="With --scene, --workload, --all or --sizes: write the figures there, and the "
            "table as FILE.md beside it.",
        ),
    ] = None,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Measure element steps per second, beside what the device can do at best."""
    chosen = bool(workload) or every or sizes
    if model + bool(scene) + chosen > 1:
        raise InputError("bench: --model, --scene and --workload, --all, --sizes go one at a time")
    if data is not None and not scene:
        raise InputError("bench: --data goes with --scene; add it, or leave --data out")
    if output is not None and not (scene or chosen):
        raise InputError(
            "bench: -o goes with --scene, --workload, --all or --sizes; add one, or leave -o out"
        )
    if model:
        from tledface import bench_model

        bench_model.main(json=json, quiet=quiet)
    elif scene:
        from tledface import bench_scenes

        bench_scenes.main(
            device=device, scenes=scene, data=data, output=output, json=json, quiet=quiet
        )
    elif chosen:
        from tledface import bench_workloads

        names = (*bench_workloads.QUICK, *bench_workloads.LARGE) if every else tuple(workload or ())
        bench_workloads.main(
            device=device,
            workloads=names,
            with_sizes=sizes,
            output=output,
            json=json,
            quiet=quiet,
        )
    else:
        from tledface.bench import main

        main(device=device, json=json, quiet=quiet)
