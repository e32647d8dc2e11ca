"""Points spread over a surface, with normals and areas: what an integral over it sums."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tledface import _core

__all__ = ["SurfacePoints", "surface_points"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points (n, 3) m, outward unit normals (n, 3) and areas (n,) m2 of a surface."""

    points: Floats
    normals: Floats
    areas: Floats


def surface_points(solid: _core.Surface, spacing: float) -> SurfacePoints:
    """Return points less than ``spacing`` (m) apart: the centroids of equal parts of each face."""
    corners = solid.vertices[solid.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    normal = cross / np.maximum(2.0 * area, 1e-300)[:, None]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    pieces = np.ceil(edges / spacing).astype(int).clip(1)
    found = []
    for count in np.unique(pieces):
        chosen = pieces == count
        i, j = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
        upright = np.stack([i, j], axis=-1)[i + j < count] + 1.0 / 3.0
        turned = np.stack([i, j], axis=-1)[i + j < count - 1] + 2.0 / 3.0
        at = np.concatenate([upright, turned]) / count
        weights = np.column_stack([1.0 - at.sum(axis=1), at])
        points = np.einsum("pc,fck->fpk", weights, corners[chosen]).reshape(-1, 3)
        found.append(
            (
                points,
                np.repeat(normal[chosen], len(at), axis=0),
                np.repeat(area[chosen] / len(at), len(at)),
            )
        )
    points, normals, areas = (np.concatenate(part) for part in zip(*found, strict=True))
    return SurfacePoints(points, normals, areas)
