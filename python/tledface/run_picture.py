"""Pictures of a run from its folder: skin and stress at its start and in a later frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tledface.errors import InputError
from tledface.io._atomic import check_new_folder
from tledface.metrics import MIN_PROMINENCE
from tledface.output import earlier_run
from tledface.picture import wrinkle_picture
from tledface.run_frames import RunFrames
from tledface.stress_picture import cut_stress_picture, skin_stress_picture
from tledface.voxel_view import VIEWS

__all__ = ["run_pictures"]

Cut = tuple[str, float | None]


def run_pictures(
    directory: str | Path,
    folder: str | Path,
    *,
    views: Sequence[str] | None = None,
    at: float | None = None,
    stress: bool = False,
    cuts: Sequence[Cut] | None = None,
) -> list[Path]:
    """Draw a run at its first frame and at a later one.

    Args:
        directory: The folder of a run; one that is still going on or failed shows what it has.
        folder: Where to; made if it is not there.
        views: Names of ``VIEWS``, "oblique", a side as "-y", or the way to the viewer as
            "0.3,-1,0.2"; None: as the run's own picture.
        at: Time of the later frame, s, the nearest is taken; None: the last.
        stress: Draw von Mises stress, on the skin and in cuts, instead of the skin.
        cuts: Axis and place (m) of planes to cut at, with ``stress``; None: across x through the
            median voxel.

    Returns:
        The files: ``skin.png``, or ``skin-VIEW.png`` for each view; with ``stress``
        ``stress.png`` or ``stress-VIEW.png``, and ``stress-cut-AXIS.png`` (numbered where an axis
        has several).

    Raises:
        InputError: no run, no frames, a damaged file, frames without stress, a time beyond them,
            an unknown view, a cut that meets no voxel, no such folder.
    """
    directory, folder = Path(directory), Path(folder)
    about = earlier_run(directory)
    if about is None:
        raise InputError(
            f"render {directory}: no run; give the folder of `tledface run`, or a model file"
        )
    kind = "stress" if stress else "skin"
    # A run without its end has no result; it is drawn as one with folds.
    found: dict[str, Any] | None = about.get("result", {"wrinkles": {}}).get("wrinkles")
    if views is None:
        chosen = [(kind, _own_view(found or {}))]
    else:
        chosen = [(f"{kind}-{_plain(view)}", _view(view)) for view in dict.fromkeys(views)]
    if found is None:
        # No muscle pulled: there is nothing to measure across.
        chosen = [(name, {**options, "profile": False}) for name, options in chosen]
    frames = RunFrames(directory)
    pair = (0, frames.at(at))
    rest, moved, faces = frames.surface(pair)
    if not stress:
        _make(folder)
        least = (found or {}).get("min_prominence_m", MIN_PROMINENCE)  # older runs have none
        return [
            wrinkle_picture(
                folder / f"{name}.png", rest, moved, faces, min_prominence=least, **options
            )
            for name, options in chosen
        ]
    on_skin, voxels = frames.surface_stress(pair), frames.voxels(pair)
    _make(folder)
    before, after = (f"{1e3 * frames.times[frame]:.3g} ms" for frame in pair)
    labels = (f"at the start, {before}", f"at {after}")
    files = []
    for name, options in chosen:
        options.pop("profile", None)
        path = folder / f"{name}.png"
        files.append(
            skin_stress_picture(path, (rest, moved), faces, on_skin, labels=labels, **options)
        )
    planes: Sequence[Cut] = [("x", None)] if cuts is None else cuts
    axes = [axis for axis, _ in planes]
    for number, (axis, place) in enumerate(planes):
        mark = f"-{axes[: number + 1].count(axis)}" if axes.count(axis) > 1 else ""
        path = folder / f"stress-cut-{axis}{mark}.png"
        files.append(cut_stress_picture(path, voxels, axis, place, labels=labels))
    return files


def _make(folder: Path) -> None:
    check_new_folder(folder, "pictures")
    folder.mkdir(exist_ok=True)


def _own_view(wrinkles: dict[str, Any]) -> dict[str, Any]:
    """The view of the run's own picture: on a face from straight before it, else from above."""
    if "up" not in wrinkles:
        return {}
    up = np.asarray(wrinkles["up"], dtype=np.float64)
    profile = tuple(np.asarray(end, dtype=np.float64) for end in wrinkles["line_m"])
    if abs(up[2]) < 0.9:
        return {"profile": profile, "view": up, "up": (0.0, 0.0, 1.0)}
    return {"profile": profile, "view": "oblique", "up": up}


def _view(name: str) -> dict[str, Any]:
    if name == "oblique":
        return {"view": "oblique"}
    if name in VIEWS:
        direction, up = VIEWS[name]
        return {"view": direction, "up": up}
    side = "xyz".find(name[-1:]) if name[:1] in ("+", "-") and len(name) == 2 else -1
    try:
        if side >= 0:
            way = (1.0 if name[0] == "+" else -1.0) * np.eye(3)[side]
        else:
            way = np.array([float(part) for part in name.split(",")])
    except ValueError:
        way = np.empty(0)
    if way.shape != (3,) or not np.isfinite(way).all() or not way.any():
        raise InputError(
            f"view: got {name!r}; allowed: {', '.join([*VIEWS, 'oblique'])}, a side as -y, or "
            "three numbers as 0.3,-1,0.2"
        )
    steep = abs(way[2]) > 0.98 * np.linalg.norm(way)
    return {"view": way, "up": (0.0, 1.0, 0.0) if steep else (0.0, 0.0, 1.0)}


def _plain(view: str) -> str:
    """A view as part of a file's name."""
    return view.replace(" ", "-").replace(",", "_")
