"""Checkpoints: the whole of a simulator in one HDF5 file, from which it goes on bit for bit.

The layout is in docs/reference/checkpoint-file.md. What the core calls its raw state (the device's
own arrays and the clock) is stored entry by entry as it is, so the bits are those of the device;
on a device that arranges nodes otherwise the displacements are moved over node by node.

A file is put together in memory and written in one go, synced and renamed: whatever happens to
the process or the disk, a file under its final name is complete.
"""

from __future__ import annotations

import io
import json
import math
import warnings
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tledface import device as device_module
from tledface.conditions import Values
from tledface.errors import InputError, SimulationError
from tledface.io._atomic import as_path, atomic_path
from tledface.io.model_file import UNITS, read_model, write_model
from tledface.io.schedules import read_schedule, write_schedule
from tledface.schedule import Schedule
from tledface.time_step import scaling_of

if TYPE_CHECKING:
    from tledface.simulator import Simulator

__all__ = ["FORMAT", "VERSION", "DamagedCheckpoint", "read_notes", "restore", "save"]

FORMAT = "tledface checkpoint"
VERSION = 1

# When the simulator next looks at the state, and what it found last: looks may change dt.
_WATCH = (
    "check_interval",
    "until_check",
    "last_bound",
    "bound_then",
    "pace",
    "iterated_at",
    "stiffest",
    "expected",
    "warned",
    "stale",
)
_DEVICE = ("id", "name", "platform", "driver")
_CHUNK = 1 << 20
# Bounds at rest differ in their last bits from compiler to compiler, models by far more.
_SAME_BOUND = 1e-6


class DamagedCheckpoint(InputError):
    """A file that is missing, cut short, changed, or no checkpoint at all."""


def save(
    sim: Simulator,
    path: str | Path,
    *,
    model_link: str | None = None,
    notes: Mapping[str, Any] | None = None,
) -> None:
    """Write a simulator's state, options, schedules and model.

    Args:
        sim: The simulator; its steps are finished first.
        path: The file; an existing one is replaced once the new one is complete and on disk.
        model_link: Name of a model file in the same folder, to which the checkpoint then refers
            instead of holding the model.
        notes: More to keep, as JSON; see `read_notes`.

    Raises:
        InputError: the folder does not exist or is not writable.
        OSError: the disk is full; an existing file stays as it was.
    """
    target = as_path(path, "checkpoint")
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, "units": UNITS})
        file.attrs["tledface"] = version("tledface")
        file.attrs["notes"] = json.dumps(dict(notes or {}))
        if model_link is None:
            write_model(sim.model, file.create_group("model"))
        else:
            file["model"] = h5py.ExternalLink(model_link, "/")
        file.create_group("options").attrs.update(sim._options)
        file.create_group("watch").attrs.update({k: getattr(sim._watch, k) for k in _WATCH})
        file["watch"].attrs["rest_bound"] = sim._watch.rest_limit
        for key, values in vars(sim._applied).items():
            file[f"applied/{key}"] = values
        if sim._ledger is not None:
            file.create_group("ledger").attrs["until_entry"] = sim._until_entry
            for key, values in sim._ledger.state().items():
                file[f"ledger/{key}"] = values
            for key, value in (sim._energies or {}).items():
                file["ledger"].attrs[key] = value
        info = sim._device.info
        file.create_group("device").attrs.update({key: getattr(info, key) for key in _DEVICE})
        _write_schedules(sim, file.create_group("schedules"))
        _write_state(sim, file.create_group("state"))
    with atomic_path(target, "checkpoint", durable=True) as part:
        part.write_bytes(image.getbuffer())


