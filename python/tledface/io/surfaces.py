"""Triangle surfaces for other tools."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from tledface.errors import InputError
from tledface.io._atomic import atomic_path

__all__ = ["SURFACE_ENDINGS", "write_surface"]

SURFACE_ENDINGS = (".ply", ".stl", ".obj", ".off", ".glb")


def write_surface(path: str | Path, vertices: ArrayLike, faces: ArrayLike) -> None:
    """Write a surface in the format of the file's ending.

    Args:
        path: A name ending in .ply, .stl, .obj, .off or .glb; replaced when complete.
        vertices: (nv, 3) float, m.
        faces: (nf, 3) int.

    Raises:
        InputError: an unknown ending, or no such folder.

    Vertex order is kept, so files of several frames correspond (STL has no shared vertices).
    """
    path = Path(path)
    if path.suffix.lower() not in SURFACE_ENDINGS:
        raise InputError(
            f"surface file {path}: ending {path.suffix!r} is not known; allowed: "
            + ", ".join(SURFACE_ENDINGS)
        )
    mesh = trimesh.Trimesh(np.asarray(vertices), np.asarray(faces), process=False)
    with atomic_path(path, "surface file") as part:
        mesh.export(part, file_type=path.suffix.lower()[1:])
