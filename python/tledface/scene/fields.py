"""Types of the scene's fields: each reads what TOML gives, checks it and converts it to SI.

A validator raises InputError without file or key; the loader puts both in front. The validation
context has ``length`` (metres in a bare length), ``base`` (folder of relative paths) and
``check_files``.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from pydantic import PlainValidator, ValidationInfo, WithJsonSchema

from tledface import units
from tledface.constitutive import Material, materials, parse_material
from tledface.errors import InputError
from tledface.schedule import Constant, Keyframes, Ramp
from tledface.subcycling import SUBSTEPS

__all__ = [
    "LENGTH_SCHEMA",
    "PATH_SCHEMA",
    "Activation",
    "Box",
    "CheckpointEvery",
    "Components",
    "Gravity",
    "Length",
    "LongStretch",
    "MassScaling",
    "MaterialField",
    "MissingFiles",
    "Name",
    "Outer",
    "Paths",
    "Positive",
    "Pressure",
    "Rate",
    "Scale",
    "Stretch",
    "Subcycling",
    "SurfacePath",
    "Time",
    "TimeStep",
    "UnitFraction",
    "Vector",
    "VoxelSize",
    "known_keys",
    "read_length",
    "read_path",
    "read_point",
]

JsonSchema = dict[str, Any]
Vector = tuple[float, float, float]


def _quantity_schema(kind: str, bare: str = "") -> JsonSchema:
    known = units.KINDS[kind]
    text = f'{known.phrase} with its unit, as "{known.example}"'
    options: list[JsonSchema] = [{"type": "string", "description": text}]
    if bare:
        options.insert(0, {"type": "number", "description": bare})
    return {"anyOf": options}


def _bare_factor(kind: str, info: ValidationInfo) -> float | None:
    if kind == "number":
        return 1.0
    return float((info.context or {}).get("length", 1.0)) if kind == "length" else None


def _quantity(
    kind: str, **bounds: float
) -> tuple[Callable[[Any, ValidationInfo], float], JsonSchema]:
    unit = units.KINDS[kind].si

    def read(value: Any, info: ValidationInfo) -> float:
        number = units.parse(value, kind, bare=_bare_factor(kind, info))
        return units.bounded(number, **bounds, shown=value, unit=unit)

    if kind == "number":
        return read, {"type": "number"}
    return read, _quantity_schema(kind, "in the scene's units" if kind == "length" else "")


def _field(
    pair: tuple[Callable[[Any, ValidationInfo], Any], JsonSchema],
) -> tuple[PlainValidator, WithJsonSchema]:
    return PlainValidator(pair[0]), WithJsonSchema(pair[1])


def list_of_three(value: Any, what: str) -> list[Any]:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise InputError(f"got {value!r}; allowed: {what}")
    return list(value)


def read_point(value: Any, info: ValidationInfo) -> Vector:
    """Three lengths in m; bare ones are in the scene's units."""
    x, y, z = (
        units.parse(part, "length", bare=_bare_factor("length", info))
        for part in list_of_three(value, "three lengths, as [0, 0, 4.5]")
    )
    return x, y, z


def _read_voxel(value: Any, info: ValidationInfo) -> Vector:
    parts = value if isinstance(value, list) else [value] * 3
    what = "a length greater than 0, or three of them, as 0.5 or [0.5, 0.5, 0.25]"
    read, _ = _quantity("length", above=0.0)
    x, y, z = (read(part, info) for part in list_of_three(parts, what))
    return x, y, z


def read_box(value: Any, info: ValidationInfo) -> tuple[Vector, Vector]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise InputError(
            f"got {value!r}; allowed: a low and a high corner, as [[0, 0, 0], [60, 60, 4.5]]"
        )
    low, high = (read_point(corner, info) for corner in value)
    if any(first > second for first, second in zip(low, high, strict=True)):
        raise InputError(f"got {value!r}; allowed: a low corner not above the high one")
    return low, high


def _read_outer(value: Any, info: ValidationInfo) -> str | list[tuple[Vector, Vector]]:
    if value == "all":
        return "all"
    if not isinstance(value, list) or not value:
        raise InputError(
            f'got {value!r}; allowed: "all", or a list of boxes, as [[[0, 0, 4], [60, 60, 5]]]'
        )
    return [read_box(box, info) for box in value]


