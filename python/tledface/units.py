"""Physical quantities written with their unit, turned into SI floats.

A quantity is a number, a space and a unit: ``"81.4 kPa"``, ``"0.5 mm"``, ``"200 1/s"``. A bare
number is taken only where its unit is implied (lengths in a scene file, dimensionless numbers)
or where it is zero. The table of units is small on purpose: it has what soft-tissue work uses.
"""

from __future__ import annotations

import difflib
import math
import numbers
import operator
import re
from dataclasses import dataclass

from tledface.errors import InputError

__all__ = ["KINDS", "LEAST", "MOST", "STRETCHES", "Kind", "bounded", "parse", "unit_scale"]

# SI numbers that single precision holds, and their products with cells too.
LEAST, MOST = 1e-15, 1e15
# Of fibres; no tissue is beyond.
STRETCHES = (0.1, 10.0)


@dataclass(frozen=True)
class Kind:
    """A kind of quantity: its name with article, its units (SI factor each) and an example."""

    phrase: str
    units: dict[str, float]
    example: str

    @property
    def si(self) -> str:
        """The SI unit's name (the first of the table with factor 1)."""
        return next(name for name, factor in self.units.items() if factor == 1.0)


KINDS: dict[str, Kind] = {
    "length": Kind("a length", {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "um": 1e-6}, "0.5 mm"),
    "time": Kind("a time", {"ms": 1e-3, "s": 1.0, "us": 1e-6, "ns": 1e-9}, "50 ms"),
    "pressure": Kind(
        "a pressure",
        {
            "kPa": 1e3,
            "Pa": 1.0,
            "MPa": 1e6,
            "GPa": 1e9,
            "N/m^2": 1.0,
            "N/mm^2": 1e6,
            "kN/m^2": 1e3,
        },
        "81.4 kPa",
    ),
    "density": Kind(
        "a density", {"kg/m^3": 1.0, "g/cm^3": 1e3, "g/ml": 1e3, "kg/l": 1e3}, "1100 kg/m^3"
    ),
    "rate": Kind("a rate", {"1/s": 1.0, "Hz": 1.0, "1/ms": 1e3}, "200 1/s"),
    "acceleration": Kind(
        "an acceleration", {"m/s^2": 1.0, "cm/s^2": 1e-2, "mm/s^2": 1e-3}, "-9.81 m/s^2"
    ),
    "number": Kind("a number", {"": 1.0, "%": 1e-2}, "0.49"),
}

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*)", re.DOTALL)
_SPELLINGS = {"²": "^2", "³": "^3", "**": "^", "µ": "u", "μ": "u", "·": "*", " ": ""}
_SYNONYMS = {
    "s^-1": "1/s",
    "ms^-1": "1/ms",
    "/s": "1/s",
    "m3": "m^3",
    "kg/m3": "kg/m^3",
    "g/cm3": "g/cm^3",
    "kg*m^-3": "kg/m^3",
    "g/cc": "g/cm^3",
    "g/mL": "g/ml",
    "kg/L": "kg/l",
    "m/s2": "m/s^2",
    "m/s/s": "m/s^2",
}


def _spelled(unit: str) -> str:
    for written, plain in _SPELLINGS.items():
        unit = unit.replace(written, plain)
    return _SYNONYMS.get(unit, unit)


def _wanted(kind: Kind) -> str:
    units = ", ".join(unit for unit in kind.units if unit)
    return f'{kind.phrase} with its unit, as "{kind.example}" (units: {units})'


def unit_scale(unit: object) -> float:
    """Metres in one length unit; raises InputError for anything but a known length unit."""
    lengths = KINDS["length"].units
    if isinstance(unit, str) and _spelled(unit) in lengths:
        return lengths[_spelled(unit)]
    raise InputError(f"got {unit!r}; allowed: one of {', '.join(lengths)}")


def parse(value: object, kind: str, *, bare: float | None = None, key: str = "") -> float:
    """The SI value of a quantity.

    Arguments: ``value``, text such as ``"81.4 kPa"`` or a number; ``kind``, a key of ``KINDS``;
    ``bare``, the SI factor of a number without a unit (None: only zero may go without);
    ``key``, put before the message. Raises InputError: unit missing, unknown or of another kind,
    or no finite number at all.
    """
    prefix = f"{key}: " if key else ""
    wanted = KINDS[kind]
    if kind == "number":
        bare = 1.0
    unit = ""
    if isinstance(value, str):
        match = _NUMBER.fullmatch(value)
        if match is None:
            raise InputError(f"{prefix}got {value!r}; allowed: {_example(wanted, bare)}")
        number, unit = float(match.group(1)), _spelled(match.group(2).strip())
    elif isinstance(value, bool) or not isinstance(value, numbers.Real):  # NumPy's are Real too
        raise InputError(f"{prefix}got {_shown(value)}; allowed: {_example(wanted, bare)}")
    else:
        number = _as_float(value)
    if not math.isfinite(number):
        raise InputError(f"{prefix}got {_shown(value)}; allowed: a finite number")
    if unit in wanted.units:
        return number * wanted.units[unit]
    if unit:
        raise InputError(f"{prefix}got {value!r}: {_unit_trouble(unit, wanted)}")
    if bare is not None:
        return number * bare
    if number == 0.0:
        return 0.0
    raise InputError(f"{prefix}unit missing: got {value!r}; allowed: {_wanted(wanted)}")


def _as_float(value: numbers.Real) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf  # a whole number of hundreds of digits


def bounded(
    value: float,
    *,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    shown: object = None,
    unit: str = "",
) -> float:
    """``value`` if it keeps its bounds (SI); else InputError naming what was got (``shown``)."""
    tests = (
        (above, "greater than", operator.gt),
        (at_least, "at least", operator.ge),
        (below, "less than", operator.lt),
        (at_most, "at most", operator.le),
    )
    if all(limit is None or holds(value, limit) for limit, _, holds in tests):
        return value
    allowed = " and ".join(
        f"{words} {limit:g}{f' {unit}' if unit and limit else ''}"
        for limit, words, _ in tests
        if limit is not None
    )
    raise InputError(f"got {_shown(value if shown is None else shown)}; allowed: {allowed}")


def _unit_trouble(unit: str, wanted: Kind) -> str:
    for other in KINDS.values():
        if unit in other.units:
            return f"{unit} is the unit of {other.phrase}; allowed: {_wanted(wanted)}"
    folded = {name.lower(): name for name in wanted.units if name}
    near = difflib.get_close_matches(unit.lower(), list(folded), n=1, cutoff=0.5)
    hint = f' (nearest: "{folded[near[0]]}")' if near else ""
    return f'unknown unit "{unit}"{hint}; allowed: {_wanted(wanted)}'


def _example(kind: Kind, bare: float | None) -> str:
    if bare is None:
        return _wanted(kind)
    return f"a finite number, as {kind.example.split()[0]}" + (
        f', or {kind.phrase} with its unit, as "{kind.example}"' if " " in kind.example else ""
    )


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
