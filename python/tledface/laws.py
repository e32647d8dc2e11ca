"""The constitutive laws that this build knows, read from the headers of their kernel files.

A law is one file ``kernels_cl/material/<name>.cl``; its header (TOML) names parameters with kinds
and bounds, energy, source, caveats, the moduli at rest and how parameters become kernel rows.
"""

from __future__ import annotations

import ast
import operator
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tledface import _core, units

__all__ = ["Direction", "Law", "Parameter", "all_laws", "evaluate", "law_files"]


@dataclass(frozen=True)
class Parameter:
    """One number of a law: kind of quantity (``units.KINDS``), bounds in SI, meaning.

    ``default`` is None where the parameter must be given, else a number or the name of the
    parameter whose value it takes.
    """

    name: str
    kind: str
    meaning: str
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    default: float | str | None = None
    bare: float | None = None

    @property
    def unit(self) -> str:
        """The SI unit, empty for a plain number."""
        return units.KINDS[self.kind].si

    @property
    def bounds(self) -> str:
        """The bounds in words and SI units."""
        limits = (("> ", self.above), (">= ", self.at_least), ("< ", self.below))
        return " and ".join(f"{sign}{limit:g}" for sign, limit in limits if limit is not None)

    def read(self, value: object, bare: float | None) -> float:
        """The checked SI value; raises InputError without the parameter's name."""
        number = units.parse(value, self.kind, bare=bare)
        return units.bounded(
            number,
            above=self.above,
            at_least=self.at_least,
            below=self.below,
            shown=value,
            unit=self.unit,
        )


@dataclass(frozen=True)
class Direction:
    """A direction of a law, reference frame; normalised when read."""

    name: str
    meaning: str
    optional: bool = False


@dataclass(frozen=True)
class Law:
    """A constitutive law.

    ``volumetric`` is "common" (the shared U(J), chosen by the option of that name), "own" or
    "none"; ``modifier`` is the keyword of laws that go with another material, else None.
    ``shear_modulus``, ``bulk_modulus`` (Pa at rest) and ``row_values`` are expressions of the
    parameters.
    """

    name: str
    title: str
    energy: str
    parameters: tuple[Parameter, ...]
    directions: tuple[Direction, ...]
    options: Mapping[str, tuple[str, ...]]
    source: str
    caveats: str
    stage: int
    rows: int
    history: int
    volumetric: str
    modifier: str | None
    shear_modulus: str
    bulk_modulus: str
    row_values: tuple[str, ...]

    @property
    def direction_rows(self) -> dict[str, int]:
        """Where each direction's x stands in ``row_values``; y and z follow it."""
        return {
            value.removesuffix(".x"): place
            for place, value in enumerate(self.row_values)
            if value.endswith(".x")
        }


_DENSITY = Parameter("density", "density", "mass per reference volume", above=0.0, bare=1.0)
_VOLUMETRIC = ("log", "quadratic")


def law_files() -> list[Path]:
    """The kernel files of the laws, sorted by name."""
    return sorted((Path(_core.__file__).parent / "kernels_cl" / "material").glob("*.cl"))


@cache
def all_laws() -> Mapping[str, Law]:
    """Every law by its name, modifiers too."""
    return {path.stem: _read(path) for path in law_files()}


def _read(path: Path) -> Law:
    text = path.read_text(encoding="utf-8")
    begin = text.index("/* @law") + len("/* @law")
    header: dict[str, Any] = tomllib.loads(text[begin : text.index("*/", begin)])
    parameters = [
        Parameter(name, **values) for name, values in header.get("parameters", {}).items()
    ]
    directions = [
        Direction(name, **values) for name, values in header.get("directions", {}).items()
    ]
    volumetric = header.get("volumetric", "none")
    modifier = header.get("modifier")
    return Law(
        name=path.stem,
        title=header["title"],
        energy=header["energy"],
        parameters=(*parameters, *(() if modifier else (_DENSITY,))),
        directions=tuple(directions),
        options={"volumetric": _VOLUMETRIC} if volumetric == "common" and not modifier else {},
        source=header["source"],
        caveats=header["caveats"],
        stage=header["stage"],
        rows=header["rows"],
        history=header["history"],
        volumetric=volumetric,
        modifier=modifier,
        shear_modulus=header.get("shear_modulus", "0"),
        bulk_modulus=header.get("bulk_modulus", "0"),
        row_values=tuple(header["row_values"]),
    )


_OPERATORS: dict[type[ast.operator], Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def evaluate(expression: str, names: Mapping[str, float]) -> float:
    """The value of a header's arithmetic expression; names may have one dot, as ``first.x``."""
    return _value(ast.parse(expression, mode="eval").body, names)


def _value(node: ast.expr, names: Mapping[str, float]) -> float:
    match node:
        case ast.Constant(value=int() | float() as number):
            return float(number)
        case ast.Name(id=name):
            return names[name]
        case ast.Attribute(value=ast.Name(id=name), attr=part):
            return names[f"{name}.{part}"]
        case ast.BinOp(left=left, op=op, right=right):
            return float(_OPERATORS[type(op)](_value(left, names), _value(right, names)))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_value(operand, names)
    raise ValueError(f"law header: {ast.dump(node)} is no arithmetic")
