"""What all tables of a scene share."""

from __future__ import annotations

import difflib
from typing import Any

from pydantic import BaseModel, ConfigDict, model_validator

from tledface.errors import InputError

__all__ = ["Table"]


class Table(BaseModel):
    """A TOML table: unknown keys are refused with the nearest known one."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, populate_by_name=False)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            raise InputError(f"got {given!r}; allowed: a table")
        known = [field.alias or name for name, field in cls.model_fields.items()]
        for key in given:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
                hint = f"nearest: {near[0]}; " if near else ""
                raise InputError(f"{key}: unknown key; {hint}allowed: {', '.join(known)}")
        return given
