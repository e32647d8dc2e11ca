"""Points and polylines from files, and the nodes near them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError

__all__ = ["near_lines", "read_lines"]

Floats = NDArray[np.float64]


def read_lines(path: str | Path, *, unit_scale: float = 1.0) -> list[Floats]:
    """Read points and polylines.

    Args:
        path: An OBJ file (its ``l`` and ``p`` elements), or text with three numbers a line,
            separated by spaces or commas, with an empty line between two polylines; # begins a
            comment.
        unit_scale: Metres in one unit of the file.

    Returns:
        (n, 3) m for each polyline; a single point has n = 1.

    Raises:
        InputError: not readable as that, or nothing in it.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        lines = _obj_lines(text) if path.suffix.lower() == ".obj" else _text_lines(text)
    except (OSError, UnicodeDecodeError, ValueError, IndexError) as error:
        raise InputError(
            f"{path}: cannot be read as lines ({' '.join(str(error).split())}); allowed: OBJ with "
            "l elements, or three numbers a line with an empty line between two lines"
        ) from None
    if not lines:
        raise InputError(f"{path}: no points or lines in it; OBJ needs l or p elements")
    if not all(np.isfinite(line).all() for line in lines):
        raise InputError(f"{path}: coordinates must be finite")
    return [line * unit_scale for line in lines]


def _text_lines(text: str) -> list[Floats]:
    lines: list[list[list[float]]] = [[]]
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            if not line.strip():
                lines.append([])
            continue
        if len(words) != 3:
            raise ValueError(f"line {number} has {len(words)} numbers, needed are 3")
        lines[-1].append([float(word) for word in words])
    return [np.array(line) for line in lines if line]


def _obj_lines(text: str) -> list[Floats]:
    points: list[list[float]] = []
    lines: list[Floats] = []
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            if len(words) < 4:
                raise ValueError(f"'{line.strip()}' needs three numbers")
            points.append([float(word) for word in words[1:4]])
        elif words[:1] in (["l"], ["p"]):
            index = [int(word.partition("/")[0]) for word in words[1:]]
            if any(not 1 <= abs(i) <= len(points) for i in index):
                raise ValueError(f"'{line.strip()}' names a vertex that is not there")
            corners = np.array([points[i - 1 if i > 0 else i] for i in index])
            lines += [corners] if words[0] == "l" else [corner[None] for corner in corners]
    return [line for line in lines if len(line)]


def near_lines(points: Floats, lines: Sequence[Floats], radius: float) -> NDArray[np.bool_]:
    """Which points (n, 3) lie within ``radius`` (m) of any of the polylines, border included."""
    near = np.zeros(len(points), dtype=bool)
    for line in lines:
        for start, end in zip(line, line[1:] if len(line) > 1 else line, strict=False):
            low, high = np.minimum(start, end) - radius, np.maximum(start, end) + radius
            inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
            run = end - start
            length2 = float(run @ run)
            offset = points[inside] - start
            share = np.clip(offset @ run / length2, 0.0, 1.0) if length2 > 0.0 else 0.0
            away = offset - np.multiply.outer(share, run)
            near[inside] |= np.einsum("ij,ij->i", away, away) <= radius**2
    return near
