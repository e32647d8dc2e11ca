"""Schedules in HDF5 groups: activations in checkpoints, motions in model files."""

from __future__ import annotations

import dataclasses

import h5py
import numpy as np

from tledface.errors import InputError
from tledface.schedule import Constant, Keyframes, Ramp, Schedule

__all__ = ["read_schedule", "write_schedule"]

_KINDS: dict[str, type[Constant] | type[Ramp] | type[Keyframes]] = {
    "constant": Constant,
    "ramp": Ramp,
    "keyframes": Keyframes,
}


def write_schedule(schedule: Schedule, group: h5py.Group) -> None:
    """Write a schedule; of a callable only that it was one."""
    kinds = [kind for kind, known in _KINDS.items() if isinstance(schedule, known)]
    group.attrs["kind"] = kinds[0] if kinds else "function"
    if not isinstance(schedule, tuple(_KINDS.values())):
        return
    for field in dataclasses.fields(schedule):  # type: ignore[arg-type]
        value = getattr(schedule, field.name)
        if isinstance(value, tuple):
            group[field.name] = np.asarray(value, dtype=np.float64)
        else:
            group.attrs[field.name] = value


def read_schedule(group: h5py.Group) -> Constant | Ramp | Keyframes | None:
    """Read what `write_schedule` wrote; None for a callable. Raises InputError if it is damaged."""
    values = {
        key: value.item() if isinstance(value, np.generic) else value
        for key, value in group.attrs.items()
    }
    kind = values.pop("kind")
    if kind not in _KINDS:
        return None
    values |= {key: tuple(data[()].tolist()) for key, data in group.items()}
    known = [field.name for field in dataclasses.fields(_KINDS[kind])]
    try:
        return _KINDS[kind](**{key: values[key] for key in known if key in values})
    except TypeError:
        raise InputError(f"schedule: a {kind} needs {', '.join(known)}") from None
