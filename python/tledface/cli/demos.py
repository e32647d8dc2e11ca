"""Verbs about the shipped scenes: demo, examples."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from pathlib import Path
from types import ModuleType
from typing import Annotated

import typer

from tledface.cli.common import AsJson, Device, Force, Quiet, give
from tledface.errors import InputError

__all__ = ["demo", "examples", "shipped"]


def shipped() -> dict[str, ModuleType]:
    """The shipped examples by name: modules of ``tledface.examples``.

    A scene's module has ``write(folder)``, that of a study of its own ``study(folder)``.
    """
    package = importlib.import_module("tledface.examples")
    modules = {
        found.name.replace("_", "-"): importlib.import_module(f"{package.__name__}.{found.name}")
        for found in pkgutil.iter_modules(package.__path__)
        if not found.name.startswith("_")
    }
    return {
        name: module
        for name, module in sorted(modules.items())
        if hasattr(module, "write") or hasattr(module, "study")
    }


def demo(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="A shipped scene; see `tledface examples`.")
    ] = "flat-block",
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="The folder for scene and results.",
            show_default="./tledface-NAME",
        ),
    ] = None,
    device: Device = "auto",
    force: Force = False,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run a shipped example: builds, simulates, shows where scene and results are."""
    from tledface import device as device_module
    from tledface.output import OutputFolder, earlier_run
    from tledface.run import run_scene
    from tledface.scene import Scene

    known = shipped()
    if name not in known:
        near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
        hint = f"nearest: {near[0]}; " if near else ""
        raise InputError(f"demo {name!r}: no such scene; {hint}shipped: {', '.join(known)}")
    folder = output or Path(f"tledface-{name}")
    # A demo's own results can always be had again, so running it twice needs no --force.
    again = (earlier_run(folder) or {}).get("demo") == name
    output_folder = OutputFolder(folder, force=force or again)
    opened = device_module.resolve(device)
    output_folder.begin({"demo": name})
    if hasattr(known[name], "study"):
        found = known[name].study(folder, device=opened, quiet=quiet or json)
        files = [path.name for path in found.files.values()]
        about = {"demo": name, "state": "finished", "files": files, "result": found.to_dict()}
        output_folder.write(about)
        give(found.text(), found.to_dict(), as_json=json, quiet=quiet)
        return
    scene = Scene.load(known[name].write(folder / "scene"))
    result = run_scene(
        scene, folder, device=opened, force=True, quiet=quiet or json, about={"demo": name}
    )
    give(result.text(), result.to_dict(), as_json=json, quiet=quiet)


def examples(
    list_: Annotated[
        bool, typer.Option("--list", help="One line a scene (which is what happens anyway).")
    ] = False,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """List the shipped scenes; `tledface demo NAME` runs one."""
    about = {name: (module.__doc__ or "").split("\n")[0] for name, module in shipped().items()}
    width = max(map(len, about), default=0)
    text = "\n".join(f"{name:<{width}}  {line}" for name, line in about.items())
    give(text, {"examples": about}, as_json=json, quiet=quiet)
