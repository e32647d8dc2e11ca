"""A scene's tables as a TOML file would hold them, also where Python gave objects.

The scene is kept with its model and its checkpoints in this form, so what it cannot hold is refused
when the scene is made, not when its run goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tledface import units
from tledface.constitutive import Material
from tledface.errors import InputError
from tledface.fibre_kinds import AlongEnd, BoxEnd, CurveEnd, End, Fibre
from tledface.schedule import Constant, Keyframes, Ramp

__all__ = ["as_tables", "without_numpy"]


def without_numpy(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables with NumPy's numbers and arrays as Python's, tuples as lists."""

    def plain(value: Any, path: str) -> Any:
        return value.tolist() if isinstance(value, np.generic | np.ndarray) else value

    return dict(_each(tables, plain))


def as_tables(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables with objects in the form that TOML gives; reading them makes equal objects.

    Raises InputError, naming the key: an object that has no such form.
    """
    return dict(_each(tables, _form))


def _each(value: Any, change: Callable[[Any, str], Any], path: str = "") -> Any:
    """A copy of nested tables and lists with every other value changed."""
    if isinstance(value, Mapping):
        dot = "." if path else ""
        return {key: _each(item, change, f"{path}{dot}{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_each(item, change, f"{path}[{index}]") for index, item in enumerate(value)]
    return change(value, path)


def _form(value: Any, path: str) -> Any:
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Material):
        return _material(value)
    if isinstance(value, Fibre):
        return _fibre(value)
    if isinstance(value, Constant):
        return float(value.value)
    if isinstance(value, Ramp):
        return {
            "ramp": [float(value.start), float(value.end)],
            "over": _si(value.over, "s"),
            "begin": _si(value.begin, "s"),
            "shape": value.shape,
        }
    if isinstance(value, Keyframes):
        pairs = zip(value.times, value.values, strict=True)
        return {"keyframes": [[_si(time, "s"), float(level)] for time, level in pairs]}
    raise InputError(
        f"{path}: got {value!r}; allowed: what a scene file can hold (numbers, texts, lists, "
        "tables), tf.material(...), tf.ramp(...)"
    )


def _material(given: Material) -> dict[str, Any]:
    numbers = {**given.parameters, "density": given.density}
    table: dict[str, Any] = {"model": given.model}
    for parameter in given.law.parameters:
        if parameter.name in numbers:
            unit = units.KINDS[parameter.kind].si
            table[parameter.name] = _si(numbers[parameter.name], unit)
    table |= given.options
    table |= {name: list(vector) for name, vector in given.directions.items()}
    if given.prony:
        table["prony"] = [[share, _si(time, "s")] for share, time in given.prony]
    if given.pretension is not None:
        tension = given.pretension
        table["pretension"] = {
            "along": _si(tension.along, "Pa"),
            "across": _si(tension.across, "Pa"),
            "line": list(tension.line),
            "normal": list(tension.normal),
        }
    return table


def _fibre(given: Fibre) -> dict[str, Any]:
    table: dict[str, Any] = {"kind": given.kind}
    for key, end in (("from", given.start), ("to", given.end)):
        if end is not None:
            table[key] = _end(end)
    if given.axis is not None:
        table["axis"] = list(given.axis)
    if given.centre is not None:
        table["centre"] = _point(given.centre)
    if given.kind == "nurbs":
        table["degree"] = given.degree
    if given.curves:
        table["curves"] = [str(path) for path in given.curves]
    return table


def _end(end: End) -> Any:
    if isinstance(end, AlongEnd):
        return list(end.direction)
    if isinstance(end, BoxEnd):
        return {"box": [_point(end.low), _point(end.high)]}
    assert isinstance(end, CurveEnd)
    points = {"points": [_point(point) for point in end.points]}
    return points if end.reach is None else points | {"reach": _si(end.reach, "m")}


def _point(point: tuple[float, float, float]) -> list[str | float]:
    return [_si(value, "m") for value in point]


def _si(value: float, unit: str) -> str | float:
    """A quantity that reads back to the same bits."""
    return f"{float(value)!r} {unit}" if unit else float(value)
