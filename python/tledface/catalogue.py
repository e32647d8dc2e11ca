"""The shipped examples by name, their variants, and their settings from the command line's words.

An example is a module of ``tledface.examples`` with ``write(folder, *, ...) -> Path``, which makes
surfaces and a scene, or ``study(folder, *, ...)``, which does all itself, with ``check(*, ...)``,
which raises InputError for settings that it refuses before it writes. Settings are its
keyword-only parameters; ``VARIANTS`` (name to keyword arguments) and ``ABOUT_VARIANTS`` (name to a
line) may stand beside it.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import math
import pkgutil
import types
import typing
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from tledface.errors import InputError

__all__ = ["REFERENCE", "Example", "Setting", "shipped"]

REFERENCE = "reference"

# What a run gives a study, which is nothing to set.
_NO_SETTINGS = ("device", "quiet")
_WORDS = {"true": True, "yes": True, "false": False, "no": False}
_ALLOWED = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    Path: "a path",
}


@dataclass(frozen=True)
class Setting:
    """A keyword of an example: its type, whether ``none`` is allowed, and its default."""

    name: str
    type: type
    optional: bool
    needed: bool
    default: Any

    def value(self, text: str) -> Any:
        """What a word of the command line means; raises ValueError if it means nothing."""
        if self.optional and text == "none":
            return None
        if self.type is bool:
            if text.lower() not in _WORDS:
                raise ValueError(text)
            return _WORDS[text.lower()]
        if self.type is Path:
            if not text:
                raise ValueError(text)
            return Path(text).expanduser().absolute()
        found = self.type(text)
        if self.type is float and not math.isfinite(found):
            raise ValueError(text)
        return found

    @property
    def allowed(self) -> str:
        """What a value may be, in words."""
        return _ALLOWED[self.type] + (" or none" if self.optional else "")


@dataclass(frozen=True)
class Example:
    """A shipped example.

    Attributes:
        name: As on the command line.
        about: One line.
        call: The module's ``write`` or ``study``.
        is_study: Whether it does all itself.
        check: The module's ``check`` for a study, None where it has none.
        variants: Keyword arguments of each variant; the first, ``reference``, has none.
        about_variants: A line for each.
        settings: What may be set, by name.
    """

    name: str
    about: str
    call: Any = field(repr=False)
    is_study: bool
    check: Any = field(repr=False)
    variants: dict[str, dict[str, Any]]
    about_variants: dict[str, str]
    settings: dict[str, Setting]

    @classmethod
    def of(cls, name: str, module: Any) -> Example:
        """Read an example's module."""
        study = hasattr(module, "study")
        call = module.study if study else module.write
        variants = {REFERENCE: {}, **getattr(module, "VARIANTS", {})}
        about = getattr(module, "ABOUT_VARIANTS", {})
        return cls(
            name,
            (module.__doc__ or "").split("\n")[0],
            call,
            study,
            getattr(module, "check", None) if study else None,
            variants,
            {variant: about.get(variant, "") for variant in variants},
            _settings(call),
        )

    def arguments(
        self,
        variant: str = REFERENCE,
        words: Sequence[str] = (),
        *,
        data: Path | None = None,
        coarse: bool = False,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Keyword arguments of a variant with settings of the command line on top.

        Args:
            variant: Its name.
            words: ``KEY=VALUE`` each.
            data: For the setting ``data``; must be there.
            coarse: Sets ``coarse``.

        Returns:
            All keyword arguments, and those of them that were set beside the variant's.

        Raises:
            InputError: an unknown variant or key, a value of another type, no such data, a
                setting that is needed and missing.
        """
        if variant not in self.variants:
            raise InputError(
                f"{self.name} --variant {variant!r}: no such variant; "
                f"{_known(variant, self.variants)}"
            )
        given: dict[str, Any] = {}
        for word in words:
            key, equals, text = word.partition("=")
            if not equals:
                raise InputError(f"{self.name} --set {word!r}: no value; give it as KEY=VALUE")
            key = key.strip().replace("-", "_")
            self._must_have(key, f"--set {key}")
            if key in given:
                raise InputError(f"{self.name} --set {key}: got it twice; give it once")
            try:
                given[key] = self.settings[key].value(text.strip())
            except ValueError:
                raise InputError(
                    f"{self.name} --set {key}: got {text.strip()!r}; allowed is "
                    f"{self.settings[key].allowed}"
                ) from None
        if data is not None:
            self._must_have("data", f"--data {data}")
            given["data"] = data.expanduser().absolute()
        if coarse:
            self._must_have("coarse", "--coarse")
            given["coarse"] = True
        place = given.get("data")
        if isinstance(place, Path) and not place.exists():
            raise InputError(f"{self.name} --data {place}: no such file or folder")
        arguments = {**self.variants[variant], **given}
        for key, setting in self.settings.items():
            if setting.needed and key not in arguments:
                how = "--data PATH" if key == "data" else f"--set {key}=VALUE"
                raise InputError(f"{self.name}: {key} is missing; give {how}")
        return arguments, given

    def _must_have(self, key: str, what: str) -> None:
        if key not in self.settings:
            raise InputError(f"{self.name} {what}: no such setting; {_known(key, self.settings)}")


def shipped() -> dict[str, ModuleType]:
    """The modules of the shipped examples by name, sorted."""
    package = importlib.import_module("tledface.examples")
    modules = {
        found.name.replace("_", "-"): importlib.import_module(f"{package.__name__}.{found.name}")
        for found in pkgutil.iter_modules(package.__path__)
        if not found.name.startswith("_")
    }
    return {
        name: module
        for name, module in sorted(modules.items())
        if hasattr(module, "write") or hasattr(module, "study")
    }


def _known(word: str, names: Iterable[str]) -> str:
    """What there is instead of a word, the nearest first."""
    names = list(names)
    if not names:
        return "it has none"
    near = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    hint = f"nearest: {near[0]}; " if near else ""
    return f"{hint}allowed: {', '.join(names)}"


def _settings(call: Any) -> dict[str, Setting]:
    """Keyword-only parameters with a type that a word can have."""
    hints = typing.get_type_hints(call)
    found = {}
    for name, parameter in inspect.signature(call).parameters.items():
        if parameter.kind is not parameter.KEYWORD_ONLY or name in _NO_SETTINGS:
            continue
        kind, optional = _kind(hints.get(name))
        if kind is not None:
            needed = parameter.default is parameter.empty
            default = None if needed else parameter.default
            found[name] = Setting(name, kind, optional, needed, default)
    return found


def _kind(hint: Any) -> tuple[type | None, bool]:
    """The type of an annotation that words are read as, and whether it may be None."""
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    members = typing.get_args(hint) if union else (hint,)
    optional = type(None) in members
    kinds = [member for member in members if member is not type(None)]
    # ``str | Path`` is a path that may be given as text.
    kind = Path if Path in kinds else kinds[0] if len(kinds) == 1 else None
    return (kind if kind in _ALLOWED else None), optional
