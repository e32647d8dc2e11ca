"""Types of the fields in ``[boundary]``: boxes that may be open, points, axes, sides."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import PlainValidator, ValidationInfo, WithJsonSchema

from tledface import units
from tledface.errors import InputError
from tledface.scene.fields import (
    JsonSchema,
    Vector,
    _bare_factor,
    _field,
    _quantity,
    _quantity_schema,
    list_of_three,
    vector_schema,
)

__all__ = [
    "Angle",
    "Axis",
    "Coefficient",
    "Cosine",
    "Direction",
    "OpenBox",
    "OpenBoxes",
    "Point",
    "Points",
    "Position",
    "Reach",
    "Side",
]

OpenBoxValue = tuple[Vector, Vector]

AXES = ("x", "y", "z")
SIDES = ("x-", "x+", "y-", "y+", "z-", "z+")


def _read_open_box(value: Any, info: ValidationInfo) -> OpenBoxValue:
    what = "a low and a high corner, as [[44, -inf, -inf], [inf, inf, 1600]]"
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise InputError(f"got {value!r}; allowed: {what}")
    low, high = (_read_open_point(corner, info, what) for corner in value)
    if any(first > second for first, second in zip(low, high, strict=True)):
        raise InputError(f"got {value!r}; allowed: a low corner not above the high one")
    return low, high


def _read_open_point(value: Any, info: ValidationInfo, what: str) -> Vector:
    x, y, z = (
        part if isinstance(part, float) and math.isinf(part) else _read_position(part, info)
        for part in list_of_three(value, what)
    )
    return x, y, z


def _read_point(value: Any, info: ValidationInfo) -> Vector:
    parts = list_of_three(value, "three lengths, as [0, 0, 4.5]")
    x, y, z = (_read_position(part, info) for part in parts)
    return x, y, z


def _read_open_boxes(value: Any, info: ValidationInfo) -> list[OpenBoxValue]:
    if not isinstance(value, list):
        raise InputError(f"got {value!r}; allowed: a list of boxes, as [[[0, 0, 0], [inf, 9, 9]]]")
    return [_read_open_box(box, info) for box in value]


def _read_points(value: Any, info: ValidationInfo) -> list[Vector]:
    if not isinstance(value, list) or not value:
        raise InputError(f"got {value!r}; allowed: a list of points, as [[0, 0, 4], [9, 0, 4]]")
    return [_read_point(point, info) for point in value]


def _read_direction(value: Any, info: ValidationInfo) -> Vector:
    good = isinstance(value, list) and len(value) == 3 and any(value)
    if not good or not all(isinstance(v, int | float) and math.isfinite(v) for v in value):
        raise InputError(f"got {value!r}; allowed: three numbers, not all 0, as [1, 0, 0]")
    x, y, z = map(float, value)
    return (x, y, z)


def _read_position(value: Any, info: ValidationInfo) -> float:
    return units.parse(value, "length", bare=_bare_factor("length", info))


def _read_side(value: Any, info: ValidationInfo) -> str:
    if value not in SIDES:
        raise InputError(f"got {value!r}; allowed: one of {', '.join(SIDES)}")
    return str(value)


def _read_axis(value: Any, info: ValidationInfo) -> str:
    if value not in AXES:
        raise InputError(f"got {value!r}; allowed: one of {', '.join(AXES)}")
    return str(value)


_LENGTH_SCHEMA = _quantity_schema("length", "in the scene's units")
_NUMBER_OR_INF = {"anyOf": _LENGTH_SCHEMA["anyOf"], "description": "a length, or -inf or inf"}
_OPEN_BOX_SCHEMA: JsonSchema = {
    "type": "array",
    "items": vector_schema(_NUMBER_OR_INF),
    "minItems": 2,
    "maxItems": 2,
    "description": "low and high corner; a side may be -inf or inf",
}

OpenBox = Annotated[OpenBoxValue, PlainValidator(_read_open_box), WithJsonSchema(_OPEN_BOX_SCHEMA)]
OpenBoxes = Annotated[
    list[OpenBoxValue],
    PlainValidator(_read_open_boxes),
    WithJsonSchema({"type": "array", "items": _OPEN_BOX_SCHEMA}),
]
Points = Annotated[
    list[Vector],
    PlainValidator(_read_points),
    WithJsonSchema({"type": "array", "items": vector_schema(_LENGTH_SCHEMA), "minItems": 1}),
]
Point = Annotated[
    Vector, PlainValidator(_read_point), WithJsonSchema(vector_schema(_LENGTH_SCHEMA))
]
Direction = Annotated[
    Vector, PlainValidator(_read_direction), WithJsonSchema(vector_schema({"type": "number"}))
]
Angle = Annotated[float, *_field(_quantity("number", at_least=-180.0, at_most=180.0))]
Position = Annotated[float, PlainValidator(_read_position), WithJsonSchema(_LENGTH_SCHEMA)]
Reach = Annotated[float, *_field(_quantity("length", at_least=0.0))]
Coefficient = Annotated[float, *_field(_quantity("number", at_least=0.0))]
Cosine = Annotated[float, *_field(_quantity("number", at_least=-1.0, below=1.0))]
Side = Annotated[str, PlainValidator(_read_side), WithJsonSchema({"enum": list(SIDES)})]
Axis = Annotated[str, PlainValidator(_read_axis), WithJsonSchema({"enum": list(AXES)})]
