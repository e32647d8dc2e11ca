"""Quantities with units to SI."""

import math

import numpy as np
import pytest

from tledface import units
from tledface.constitutive import material
from tledface.errors import InputError


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        ("81.4 kPa", "pressure", 81.4e3),
        ("5 MPa", "pressure", 5e6),
        ("0.5N/mm^2", "pressure", 0.5e6),
        ("50 ms", "time", 0.05),
        ("2 us", "time", 2e-6),
        ("2 µs", "time", 2e-6),
        ("0.5 mm", "length", 5e-4),
        ("1.5e-1 cm", "length", 1.5e-3),
        ("1100 kg/m^3", "density", 1100.0),
        ("1100 kg/m³", "density", 1100.0),
        ("1.1 g/cm3", "density", 1100.0),
        ("200 1/s", "rate", 200.0),
        ("200 s^-1", "rate", 200.0),
        ("-9.81 m/s^2", "acceleration", -9.81),
        ("-9.81 m / s**2", "acceleration", -9.81),
        ("49 %", "number", 0.49),
        ("0.49", "number", 0.49),
    ],
)
def test_text_becomes_si(text, kind, expected):
    assert units.parse(text, kind) == pytest.approx(expected, rel=1e-15)


# Written out again: a factor that is off in the table is off in no other place.
FACTORS = {
    "length": {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 0.000001},
    "time": {"s": 1.0, "ms": 0.001, "us": 0.000001, "ns": 0.000000001},
    "pressure": {
        "Pa": 1.0, "kPa": 1000.0, "MPa": 1000000.0, "GPa": 1000000000.0, "N/m^2": 1.0,
        "N/mm^2": 1000000.0, "kN/m^2": 1000.0,
    },
    "density": {"kg/m^3": 1.0, "g/cm^3": 1000.0, "g/ml": 1000.0, "kg/l": 1000.0},
    "rate": {"1/s": 1.0, "Hz": 1.0, "1/ms": 1000.0},
    "acceleration": {"m/s^2": 1.0, "cm/s^2": 0.01, "mm/s^2": 0.001},
    "number": {"": 1.0, "%": 0.01},
}  # fmt: skip


@pytest.mark.parametrize("kind", units.KINDS)
def test_every_unit_has_its_factor(kind):
    found = {unit: units.parse(f"3 {unit}", kind) for unit in units.KINDS[kind].units}
    assert found == pytest.approx({unit: 3 * f for unit, f in FACTORS[kind].items()}, rel=1e-12)


def test_every_example_of_the_table_parses_with_its_own_kind():
    for kind, known in units.KINDS.items():
        assert math.isfinite(units.parse(known.example, kind))
        assert known.units[known.si] == 1.0


@pytest.mark.parametrize("kind", [np.int64, np.int32, np.float32, np.float64, np.uint8])
def test_numbers_of_numpy_are_numbers(kind):
    value = units.parse(kind(34), "pressure", bare=1.0)
    assert type(value) is float and value == 34.0
    assert type(units.parse(kind(1), "number")) is float
    made = material("neo_hookean", youngs_modulus=kind(34), poissons_ratio=0.25, density=kind(100))
    assert made.youngs_modulus == 34.0


@pytest.mark.parametrize("value", [np.True_, np.float32("nan"), 10**400, 1 + 2j, np.array([1.0])])
def test_what_is_no_finite_number_is_refused(value):
    with pytest.raises(InputError, match=r"^got .*; allowed: a finite number"):
        units.parse(value, "number")


def test_bare_number_needs_an_implied_unit_unless_zero():
    assert units.parse(0.5, "length", bare=1e-3) == 5e-4
    assert units.parse("0.5", "length", bare=1e-3) == 5e-4
    assert units.parse(0, "acceleration") == 0.0
    assert units.parse(0.49, "number") == 0.49
    with pytest.raises(InputError, match=r'^E: unit missing: got 81\.4; .* "81\.4 kPa"'):
        units.parse(81.4, "pressure", key="E")
    with pytest.raises(InputError, match="unit missing"):
        units.parse("81.4", "pressure")


@pytest.mark.parametrize(
    ("value", "kind", "message"),
    [
        ("5 kpa", "pressure", r'unknown unit "kpa" \(nearest: "kPa"\)'),
        ("5 mm", "pressure", "mm is the unit of a length"),
        ("5 furlong", "length", 'unknown unit "furlong"'),
        ("five mm", "length", "got 'five mm'"),
        ("nan mm", "length", "allowed"),
        ("1e999 mm", "length", "finite"),
        (math.inf, "number", "finite"),
        (True, "number", "got True"),
        ([1], "time", r"got \[1\]"),
        (None, "length", "got None"),
    ],
)
def test_bad_quantities_are_named(value, kind, message):
    with pytest.raises(InputError, match=message) as raised:
        units.parse(value, kind)
    assert "\n" not in str(raised.value)


def test_bounds():
    assert units.bounded(0.0, at_least=0.0, below=0.5) == 0.0
    with pytest.raises(InputError, match=r"got 0\.5; allowed: at least 0 and less than 0\.5$"):
        units.bounded(0.5, at_least=0.0, below=0.5)
    with pytest.raises(InputError, match=r"got '-1 mm'; allowed: greater than 0$"):
        units.bounded(-1e-3, above=0.0, shown="-1 mm", unit="m")
    with pytest.raises(InputError):
        units.bounded(math.nan, at_most=1.0)


def test_unit_scale():
    assert units.unit_scale("mm") == 1e-3
    with pytest.raises(InputError, match="got 'inch'; allowed: one of mm, m, cm, um"):
        units.unit_scale("inch")
