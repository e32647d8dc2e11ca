"""Reading surface files into closed, checked surfaces in metres."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tledface import _core
from tledface.errors import InputError

__all__ = ["SURFACE_FORMATS", "SurfaceFile", "read_surface"]

# Without a handler its warnings, some with a traceback, go to standard error beside our one line.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

SURFACE_FORMATS = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf")


# Bytes of a binary STL file: before its triangles, with their number, and of each.
_STL_HEAD, _STL_TRIANGLE = 84, 50


@dataclass(frozen=True, eq=False)
class SurfaceFile:
    """A surface as its file has it and as a closed volume.

    Attributes:
        path: The file.
        vertices: (nv, 3) float64, m, in the file's order (equal ones of an STL file merged).
        faces: (nf, 3) int32, in the file's order.
        solid: The checked volume: welded, oriented, small holes filled.
    """

    path: Path
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    solid: _core.Surface

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Low and high corner of the volume's box, (2, 3) m."""
        vertices = self.solid.vertices
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def read_surface(
    path: str | Path, *, unit_scale: float = 1.0, close_holes: bool = False
) -> SurfaceFile:
    """Read a closed triangle surface.

    Args:
        path: A file that trimesh reads, by its ending (see ``SURFACE_FORMATS``).
        unit_scale: Metres in one unit of the file.
        close_holes: Close holes above the limit too, as cuts that no layer follows.

    Raises:
        InputError: no such file, an unknown ending, not readable as that format, no triangles, a
            vertex that is not finite, a large hole, a surface that cannot be oriented, no volume.

    Holes up to a tenth of the box's diagonal in perimeter are filled; ``solid.report`` has what
    was found and repaired, lengths in metres.
    """
    path = Path(path)
    vertices, faces = _read_triangles(path)
    if path.suffix.lower() == ".stl":
        vertices, faces = _merge_equal(vertices, faces)
    vertices = vertices * unit_scale
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise InputError(
            f"{path}: a face names vertex {faces.min() if faces.min() < 0 else faces.max()}, "
            f"allowed are 0 to {len(vertices) - 1}; export the surface again"
        )
    triangles = faces.astype(np.int32)
    solid = _core.prepare_surface(vertices, triangles, str(path), close_holes=close_holes)
    return SurfaceFile(path, vertices, triangles, solid)


def read_parts(path: Path) -> list[trimesh.Trimesh]:
    """Read the meshes of a file, each at its place; raises InputError as `read_surface` does."""
    if not path.is_file():
        raise InputError(
            f"{path}: {'is not a file' if path.exists() else 'no such surface file'}; "
            "check the path, relative ones start at the scene file's folder"
        )
    if path.suffix.lower() not in SURFACE_FORMATS:
        raise InputError(
            f"{path}: ending {path.suffix!r} is not known; allowed: {', '.join(SURFACE_FORMATS)}"
        )
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; export the surface again")
    if path.suffix.lower() == ".stl":
        _check_length(path)
    try:
        loaded = trimesh.load(path, process=False)
        parts = [loaded] if isinstance(loaded, trimesh.Trimesh) else _scene_parts(loaded)
        for part in parts:
            _ = np.reshape(part.vertices, (-1, 3)), np.reshape(part.faces, (-1, 3))
        return parts
    # The parsers raise whatever the damage provokes: struct, index, key and value errors.
    except Exception as error:
        obj = isinstance(error, IndexError) and path.suffix.lower() == ".obj"
        reason = (_obj_index(path) if obj else "") or " ".join(str(error).split())
        reason = reason or type(error).__name__
        raise InputError(
            f"{path}: cannot be read as {path.suffix.lower()[1:].upper()} ({reason}); "
            "export the surface again"
        ) from None


def _check_length(path: Path) -> None:
    """Raise InputError for a binary STL file that is cut short."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_STL_HEAD)
    # A text has no zero byte; a number of triangles has, unless there are 17 million.
    if b"\0" not in head:
        return
    triangles = int.from_bytes(head[80:], "little")
    expected = _STL_HEAD + _STL_TRIANGLE * triangles
    of = f"of {triangles} triangles"
    if size < _STL_HEAD:
        expected, of = _STL_HEAD, "of no triangle"
    if size < expected:
        raise InputError(
            f"{path}: cut short: {size} bytes, {expected} expected (binary STL {of}); copy or "
            "export the surface again"
        )


def _obj_index(path: Path) -> str:
    """The first face of an OBJ file that names a vertex that is not there; empty without one."""
    lines = [
        line.split() for line in path.read_text(encoding="utf-8", errors="replace").split("\n")
    ]
    count = sum(words[:1] == ["v"] for words in lines)
    for number, words in enumerate(lines, start=1):
        for corner in words[1:] if words[:1] == ["f"] else []:
            vertex = corner.split("/")[0]
            if vertex.lstrip("-").isdigit() and not 1 <= abs(int(vertex)) <= count:
                return f"line {number}: a face names vertex {vertex}; allowed: 1 to {count}"
    return ""


def _read_triangles(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    parts = read_parts(path)
    vertices = [np.asarray(part.vertices, dtype=np.float64).reshape(-1, 3) for part in parts]
    faces = [np.asarray(part.faces, dtype=np.int64).reshape(-1, 3) for part in parts]
    if not parts or not sum(len(triangles) for triangles in faces):
        raise InputError(f"{path}: no triangles in it; a closed triangle surface is needed")
    starts = np.cumsum([0, *(len(points) for points in vertices[:-1])])
    return (
        np.concatenate(vertices),
        np.concatenate([part + start for part, start in zip(faces, starts, strict=True)]),
    )


def _scene_parts(loaded: Any) -> list[trimesh.Trimesh]:
    """Return the meshes of a file with several, each moved to its place."""
    if not isinstance(loaded, trimesh.Scene):
        return []
    parts = []
    for node in loaded.graph.nodes_geometry:
        transform, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        if isinstance(mesh, trimesh.Trimesh):
            parts.append(mesh.copy().apply_transform(transform))
    return parts


def _merge_equal(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Merge equal vertices, keeping the order of their first appearance."""
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[inverse.reshape(-1)][faces]
