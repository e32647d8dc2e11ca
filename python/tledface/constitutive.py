"""Materials: a constitutive law's name with checked parameters, in SI units.

The laws themselves, their parameters, bounds and sources, stand in `tledface.laws`.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from tledface import units
from tledface.errors import InputError
from tledface.laws import Law, all_laws, evaluate

__all__ = ["Material", "material", "materials", "parse_material"]

Vector = tuple[float, float, float]

_PRONY_TERMS = 3


@dataclass(frozen=True)
class Material:
    """A law with its parameters, SI; `material` makes one. Equal values are equal materials.

    Attributes:
        model: Name of the law.
        parameters: The law's numbers by name, without the density.
        density: kg/m3, mass per reference volume.
        options: The law's choices by name, as ``volumetric``.
        directions: Unit vectors by name, reference frame.
        prony: Pairs (share, time in s), or none.
        pretension: `Pretension`, or None.
    """

    model: str
    parameters: dict[str, float]
    density: float
    options: dict[str, str] = field(default_factory=dict)
    directions: dict[str, Vector] = field(default_factory=dict)
    prony: tuple[tuple[float, float], ...] = ()
    pretension: Pretension | None = None

    @property
    def law(self) -> Law:
        """The law itself."""
        return all_laws()[self.model]

    @cached_property
    def mu(self) -> float:
        """Shear modulus at small strain, Pa (instantaneous with ``prony``)."""
        return evaluate(self.law.shear_modulus, self.parameters)

    @cached_property
    def bulk(self) -> float:
        """Bulk modulus at small strain, Pa."""
        return evaluate(self.law.bulk_modulus, self.parameters)

    @property
    def youngs_modulus(self) -> float:
        """Young's modulus at small strain, Pa: 9 K mu / (3 K + mu)."""
        given = self.parameters.get("youngs_modulus")
        return 9 * self.bulk * self.mu / (3 * self.bulk + self.mu) if given is None else given

    @property
    def poissons_ratio(self) -> float:
        """Poisson's ratio at small strain: (3 K - 2 mu) / (2 (3 K + mu))."""
        given = self.parameters.get("poissons_ratio")
        if given is not None:
            return given
        return (3 * self.bulk - 2 * self.mu) / (2 * (3 * self.bulk + self.mu))

    @property
    def volumetric(self) -> str:
        """The form of U(J): "log" or "quadratic"; "own" where the law has its own."""
        return self.options.get("volumetric", "own")

    def rows(self) -> list[tuple[str, list[float]]]:
        """The kernel rows of the law and its modifiers, weight left out, by law name.

        The plain neo-Hookean law needs none: every element has its share of it.
        """
        result = []
        if self.model != "neo_hookean":
            names = dict(self.parameters) | {"mu": self.mu, "bulk": self.bulk}
            names |= _components(self.directions, [d.name for d in self.law.directions])
            result.append((self.model, [evaluate(v, names) for v in self.law.row_values]))
        if self.prony:
            padded = [*self.prony, *[(0.0, 0.0)] * (_PRONY_TERMS - len(self.prony))]
            result.append(("prony", [value for pair in padded for value in pair]))
        if self.pretension is not None:
            p = self.pretension
            result.append(("pretension", [p.along, p.across, *p.line, *p.normal]))
        return result

    def direction_names(self) -> list[str]:
        """The directions of the law and its modifiers."""
        return [name for law, _ in self.rows() for name in all_laws()[law].direction_rows]

    def __hash__(self) -> int:
        """Hash over all values, so that equal materials are one dictionary key."""
        numbers, choices = sorted(self.parameters.items()), sorted(self.options.items())
        vectors = sorted(self.directions.items())
        return hash(
            (self.model, *numbers, self.density, *choices, *vectors, self.prony, self.pretension)
        )


@dataclass(frozen=True)
class Pretension:
    """Natural tension of skin: W = S0 : E, a second Piola-Kirchhoff stress that stays.

    Attributes:
        along, across: Pa, along the line and across it within the skin.
        line, normal: Unit vectors at right angles, reference frame.
    """

    along: float
    across: float
    line: Vector
    normal: Vector


