"""Closed boxes whose faces are grids of triangles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["box_surface"]


def box_surface(
    low: Sequence[float], high: Sequence[float], edge: float | None = None
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return a box as vertices (nv, 3) and outward faces (nf, 3).

    Args:
        low: Its low corner.
        high: Its high corner.
        edge: Legs of the triangles, about; None: two triangles a face.

    Diagonals alternate, so that no direction is preferred.
    """
    start, size = np.asarray(low, dtype=float), np.subtract(high, low)
    n = np.ones(3, dtype=int) if edge is None else np.maximum(np.rint(size / edge), 1).astype(int)
    triangles = []
    for axis in range(3):
        one, two = (axis + 1) % 3, (axis + 2) % 3
        i, j = np.meshgrid(np.arange(n[one]), np.arange(n[two]), indexing="ij")
        for side in (0, n[axis]):
            corners = np.empty((i.size, 4, 3), dtype=int)
            corners[..., axis] = side
            corners[..., one] = np.add.outer(i.ravel(), (0, 1, 1, 0))
            corners[..., two] = np.add.outer(j.ravel(), (0, 0, 1, 1))
            # Every other square starts at its next corner, which turns its diagonal.
            odd = (i + j).ravel() % 2 == 1
            corners[odd] = np.roll(corners[odd], 1, axis=1)
            if side == 0:
                corners = corners[:, ::-1]
            triangles += [corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]
    places = np.concatenate(triangles).reshape(-1, 3)
    vertices, faces = np.unique(places, axis=0, return_inverse=True)
    return start + vertices * (size / n), faces.reshape(-1, 3).astype(np.int64)
