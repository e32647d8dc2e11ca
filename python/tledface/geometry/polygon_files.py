"""Reading render surfaces as their files have them: vertex order, polygons, UVs, names."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.geometry.surfaces import _merge_equal, read_parts
from tledface.polygons import Labels, Polygons

__all__ = ["read_polygons"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LABEL_WORDS = {"o": "object", "g": "group", "usemtl": "material"}


def read_polygons(path: str | Path, *, unit_scale: float = 1.0) -> tuple[Floats, Polygons]:
    """Read a surface to be shown, open or closed, vertex for vertex.

    Args:
        path: An OBJ, OFF, PLY, STL or glTF file, by its ending.
        unit_scale: Metres in one unit of the file.

    Returns:
        vertices (nv, 3) m in the file's order (equal ones of an STL file merged, in the order of
        their first appearance), and the faces. OBJ keeps texture and normal indices, objects,
        groups and materials; PLY and glTF texture coordinates; OBJ, OFF and PLY polygons of more
        than three corners.

    Raises:
        InputError: no such file, an unknown ending, not readable as that format, no faces, a
            vertex that is not finite, an index that does not exist.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending == ".obj" or (ending == ".off" and _is_plain_off(path)):
        _check_file(path)
        text = path.read_text(encoding="utf-8", errors="replace")
        try:
            vertices, polygons = _parse_obj(text) if ending == ".obj" else _parse_off(text)
        except (ValueError, IndexError, OverflowError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"{path}: cannot be read as {ending[1:].upper()} ({reason}); export the surface "
                "again"
            ) from None
    else:
        vertices, polygons = _of_parts(path)
    if not len(polygons.sizes):
        raise InputError(f"{path}: no faces in it; a surface is needed")
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        raise InputError(
            f"{path}: vertex {int(np.argmin(finite))} is not finite "
            f"({np.count_nonzero(~finite)} such of {len(vertices)}); repair the mesh"
        )
    polygons.check(len(vertices), str(path))
    return np.ascontiguousarray(vertices) * unit_scale, polygons


def _check_file(path: Path) -> None:
    if not path.is_file():
        raise InputError(f"{path}: {'is not a file' if path.exists() else 'no such surface file'}")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; export the surface again")


def _is_plain_off(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4).rstrip() == b"OFF"


def _numbers(tokens: list[str], columns: int) -> Floats:
    return np.fromiter(map(float, tokens), np.float64, len(tokens)).reshape(-1, columns)


def _parse_obj(text: str) -> tuple[Floats, Polygons]:
    vertices: list[str] = []
    texture: list[str] = []
    n_vertices = n_texture = n_normals = 0
    corners: list[list[str]] = []
    # How many vertices, texture coordinates and normals there were: negative indices count back.
    seen: list[tuple[int, int, int]] = []
    libraries: list[str] = []
    current: dict[str, int] = {}
    names: dict[str, dict[str, int]] = {}
    label_runs: dict[str, list[tuple[int, int]]] = {}
    for line in text.replace("\\\n", " ").splitlines():
        words = line.split()
        if not words or words[0][0] == "#":
            continue
        word = words[0]
        if word == "v":
            vertices += _exactly(words, 3)
            n_vertices += 1
        elif word == "vt":
            texture += words[1:3] if len(words) > 2 else [*_exactly(words, 1), "0"]
            n_texture += 1
        elif word == "vn":
            n_normals += 1
        elif word == "f":
            corners.append(words[1:])
            seen.append((n_vertices, n_texture, n_normals))
        elif word in _LABEL_WORDS:
            kind = _LABEL_WORDS[word]
            name = " ".join(words[1:])
            known = names.setdefault(kind, {})
            current[kind] = known.setdefault(name, len(known))
            label_runs.setdefault(kind, []).append((len(corners), current[kind]))
        elif word == "mtllib":
            libraries.append(" ".join(words[1:]))
    sizes = np.fromiter(map(len, corners), np.int32, len(corners))
    index = _corner_indices(list(chain.from_iterable(corners)))
    before = np.repeat(np.array(seen, dtype=np.int64).reshape(-1, 3), sizes, axis=0)
    index = np.where(index < 0, index + before, index - 1)
    has_uv, has_normals = bool((index[:, 1] >= 0).any()), bool((index[:, 2] >= 0).any())
    polygons = Polygons(
        sizes,
        index[:, 0].astype(np.int32),
        uv=_numbers(texture, 2) if has_uv else None,
        uv_of=index[:, 1].astype(np.int32) if has_uv else None,
        normal_of=index[:, 2].astype(np.int32) if has_normals else None,
        n_normals=n_normals if has_normals else 0,
        labels={kind: _labels(names[kind], runs, len(sizes)) for kind, runs in label_runs.items()},
        library=" ".join(libraries),
    )
    return _numbers(vertices, 3), polygons


def _exactly(words: list[str], count: int) -> list[str]:
    if len(words) <= count:
        raise ValueError(f"'{' '.join(words)}' needs {count} numbers")
    return words[1 : count + 1]


