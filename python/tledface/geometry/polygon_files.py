"""Reading render surfaces as their files have them: vertex order, polygons, UVs, names."""

from __future__ import annotations

import itertools
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

_MAX_INDEX = 2**31 - 1
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
    vertices: list[Floats] = []
    texture: list[Floats] = []
    n_vertices = n_texture = n_normals = n_faces = 0
    sizes: list[NDArray[np.int32]] = []
    corners: list[Ints] = []
    libraries: list[str] = []
    names: dict[str, dict[str, int]] = {}
    label_runs: dict[str, list[tuple[int, int]]] = {}
    # Files have long runs of lines of one kind, which are read at once.
    lines = text.replace("\\\n", " ").splitlines()
    for word, run in itertools.groupby(lines, _first_word):
        if word == "v":
            vertices.append(_rows([*run], word, 3))
            n_vertices += len(vertices[-1])
        elif word == "vt":
            texture.append(_rows([*run], word, 2, short=True))
            n_texture += len(texture[-1])
        elif word == "vn":
            n_normals += sum(1 for _ in run)
        elif word == "f":
            rows = [*run]
            words = " ".join(rows).split()
            each, left_over = divmod(len(words), len(rows))
            if left_over or words[::each].count("f") != len(rows):
                split = [row.split()[1:] for row in rows]
                sizes.append(np.fromiter(map(len, split), np.int32, len(split)))
                words = list(itertools.chain.from_iterable(split))
            else:
                sizes.append(np.full(len(rows), each - 1, dtype=np.int32))
                del words[::each]
            index = _corner_indices(words)
            # Negative indices count back from what there is by now.
            before = np.array([n_vertices, n_texture, n_normals])
            if (index < -before).any() or (np.abs(index) > _MAX_INDEX).any():
                raise ValueError("a face names what is not there")
            index = np.where(index < 0, index + before, index - 1)
            corners.append(index)
            n_faces += len(rows)
        elif word in _LABEL_WORDS:
            kind = _LABEL_WORDS[word]
            for line in run:
                known = names.setdefault(kind, {})
                label = known.setdefault(" ".join(line.split()[1:]), len(known))
                label_runs.setdefault(kind, []).append((n_faces, label))
        elif word == "mtllib":
            libraries += [" ".join(line.split()[1:]) for line in run]
    table = np.concatenate([*corners, np.empty((0, 3), dtype=np.int64)])
    has_uv, has_normals = bool((table[:, 1] >= 0).any()), bool((table[:, 2] >= 0).any())
    polygons = Polygons(
        np.concatenate([*sizes, np.empty(0, dtype=np.int32)]),
        table[:, 0].astype(np.int32),
        uv=np.concatenate([*texture, np.empty((0, 2))]) if has_uv else None,
        uv_of=table[:, 1].astype(np.int32) if has_uv else None,
        normal_of=table[:, 2].astype(np.int32) if has_normals else None,
        n_normals=n_normals if has_normals else 0,
        labels={kind: _labels(names[kind], runs, n_faces) for kind, runs in label_runs.items()},
        library=" ".join(libraries),
    )
    return np.concatenate([*vertices, np.empty((0, 3))]), polygons


def _first_word(line: str) -> str:
    return line[: line.find(" ")] if line[:1].isalpha() and " " in line else _slow_word(line)


def _slow_word(line: str) -> str:
    words = line.split(None, 1)
    return words[0] if words else ""


def _rows(lines: list[str], word: str, columns: int, *, short: bool = False) -> Floats:
    """The first numbers of each line, (n, columns); with ``short`` a missing one is 0."""
    words = " ".join(lines).split()
    each, left_over = divmod(len(words), len(lines))
    if left_over or each <= columns or words[::each].count(word) != len(lines):
        rows = [line.split() for line in lines]
        if short:
            rows = [row if len(row) > columns else [*row, "0"] for row in rows]
        words = [number for row in rows for number in _exactly(row, columns)]
    else:
        words = [number for n in range(columns) for number in words[n + 1 :: each]]
        return np.fromiter(map(float, words), np.float64, len(words)).reshape(columns, -1).T
    return _numbers(words, columns)


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
    points = list(
        itertools.chain.from_iterable(_exactly(["v", *row], 3) for row in body[:n_vertices])
    )
    faces = body[n_vertices : n_vertices + n_faces]
    sizes = np.fromiter((int(row[0]) for row in faces), np.int32, n_faces)
    corners = [_exactly(row, int(row[0])) for row in faces]
    flat = list(map(int, itertools.chain.from_iterable(corners)))
    if flat and max(flat) > _MAX_INDEX:
        raise ValueError("a face names what is not there")
    return _numbers(points, 3), Polygons(sizes, np.array(flat, dtype=np.int32))


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