class MissingFiles(InputError):
    """Surface files that are not there."""

    def __init__(self, files: list[Path]) -> None:
        """One line that names them all, and what lies near the first."""
        path = files[0]
        if path.is_dir():
            super().__init__(f'got "{path}", which is a folder; allowed: a surface file')
            self.files = files
            return
        names = [entry.name for entry in path.parent.iterdir()] if path.parent.is_dir() else []
        near = difflib.get_close_matches(path.name, names, n=1)
        hint = f"; nearest there: {near[0]}" if near else ""
        others = dict.fromkeys(f'"{file}"' for file in files[1:] if file != path)
        also = f"; also not found: {', '.join(others)}" if others else ""
        super().__init__(
            f'file not found: "{path}"{hint}{also}; give paths relative to the scene file, or '
            "absolute"
        )
        self.files = files


def read_path(value: Any, info: ValidationInfo) -> Path:
    """A path from the scene's folder; raises MissingFiles unless the file exists."""
    if isinstance(value, Path):
        value = str(value)
    if not isinstance(value, str) or not value:
        raise InputError(f'got {value!r}; allowed: the path of a surface file, as "skin.stl"')
    context = info.context or {}
    base = Path(context.get("base", "."))
    path = base / Path(value).expanduser()
    if context.get("check_files", True) and not path.is_file():
        raise MissingFiles([path])
    return path


def read_paths(value: Any, info: ValidationInfo) -> list[Path]:
    if not isinstance(value, list):
        raise InputError(f'got {value!r}; allowed: a list of surface files, as ["left.obj"]')
    paths: list[Path] = []
    missing: list[Path] = []
    for item in value:
        try:
            paths.append(read_path(item, info))
        except MissingFiles as error:
            missing += error.files
    if missing:
        raise MissingFiles(missing)
    return paths


def _read_gravity(value: Any, info: ValidationInfo) -> Vector:
    what = 'three accelerations, as [0, 0, "-9.81 m/s^2"]'
    x, y, z = (units.parse(part, "acceleration") for part in list_of_three(value, what))
    return x, y, z


def _read_name(value: Any, info: ValidationInfo) -> str:
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"got {value!r}; allowed: a text that is not empty")
    return value


def _read_components(value: Any, info: ValidationInfo) -> str:
    if not isinstance(value, str) or not value or set(value) - set("xyz"):
        raise InputError(f'got {value!r}; allowed: letters of "xyz"')
    return "".join(sorted(set(value)))


def _read_time_step(value: Any, info: ValidationInfo) -> float | str:
    if value == "auto":
        return "auto"
    if isinstance(value, str) and value.isalpha():
        raise InputError(f'got {value!r}; allowed: "auto", or a time with its unit, as "2 us"')
    return units.bounded(
        units.parse(value, "time"), above=0.0, shown=value, unit=units.KINDS["time"].si
    )


def _read_mass_scaling(value: Any, info: ValidationInfo) -> float | dict[str, float]:
    if not isinstance(value, dict):
        return units.bounded(units.parse(value, "number"), at_least=1.0, shown=value)
    known_keys(value, ["dt"])
    step = value.get("dt")
    dt = units.parse(step, "time", key="dt")
    return {"dt": units.bounded(dt, above=0.0, shown=step, unit=units.KINDS["time"].si)}


def _read_subcycling(value: Any, info: ValidationInfo) -> bool | int:
    if isinstance(value, bool) or (isinstance(value, int) and value in SUBSTEPS):
        return value
    allowed = ", ".join(map(str, SUBSTEPS))
    raise InputError(f"got {value!r}; allowed: true, false, {allowed}")


def _read_checkpoint_every(value: Any, info: ValidationInfo) -> float | str:
    if value in ("auto", "off"):
        return str(value)
    if isinstance(value, str) and value.isalpha():
        raise InputError(
            f'got {value!r}; allowed: "auto", "off", or a time with its unit, as "10 ms"'
        )
    return units.bounded(
        units.parse(value, "time"), above=0.0, shown=value, unit=units.KINDS["time"].si
    )


def _read_material(value: Any, info: ValidationInfo) -> Material:
    return value if isinstance(value, Material) else parse_material(value)


