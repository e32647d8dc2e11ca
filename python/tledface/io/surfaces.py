"""Surfaces for other tools, vertex for vertex and face for face."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError
from tledface.io._atomic import atomic_path
from tledface.polygons import Polygons

__all__ = ["SURFACE_ENDINGS", "write_surface"]

SURFACE_ENDINGS = (".ply", ".stl", ".obj", ".off", ".glb")

_OBJ_WORDS = {"object": "o", "group": "g", "material": "usemtl"}


def write_surface(path: str | Path, vertices: ArrayLike, faces: ArrayLike | Polygons) -> None:
    """Write a surface in the format of the file's ending.

    Args:
        path: A name ending in .ply, .stl, .obj, .off or .glb; replaced when complete.
        vertices: (nv, 3) float, m.
        faces: (nf, 3) int, or polygons. OBJ keeps all they hold, with normals of the shape as it
            is now; PLY keeps polygons of more than three corners, the others triangles.

    Raises:
        InputError: an unknown ending, or no such folder.

    Vertex order is kept, so files of several frames correspond (STL has no shared vertices).
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in SURFACE_ENDINGS:
        raise InputError(
            f"surface file {path}: ending {path.suffix!r} is not known; allowed: "
            + ", ".join(SURFACE_ENDINGS)
        )
    points = np.asarray(vertices)
    if isinstance(faces, Polygons) and not faces.is_plain and ending in (".obj", ".ply"):
        with atomic_path(path, "surface file") as part:
            if ending == ".obj":
                with part.open("w", encoding="utf-8") as text:
                    _write_obj(text, points, faces)
            else:
                with part.open("wb") as binary:
                    _write_ply(binary, points, faces)
        return
    triangles = faces.triangles() if isinstance(faces, Polygons) else np.asarray(faces)
    mesh = trimesh.Trimesh(points, triangles, process=False)
    with atomic_path(path, "surface file") as part:
        mesh.export(part, file_type=ending[1:])


def _write_obj(file: TextIO, vertices: NDArray[Any], polygons: Polygons) -> None:
    if polygons.library:
        file.write(f"mtllib {polygons.library}\n")
    _write_rows(file, "v %.9g %.9g %.9g\n", vertices)
    if polygons.uv is not None:
        _write_rows(file, "vt %.9g %.9g\n", polygons.uv)
    if polygons.normal_of is not None:
        _write_rows(file, "vn %.6f %.6f %.6f\n", polygons.corner_normals(vertices))
    words = _corner_words(polygons)
    changes: dict[int, list[str]] = {}
    for kind in ("object", "group", "material"):
        labels = polygons.labels.get(kind)
        if labels is None:
            continue
        changed = np.flatnonzero(np.diff(labels.of, prepend=-1))
        for polygon in changed.tolist():
            name = labels.names[labels.of[polygon]]
            changes.setdefault(polygon, []).append(f"{_OBJ_WORDS[kind]} {name}\n")
    for polygon, (first, end) in enumerate(itertools.pairwise(polygons.starts.tolist())):
        if polygon in changes:
            file.writelines(changes[polygon])
        file.write(f"f {' '.join(words[first:end])}\n")


def _write_rows(file: TextIO, form: str, values: NDArray[Any]) -> None:
    file.writelines(form % row for row in map(tuple, values.tolist()))


def _corner_words(polygons: Polygons) -> list[str]:
    """The corners as OBJ writes them: "1", "1/2", "1//3", "1/2/3"."""
    vertex = (polygons.vertex + 1).tolist()
    none = [0] * len(vertex)
    uv = none if polygons.uv_of is None else (polygons.uv_of + 1).tolist()
    normal = none if polygons.normal_of is None else (polygons.normal_of + 1).tolist()
    if uv is none and normal is none:
        return [str(index) for index in vertex]
    return [
        f"{v}/{t or ''}/{n}" if n else f"{v}/{t}" if t else f"{v}"
        for v, t, n in zip(vertex, uv, normal, strict=True)
    ]


def _write_ply(file: BinaryIO, vertices: NDArray[Any], polygons: Polygons) -> None:
    sizes, n_polygons = polygons.sizes, len(polygons.sizes)
    # Several readers take binary lists of one length only.
    binary = bool((sizes == sizes[0]).all())
    file.write(
        f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\n"
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {n_polygons}\nproperty list int int vertex_indices\nend_header\n".encode()
    )
    if not binary:
        np.savetxt(file, vertices, "%.9g")
        corners, starts = [str(v) for v in polygons.vertex.tolist()], polygons.starts.tolist()
        rows = (corners[a:b] for a, b in itertools.pairwise(starts))
        file.writelines(f"{len(row)} {' '.join(row)}\n".encode() for row in rows)
        return
    file.write(np.ascontiguousarray(vertices, dtype="<f4").tobytes())
    rows_of = polygons.vertex.reshape(n_polygons, -1)
    file.write(np.ascontiguousarray(np.column_stack([sizes, rows_of]), dtype="<i4").tobytes())
