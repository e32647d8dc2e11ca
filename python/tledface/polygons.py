"""The faces of a render surface as its file has them: polygons, texture coordinates, names.

A corner is one use of a vertex by a polygon. Texture coordinates and normals have indices of their
own at the corners, as in OBJ files: a vertex on a seam stays one vertex.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError

__all__ = ["Labels", "Polygons"]

Ints = NDArray[np.int32]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Labels:
    """Names that polygons carry: ``of`` (n_polygons,) int32 indexes ``names``, -1 has none."""

    names: list[str]
    of: Ints


@dataclass(frozen=True, eq=False)
class Polygons:
    """Polygons of any number of corners; make one with `Polygons.of_triangles`, or read
    it with `tledface.geometry.read_polygons`.

    Attributes:
        sizes: (n_polygons,) int32, corners of each.
        vertex: (n_corners,) int32, vertex of each corner.
        uv: (n_uv, 2) float64, or None.
        uv_of: (n_corners,) int32 into ``uv``, -1 where a corner has none; None without ``uv``.
        normal_of: (n_corners,) int32, which corners share a normal, -1 for none; or None. The
            normals themselves follow from the shape, see `corner_normals`.
        n_normals: How many normals ``normal_of`` counts.
        labels: Names by kind: "object", "group", "material".
        library: The material library a file names (OBJ's mtllib), or "".
    """

    sizes: Ints
    vertex: Ints
    uv: Floats | None = None
    uv_of: Ints | None = None
    normal_of: Ints | None = None
    n_normals: int = 0
    labels: dict[str, Labels] = field(default_factory=dict)
    library: str = ""

    @classmethod
    def of_triangles(cls, faces: ArrayLike) -> Polygons:
        """Plain triangles, (nf, 3) int."""
        triangles = np.asarray(faces, dtype=np.int32).reshape(-1, 3)
        return cls(np.full(len(triangles), 3, dtype=np.int32), triangles.reshape(-1))

    @property
    def is_plain(self) -> bool:
        """Whether these are triangles without texture coordinates, normals and names."""
        return not (
            (self.sizes != 3).any()
            or self.uv is not None
            or self.normal_of is not None
            or self.labels
            or self.library
        )

    @property
    def starts(self) -> NDArray[np.int64]:
        """First corner of each polygon, and the end: (n_polygons + 1,)."""
        return np.concatenate([[0], np.cumsum(self.sizes, dtype=np.int64)])

    def triangle_corners(self) -> NDArray[np.int64]:
        """Corners of the triangles that polygons fall into, fans from their first: (nf, 3)."""
        count = self.sizes.astype(np.int64) - 2
        polygon = np.repeat(np.arange(len(count)), count)
        within = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        first = self.starts[polygon]
        return np.stack([first, first + within + 1, first + within + 2], axis=1)

    def triangles(self) -> Ints:
        """Vertices of those triangles, (nf, 3) int32."""
        return np.ascontiguousarray(self.vertex[self.triangle_corners()])

    def corner_normals(self, vertices: ArrayLike) -> Floats:
        """Return the (n_normals, 3) unit normals of a shape with the sharing of ``normal_of``.

        Each is the mean of the triangles at its corners, weighted by their area; zero where no
        corner uses it.
        """
        points = np.asarray(vertices, dtype=np.float64)
        total = np.zeros((self.n_normals, 3))
        if self.normal_of is None:
            return total
        corners = self.triangle_corners()
        a, b, c = (points[self.vertex[corners[:, n]]] for n in range(3))
        area = np.cross(b - a, c - a)
        for n in range(3):
            shared = self.normal_of[corners[:, n]]
            used = shared >= 0
            for axis in range(3):
                total[:, axis] += np.bincount(
                    shared[used], area[used, axis], minlength=self.n_normals
                )
        length = np.linalg.norm(total, axis=1)
        return total / np.where(length > 0.0, length, 1.0)[:, None]

    def check(self, n_vertices: int, where: str) -> None:
        """Raise InputError unless all indices exist and every polygon has three corners."""
        if (self.sizes < 3).any():
            number = int(np.argmax(self.sizes < 3))
            raise InputError(
                f"{where}: face {number} has {self.sizes[number]} corners, needed are 3 or more; "
                "export the surface again"
            )
        checks: list[tuple[str, Any, int, int]] = [("vertex", self.vertex, n_vertices, 0)]
        if self.uv is not None:
            checks.append(("texture coordinate", self.uv_of, len(self.uv), -1))
        if self.normal_of is not None:
            checks.append(("normal", self.normal_of, self.n_normals, -1))
        for what, index, count, low in checks:
            if len(index) != int(self.sizes.sum()):
                raise InputError(f"{where}: {len(index)} {what} indices for {len(self.vertex)}")
            if len(index) and (index.min() < low or index.max() >= count):
                bad = int(index.min() if index.min() < low else index.max())
                raise InputError(
                    f"{where}: a face names {what} {bad + 1} of {count}; export the surface again"
                )
