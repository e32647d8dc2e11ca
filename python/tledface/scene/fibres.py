"""The scene's ``fibre`` key: a direction, a kind of fibre field, or a table with its options."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import PlainValidator, ValidationInfo, WithJsonSchema

from tledface import fibre_kinds as kinds
from tledface import units
from tledface.errors import InputError
from tledface.scene.fields import (
    BOX_SCHEMA,
    LENGTH_SCHEMA,
    PATH_SCHEMA,
    POINT_SCHEMA,
    Vector,
    list_of_three,
    read_box,
    read_path,
    read_paths,
    read_point,
    vector_schema,
)

__all__ = ["Fibre"]

_PLAIN = ("nurbs", "spindle", "sphincter")
_FORMS = (
    'three numbers, as [0, 0, 1], "long-axis", '
    + ", ".join(f'"{name}"' for name in _PLAIN)
    + ', or a table, as { kind = "sheet", to = "+z" } or { curves = "fibres.obj" }'
)


def _read_fibre(value: Any, info: ValidationInfo) -> Vector | str | kinds.Fibre:
    if isinstance(value, kinds.Fibre) or value == "long-axis":
        return value  # type: ignore[no-any-return]
    if isinstance(value, str):
        if value not in kinds.KINDS:
            raise InputError(f"got {value!r}; allowed: {_FORMS}")
        return kinds.make_fibre(value)
    if isinstance(value, dict):
        return _read_table(value, info)
    x, y, z = (units.parse(part, "number") for part in list_of_three(value, _FORMS))
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        raise InputError(f"got {value!r}, which has no direction; allowed: {_FORMS}")
    return x / length, y / length, z / length


def _read_table(table: dict[str, Any], info: ValidationInfo) -> kinds.Fibre:
    options = {key: value for key, value in table.items() if key != "kind"}
    kind = table.get("kind", "curves" if "curves" in table else None)
    if kind is None:
        raise InputError(f"kind: missing; allowed: {', '.join(kinds.KINDS)}")
    for key in ("from", "to"):
        if key in options:
            options[key] = _read_end(options[key], key, info)
    for key, what in (("axis", "three numbers, as [0, 1, 0]"), ("centre", "three lengths")):
        if key in options:
            try:
                parts = list_of_three(options[key], what)
                options[key] = (
                    [units.parse(part, "number") for part in parts]
                    if key == "axis"
                    else read_point(parts, info)
                )
            except InputError as error:
                raise InputError(f"{key}: {error}") from None
    if isinstance(options.get("curves"), str):
        options["curves"] = read_path(options["curves"], info)
    elif isinstance(options.get("curves"), list):
        options["curves"] = read_paths(options["curves"], info)
    return kinds.make_fibre(kind, options)


def _read_end(value: Any, key: str, info: ValidationInfo) -> Any:
    """An end with its lengths in metres, still to be checked by `make_end`."""
    try:
        if isinstance(value, dict) and set(value) == {"box"}:
            return {"box": read_box(value["box"], info)}
        if isinstance(value, dict) and isinstance(value.get("points"), list):
            found = dict(value, points=[read_point(point, info) for point in value["points"]])
            if "reach" in value:
                length = (info.context or {}).get("length", 1.0)
                found["reach"] = units.parse(value["reach"], "length", bare=length)
            return found
        if isinstance(value, list):
            return [units.parse(part, "number") for part in value]
    except InputError as error:
        raise InputError(f"{key}: {error}") from None
    return value


_END_SCHEMA: dict[str, Any] = {
    "anyOf": [
        {"enum": ["+x", "-x", "+y", "-y", "+z", "-z"], "description": "the end towards an axis"},
        vector_schema({"type": "number"}) | {"description": "the end towards a direction"},
        {
            "type": "object",
            "properties": {"box": BOX_SCHEMA},
            "required": ["box"],
            "additionalProperties": False,
        },
        {
            "type": "object",
            "properties": {
                "points": {"type": "array", "items": POINT_SCHEMA, "minItems": 1},
                "reach": LENGTH_SCHEMA,
            },
            "required": ["points"],
            "additionalProperties": False,
            "description": "the part within reach of a line",
        },
    ]
}
_OPTION_SCHEMAS: dict[str, Any] = {
    "from": _END_SCHEMA,
    "to": _END_SCHEMA,
    "degree": {"type": "integer", "minimum": 1, "maximum": 5, "default": 3},
    "axis": vector_schema({"type": "number"}),
    "centre": POINT_SCHEMA,
    "curves": {"anyOf": [PATH_SCHEMA, {"type": "array", "items": PATH_SCHEMA, "minItems": 1}]},
}


def _table_schema(kind: str) -> dict[str, Any]:
    options = kinds.KINDS[kind]
    return {
        "type": "object",
        "properties": {"kind": {"const": kind}} | {key: _OPTION_SCHEMAS[key] for key in options},
        "required": ["curves"] if kind == "curves" else ["kind"],
        "additionalProperties": False,
    }


Fibre = Annotated[
    Vector | str | kinds.Fibre,
    PlainValidator(_read_fibre),
    WithJsonSchema(
        {
            "anyOf": [
                {"enum": ["long-axis", *_PLAIN]},
                vector_schema({"type": "number"}),
                *(_table_schema(kind) for kind in kinds.KINDS),
            ]
        }
    ),
]
