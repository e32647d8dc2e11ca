"""Pictures of a finished run from its folder: the skin at rest and at the end."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.io._atomic import check_folder
from tledface.output import earlier_run
from tledface.picture import wrinkle_picture
from tledface.voxel_view import VIEWS

__all__ = ["run_pictures", "surface_frames"]

_FRAMES = ("frames_surface.vtkhdf", "frames_surface.part.vtkhdf")


def run_pictures(
    directory: str | Path, folder: str | Path, *, views: Sequence[str] | None = None
) -> list[Path]:
    """Draw the surface of a run at its first and last frame.

    Args:
        directory: The folder of a run; one that is still going on or failed shows what it has.
        folder: Where to; made if it is not there.
        views: Names of ``VIEWS``, or "oblique"; None: as the run's own picture.

    Returns:
        The files: ``skin.png``, or ``skin-VIEW.png`` for each view.

    Raises:
        InputError: no run, no frames, a damaged file, an unknown view, no such folder.
    """
    directory, folder = Path(directory), Path(folder)
    about = earlier_run(directory)
    if about is None:
        raise InputError(
            f"render {directory}: no run; give the folder of `tledface run`, or a model file"
        )
    known = [*VIEWS, "oblique"]
    for view in views or ():
        if view not in known:
            raise InputError(f"view: got {view!r}; allowed: {', '.join(known)}")
    rest, moved, faces = surface_frames(directory)
    check_folder(folder, "pictures")
    folder.mkdir(exist_ok=True)
    found = ((about.get("result") or {}).get("wrinkles")) or {}
    if views is None:
        chosen: list[tuple[str, dict[str, Any]]] = [("skin", _own_view(found))]
    else:
        chosen = [(f"skin-{view.replace(' ', '-')}", _view(view)) for view in dict.fromkeys(views)]
    return [
        wrinkle_picture(folder / f"{name}.png", rest, moved, faces, **options)
        for name, options in chosen
    ]


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
    direction, up = VIEWS[name]
    return {"view": direction, "up": up}


def surface_frames(
    directory: Path,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Points of the first and last frame, (nv, 3) m, and the triangles that follow the tissue."""
    path = next((directory / name for name in _FRAMES if (directory / name).exists()), None)
    if path is None:
        raise InputError(f"render {directory}: it holds no {_FRAMES[0]}; run the scene again")
    try:
        with h5py.File(path, "r") as file:
            root = file["VTKHDF"]
            n_points = int(root["NumberOfPoints"][0])
            offsets = root["Steps/PointOffsets"]
            last = int(np.ravel(offsets[int(root["Steps"].attrs["NSteps"]) - 1])[0])
            rest = root["Points"][:n_points].astype(np.float64)
            moved = root["Points"][last : last + n_points].astype(np.float64)
            faces = root["Polygons/Connectivity"][()].astype(np.int64).reshape(-1, 3)
            if "moves" in root["CellData"]:
                faces = faces[root["CellData/moves"][()] != 0]
    except (OSError, KeyError, ValueError, IndexError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: cannot be read ({reason}); run the scene again") from None
    return rest, moved, faces
