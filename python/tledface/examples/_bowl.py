"""A bone curved in two directions, and closed surfaces at given heights over it.

Places are (u, v, h), mm: arc lengths on the bone from the middle, sideways and upwards, and the
height over it. The bone is a piece of a torus whose front looks along -y with +z up, so that a
constant h is a constant distance from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Bowl"]

Floats = NDArray[np.float64]
Solid = tuple[Floats, NDArray[np.int64]]


@dataclass(frozen=True)
class Bowl:
    """The bone's radii at its middle, mm: of its horizontal and of its upright section."""

    horizontal: float
    upright: float

    def places(self, u: ArrayLike, v: ArrayLike, h: ArrayLike) -> Floats:
        """Points (..., 3), mm, of places that broadcast to (...)."""
        u, v, h = np.broadcast_arrays(u, v, h)
        sideways, away = np.asarray(u) / self.horizontal, self.radius(v, h)
        z = (self.upright + np.asarray(h)) * np.sin(np.asarray(v) / self.upright)
        return np.stack([away * np.sin(sideways), -away * np.cos(sideways), z], axis=-1)

    def radius(self, v: ArrayLike, h: ArrayLike) -> Floats:
        """Distance from the upright axis, mm."""
        return np.asarray(
            self.horizontal
            - self.upright
            + (self.upright + np.asarray(h)) * np.cos(np.asarray(v) / self.upright)
        )

    def solid(self, u: Floats, v: Floats, low: Any, high: Any) -> Solid:
        """The closed solid over a grid of places between two heights.

        Args:
            u, v: (rows, columns) mm; v rises with the rows, u with the columns.
            low, high: Heights, numbers or (rows, columns), mm.

        Returns:
            Vertices (n, 3) mm, and faces (m, 3) that look outwards.
        """
        outer, inner = self.places(u, v, high), self.places(u, v, low)
        rows, columns = u.shape
        index = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
        # Diagonals alternate so that the sheet has no preferred direction.
        even = (np.add.outer(np.arange(rows - 1), np.arange(columns - 1)) % 2 == 0)[..., None]
        one = np.where(even, np.stack([a, b, c], -1), np.stack([a, b, d], -1)).reshape(-1, 3)
        two = np.where(even, np.stack([a, c, d], -1), np.stack([b, c, d], -1)).reshape(-1, 3)
        rim = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
        after = np.roll(rim, -1)
        n = rows * columns
        strips = (np.stack([rim, rim + n, after], 1), np.stack([after, rim + n, after + n], 1))
        sheet = np.concatenate([one, two])
        faces = np.concatenate([sheet, sheet[:, ::-1] + n, *strips])
        return np.concatenate([outer.reshape(-1, 3), inner.reshape(-1, 3)]), faces

    def sheet(
        self, left: Any, right: Any, bottom: float, top: float, low: float, high: float
    ) -> Solid:
        """A solid between two edges (functions of v, or numbers) and two heights on the bone."""
        v = np.linspace(bottom, top, max(2, round((top - bottom) / _SPACING) + 1))
        edges = [
            np.broadcast_to(edge(v) if callable(edge) else edge, v.shape) for edge in (left, right)
        ]
        columns = max(2, round(float((edges[1] - edges[0]).max()) / _SPACING) + 1)
        share = np.linspace(0.0, 1.0, columns)
        u = edges[0][:, None] * (1.0 - share) + edges[1][:, None] * share
        return self.solid(u, np.broadcast_to(v[:, None], u.shape), low, high)


# mm between the vertices of muscles, tendons and bones.
_SPACING = 1.5
