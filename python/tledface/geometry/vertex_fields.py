"""Values on the vertices of a surface file, carried to the vertices of its checked volume."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.geometry.surfaces import SurfaceFile, read_parts

__all__ = ["on_solid", "painted", "values_of_file", "vertex_property"]

Floats = NDArray[np.float64]


def vertex_property(surface: SurfaceFile, name: str) -> Floats:
    """Return a vertex property of a PLY file, (nv,), as it stands there.

    Raises InputError: another kind of file, no such property (says which there are).
    """
    if surface.path.suffix.lower() != ".ply":
        raise InputError(
            f"{surface.path}: only PLY files have vertex properties by name; give the values in a "
            'file of their own, as { file = "values.npy" }'
        )
    data: dict[str, Any] = {}
    for part in read_parts(surface.path):
        raw = part.metadata.get("_ply_raw", {}).get("vertex", {}).get("data", {})
        held = getattr(getattr(raw, "dtype", None), "names", None) or list(raw)
        data |= {key: np.ravel(raw[key]) for key in held}
    if name not in data:
        raise InputError(
            f"{surface.path}: no vertex property {name!r}; it has {', '.join(data) or 'none'}"
        )
    return _checked(data[name], surface, f"vertex property {name!r}")


def values_of_file(surface: SurfaceFile, path: Path) -> Floats:
    """Return the values of a file with one per vertex of the surface's file, (nv,).

    ``.npy``, or text: numbers separated by commas, blanks or lines.

    Raises InputError: not readable, another number of values, a value that is not finite.
    """
    try:
        if path.suffix.lower() == ".npy":
            values = np.load(path, allow_pickle=False)
        else:
            text = path.read_text(encoding="utf-8").replace(",", " ").split()
            values = np.array([float(word) for word in text])
    except (OSError, ValueError, UnicodeDecodeError, EOFError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as numbers ({reason})") from None
    return _checked(np.ravel(values), surface, str(path))


def painted(surface: SurfaceFile, channel: str) -> Floats:
    """Return the vertex colour of a surface file from 0 to 1, (nv,): grey, red, green or blue.

    Raises InputError: the file has no vertex colours.
    """
    colours = []
    for part in read_parts(surface.path):
        visual: Any = part.visual
        if visual.kind != "vertex":
            raise InputError(
                f"{surface.path}: has no vertex colours; paint it and export as PLY, OBJ with "
                "colours or glTF"
            )
        colours.append(np.asarray(visual.vertex_colors)[:, :3] / 255.0)
    rgb = np.concatenate(colours)
    index = {"red": 0, "green": 1, "blue": 2}.get(channel)
    level = rgb.mean(axis=1) if index is None else rgb[:, index]
    return _checked(level, surface, "vertex colours")


def on_solid(surface: SurfaceFile, values: Floats) -> Floats:
    """Carry values of the file's vertices, (nv,), to those of the solid.

    Vertices at one place that were merged give their mean; what a filled hole added takes the
    mean of its neighbours.
    """
    solid = surface.solid
    ours = solid.vertices
    # Adding 0 makes -0 and 0 the same row, as they are the same place.
    rows = np.concatenate([surface.vertices, ours]) + 0.0
    _, group = np.unique(rows, axis=0, return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group[: len(values)], minlength=group.max() + 1)
    total = np.bincount(group[: len(values)], weights=values, minlength=group.max() + 1)
    slot = group[len(values) :]
    known = count[slot] > 0
    result = np.zeros(len(ours))
    result[known] = total[slot[known]] / count[slot[known]]
    sides = solid.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    while not known.all():
        inward = sides[known[sides[:, 1]] & ~known[sides[:, 0]]]
        number = np.bincount(inward[:, 0], minlength=len(ours))
        summed = np.bincount(inward[:, 0], weights=result[inward[:, 1]], minlength=len(ours))
        new = number > 0
        if not new.any():
            result[~known] = result[known].mean()
            break
        result[new] = summed[new] / number[new]
        known = known | new
    return result


def _checked(values: Sequence[float] | NDArray[Any], surface: SurfaceFile, what: str) -> Floats:
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.shape != (len(surface.vertices),):
        raise InputError(
            f"{what}: {numbers.size} values, {surface.path} has {len(surface.vertices)} vertices; "
            "one each is needed"
            + ("; STL files have no vertices of their own, take PLY" if _is_stl(surface) else "")
        )
    if not np.isfinite(numbers).all():
        bad = int(np.argmin(np.isfinite(numbers)))
        raise InputError(f"{what}: the value of vertex {bad} is {numbers[bad]}, need finite ones")
    return numbers


def _is_stl(surface: SurfaceFile) -> bool:
    return surface.path.suffix.lower() == ".stl"
