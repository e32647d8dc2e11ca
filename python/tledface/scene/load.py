"""Loading a scene: TOML to checked tables, and any trouble to one line naming file and key."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import PrivateAttr, ValidationError

from tledface import units
from tledface.errors import InputError
from tledface.io._atomic import as_path
from tledface.scene.fields import MissingFiles
from tledface.scene.source import as_tables, without_numpy
from tledface.scene.tables import SceneTables

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

    from tledface.model import Model

__all__ = ["MODEL_ENDINGS", "Scene"]

MODEL_ENDINGS = (".h5", ".hdf5")


class Scene(SceneTables):
    """A checked scene, all values SI: what to build and how to run it.

    Its attributes are the tables of the file (``geometry``, ``layers``, ``muscles``, ``volumes``,
    ``surfaces``, ``boundary``, ``solver``, ``output``) with the keys of
    docs/how-to/scene-file.md: ``scene.solver.damping`` in 1/s, ``scene.muscles[0].activation`` as a
    callable of t in s. It does not change.

    Example: ``Scene.load("brow.toml").build()``.
    """

    _path: Path | None = PrivateAttr(default=None)
    _source: dict[str, Any] = PrivateAttr(default_factory=dict)

    @property
    def path(self) -> Path | None:
        """The file the scene came from; None for a dictionary."""
        return self._path

    @property
    def source(self) -> dict[str, Any]:
        """The tables as a file would hold them, before conversion."""
        return self._source

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a TOML scene file.

        Args:
            path: The file; paths in it are relative to its folder.

        Raises:
            InputError: one line (file, key, what was got, what is allowed): no such file, a file of
                another kind, TOML syntax, unknown key, missing or bad value, missing unit, missing
                surface files.
        """
        path = as_path(path, "scene")
        if other := _not_a_scene(path):
            raise InputError(f"{path}: {other}")
        try:
            text = path.read_text(encoding="utf-8-sig")  # some editors begin a file with its mark
        except UnicodeDecodeError:
            raise InputError(
                f"{path}: cannot be read as text; allowed: a scene file (.toml), or a model file "
                "(.h5) where one is taken, as by `tledface run`"
            ) from None
        except OSError as error:
            raise InputError(f"{path}: cannot be read as text ({error})") from None
        try:
            tables = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{path}: TOML syntax: {error}") from None
        scene = cls._checked(tables, path.parent, str(path), check_files=True)
        scene._path = path
        return scene

    @classmethod
    def from_dict(
        cls, tables: Mapping[str, Any], base: str | Path = ".", *, check_files: bool = True
    ) -> Scene:
        """A scene from TOML-like tables.

        Args:
            tables: The tables of a scene file; values may also be ``tf.material(...)``,
                ``tf.ramp(...)``, NumPy numbers and arrays.
            base: Folder that relative paths start at.
            check_files: Surface files must exist; False for a scene whose model is built already.

        Raises:
            InputError: as `load`.
        """
        return cls._checked(tables, Path(base), "scene", check_files=check_files)

    @classmethod
    def _checked(
        cls, tables: Mapping[str, Any], base: Path, where: str, *, check_files: bool
    ) -> Scene:
        if not isinstance(tables, Mapping):
            raise InputError(f"{where}: got {tables!r}; allowed: a dict of a scene's tables")
        try:
            length = units.unit_scale(tables["units"]) if "units" in tables else 1.0
        except InputError as error:
            raise InputError(f"{where}: units: {error}") from None
        tables = without_numpy(tables)
        context = {"length": length, "base": base, "check_files": check_files}
        try:
            scene = cls.model_validate(tables, context=context)
        except ValidationError as error:
            raise InputError(f"{where}: {_one_line(error, tables)}") from None
        try:
            scene._source = as_tables(tables)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        return scene

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """The JSON Schema of the scene file."""
        schema = cls.model_json_schema(by_alias=True)
        return {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            **schema,
            "title": "tledface scene",
            "description": "A scene file of tledface, version 1 (written as TOML)",
        }

    def build(self) -> Model:
        """Voxelise the surfaces into a model.

        Raises:
            InputError: surfaces that cannot be used, nothing kept, more voxels than memory.
        """
        from tledface.build import build_model

        return build_model(self)


