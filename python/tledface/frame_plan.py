"""How many frames a run gives and what room they need, known before one is written."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

from tledface.errors import InputError
from tledface.io.vtkhdf import file_bytes, frame_bytes

if TYPE_CHECKING:
    from pathlib import Path

    from tledface.scene import Scene
    from tledface.simulator import Simulator
    from tledface.surface import BoundSurface

__all__ = ["require_room", "reserved_frames"]

# Places for more take HDF5 seconds to make, which nothing interrupts.
_MOST_FRAMES = 10**6
# Where no folder is known yet; bytes.
_MOST_BYTES = 1e12
# A step gets shorter with strain; frames beyond those reserved still find room.
_SHORTER = 2.0


def require_room(
    scene: Scene,
    sim: Simulator,
    surface: BoundSurface,
    folder: Path | None = None,
    free: float = _MOST_BYTES,
) -> None:
    """Refuse a run whose frames do not fit into ``free`` bytes of ``folder``, None for anywhere.

    Raises InputError, which names the settings that make it so.
    """
    frames = _frames(scene, sim)
    each = frame_bytes(sim.model, surface)
    if frames <= _MOST_FRAMES and frames * each <= free:
        longest, limit = file_bytes(sim.model, surface, frames), _file_limit()
        if longest > limit:
            raise InputError(
                f"{scene.path or 'scene'}: output.fps, solver.duration: got {frames:,.0f} frames "
                f"in a file of {longest / 1e6:.3g} MB; allowed by the limit of file sizes: "
                f"{limit / 1e6:.3g} MB; raise it (ulimit -f), or lower output.fps or "
                "solver.duration"
            )
        return
    count = f"{frames:,.0f}" if frames < 1e12 else f"{frames:.3g}"
    if frames > _MOST_FRAMES:
        allowed = f"allowed: {_MOST_FRAMES:,} frames"
    else:
        where = "allowed" if folder is None else f"free for {folder}"
        allowed = f"{where}: {free / 1e9:.3g} GB"
    raise InputError(
        f"{scene.path or 'scene'}: output.fps, solver.duration: got {count} frames of "
        f"{each / 1e6:.3g} MB, {frames * each / 1e9:.3g} GB; {allowed}; lower output.fps or "
        "solver.duration"
    )


def reserved_frames(scene: Scene, sim: Simulator) -> int:
    """Number of frames to reserve space for."""
    return math.ceil(_frames(scene, sim, _SHORTER))


def _file_limit() -> float:
    """Bytes that this process may have in a file."""
    if sys.platform == "win32":
        return math.inf
    import resource

    limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    return math.inf if limit == resource.RLIM_INFINITY else limit


def _frames(scene: Scene, sim: Simulator, shorter: float = 1.0) -> float:
    """One at the start, then one for each 1/fps, and one more at the end where that falls between.

    A step gives one at most. May be infinite.
    """
    duration, pace = scene.solver.duration, scene.solver.time_scaling
    by_time = duration * scene.output.fps
    by_steps = shorter * duration / (sim.dt * pace)
    least = min(by_time, by_steps)
    return 1.0 + (math.ceil(least - 1e-9) if math.isfinite(least) else least)