def _read_activation(value: Any, info: ValidationInfo) -> Ramp | Keyframes | Constant:
    what = (
        'a number from 0 to 1, { ramp = [0.0, 0.75], over = "50 ms" }, or '
        '{ keyframes = [["0 ms", 0.0], ["50 ms", 0.75]] }'
    )
    if isinstance(value, Ramp | Keyframes | Constant):
        return value
    if not isinstance(value, dict):
        level = units.parse(value, "number")
        return Constant(units.bounded(level, at_least=0.0, at_most=1.0, shown=value))
    kinds: dict[str, Callable[[dict[str, Any], str], Ramp | Keyframes]] = {
        "ramp": _ramp,
        "keyframes": _keyframes,
    }
    for kind, read in kinds.items():
        if kind in value:
            return read(value, what)
    raise InputError(f"got {value!r}; allowed: {what}")


def _ramp(table: dict[str, Any], what: str) -> Ramp:
    known_keys(table, ["ramp", "over", "begin", "shape"])
    levels = table["ramp"]
    if not isinstance(levels, list) or len(levels) != 2 or "over" not in table:
        raise InputError(f"got {table!r}; allowed: {what}")
    start, end = (units.parse(level, "number", key="ramp") for level in levels)
    over = units.parse(table["over"], "time", key="over")
    begin = units.parse(table.get("begin", 0.0), "time", key="begin")
    return Ramp(start, end, over, begin, table.get("shape", "linear"))


def _keyframes(table: dict[str, Any], what: str) -> Keyframes:
    known_keys(table, ["keyframes"])
    keys = table["keyframes"]
    if not isinstance(keys, list) or not all(isinstance(k, list) and len(k) == 2 for k in keys):
        raise InputError(f"got {table!r}; allowed: {what}")
    times = tuple(units.parse(time, "time", key="keyframes") for time, _ in keys)
    return Keyframes(times, tuple(units.parse(a, "number", key="keyframes") for _, a in keys))


def known_keys(table: dict[str, Any], known: list[str]) -> None:
    """Raise InputError for a key that is not known, with the nearest that is."""
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
            hint = f"nearest: {near[0]}; " if near else ""
            raise InputError(f"{key}: unknown key; {hint}allowed: {', '.join(known)}")


def vector_schema(items: JsonSchema) -> JsonSchema:
    return {"type": "array", "items": items, "minItems": 3, "maxItems": 3}


def _material_schema() -> JsonSchema:
    laws: list[JsonSchema] = []
    for law in materials().values():
        if law.modifier is not None:
            continue
        keys: JsonSchema = {"model": {"const": law.name, "description": law.energy}}
        for parameter in law.parameters:
            bare = f"in {parameter.unit}" if parameter.bare else ""
            numeric = parameter.kind == "number"
            shape = {"type": "number"} if numeric else _quantity_schema(parameter.kind, bare)
            meaning = f"{parameter.meaning}; {parameter.bounds} {parameter.unit}".rstrip()
            keys[parameter.name] = {**shape, "description": meaning}
        for option, choices in law.options.items():
            keys[option] = {"enum": list(choices), "default": choices[0]}
        needed = ["model", *(p.name for p in law.parameters if p.default is None)]
        for direction in law.directions:
            keys[direction.name] = vector_schema({"type": "number"}) | {
                "description": direction.meaning
            }
            if not direction.optional:
                needed.append(direction.name)
        if law.volumetric != "own":
            keys["prony"] = {
                "type": "array",
                "maxItems": 3,
                "description": "viscoelastic terms [share, time] on the isochoric stress",
            }
        keys["pretension"] = {
            "type": "object",
            "description": "natural tension: along, across (stress), line, normal ([x, y, z])",
        }
        laws.append(
            {
                "type": "object",
                "properties": keys,
                "required": needed,
                "additionalProperties": False,
            }
        )
    return laws[0] if len(laws) == 1 else {"oneOf": laws}