def _not_a_scene(path: Path) -> str:
    """Why a path cannot be a scene file; empty if it may be one."""
    ending = path.suffix.lower()
    if path.is_dir():
        return "is a folder; give a scene file (.toml)"
    if not path.exists():
        hint = f"`tledface new {path}` writes one to start from"
        return f"no such scene file; {hint if ending == '.toml' else 'give a scene file (.toml)'}"
    if ending in MODEL_ENDINGS:
        return "is a model file; use `tledface run`"
    if ending == ".toml":
        return ""
    from tledface.geometry.surfaces import SURFACE_FORMATS

    if ending in SURFACE_FORMATS:
        return "is a surface; a scene file (.toml) names it"
    return ""


def _one_line(error: ValidationError, tables: Mapping[str, Any]) -> str:
    problems = error.errors(include_url=False)
    # A misspelt key also shows up as a missing one: the misspelling is the one to name.
    problems.sort(key=lambda problem: problem["type"] == "missing")
    first, more = problems[0], len(problems) - 1
    line = _message(first, tables)
    missing = [x for x in map(_cause, problems) if isinstance(x, MissingFiles)]
    if isinstance(_cause(first), MissingFiles):
        line = str(MissingFiles([file for problem in missing for file in problem.files]))
        more -= len(missing) - 1
    path = _key_path(first["loc"])
    if path and not line.startswith(f"{path}["):
        joint = "." if line.partition(":")[0].isidentifier() else ": "
        line = f"{path}{joint}{line}"
    return line + (f" (and {more} more problem{'s' if more > 1 else ''})" if more else "")


def _cause(problem: ErrorDetails) -> Any:
    return problem.get("ctx", {}).get("error")


def _key_path(location: tuple[int | str, ...]) -> str:
    path = ""
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    return path


def _message(problem: ErrorDetails, tables: Mapping[str, Any]) -> str:
    cause = _cause(problem)
    if isinstance(cause, InputError):
        return str(cause) + _label(problem["loc"], tables)
    if problem["type"] == "missing":
        return f"key missing{_example(problem['loc'])}"
    wanted = problem["msg"].replace("Input should be", "").strip().replace("'", '"')
    shown = repr(problem["input"])
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    return f"got {shown}; allowed: {wanted}{_label(problem['loc'], tables)}"


def _label(location: tuple[int | str, ...], tables: Mapping[str, Any]) -> str:
    """The name of the layer or muscle in question, which is easier to find than its number."""
    if len(location) < 2 or not isinstance(location[1], int):
        return ""
    try:
        name = tables[str(location[0])][location[1]]["name"]
    except (KeyError, IndexError, TypeError):
        return ""
    return f" (of {name!r})" if isinstance(name, str) else ""


def _example(location: tuple[int | str, ...]) -> str:
    model: Any = Scene
    field = None
    for part in location:
        if isinstance(part, int):
            continue
        field = next(
            (f for name, f in model.model_fields.items() if (f.alias or name) == part), None
        )
        if field is None:
            return ""
        inner = getattr(field.annotation, "__args__", (field.annotation,))[0]
        model = inner if hasattr(inner, "model_fields") else model
    if field is None or not field.examples:
        return ""
    example = field.examples[0]
    literal = isinstance(example, str) and example[:1] not in "{["
    shown = json.dumps(example) if literal or not isinstance(example, str) else example
    if location[-1] in ("geometry", "solver"):
        return f"; give a table [{location[-1]}]"
    return f"; give it, as {shown if shown == '[[layers]]' else f'{location[-1]} = {shown}'}"
