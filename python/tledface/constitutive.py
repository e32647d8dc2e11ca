"""Materials: a constitutive law's name with checked parameters, in SI units.

The registry describes every law: its parameters with unit and bounds, its energy, where that
comes from and what to be careful about.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field

from tledface import units
from tledface.errors import InputError

__all__ = ["Law", "Material", "Parameter", "material", "materials", "parse_material"]


@dataclass(frozen=True)
class Parameter:
    """One number of a law: kind of quantity (``units.KINDS``), bounds in SI, meaning."""

    name: str
    kind: str
    meaning: str
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
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
class Law:
    """A constitutive law: parameters, choices (first one is the default), source, caveats."""

    name: str
    energy: str
    parameters: tuple[Parameter, ...]
    options: dict[str, tuple[str, ...]]
    source: str
    caveats: str


_DENSITY = Parameter("density", "density", "mass per reference volume", above=0.0, bare=1.0)

_LAWS = {
    "neo_hookean": Law(
        name="neo_hookean",
        energy="W = mu/2 (J^(-2/3) I1 - 3) + U(J); "
        'volumetric "log": U = bulk/4 (J^2 - 1 - 2 ln J), "quadratic": U = bulk/2 (J - 1)^2',
        parameters=(
            Parameter("youngs_modulus", "pressure", "stiffness at small strain", above=0.0),
            Parameter("poissons_ratio", "number", "0.5 is incompressible", at_least=0.0, below=0.5),
            _DENSITY,
        ),
        options={"volumetric": ("log", "quadratic")},
        source="decoupled compressible neo-Hookean; Warburton & Maddock 2014, Physically-based "
        "forehead animation including wrinkles, section 5",
        caveats='volumetric="quadratic" has finite energy at J = 0, so elements can invert under '
        'strong contraction; "log" does not. The time step shrinks as poissons_ratio nears 0.5.',
    )
}


@dataclass(frozen=True)
class Material:
    """A law with its parameters (SI).

    ``parameters`` holds the law's numbers without the density, ``density`` is in kg/m^3,
    ``options`` the law's choices by name.
    """

    model: str
    parameters: dict[str, float]
    density: float
    options: dict[str, str] = field(default_factory=dict)

    @property
    def youngs_modulus(self) -> float:
        """Young's modulus at small strain, Pa."""
        return self.parameters["youngs_modulus"]

    @property
    def poissons_ratio(self) -> float:
        """Poisson's ratio at small strain."""
        return self.parameters["poissons_ratio"]

    @property
    def mu(self) -> float:
        """Shear modulus at small strain, Pa: E / (2 (1 + nu))."""
        return self.youngs_modulus / (2.0 * (1.0 + self.poissons_ratio))

    @property
    def bulk(self) -> float:
        """Bulk modulus at small strain, Pa: E / (3 (1 - 2 nu))."""
        return self.youngs_modulus / (3.0 * (1.0 - 2.0 * self.poissons_ratio))

    @property
    def volumetric(self) -> str:
        """The form of U(J): "log" or "quadratic"."""
        return self.options["volumetric"]

    def __hash__(self) -> int:
        """Hash over all values, so that equal materials are one dictionary key."""
        numbers, choices = sorted(self.parameters.items()), sorted(self.options.items())
        return hash((self.model, tuple(numbers), self.density, tuple(choices)))


def material(model: str, **params: float | str) -> Material:
    """A material by the name of its law, SI numbers (text with units is taken too).

    Example: ``material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)``.
    Raises InputError: unknown law or parameter (the nearest known one is named), a parameter
    missing or out of its bounds.
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
    return dict(_LAWS)


def _checked(given: Mapping[str, object], *, bare_si: bool) -> Material:
    name = given.get("model")
    if name is None:
        raise InputError(f"model missing; allowed: {_quoted(_LAWS)}")
    law = _LAWS.get(name) if isinstance(name, str) else None
    if law is None:
        raise InputError(f"model: unknown law {name!r}{_nearest(name, _LAWS)}")
    known = [*(parameter.name for parameter in law.parameters), *law.options]
    for key in given:
        if key != "model" and key not in known:
            raise InputError(f"{key}: unknown parameter of {law.name}{_nearest(key, known)}")
    values: dict[str, float] = {}
    for parameter in law.parameters:
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
    options: dict[str, str] = {}
    for option, choices in law.options.items():
        chosen = given.get(option, choices[0])
        if not isinstance(chosen, str) or chosen not in choices:
            raise InputError(f"{option}: got {chosen!r}; allowed: {_quoted(choices)}")
        options[option] = chosen
    density = values.pop("density")
    return Material(law.name, values, density, options)


def _quoted(names: Mapping[str, object] | tuple[str, ...] | list[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def _nearest(name: object, known: Mapping[str, object] | list[str]) -> str:
    near = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.0)
    return f"; nearest: {near[0]}; allowed: {', '.join(known)}"
