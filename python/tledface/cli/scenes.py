"""Verbs about scenes: new, check, build, run, resume, schema."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tledface.cli.common import AsJson, Device, Force, Quiet, give

if TYPE_CHECKING:
    from tledface.model import Model
    from tledface.scene import Scene

__all__ = ["build", "check", "new", "resume", "run", "schema"]

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="A scene file (TOML).")]


SceneOrModel = Annotated[
    Path,
    typer.Argument(metavar="SCENE|MODEL", help="A scene file, or a model made by `build`."),
]


def _scene_or_model(path: Path) -> tuple[Scene, Model | None]:
    """The scene of a scene file, or scene and model of a model file."""
    from tledface.run import load_run
    from tledface.scene import MODEL_ENDINGS, Scene

    if path.suffix.lower() in MODEL_ENDINGS and not path.is_dir():
        return load_run(path)
    return Scene.load(path), None


def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The scene file to write.")],
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write a commented scene to start from."""
    from tledface.scene import write_template

    write_template(file)
    give(
        f"wrote {file}; set its surface files, then: tledface check {file}",
        {"scene": str(file)},
        as_json=json,
        quiet=quiet,
    )


def check(
    scene: SceneOrModel, device: Device = "auto", json: AsJson = False, quiet: Quiet = False
) -> None:
    """Validate a scene; print voxels, bound nodes, memory, time step bound and its tissue, time.

    Builds the model (or takes one made by `build`) and times a few steps on the device, and
    writes nothing.
    """
    from tledface.check import check_scene

    loaded, model = _scene_or_model(scene)
    found = check_scene(loaded, device=device, quiet=quiet or json, model=model, name=str(scene))
    give(found.text(), found.to_dict(), as_json=json, quiet=quiet)


def build(
    scene: SceneFile,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="MODEL.h5", help="The model file to write.")
    ],
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Turn a scene's surfaces into a voxel model, saved as HDF5."""
    from tledface.boundary import boundary_text
    from tledface.errors import InputError
    from tledface.geometry.report import GEOMETRY_KEYS, geometry_lines
    from tledface.progress import spinner
    from tledface.run import save_built
    from tledface.scene import MODEL_ENDINGS, Scene

    if output.suffix.lower() not in MODEL_ENDINGS:
        raise InputError(
            f"output {output}: ending {output.suffix!r} is not that of a model file; allowed: "
            f"{', '.join(MODEL_ENDINGS)}"
        )
    loaded = Scene.load(scene)
    with spinner("building the model", quiet=quiet or json):
        model = loaded.build()
    save_built(loaded, model, output)
    bound = model.report.get("boundary", {})
    lines = [
        f"wrote {output}: {model.n_elements:,} voxels, {model.n_nodes:,} nodes; "
        f"tissues {', '.join(model.tissues)}",
        *(f"{label:<10} {text}" for label, text in geometry_lines(model.report)),
        *(boundary_text(bound) if bound else []),
    ]
    give(
        "\n".join(lines),
        {
            "model": str(output),
            "elements": model.n_elements,
            "nodes": model.n_nodes,
            "tissues": list(model.tissues),
            "boundary": bound,
            "geometry": {key: model.report[key] for key in GEOMETRY_KEYS},
        },
        as_json=json,
        quiet=quiet,
    )


def run(
    scene: SceneOrModel,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="The folder for the results.")
    ],
    device: Device = "auto",
    force: Force = False,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a scene: frames for ParaView, the deformed surface, a picture."""
    from tledface.run import run_scene

    loaded, model = _scene_or_model(scene)
    result = run_scene(loaded, output, device=device, force=force, model=model, quiet=quiet or json)
    give(result.text(), result.to_dict(), as_json=json, quiet=quiet)


def resume(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run.")],
    device: Annotated[
        str | None,
        typer.Option(
            "--device",
            metavar="DEVICE",
            help="As for run; another than before ends with other bits.",
            show_default="the run's own",
        ),
    ] = None,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Go on with a run that was killed or stopped, from its last checkpoint to its end."""
    from tledface.run import resume_run

    result = resume_run(directory, device=device, quiet=quiet or json)
    give(result.text(), result.to_dict(), as_json=json, quiet=quiet)


def schema(
    quiet: Annotated[bool, typer.Option("--quiet", "-q", hidden=True)] = False,
    json: Annotated[bool, typer.Option("--json", hidden=True)] = False,
) -> None:
    """Print the JSON Schema of the scene file."""
    from tledface.scene import Scene

    print(json_module.dumps(Scene.json_schema(), indent=None if json else 2))
