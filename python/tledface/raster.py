"""An orthographic z-buffer in NumPy: which triangle covers a pixel, how high, and where in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError

__all__ = ["Raster", "box_mean", "rasterise", "view_axes"]

# Bounds the memory to about 0.2 GB.
_PIXELS_AT_ONCE = 2_000_000
# Pixels; closes the seams between neighbouring triangles.
_SEAM = 1e-9


@dataclass(frozen=True, eq=False)
class Raster:
    """Covered pixels of an image; row 0 is the lowest ordinate.

    Attributes:
        height: (rows, columns) float64, greatest height at each pixel's centre, NaN where bare.
        triangle: (rows, columns) int32, the triangle seen there, -1 where bare.
        barycentric: (rows, columns, 3) float32, its barycentric coordinates there.
    """

    height: NDArray[np.float64]
    triangle: NDArray[np.int32]
    barycentric: NDArray[np.float32]


def view_axes(direction: ArrayLike, up: ArrayLike) -> NDArray[np.float64]:
    """Return the (3, 3) rows right, up and towards the viewer of an orthographic view.

    Args:
        direction: (3,) from the object to the viewer, any length above 0.
        up: (3,) direction that points up in the picture, not parallel to ``direction``.

    Raises:
        InputError: a zero or non-finite direction, or the two are parallel.
    """
    toward = np.asarray(direction, dtype=np.float64)
    upward = np.asarray(up, dtype=np.float64)
    for what, vector in (("direction", toward), ("up", upward)):
        if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
            raise InputError(f"view {what}: need three finite numbers, not all 0, got {vector}")
    toward = toward / np.linalg.norm(toward)
    right = np.cross(upward / np.linalg.norm(upward), toward)
    length = np.linalg.norm(right)
    if length < 1e-9:
        raise InputError(f"view up {upward} is parallel to the view direction; choose another")
    right /= length
    return np.stack([right, np.cross(toward, right), toward])


def rasterise(
    points: NDArray[np.float64], faces: NDArray[np.integer], shape: tuple[int, int]
) -> Raster:
    """Draw triangles and keep the highest at each pixel.

    Args:
        points: (n, 3) abscissa and ordinate in pixels, the centre of pixel (row, column) at
            (column, row), and height in any unit.
        faces: (m, 3) int; both orientations are drawn, triangles seen edge-on are not.
        shape: rows and columns.
    """
    rows, columns = shape
    height = np.full(rows * columns, -np.inf)
    triangle = np.full(rows * columns, -1, dtype=np.int32)
    corners = points[faces]
    a, b, c = (corners[:, n] for n in range(3))
    normal = np.cross(b - a, c - a)
    level = corners[:, :, 1]
    low = np.clip(np.ceil(level.min(axis=1) - _SEAM), 0, rows).astype(np.int64)
    high = np.clip(np.floor(level.max(axis=1) + _SEAM) + 1, 0, rows).astype(np.int64)
    seen = np.flatnonzero((np.abs(normal[:, 2]) > 1e-12) & (high > low))
    face, y = _expand(seen, low[seen], high[seen])
    left, right = _spans(corners, face, y)
    start = np.clip(np.ceil(left - _SEAM), 0, columns).astype(np.int64)
    stop = np.clip(np.floor(right + _SEAM) + 1, 0, columns).astype(np.int64)
    stop = np.maximum(start, stop)
    total = np.cumsum(stop - start)
    first = 0
    while first < len(face):
        done = total[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(total, done + _PIXELS_AT_ONCE, side="right")))
        part = np.arange(first, last)
        first = last
        span, x = _expand(part, start[part], stop[part])
        drawn = face[span]
        pixel = y[span] * columns + x
        # Height on the plane of the triangle.
        slope = -normal[face[part], :2] / normal[face[part], 2:]
        base = a[face[part], 2] - slope[:, 0] * a[face[part], 0]
        base += slope[:, 1] * (y[part] - a[face[part], 1])
        z = base[span - part[0]] + slope[span - part[0], 0] * x
        before = height[pixel]
        np.maximum.at(height, pixel, z)
        # Backwards, so that of triangles that are equally high the first is left.
        wins = np.flatnonzero((z == height[pixel]) & (z > before))[::-1]
        triangle[pixel[wins]] = drawn[wins]
    covered = np.flatnonzero(triangle >= 0)
    height[triangle < 0] = np.nan
    barycentric = np.zeros((rows * columns, 3), dtype=np.float32)
    barycentric[covered] = _barycentric(corners[triangle[covered], :, :2], covered, columns)
    return Raster(
        height.reshape(shape), triangle.reshape(shape), barycentric.reshape(rows, columns, 3)
    )


def box_mean(image: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Mean over the square of ``2 reach + 1`` pixels around each, cut off at the image's edge.

    The divisor is that of a whole square: what lies outside counts as 0.
    """
    for axis in (0, 1):
        n = image.shape[axis]
        total = np.concatenate(
            [np.zeros_like(image.take([0], axis=axis)), np.cumsum(image, axis=axis)], axis=axis
        )
        low = np.maximum(np.arange(n) - reach, 0)
        high = np.minimum(np.arange(n) + reach + 1, n)
        image = (total.take(high, axis=axis) - total.take(low, axis=axis)) / (2 * reach + 1)
    return image


def _expand(
    item: NDArray[np.int64], start: NDArray[np.int64], stop: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each item repeated for the whole numbers from its start to before its stop."""
    count = stop - start
    shift = np.repeat(start - (np.cumsum(count) - count), count)
    return np.repeat(item, count), np.arange(len(shift)) + shift


def _spans(
    corners: NDArray[np.float64], face: NDArray[np.int64], y: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest abscissa of a triangle on a row of pixels."""
    left, right = np.full(len(face), np.inf), np.full(len(face), -np.inf)
    for n in range(3):
        p, q = corners[:, n, :2], corners[:, (n + 1) % 3, :2]
        rise = q[:, 1] - p[:, 1]
        level = rise == 0.0
        slope = (q[:, 0] - p[:, 0]) / np.where(level, 1.0, rise)
        low, high = np.minimum(p[:, 1], q[:, 1]) - _SEAM, np.maximum(p[:, 1], q[:, 1]) + _SEAM
        x = p[face, 0] + (y - p[face, 1]) * slope[face]
        # Rounding next to an almost level edge must not leave the edge.
        x = np.clip(x, np.minimum(p[:, 0], q[:, 0])[face], np.maximum(p[:, 0], q[:, 0])[face])
        crossed = (y >= low[face]) & (y <= high[face]) & ~level[face]
        np.minimum(left, x, out=left, where=crossed)
        np.maximum(right, x, out=right, where=crossed)
    return np.where(left > right, 0.0, left), np.where(left > right, -1.0, right)


def _barycentric(
    corners: NDArray[np.float64], pixel: NDArray[np.int64], columns: int
) -> NDArray[np.float64]:
    arms = corners - np.stack([pixel % columns, pixel // columns], axis=1)[:, None, :]
    x, y = arms[..., 0], arms[..., 1]
    weights = np.stack(
        [x[:, n - 2] * y[:, n - 1] - y[:, n - 2] * x[:, n - 1] for n in range(3)], axis=1
    )
    normalised: NDArray[np.float64] = weights / weights.sum(axis=1, keepdims=True)
    return normalised