def restore(
    path: str | Path,
    *,
    device: Any = None,
    activations: Mapping[str, float | Callable[[float], float]] | None = None,
) -> Simulator:
    """A simulator that goes on where `save` found one; see `Simulator.restore`."""
    path = as_path(path, "checkpoint")
    with _opened(path) as file:
        opened, unlike = _find_device(file, device)
        try:
            return _read(file, path, opened, unlike, activations or {})
        except (InputError, SimulationError):
            raise  # what was asked for, or the device: the file may be whole
        except (KeyError, OSError, TypeError, ValueError, IndexError, RuntimeError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise DamagedCheckpoint(f"checkpoint {path}: damaged ({reason})") from None


def read_notes(path: str | Path) -> dict[str, Any]:
    """The notes given to `save`; raises DamagedCheckpoint."""
    with _opened(Path(path)) as file:
        try:
            return dict(json.loads(file.attrs["notes"]))
        except (KeyError, OSError, TypeError, ValueError) as error:
            raise DamagedCheckpoint(f"checkpoint {path}: damaged ({error})") from None


def _opened(path: Path) -> h5py.File:
    if not path.is_file():
        found = "is a folder; give a file in it" if path.is_dir() else "no such file"
        raise DamagedCheckpoint(f"checkpoint {path}: {found}")
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise DamagedCheckpoint(
            f"checkpoint {path}: not an HDF5 file, or cut short; take an earlier one"
        ) from None
    found, number = file.attrs.get("format"), file.attrs.get("version")
    if found != FORMAT or number != VERSION:
        file.close()
        raise DamagedCheckpoint(
            f"checkpoint {path}: an HDF5 file but not a tledface checkpoint"
            if found != FORMAT
            else f"checkpoint {path}: version {number}, this tledface reads version {VERSION}"
        )
    return file


def _read(
    file: h5py.File,
    path: Path,
    device: Any,
    unlike: str,
    activations: Mapping[str, float | Callable[[float], float]],
) -> Simulator:
    from tledface.simulator import Simulator

    options = {key: _plain(value) for key, value in file["options"].attrs.items()}
    watch = {key: _plain(value) for key, value in file["watch"].attrs.items()}
    state = {key: _plain(value) for key, value in file["state"].attrs.items()}
    state |= {key: data[()] for key, data in file["state/arrays"].items()}
    if options.get("hourglass") == "physical":
        options.pop("hourglass_kappa", None)  # stored, but that form has none
    model = read_model(file["model"])
    schedules = _read_schedules(file["schedules"], path, activations)
    sim = Simulator(model, device=device, **scaling_of(options))
    if not math.isclose(sim._watch.rest_limit, watch["rest_bound"], rel_tol=_SAME_BOUND):
        raise InputError(
            f"checkpoint {path}: its model is not the one that was simulated (it was changed after "
            "the simulator was made); leave the model alone once it is simulated"
        )
    for muscle, schedule in schedules.items():
        sim.activate(muscle, schedule)
    layout = _read_layout(file["state/layout"])
    moves = _is_elsewhere(layout, sim)
    if unlike or moves:
        state.pop("sliding", None)  # arranged as its device needs it; sought again
    if moves:
        state = _moved(state, layout, sim, path)
    sim._core.set_raw_state(**state)
    sim._applied = Values(**{key: data[()] for key, data in file["applied"].items()})
    if sim._ledger is not None:
        sim._ledger.set_state({key: data[()] for key, data in file["ledger"].items()})
        entry = {key: _plain(value) for key, value in file["ledger"].attrs.items()}
        sim._until_entry = entry.pop("until_entry")
        sim._energies = entry or None
    for key in _WATCH:
        if key in watch:  # older files have no bound_then, iterated_at, pace
            setattr(sim._watch, key, watch[key])
    if moves:
        sim._watch.stale = True  # levels of subcycling are those of other blocks
    if unlike or moves:
        why = unlike or "its nodes stand in other places than now"
        warnings.warn(f"checkpoint {path}: {why}; not bit for bit", stacklevel=4)
    return sim


# -- schedules ---------------------------------------------------------------------------------


def _write_schedules(sim: Simulator, group: h5py.Group) -> None:
    for number, (muscle, schedule) in enumerate(zip(sim._muscles, sim._schedules, strict=True)):
        entry = group.create_group(str(number))
        entry.attrs["muscle"] = muscle.name
        write_schedule(schedule, entry)


def _read_schedules(
    group: h5py.Group,
    path: Path,
    activations: Mapping[str, float | Callable[[float], float]],
) -> dict[str, float | Callable[[float], float] | Schedule]:
    found: dict[str, float | Callable[[float], float] | Schedule] = {}
    for number in range(len(group)):
        entry = group[str(number)]
        muscle = str(entry.attrs["muscle"])
        if muscle in activations:
            continue
        schedule = read_schedule(entry)
        if schedule is None:
            raise InputError(
                f"checkpoint {path}: the activation of {muscle!r} was a callable, which no file "
                f"can hold; give it again: restore(..., activations={{{muscle!r}: f}})"
            )
        found[muscle] = schedule
    return found | dict(activations)


# -- state -------------------------------------------------------------------------------------


def _write_state(sim: Simulator, group: h5py.Group) -> None:
    arrays, layout = group.create_group("arrays"), group.create_group("layout")
    for key, value in sim._core.raw_state().items():
        if isinstance(value, np.ndarray):
            # Checksums: a byte changed on the disk is an error, not a wrong simulation.
            arrays.create_dataset(
                key, data=value, chunks=(min(max(len(value), 1), _CHUNK),), fletcher32=True
            )
        else:
            group.attrs[key] = value
    core = sim._core
    layout.attrs["lanes"] = core.lanes
    layout.attrs["axis_order"] = list(core.axis_order)
    layout.create_dataset(
        "node_slots", data=core.node_slots(), compression="gzip", compression_opts=1, shuffle=True
    )


def _read_layout(group: h5py.Group) -> dict[str, Any]:
    return {
        "lanes": int(group.attrs["lanes"]),
        "axis_order": group.attrs["axis_order"].tolist(),
        "node_slots": group["node_slots"],
    }


def _is_elsewhere(layout: dict[str, Any], sim: Simulator) -> bool:
    """Whether nodes stand elsewhere: a device of other lanes, or the blocks of an older version."""
    core = sim._core
    return (
        layout["lanes"] != core.lanes
        or layout["axis_order"] != list(core.axis_order)
        or not np.array_equal(layout["node_slots"][()], core.node_slots())
    )


def _moved(
    state: dict[str, Any], layout: dict[str, Any], sim: Simulator, path: Path
) -> dict[str, Any]:
    """The state in the arrangement of this simulator: node by node, component by component."""
    core = sim._core
    dtype = np.dtype(np.float32 if core.single else np.float64)
    arrays = {key: value for key, value in state.items() if isinstance(value, np.ndarray)}
    # A device takes no empty buffer: an array of one number is one of none.
    if any(
        len(v) > dtype.itemsize
        for k, v in arrays.items()
        if k not in ("u", "u_prev", "limit_squares", "levels")
    ):
        raise InputError(
            f"checkpoint {path}: its state has histories of materials, arranged as its device and "
            "version of tledface need them; restore it with the device and version it was made with"
        )
    levels = state.pop("levels", None)
    old, old_order = layout["node_slots"][()], layout["axis_order"]
    new, new_order = np.asarray(core.node_slots()), list(core.axis_order)
    moved = dict(state)
    for key in ("u", "u_prev"):
        before = state[key].view(dtype).reshape(-1, 3, layout["lanes"])
        if key == "u_prev" and levels is not None:
            # A shortest step before u everywhere.
            now = state["u"].view(dtype).reshape(before.shape)[: len(levels) // 2]
            steps = dtype.type(2) ** levels[: len(now), None, None]
            before = before.copy()
            before[: len(now)] = now - (now - before[: len(now)]) / steps
        after: NDArray[Any] = np.zeros((core.n_blocks + 1, 3, core.lanes), dtype=dtype)
        for axis in range(3):
            values = before[:, old_order.index(axis)][old // layout["lanes"], old % layout["lanes"]]
            after[:, new_order.index(axis)][new // core.lanes, new % core.lanes] = values
        moved[key] = after.reshape(-1).view(np.uint8)
    return moved


def _find_device(file: h5py.File, wanted: Any) -> tuple[Any, str]:
    """The device to use, and in what it is unlike the one before ("" if it is the same)."""
    was = {key: str(file["device"].attrs[key]) for key in _DEVICE}
    if wanted is None:
        known = [d for d in device_module.devices() if d.works]
        same = [d for d in known if d.id == "native"] if was["id"] == "native" else []
        same = same or [d for d in known if d.name == was["name"]]
        # The numbers of OpenCL devices may change; of equal devices take the one of that number.
        same.sort(key=lambda d: d.id != was["id"])
        wanted = same[0].id if same else "auto"
    opened = device_module.resolve(wanted)
    now = {key: str(getattr(opened.info, key)) for key in _DEVICE}
    native = was["id"] == now["id"] == "native"
    # The name of the native device has its number of threads, on which no bit depends.
    compared = ("platform",) if native else ("name", "platform", "driver")
    for key in compared:
        if was[key] != now[key]:
            what = "the device" if key == "name" else f"the device's {key}"
            return opened, f"{what} was {was[key]}, now it is {now[key]}"
    if file.attrs.get("tledface") != version("tledface"):
        return opened, f"made by tledface {file.attrs.get('tledface')}"
    return opened, ""


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