def material(model: str, **params: object) -> Material:
    """A material by the name of its law.

    Args:
        model: Name of the law, a key of `materials`.
        **params: The law's parameters, SI numbers or text with units (``"34 kPa"``), its directions
            and options, ``density``; ``prony`` and ``pretension`` where wanted:
            docs/reference/materials.md has them all with units, bounds and sources.

    Raises:
        InputError: unknown law or parameter (the nearest known one is named), a parameter missing
            or out of its bounds.

    Example: ``material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)``.
    """
    return _checked({"model": model, **params}, bare_si=True)


def parse_material(table: object) -> Material:
    """A material from a scene's table, where a stiffness must carry its unit; see ``material``."""
    if not isinstance(table, Mapping):
        raise InputError(
            f'got {table!r}; allowed: a table, as {{ model = "neo_hookean", '
            'youngs_modulus = "81.4 kPa", poissons_ratio = 0.49, density = "1100 kg/m^3" }'
        )
    return _checked(table, bare_si=False)


def materials() -> dict[str, Law]:
    """Every law by its name: parameters with units and bounds, energy, source, caveats."""
    return dict(all_laws())


def _checked(given: Mapping[str, object], *, bare_si: bool) -> Material:
    laws = {name: law for name, law in all_laws().items() if law.modifier is None}
    modifiers = [law.modifier for law in all_laws().values() if law.modifier is not None]
    name = given.get("model")
    if name is None:
        raise InputError(f"model missing; allowed: {_quoted(laws)}")
    law = laws.get(name) if isinstance(name, str) else None
    if law is None:
        raise InputError(f"model: unknown law {name!r}{_nearest(name, laws)}")
    known = [
        *(parameter.name for parameter in law.parameters),
        *(direction.name for direction in law.directions),
        *law.options,
        *modifiers,
    ]
    for key in given:
        if key != "model" and key not in known:
            raise InputError(f"{key}: unknown parameter of {law.name}{_nearest(key, known)}")
    values = _read_parameters(law, given, bare_si=bare_si)
    options: dict[str, str] = {}
    for option, choices in law.options.items():
        chosen = given.get(option, choices[0])
        if not isinstance(chosen, str) or chosen not in choices:
            raise InputError(f"{option}: got {chosen!r}; allowed: {_quoted(choices)}")
        options[option] = chosen
    directions = {}
    for direction in law.directions:
        if direction.name in given:
            directions[direction.name] = _unit_vector(direction.name, given[direction.name])
        elif not direction.optional:
            raise InputError(f"{direction.name} missing: {law.name} needs a direction [x, y, z]")
    density = values.pop("density")
    made = Material(
        law.name,
        values,
        density,
        options,
        directions,
        _read_prony(given.get("prony"), law, bare_si=bare_si),
        _read_pretension(given.get("pretension"), bare_si=bare_si),
    )
    if not (made.mu > 0.0 and made.bulk > 0.0):
        raise InputError(
            f"{law.name}: shear modulus {made.mu:g} Pa and bulk modulus {made.bulk:g} Pa at rest; "
            "both must be above 0"
        )
    for key, value, unit in (
        ("shear modulus", made.mu, "Pa"),
        ("bulk modulus", made.bulk, "Pa"),
        ("density", made.density, "kg/m^3"),
    ):
        if not units.LEAST <= value <= units.MOST:
            raise InputError(
                f"{key}: got {value:g} {unit} for {law.name}; allowed: {units.LEAST:g} to "
                f"{units.MOST:g} {unit}, which single precision holds"
            )
    return made


def _read_parameters(law: Law, given: Mapping[str, object], *, bare_si: bool) -> dict[str, float]:
    values: dict[str, float] = {}
    for parameter in law.parameters:
        if parameter.name not in given and parameter.default is not None:
            values[parameter.name] = (
                values[parameter.default]
                if isinstance(parameter.default, str)
                else parameter.default
            )
            continue
        if parameter.name not in given:
            wanted = units.KINDS[parameter.kind]
            raise InputError(
                f"{parameter.name} missing: {law.name} needs {wanted.phrase}, "
                f"{parameter.bounds} {parameter.unit}".rstrip()
            )
        try:
            bare = 1.0 if bare_si else parameter.bare
            values[parameter.name] = parameter.read(given[parameter.name], bare)
        except InputError as error:
            raise InputError(f"{parameter.name}: {error}") from None
        if parameter.kind == "pressure" and abs(values[parameter.name]) > units.MOST:
            raise InputError(
                f"{parameter.name}: got {given[parameter.name]!r}; allowed: up to {units.MOST:g} "
                f"{parameter.unit}, which single precision holds"
            )
    return values


