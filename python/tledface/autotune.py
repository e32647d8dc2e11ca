"""Which kernels compute the steps on a GPU: timed once for each device, then remembered.

The choice depends on registers, caches and local memory in ways that only a clock knows
(docs/explanation/gpu-kernels.md). It is kept in the user's cache folder, by device, driver,
version of tledface, precision and hourglass form; CPUs need none. Likewise whether runs of steps
are replayed as command buffers.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tledface import _core
from tledface._core_model import core_model
from tledface.errors import InputError, SimulationError

__all__ = ["Kernels", "cache_file", "fastest", "recording_pays", "tune", "tune_recording"]

Candidate = TypeVar("Candidate", bound=Hashable)
Choice = TypeVar("Choice")

# A sheet as thick as faces are, and as large: other tiles are best in thick blocks, by less.
_CELLS = (320, 320, 5)
_WARM_UP, _ROUNDS, _STEPS = 10, 5, 40
# Where the host sets the pace: whole recordings of a body that no device is busy with.
_SMALL_CELLS, _RECORDED_STEPS = (16, 8, 4), 512
# Time that replaying must save, of that of launches one by one.
_WORTH = 0.05
_ACTIVATION = 0.3


@dataclass(frozen=True)
class Kernels:
    """What computes the steps.

    Attributes:
        kernels: ``"gather"`` or ``"tile"``.
        tile: Elements of a tile in x and y, and planes in z at most (0: by the device's units).
        registers: Of a work-item at most; 0: what the kernels are made for.
    """

    kernels: str
    tile: tuple[int, int, int] = (16, 8, 0)
    registers: int = 0

    def __str__(self) -> str:
        """Name it as in the cache: ``gather``, ``tile 16x8``, ``tile 16x8, 128 registers``."""
        name = self.kernels
        if name == "tile":
            name += " {}x{}".format(*self.tile)
        return f"{name}, {self.registers} registers" if self.registers else name


# Work-groups of 128 to 256 items.
_CANDIDATES = (
    Kernels("gather"),
    *(Kernels("tile", shape) for shape in ((16, 8, 0), (32, 8, 0), (16, 16, 0))),
)

_chosen: dict[str, Kernels] = {}  # of this process
_pays: dict[str, bool] = {}


def tune(device: _core.Device, *, precision: str, hourglass: str) -> None:
    """Make ``kernels="auto"`` on a GPU mean the fastest; other devices know their own.

    ``TLEDFACE_AUTOTUNE=0`` in the environment: nothing is timed or read, ``"auto"`` is gather.
    """
    if device.info.kind != "gpu" or os.environ.get("TLEDFACE_AUTOTUNE") == "0":
        return
    chosen = fastest(device, precision=precision, hourglass=hourglass)
    _core.choose_kernels(device.info.id, precision, hourglass, **asdict(chosen))


def fastest(
    device: _core.Device,
    *,
    precision: str,
    hourglass: str,
    cells: tuple[int, int, int] = _CELLS,
    candidates: Sequence[Kernels] = _CANDIDATES,
    clock: Callable[[], float] = time.perf_counter,
) -> Kernels:
    """Look up the fastest kernels of an OpenCL device, or time the candidates on a block."""
    info = device.info
    body = "x".join(map(str, cells))
    key = f"{_key(device)}, {precision}, {hourglass}, {body}"
    known = _chosen.get(key) or _remembered(key, {str(c): c for c in candidates})
    if known is None:
        able = [c for c in candidates if not c.registers or info.limits_registers]
        seconds = _timed(
            device,
            cells,
            {candidate: asdict(candidate) for candidate in able},
            clock,
            steps=_STEPS,
            precision=precision,
            hourglass=hourglass,
        )
        if not seconds:  # whoever makes a simulator learns why
            return Kernels("gather")
        known = min(seconds, key=lambda candidate: seconds[candidate])
        _remember(key, str(known), {str(c): s for c, s in seconds.items()})
    _chosen[key] = known
    return known


def tune_recording(device: _core.Device) -> None:
    """Make simulators replay runs of steps as command buffers where that pays.

    Only on devices whose command buffers are right. GPUs are timed once; CPUs launch one by one,
    which costs them less (docs/explanation/gpu-kernels.md). ``TLEDFACE_COMMAND_BUFFERS`` in the
    environment, 0 or 1, decides instead of the clock.

    Raises:
        InputError: another value there.
    """
    info = device.info
    wanted = os.environ.get("TLEDFACE_COMMAND_BUFFERS", "")
    if wanted not in ("", "0", "1"):
        raise InputError(
            f"TLEDFACE_COMMAND_BUFFERS: got {wanted!r}; allowed: 0 or 1; unset it to let the "
            "device be timed"
        )
    if not info.command_buffers:
        return
    timed = info.kind == "gpu" and os.environ.get("TLEDFACE_AUTOTUNE") != "0"
    pays = wanted == "1" if wanted else timed and recording_pays(device)
    _core.choose_recording(info.id, pays)


def recording_pays(device: _core.Device, *, clock: Callable[[], float] = time.perf_counter) -> bool:
    """Look up whether replayed steps are faster than launches one by one, or time both."""
    key = f"{_key(device)}, command buffers"
    known = _pays.get(key)
    if known is None:
        known = _remembered(key, {"replayed": True, "one by one": False})
    if known is None:
        runs = {name: {"recorded": name == "replayed"} for name in ("one by one", "replayed")}
        seconds = _timed(device, _SMALL_CELLS, runs, clock, steps=_RECORDED_STEPS)
        if len(seconds) < len(runs):
            return False
        known = seconds["replayed"] < (1.0 - _WORTH) * seconds["one by one"]
        _remember(key, "replayed" if known else "one by one", seconds)
    _pays[key] = known
    return known


def cache_file() -> Path:
    """Where choices are kept: ``$XDG_CACHE_HOME/tledface/kernels.json``, else ``~/.cache/…``."""
    folder = os.environ.get("XDG_CACHE_HOME")
    return (Path(folder) if folder else Path.home() / ".cache") / "tledface" / "kernels.json"


def _key(device: _core.Device) -> str:
    info = device.info
    return f"{info.name}, driver {info.driver}, tledface {version('tledface')}"


def _timed(
    device: _core.Device,
    cells: tuple[int, int, int],
    candidates: Mapping[Candidate, Mapping[str, Any]],
    clock: Callable[[], float],
    *,
    steps: int,
    precision: str = "single",
    hourglass: str = "physical",
) -> dict[Candidate, float]:
    """Seconds a step with each candidate's options that runs, the best of rounds in turns."""
    model = core_model(_block(cells))
    runs: dict[Candidate, _core.Simulator] = {}
    levels = np.full((steps, 1), _ACTIVATION)
    for candidate, options in candidates.items():
        try:
            core = _core.Simulator(
                device,
                model,
                precision=precision,
                hourglass=hourglass,
                kappa=0.075,
                damping=0.0,
                **options,
            )
            core.dt = 0.5 * core.bound_at_rest()[0]
            core.step(min(_WARM_UP, steps), levels[:_WARM_UP])
            core.finish()
        except (InputError, SimulationError):
            continue  # too large a group for the device, or no room
        runs[candidate] = core
    seconds = dict.fromkeys(runs, float("inf"))
    for _ in range(_ROUNDS):
        for candidate, core in runs.items():
            begin = clock()
            core.step(steps, levels)
            core.finish()
            seconds[candidate] = min(seconds[candidate], (clock() - begin) / steps)
    return seconds


def _block(cells: tuple[int, int, int]) -> Any:
    """Soft tissue with a muscle through its lowest layers, an eighth or one, which contracts."""
    from tledface.constitutive import material
    from tledface.model import Model

    h = 1e-3
    tissue = material("neo_hookean", youngs_modulus=50e3, poissons_ratio=0.45, density=1000.0)
    size = (cells[0] * h, cells[1] * h, cells[2] * h)
    model = Model.block(cells=cells, size=size, material=tissue)
    model.add_muscle(
        "muscle",
        lambda c: c[:, 2] < max(size[2] / 8, h),
        fibre=(1, 0, 0),
        sigma_act=50e3,
        sigma_pas=50e3,
    )
    model.fix(lambda X: X[:, 0] < 0.1 * h)
    return model


def _remembered(key: str, choices: Mapping[str, Choice]) -> Choice | None:
    """The choice in the cache, by its name; None without one, whatever is in the file."""
    try:
        name = json.loads(cache_file().read_text("utf-8"))[key]["chosen"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return choices.get(name) if isinstance(name, str) else None


def _remember(key: str, chosen: str, seconds: Mapping[str, float]) -> None:
    """Enter a choice; a cache that cannot be read is begun anew, one not written does no harm."""
    path = cache_file()
    try:
        known = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        known = {}
    if not isinstance(known, dict):
        known = {}
    known[key] = {
        "chosen": chosen,
        "ms_per_step": {name: round(1e3 * s, 5) for name, s in seconds.items()},
    }
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n", "utf-8")
        os.replace(part, path)
    except OSError:
        pass
