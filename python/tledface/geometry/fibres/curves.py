"""Fibres from curves that a user has drawn: reading them, and the field between them."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial import cKDTree

from tledface.errors import InputError
from tledface.geometry.fibres.ends import polyline_points
from tledface.geometry.fibres.potential import GridField, MuscleGrid

__all__ = ["CURVE_FORMATS", "check_curves", "curve_field", "read_curves"]

Floats = NDArray[np.float64]

CURVE_FORMATS = (".obj", ".csv", ".npy")
# Weight of a curve at distance d: 1 / d^4. The nearest ones decide, and the change from one to
# the next is smooth.
_POWER = 4


def read_curves(path: str | Path, *, unit_scale: float = 1.0) -> list[Floats]:
    """Read curves along fibres.

    Args:
        path: ``.obj`` with ``l`` elements; ``.csv`` with columns x, y, z and, for several curves,
            a first column that numbers or names the curve, with or without a line of headings;
            ``.npy`` (n, 3) for one curve or (m, n, 3) for m.
        unit_scale: Metres in one unit of the file.

    Returns:
        (n, 3) m for each curve, n at least 2, repeated points left out.

    Raises:
        InputError: no such file, another ending, not readable, no curve, a point that is not
            finite, a curve without length.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file of curves; paths start at the scene file's folder")
    readers = {".obj": _read_obj, ".csv": _read_csv, ".npy": _read_npy}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"{path}: ending {path.suffix!r} is not known for curves; allowed: "
            f"{', '.join(CURVE_FORMATS)}"
        )
    try:
        curves = reader(path)
    except (ValueError, IndexError, OSError, EOFError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read as curves ({reason})") from None
    return [unit_scale * curve for curve in check_curves(curves, str(path))]


def check_curves(curves: Sequence[ArrayLike], name: str) -> list[Floats]:
    """Curves (n, 3) without repeated points; raises InputError as `read_curves` does."""
    if not len(curves):
        raise InputError(f"{name}: no curve in it; give lines of at least two points")
    result = []
    for number, given in enumerate(curves):
        curve = np.asarray(given, dtype=np.float64)
        if curve.ndim != 2 or curve.shape[1] != 3:
            raise InputError(f"{name}: curve {number} has shape {curve.shape}; need (n, 3) points")
        if not np.isfinite(curve).all():
            raise InputError(f"{name}: curve {number} has a point that is not finite")
        moves = np.r_[True, np.linalg.norm(np.diff(curve, axis=0), axis=1) > 0.0][: len(curve)]
        if moves.sum() < 2:
            raise InputError(f"{name}: curve {number} has no length; give two points or more")
        result.append(curve[moves])
    return result


def curve_field(grid: MuscleGrid, curves: list[Floats]) -> GridField:
    """Directions between curves: the mean of their tangents, nearest points first.

    Each node takes from every curve the tangent at its nearest point, weighted with 1 / distance^4.
    Curves are turned to run the same way as their neighbours first.
    """
    lines = [polyline_points(curve, grid.spacing) for curve in curves]
    tangents = [np.gradient(line, axis=0) for line in lines]
    lines, tangents = _same_way(lines, tangents)
    nodes = grid.positions
    total = np.zeros_like(nodes)
    for line, tangent in zip(lines, tangents, strict=True):
        distance, nearest = cKDTree(line).query(nodes)
        # Curves pass nodes at any small distance: nearer than part of a cell all count alike.
        weight = (distance**2 + (0.25 * grid.spacing) ** 2) ** (-_POWER / 2) * grid.spacing**_POWER
        total += (weight / np.linalg.norm(tangent[nearest], axis=1))[:, None] * tangent[nearest]
    return grid.field(total)


def _same_way(lines: list[Floats], tangents: list[Floats]) -> tuple[list[Floats], list[Floats]]:
    """Turn curves so that each runs the way of the nearest one turned before it."""
    trees = [cKDTree(line) for line in lines]
    count = len(lines)
    gaps, agree = np.zeros((count, count)), np.zeros((count, count))
    for a in range(count):
        for b in range(a + 1, count):
            distance, other = trees[a].query(lines[b])
            near = int(np.argmin(distance))
            gaps[a, b] = distance[near] + 1e-12
            weight = 1.0 / (distance + distance.mean() + 1e-12) ** 2
            agree[a, b] = agree[b, a] = weight @ np.einsum(
                "ij,ij->i", tangents[a][other], tangents[b]
            )
    order, before = breadth_first_order(minimum_spanning_tree(gaps), 0, directed=False)
    sign = np.ones(count)
    for item in order[1:]:
        turn = -1.0 if agree[before[item], item] < 0.0 else 1.0
        sign[item] = sign[before[item]] * turn
    return lines, [s * tangent for s, tangent in zip(sign, tangents, strict=True)]


def _read_obj(path: Path) -> list[Floats]:
    points: list[list[float]] = []
    lines: list[list[int]] = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            points.append([float(word) for word in words[1:4]])
        elif words[:1] == ["l"]:
            numbers = [int(word.split("/")[0]) for word in words[1:]]
            # Counted from 1, or backwards from the last point so far.
            lines.append([n - 1 if n > 0 else len(points) + n for n in numbers])
    array = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    for numbers in lines:
        if min(numbers) < 0 or max(numbers) >= len(array):
            raise ValueError(f"a line names a point that is not there, of {len(array)}")
    return [array[numbers] for numbers in lines]


def _read_csv(path: Path) -> list[Floats]:
    with path.open(newline="", encoding="utf-8") as stream:
        rows = [row for row in csv.reader(stream) if row and not row[0].lstrip().startswith("#")]
    if rows and not _is_number(rows[0][-1]):
        rows = rows[1:]
    widths = {len(row) for row in rows}
    if rows and widths not in ({3}, {4}):
        raise ValueError(f"rows of {sorted(widths)} columns, need x, y, z or curve, x, y, z")
    curves: dict[str, list[list[float]]] = {}
    for row in rows:
        name = row[0].strip() if len(row) == 4 else ""
        curves.setdefault(name, []).append([float(cell) for cell in row[-3:]])
    return [np.asarray(curve) for curve in curves.values()]


def _read_npy(path: Path) -> list[Floats]:
    array = np.load(path, allow_pickle=False)
    if array.ndim not in (2, 3) or array.shape[-1] != 3 or array.dtype.kind not in "fiu":
        raise ValueError(f"numbers of shape {array.shape}, need (n, 3) or (m, n, 3)")
    return list(np.atleast_3d(array.astype(np.float64)).reshape(-1, array.shape[-2], 3))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