LENGTH_SCHEMA = _quantity_schema("length", "in the scene's units")
POINT_SCHEMA = vector_schema(LENGTH_SCHEMA)
BOX_SCHEMA: JsonSchema = {
    "type": "array",
    "items": POINT_SCHEMA,
    "minItems": 2,
    "maxItems": 2,
    "description": "low and high corner",
}
PATH_SCHEMA: JsonSchema = {"type": "string", "description": "path relative to the scene file"}
_ACTIVATION_SCHEMA: JsonSchema = {
    "anyOf": [
        {"type": "number", "minimum": 0, "maximum": 1},
        {
            "type": "object",
            "properties": {
                "ramp": {
                    "type": "array",
                    "items": {"type": "number", "minimum": 0, "maximum": 1},
                    "minItems": 2,
                    "maxItems": 2,
                },
                "over": _quantity_schema("time"),
                "begin": _quantity_schema("time"),
                "shape": {"enum": ["linear", "cosine"], "default": "linear"},
            },
            "required": ["ramp", "over"],
            "additionalProperties": False,
        },
        {
            "type": "object",
            "properties": {
                "keyframes": {
                    "type": "array",
                    "items": {"type": "array", "minItems": 2, "maxItems": 2},
                    "minItems": 1,
                }
            },
            "required": ["keyframes"],
            "additionalProperties": False,
        },
    ]
}

read_length, _ = _quantity("length", above=0.0)
Length = Annotated[float, *_field(_quantity("length", above=0.0))]
Pressure = Annotated[float, *_field(_quantity("pressure", at_least=0.0, at_most=units.MOST))]
Time = Annotated[float, *_field(_quantity("time", above=0.0))]
Rate = Annotated[float, *_field(_quantity("rate", at_least=0.0))]
Positive = Annotated[float, *_field(_quantity("number", above=0.0))]
Stretch = Annotated[
    float, *_field(_quantity("number", at_least=units.STRETCHES[0], at_most=units.STRETCHES[1]))
]
LongStretch = Annotated[
    float, *_field(_quantity("number", at_least=1.0, at_most=units.STRETCHES[1]))
]
Scale = Annotated[float, *_field(_quantity("number", at_least=1.0))]
UnitFraction = Annotated[float, *_field(_quantity("number", above=0.0, at_most=1.0))]
TimeStep = Annotated[
    float | str,
    PlainValidator(_read_time_step),
    WithJsonSchema({"anyOf": [{"const": "auto"}, _quantity_schema("time")]}),
]
Subcycling = Annotated[
    bool | int,
    PlainValidator(_read_subcycling),
    WithJsonSchema({"anyOf": [{"type": "boolean"}, {"enum": list(SUBSTEPS)}]}),
]
MassScaling = Annotated[
    float | dict[str, float],
    PlainValidator(_read_mass_scaling),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "minimum": 1},
                {
                    "type": "object",
                    "properties": {"dt": _quantity_schema("time")},
                    "required": ["dt"],
                    "additionalProperties": False,
                },
            ]
        }
    ),
]
CheckpointEvery = Annotated[
    float | str,
    PlainValidator(_read_checkpoint_every),
    WithJsonSchema({"anyOf": [{"enum": ["auto", "off"]}, _quantity_schema("time")]}),
]
VoxelSize = Annotated[
    Vector,
    PlainValidator(_read_voxel),
    WithJsonSchema({"anyOf": [*LENGTH_SCHEMA["anyOf"], POINT_SCHEMA]}),
]
Box = Annotated[tuple[Vector, Vector], PlainValidator(read_box), WithJsonSchema(BOX_SCHEMA)]
Outer = Annotated[
    str | list[tuple[Vector, Vector]],
    PlainValidator(_read_outer),
    WithJsonSchema({"anyOf": [{"const": "all"}, {"type": "array", "items": BOX_SCHEMA}]}),
]
SurfacePath = Annotated[Path, PlainValidator(read_path), WithJsonSchema(PATH_SCHEMA)]
Paths = Annotated[
    list[Path],
    PlainValidator(read_paths),
    WithJsonSchema({"type": "array", "items": PATH_SCHEMA}),
]
Gravity = Annotated[
    Vector,
    PlainValidator(_read_gravity),
    WithJsonSchema(vector_schema(_quantity_schema("acceleration", "0"))),
]
Components = Annotated[
    str,
    PlainValidator(_read_components),
    WithJsonSchema({"type": "string", "pattern": "^[xyz]{1,3}$"}),
]
Name = Annotated[
    str, PlainValidator(_read_name), WithJsonSchema({"type": "string", "minLength": 1})
]
MaterialField = Annotated[
    Material, PlainValidator(_read_material), WithJsonSchema(_material_schema())
]
Activation = Annotated[
    Ramp | Keyframes | Constant,
    PlainValidator(_read_activation),
    WithJsonSchema(_ACTIVATION_SCHEMA),
]
