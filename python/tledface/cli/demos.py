"""Verbs about the shipped examples: demo, examples."""

from __future__ import annotations

import difflib
import os
import shlex
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tledface.catalogue import REFERENCE, Example, shipped
from tledface.cli.common import AsJson, Device, Force, Quiet, give
from tledface.errors import InputError

if TYPE_CHECKING:
    from tledface.output import OutputFolder

__all__ = ["demo", "examples", "shipped"]


def demo(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="A shipped scene; see `tledface examples`.")
    ] = "flat-block",
    variant: Annotated[
        str,
        typer.Option(
            "--variant", metavar="V", help="One of its variants; see `tledface examples --list`."
        ),
    ] = REFERENCE,
    data: Annotated[
        Path | None,
        typer.Option("--data", metavar="PATH", help="Your mesh or data, for scenes that take it."),
    ] = None,
    coarse: Annotated[
        bool, typer.Option("--coarse", help="A smaller version, for scenes that have one.")
    ] = False,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Another setting of the scene (lengths in mm); may be given several times.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="The folder for scene and results.",
            show_default="./tledface-NAME, or ./tledface-NAME-V for a variant",
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
    from tledface.run import prepared, run_prepared
    from tledface.run_checkpoints import how_to_resume
    from tledface.scene import Scene

    example = _example(name)
    arguments, given = example.arguments(variant, set_ or [], data=data, coarse=coarse)
    ending = "" if variant == REFERENCE else f"-{variant}"
    folder = output or Path(f"tledface-{name}{ending}")
    about: dict[str, Any] = {
        "demo": name,
        "variant": variant,
        "settings": {k: str(v) if isinstance(v, Path) else v for k, v in given.items()},
    }
    # A demo's own results can always be had again, so running it twice needs no --force.
    earlier = earlier_run(folder) or {}
    again = all(earlier.get(key) == value for key, value in about.items())
    unfinished = again and not force and earlier.get("state") != "finished"
    if unfinished and (go_on := how_to_resume(folder)):
        raise InputError(
            f"output {folder}: holds this run unfinished; {go_on}, --force starts again"
        )
    output_folder = OutputFolder(folder, force=force or again)
    opened = device_module.resolve(device)
    if example.is_study:
        with output_folder.held():
            found = _study(output_folder, example, about, opened, arguments, quiet=quiet or json)
        give(found.text(), found.to_dict(), as_json=json, quiet=quiet)
        return
    quietly = quiet or json
    with output_folder.held():
        with _scene_in(folder, example, arguments) as (draft, keep):
            sim = prepared(Scene.load(draft), output_folder, opened, quiet=quietly)
            # Only now: what is refused loses no earlier results.
            output_folder.begin(about)
            scene = Scene.load(keep())
        result = run_prepared(scene, sim, output_folder, about, quiet=quietly)
    give(result.text(), result.to_dict(), as_json=json, quiet=quiet)


def examples(
    list_: Annotated[
        bool, typer.Option("--list", help="Show the variants and settings of each, too.")
    ] = False,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """List the shipped scenes; `tledface demo NAME` runs one."""
    found = [Example.of(name, module) for name, module in shipped().items()]
    width = max((len(example.name) for example in found), default=0)
    lines = []
    for example in found:
        lines.append(f"{example.name:<{width}}  {example.about}")
        if list_:
            lines += [f"{'':<{width}}    {line}" for line in _details(example)]
    values = {
        "examples": {example.name: example.about for example in found},
        "variants": {example.name: example.about_variants for example in found},
        "settings": {
            example.name: {
                key: {
                    "allowed": setting.allowed,
                    "needed": setting.needed,
                    "default": str(setting.default)
                    if isinstance(setting.default, Path)
                    else setting.default,
                }
                for key, setting in example.settings.items()
            }
            for example in found
        },
    }
    give("\n".join(lines), values, as_json=json, quiet=quiet)


def _example(name: str) -> Example:
    known = shipped()
    if name not in known:
        near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
        hint = f"nearest: {near[0]}; " if near else ""
        raise InputError(f"demo {name!r}: no such scene; {hint}shipped: {', '.join(known)}")
    return Example.of(name, known[name])


def _details(example: Example) -> list[str]:
    """Lines about the variants and settings of an example."""
    width = max(map(len, example.variants))
    lines = [
        f"--variant {variant:<{width}}  {line}".rstrip()
        for variant, line in example.about_variants.items()
        if len(example.variants) > 1
    ]
    words = []
    for key, setting in example.settings.items():
        if key == "coarse":
            lines.append("--coarse")
        elif key == "data":
            lines.append("--data PATH" + (" (needed)" if setting.needed else ""))
        else:
            words.append(f"{key}={'?' if setting.needed else _word(setting.default)}")
    return [*lines, f"--set {' '.join(words)}"] if words else lines


def _word(value: Any) -> str:
    """A value as the command line takes it."""
    plain = value is None or isinstance(value, bool)
    return str(value).lower() if plain else shlex.quote(str(value))


def _study(
    output: OutputFolder,
    example: Example,
    about: dict[str, Any],
    device: Any,
    arguments: dict[str, Any],
    *,
    quiet: bool,
) -> Any:
    """Compute a study into its folder, and say in ``run.json`` how it ended.

    Settings that it refuses leave the folder as it was.
    """
    if example.check is not None:
        example.check(**arguments)
    output.begin(about)
    try:
        found = example.call(output.path, device=device, quiet=quiet, **arguments)
    except BaseException as error:
        output.write({**about, "state": "failed", "error": str(error), "files": []})
        raise
    files = [path.name for path in found.files.values()]
    output.write({**about, "state": "finished", "files": files, "result": found.to_dict()})
    return found


@contextmanager
def _scene_in(
    folder: Path, example: Example, arguments: dict[str, Any]
) -> Iterator[tuple[Path, Any]]:
    """Write a scene beside its place; the second value moves it there and returns its file.

    The draft is as deep in the folder as the place, so that relative paths hold in both. Whatever
    fails before it is moved leaves the folder as it was.
    """
    place = folder / "scene"
    draft = Path(tempfile.mkdtemp(prefix=".scene-", dir=folder))
    try:
        draft.chmod(0o755)
        file = example.call(draft, **arguments)

        def keep() -> Path:
            for part in sorted(draft.rglob("*")):
                target = place / part.relative_to(draft)
                if part.is_dir():
                    target.mkdir(parents=True, exist_ok=True)
                else:
                    target.parent.mkdir(parents=True, exist_ok=True)
                    os.replace(part, target)
            return place / Path(file).relative_to(draft)

        yield draft / Path(file).relative_to(draft), keep
    except InputError as error:
        # The draft is gone when the message is read.
        raise InputError(str(error).replace(str(draft), str(place))) from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)
