"""How the fibres of a muscle run: the kinds there are and their options, checked.

A plain direction and "long-axis" need no options and are not here; the fields themselves are
computed by `tledface.geometry.fibres`.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError

__all__ = ["KINDS", "AlongEnd", "BoxEnd", "CurveEnd", "End", "Fibre", "make_end", "make_fibre"]

Vector = tuple[float, float, float]

# Kind -> the options it takes.
KINDS: dict[str, tuple[str, ...]] = {
    "nurbs": ("from", "to", "degree"),
    "spindle": ("from", "to"),
    "sheet": ("from", "to"),
    "sphincter": ("axis", "centre"),
    "curves": ("curves",),
}
_AXES = {
    f"{sign}{letter}": tuple((1.0 if sign == "+" else -1.0) * row)
    for row, letter in zip(np.eye(3), "xyz", strict=True)
    for sign in "+-"
}
_END_FORMS = (
    '"+z" (or another axis with its sign), a direction as [0, 0.2, 1], '
    "{ box = [[low], [high]] } or { points = [[...], [...]] }"
)
_MAX_DEGREE = 5


@dataclass(frozen=True)
class AlongEnd:
    """The end towards a direction: fibres leave the muscle along it, as far as its shape lets.

    Attributes:
        direction: Unit vector.
    """

    direction: Vector


@dataclass(frozen=True)
class BoxEnd:
    """The part of a muscle in a box, m."""

    low: Vector
    high: Vector


@dataclass(frozen=True)
class CurveEnd:
    """The part of a muscle near a polyline (or near one point), m.

    Attributes:
        points: Corners of the line.
        reach: How near; None: a little more than the line is off the muscle.
    """

    points: tuple[Vector, ...]
    reach: float | None = None


End = AlongEnd | BoxEnd | CurveEnd


@dataclass(frozen=True)
class Fibre:
    """A kind of fibre field with its options, SI; what is None is found from the muscle's shape.

    Attributes:
        kind: A key of ``KINDS``.
        start: Where fibres begin (``from``).
        end: Where they end (``to``).
        axis: Unit vector through a sphincter's hole.
        centre: m, a point of that axis.
        degree: Of a NURBS volume along the muscle.
        curves: Files of curves.
    """

    kind: str
    start: End | None = None
    end: End | None = None
    axis: Vector | None = None
    centre: Vector | None = None
    degree: int = 3
    curves: tuple[Path, ...] = ()


def make_fibre(kind: Any, options: Mapping[str, Any] | None = None) -> Fibre:
    """Check a kind and its options.

    Args:
        kind: A key of ``KINDS``.
        options: By the names in ``KINDS``: ``from`` and ``to`` as `make_end` takes them or ends,
            ``axis`` and ``centre`` (3,), m, ``degree`` 1 to 5, ``curves`` a file or several.

    Raises:
        InputError: an unknown kind or option, an option of another kind, a sheet without ends,
            two ends that point the same way, values of a wrong form.
    """
    if not isinstance(kind, str) or kind not in KINDS:
        near = difflib.get_close_matches(str(kind), KINDS, n=1)
        hint = f"; nearest: {near[0]}" if near else ""
        raise InputError(f"kind: got {kind!r}{hint}; allowed: {', '.join(KINDS)}")
    given = {key: value for key, value in (options or {}).items() if value is not None}
    for key in given:
        if key not in KINDS[kind]:
            near = difflib.get_close_matches(key, KINDS[kind], n=1)
            hint = f"nearest: {near[0]}; " if near else ""
            raise InputError(f"{key}: not a key of {kind!r}; {hint}allowed: {_listed(kind)}")
    start, end = (_end(given[key], key) if key in given else None for key in ("from", "to"))
    if kind == "sheet":
        _check_sheet(start, end)
    elif isinstance(start, AlongEnd) != isinstance(end, AlongEnd) or (start is None) != (
        end is None
    ):
        missing = "to" if end is None else "from"
        raise InputError(f"{missing}: missing; allowed: both from and to, or neither")
    axis = _direction(given["axis"], "axis") if "axis" in given else None
    centre = _point(given["centre"], "centre") if "centre" in given else None
    degree = given.get("degree", 3)
    if isinstance(degree, bool) or not isinstance(degree, int) or not 1 <= degree <= _MAX_DEGREE:
        raise InputError(f"degree: got {degree!r}; allowed: a whole number from 1 to {_MAX_DEGREE}")
    curves = _curve_files(given.get("curves")) if kind == "curves" else ()
    return Fibre(kind, start, end, axis, centre, degree, curves)


def make_end(value: Any) -> End:
    """Return an end of a muscle from its description.

    Args:
        value: ``"+z"`` or another axis with its sign, a direction (3,), ``{"box": (2, 3)}`` m, or
            ``{"points": (n, 3), "reach": ...}`` m.

    Raises:
        InputError: anything else, or numbers that are not finite.
    """
    if isinstance(value, AlongEnd | BoxEnd | CurveEnd):
        return value
    if isinstance(value, str):
        if value not in _AXES:
            raise InputError(f"got {value!r}; allowed: {_END_FORMS}")
        return AlongEnd(_three(_AXES[value]))
    if isinstance(value, Mapping):
        keys = set(value)
        if keys == {"box"}:
            low, high = _rows(value["box"], "box", 2, 2)
            if any(a > b for a, b in zip(low, high, strict=True)):
                raise InputError(f"box: got {value['box']!r}; allowed: a low and a high corner")
            return BoxEnd(low, high)
        if "points" in keys and keys <= {"points", "reach"}:
            reach = value.get("reach")
            if reach is not None and not (np.ndim(reach) == 0 and 0.0 < float(reach) < np.inf):
                raise InputError(f"reach: got {reach!r}; allowed: a length greater than 0")
            rows = _rows(value["points"], "points", 1, None)
            return CurveEnd(rows, None if reach is None else float(reach))
        raise InputError(f"got keys {', '.join(map(str, value)) or 'none'}; allowed: {_END_FORMS}")
    return AlongEnd(_direction(value, ""))


def _end(value: Any, key: str) -> End:
    try:
        return make_end(value)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None


def _check_sheet(start: End | None, end: End | None) -> None:
    if start is None and end is None:
        raise InputError('to: missing; a sheet needs the end its fibres run to, as to = "+z"')
    one_of_two = (start is None) != (end is None)
    if one_of_two and not isinstance(end if start is None else start, AlongEnd):
        missing = "to" if end is None else "from"
        raise InputError(f'{missing}: missing; one end alone must be a direction, as to = "+z"')
    if isinstance(start, AlongEnd) and isinstance(end, AlongEnd):
        between = np.subtract(end.direction, start.direction)
        if np.linalg.norm(between) < 1e-6:
            raise InputError("to: points the same way as from; allowed: another direction")


def _listed(kind: str) -> str:
    return ", ".join(KINDS[kind])


def _point(value: ArrayLike, key: str) -> Vector:
    return _rows([value], key, 1, 1)[0]


def _direction(value: ArrayLike, key: str) -> Vector:
    vector = _rows([value], key, 1, 1)[0]
    length = float(np.linalg.norm(vector))
    if length == 0.0:
        label = f"{key}: " if key else ""
        raise InputError(f"{label}got {value!r}, which has no direction; allowed: {_END_FORMS}")
    return _three(np.asarray(vector) / length)


def _rows(value: Any, key: str, least: int, most: int | None) -> tuple[Vector, ...]:
    label = f"{key}: " if key else ""
    try:
        rows = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    too_many = most is not None and len(rows) > most
    if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) < least or too_many:
        shown = value[0] if least == most == 1 else value
        what = "three numbers" if least == most == 1 else "points of three lengths, as [[0, 0, 1]]"
        allowed = what if key else _END_FORMS
        raise InputError(f"{label}got {shown!r}; allowed: {allowed}")
    if not np.isfinite(rows).all():
        raise InputError(f"{label}got {value!r}; allowed: finite numbers")
    return tuple(_three(row) for row in rows)


def _three(values: ArrayLike) -> Vector:
    array: NDArray[np.float64] = np.asarray(values, dtype=np.float64)
    return float(array[0]), float(array[1]), float(array[2])


def _curve_files(value: Any) -> tuple[Path, ...]:
    files = [value] if isinstance(value, str | Path) else value
    if not isinstance(files, list | tuple) or not files:
        raise InputError('curves: missing; give a file of curves, as curves = "fibres.obj"')
    if not all(isinstance(file, str | Path) for file in files):
        raise InputError(f"curves: got {value!r}; allowed: a path or a list of paths")
    return tuple(Path(file) for file in files)
