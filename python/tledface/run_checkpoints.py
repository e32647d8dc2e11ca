"""The checkpoints of a run in its folder: the last two, and the model they share.

``checkpoint.h5`` is the last, ``checkpoint-before.h5`` the one before it, ``checkpoint-model.h5``
the model and scene, written once. A new one is written and synced under another name before any
name changes, so at every moment there is a complete one. The frames it counts are synced first.
"""

from __future__ import annotations

import math
import os
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tledface import checkpoint
from tledface.errors import InputError, in_shell
from tledface.io.vtkhdf import VTKHDFWriter

if TYPE_CHECKING:
    from tledface.model import Model
    from tledface.scene import Scene
    from tledface.simulator import Simulator

__all__ = [
    "MODEL_FILE",
    "RunCheckpoints",
    "any_in",
    "how_to_resume",
    "newest_whole",
    "remove_from",
]

LAST, BEFORE, MODEL_FILE = "checkpoint.h5", "checkpoint-before.h5", "checkpoint-model.h5"
_NEW = "checkpoint-new.h5"
# "auto": a run that a user can lose a minute of loses a minute at most.
_AUTO_WALL = 60.0


class RunCheckpoints:
    """Takes a run's checkpoints when they are due.

    Args:
        folder: The run's folder.
        scene, model: What is run, saved with the first checkpoint.
        every: Simulated seconds, ``"auto"`` (each minute of the run) or ``"off"``.
    """

    def __init__(self, folder: Path, scene: Scene, model: Model, every: float | str) -> None:
        """Nothing is written."""
        self._folder, self._scene, self._model, self._every = folder, scene, model, every
        self._last_wall = time.perf_counter()
        self._next = 0.0 if isinstance(every, float) else math.inf

    def due(self, sim: Simulator) -> bool:
        """Whether it is time for one."""
        if self._every == "auto":
            return time.perf_counter() - self._last_wall >= _AUTO_WALL
        return sim.time + 0.51 * sim.dt >= self._next

    def take(self, sim: Simulator, writer: VTKHDFWriter, notes: dict[str, Any]) -> None:
        """Write one; a full disk is a warning, as the one before it stays.

        Raises SimulationError: the state is no longer finite; the one before it stays too.
        """
        self.wait(sim)
        sim._require_finite()
        last, before = self._folder / LAST, self._folder / BEFORE
        new = self._folder / _NEW
        try:
            self._save_model()
            writer.sync()
            checkpoint.save(sim, new, model_link=MODEL_FILE, notes=notes)
        except (OSError, RuntimeError) as error:
            warnings.warn(
                f"no checkpoint at t = {sim.time:.6g} s ({error}); an earlier one stays",
                stacklevel=2,
            )
            return
        if last.exists():
            os.replace(last, before)
        os.replace(new, last)

    def wait(self, sim: Simulator) -> None:
        """Let the time to the next one begin now."""
        self._last_wall = time.perf_counter()
        if isinstance(self._every, float):
            self._next = self._every * (math.floor((sim.time + 0.51 * sim.dt) / self._every) + 1)

    def _save_model(self) -> None:
        from tledface.io._atomic import atomic_path
        from tledface.run import save_built

        if (self._folder / MODEL_FILE).exists():
            return
        with atomic_path(self._folder / MODEL_FILE, "model file", durable=True) as part:
            save_built(self._scene, self._model, part)


def remove_from(folder: Path) -> None:
    """Remove the checkpoints of a run's folder, whole ones and what a kill left of others."""
    for name in (LAST, BEFORE, _NEW, MODEL_FILE):
        path = folder / name
        for file in (path, path.with_name(f"{path.stem}.part{path.suffix}")):
            file.unlink(missing_ok=True)
    (folder / "checkpoint-model.part.part.h5").unlink(missing_ok=True)


def any_in(folder: Path) -> bool:
    """Whether the folder holds a checkpoint, whole or damaged."""
    return bool(_present(folder))


def how_to_resume(folder: Path) -> str:
    """How a message says to go on with the run in a folder; empty: it holds no checkpoint."""
    return f"`tledface resume {in_shell(folder)}` goes on" if any_in(folder) else ""


def newest_whole(folder: Path, device: Any = None) -> tuple[Simulator, dict[str, Any]]:
    """The simulator of the newest checkpoint that is whole, and its notes.

    A damaged one is a warning, and the one before it is taken. Raises InputError: there is none.
    """
    found = _present(folder)
    if not found:
        raise InputError(
            f"resume {folder}: nothing to resume, the run ended before its first checkpoint; run "
            "it again with --force"
        )
    damage = ""
    for path in found:
        if damage:
            warnings.warn(f"{damage}; taking the one before it", stacklevel=2)
        try:
            notes = checkpoint.read_notes(path)
            return checkpoint.restore(path, device=device), notes
        except checkpoint.DamagedCheckpoint as error:
            damage = str(error)
    raise InputError(
        f"resume {folder}: no checkpoint is whole ({damage}); run it again with --force"
    )


def _present(folder: Path) -> list[Path]:
    """The checkpoints there, newest first."""
    # Between two renames the newest has its first name still.
    names = [folder / name for name in (_NEW, LAST, BEFORE)]
    return [path for path in names if path.exists()]