def _corner_indices(corners: list[str]) -> Ints:
    """Vertex, texture and normal index of corners such as "1", "1/2", "1//3"; 0 is none."""
    slashes = set(map(_count_slashes, corners))
    result = np.zeros((len(corners), 3), dtype=np.int64)
    if len(slashes) == 1 and not any(map(_ends_open, corners)):
        columns = slashes.pop() + 1
        flat = " ".join(corners).replace("//", "/0/").replace("/", " ").split()
        values = np.fromiter(map(int, flat), np.int64, len(flat))
        result[:, :columns] = values.reshape(-1, columns)
    else:
        for row, corner in enumerate(corners):
            parts = corner.split("/")
            result[row, : len(parts)] = [int(part) if part else 0 for part in parts]
    if (result[:, 0] == 0).any():
        raise ValueError("a face names vertex 0; OBJ counts from 1")
    return result


def _count_slashes(corner: str) -> int:
    return corner.count("/")


def _ends_open(corner: str) -> bool:
    return corner[-1] == "/"


def _labels(names: dict[str, int], runs: list[tuple[int, int]], n_polygons: int) -> Labels:
    of = np.full(n_polygons, -1, dtype=np.int32)
    for first, label in runs:
        of[first:] = label
    return Labels(list(names), of)


def _parse_off(text: str) -> tuple[Floats, Polygons]:
    lines = [words for line in text.splitlines() if (words := line.partition("#")[0].split())]
    head = lines[0][1:] or lines[1]
    body = lines[1:] if lines[0][1:] else lines[2:]
    n_vertices, n_faces = int(head[0]), int(head[1])
    if n_vertices < 0 or n_faces < 0 or len(body) < n_vertices + n_faces:
        raise ValueError(f"{len(body)} lines for {n_vertices} vertices and {n_faces} faces")
    points = list(chain.from_iterable(_exactly(["v", *row], 3) for row in body[:n_vertices]))
    faces = body[n_vertices : n_vertices + n_faces]
    sizes = np.fromiter((int(row[0]) for row in faces), np.int32, n_faces)
    corners = [_exactly(row, int(row[0])) for row in faces]
    flat = list(chain.from_iterable(corners))
    return _numbers(points, 3), Polygons(sizes, np.fromiter(map(int, flat), np.int32, len(flat)))


def _of_parts(path: Path) -> tuple[Floats, Polygons]:
    """Read what trimesh reads, its parts one after another."""
    parts = read_parts(path)
    if not parts:
        raise InputError(f"{path}: no faces in it; a surface is needed")
    vertices, polygons = [], []
    start = 0
    for part in parts:
        points = np.asarray(part.vertices, dtype=np.float64).reshape(-1, 3)
        sizes, corners = _ply_polygons(part)
        if sizes is None or corners is None:
            triangles = np.asarray(part.faces, dtype=np.int64).reshape(-1, 3)
            sizes, corners = np.full(len(triangles), 3, dtype=np.int32), triangles.reshape(-1)
        vertices.append(points)
        polygons.append((sizes, corners + start, _texture(part)))
        start += len(points)
    points = np.concatenate(vertices)
    sizes = np.concatenate([part[0] for part in polygons])
    corners = np.concatenate([part[1] for part in polygons])
    if path.suffix.lower() == ".stl":
        points, corners = _merge_equal(points, corners)
    uv = [part[2] for part in polygons if part[2] is not None]
    textured = len(uv) == len(polygons)
    index = corners.astype(np.int32)
    return points, Polygons(
        sizes,
        index,
        uv=np.concatenate(uv) if textured else None,
        # These formats have one texture coordinate a vertex.
        uv_of=index.copy() if textured else None,
    )


def _ply_polygons(part: trimesh.Trimesh) -> tuple[Any, Any]:
    """Sizes and corners of a PLY file's polygons; trimesh itself keeps triangles only."""
    lists = part.metadata.get("_ply_raw", {}).get("face", {}).get("data", {})
    names = lists.dtype.names if hasattr(lists, "dtype") else lists
    for name in ("vertex_indices", "vertex_index"):
        if not names or name not in names:
            continue
        rows = lists[name]
        if getattr(rows, "dtype", None) is not None and rows.dtype.names:
            rows = rows[rows.dtype.names[-1]]
        rows = [np.asarray(row, dtype=np.int64).reshape(-1) for row in rows]
        sizes = np.fromiter(map(len, rows), np.int32, len(rows))
        return sizes, np.concatenate([*rows, np.empty(0, dtype=np.int64)])
    return None, None


def _texture(part: trimesh.Trimesh) -> Floats | None:
    uv = getattr(part.visual, "uv", None)
    if uv is None:
        columns = part.metadata.get("_ply_raw", {}).get("vertex", {}).get("data", {})
        known = columns.dtype.names if hasattr(columns, "dtype") else columns
        for pair in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")):
            if known and all(name in known for name in pair):
                uv = np.stack([np.asarray(columns[name]).reshape(-1) for name in pair], axis=1)
    if uv is None or np.shape(uv) != (len(part.vertices), 2):
        return None
    return np.array(uv, dtype=np.float64)