def _read_prony(value: object, law: Law, *, bare_si: bool) -> tuple[tuple[float, float], ...]:
    if value is None:
        return ()
    if law.volumetric == "own":
        raise InputError(
            f"prony: {law.name} has no separate isochoric part; allowed with laws that have one"
        )
    pairs = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    if not 1 <= len(pairs) <= _PRONY_TERMS:
        raise InputError(f"prony: got {len(pairs)} terms; allowed: 1 to {_PRONY_TERMS}")
    result = []
    for pair in pairs:
        if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
            raise InputError(
                f"prony: got {pair!r}; allowed: pairs [share, time], as [0.3, '20 ms']"
            )
        bounds = {"at_least": units.LEAST, "at_most": units.MOST}
        try:
            share = units.parse(pair[0], "number")
            share = units.bounded(share, above=0.0, below=1.0, shown=pair[0])
            time = units.parse(pair[1], "time", bare=1.0 if bare_si else None)
            time = units.bounded(time, **bounds, shown=pair[1], unit="s")
        except InputError as error:
            raise InputError(f"prony: {error}") from None
        result.append((share, time))
    if sum(share for share, _ in result) >= 1.0:
        raise InputError("prony: the shares add up to 1 or more; allowed: less than 1")
    return tuple(result)


def _read_pretension(value: object, *, bare_si: bool) -> Pretension | None:
    if value is None:
        return None
    keys = ("along", "across", "line", "normal")
    if not isinstance(value, Mapping) or set(value) - set(keys) or "along" not in value:
        raise InputError(
            f"pretension: got {value!r}; allowed: a table with along and across (stress), "
            "line and normal ([x, y, z])"
        )
    bare = 1.0 if bare_si else None
    try:
        along, across = (
            units.bounded(
                units.parse(given, "pressure", bare=bare),
                at_least=-units.MOST,
                at_most=units.MOST,
                shown=given,
                unit="Pa",
            )
            for given in (value["along"], value.get("across", 0.0))
        )
    except InputError as error:
        raise InputError(f"pretension: {error}") from None
    if "line" not in value or "normal" not in value:
        raise InputError("pretension: line and normal missing; give both as [x, y, z]")
    line = _unit_vector("pretension line", value["line"])
    normal = _unit_vector("pretension normal", value["normal"])
    if abs(sum(a * b for a, b in zip(line, normal, strict=True))) > 1e-3:
        raise InputError("pretension: line and normal must be at right angles")
    return Pretension(along, across, line, normal)


def _unit_vector(name: str, value: object) -> Vector:
    try:
        x, y, z = (float(v) for v in value)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        raise InputError(f"{name}: got {value!r}; allowed: a direction [x, y, z]") from None
    size = math.sqrt(x * x + y * y + z * z)
    if not (math.isfinite(size) and size > 0.0):
        raise InputError(f"{name}: got {value!r}; allowed: a direction that is finite and not 0")
    return (x / size, y / size, z / size)


def _components(directions: Mapping[str, Vector], names: Sequence[str]) -> dict[str, float]:
    """Components by dotted name; a direction that is left out is (0, 0, 0)."""
    return {
        f"{name}.{axis}": value
        for name in names
        for axis, value in zip("xyz", directions.get(name, (0.0, 0.0, 0.0)), strict=True)
    }


def _quoted(names: Mapping[str, object] | tuple[str, ...] | list[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def _nearest(name: object, known: Mapping[str, object] | list[str]) -> str:
    near = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.6)
    hint = f"; nearest: {near[0]}" if near else ""
    return f"{hint}; allowed: {', '.join(known)}"
