"""The galea aponeurotica: a closed tendon sheet that carries on from a muscle's upper edge.

Atlases often lack it, and without it frontalis has nothing to pull against at its top: it slides
down the forehead. The sheet follows the muscle's upper edge, its gap at the midline included, under
the skin up to a given height.

The head is described by angle about an upright axis and height (``up`` is +z): a column of the
sheet is a band of angle. In each column the muscle's upper edge and its depth under the skin
there are measured; the sheet runs at that depth from ``overlap`` below the edge to ``top``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray

from tledface import _core
from tledface.errors import InputError

__all__ = ["aponeurosis", "closed_sheet"]

Floats = NDArray[np.float64]

# Heights below the muscle's upper edge over which its depth is measured, m.
_EDGE_BAND = 4e-3
# Columns over which depth and edge are smoothed, m of arc.
_SMOOTH = 4e-3


def aponeurosis(
    skin: _core.Surface,
    muscles: Sequence[_core.Surface],
    *,
    top: float,
    overlap: float = 3e-3,
    thickness: float = 1e-3,
    spacing: float = 1e-3,
) -> trimesh.Trimesh:
    """Return the sheet between a muscle's upper edge and a height, as a closed surface.

    Args:
        skin: The outer surface; +z is up.
        muscles: The sheet muscle, in one or more surfaces.
        top: Height on the skin over the sheet's end, m.
        overlap: How far it reaches into the muscle, m.
        thickness: Its thickness, m.
        spacing: Distance of its vertices, m.

    Raises:
        InputError: ``top`` is not above the muscle, or skin is missing over the sheet.
    """
    points = np.concatenate([_dense(muscle, spacing) for muscle in muscles])
    squared, _, foot, _ = skin.closest_points(points)
    depth = np.sqrt(squared)
    centre = _axis(points)
    angle, radius = _polar(foot, centre)
    height = foot[:, 2]  # on the skin, from where the sheet is moved inwards
    columns = int(np.ceil(np.ptp(angle) * radius.mean() / spacing))
    bins = np.linspace(angle.min(), angle.max(), columns + 1)
    column = np.clip(np.digitize(angle, bins) - 1, 0, columns - 1)
    edge = np.full(columns, -np.inf)
    np.maximum.at(edge, column, height)
    near_edge = height > edge[column] - _EDGE_BAND
    count = np.bincount(column[near_edge], minlength=columns)
    total = np.bincount(column[near_edge], weights=depth[near_edge], minlength=columns)
    filled = count > 0
    middles = 0.5 * (bins[1:] + bins[:-1])
    edge = np.interp(middles, middles[filled], edge[filled])
    deep = np.interp(middles, middles[filled], total[filled] / count[filled])
    width = max(1, round(_SMOOTH / spacing))
    edge, deep = _smoothed(edge, width), _smoothed(deep, width)
    if not top > edge.max():
        raise InputError(
            f"aponeurosis: top is {1e3 * top:g} mm, the muscle reaches {1e3 * edge.max():g} mm; "
            "give a height above it"
        )
    rows = int(np.ceil((top - edge.min() + overlap) / spacing)) + 1
    share = np.linspace(0.0, 1.0, rows)[:, None]
    heights = (edge - overlap) * (1.0 - share) + top * share
    outer = _skin_radius(skin, centre, middles, heights)
    on_skin = np.stack(
        [
            centre[0] + outer * np.sin(middles),
            centre[1] - outer * np.cos(middles),
            np.broadcast_to(heights, outer.shape),
        ],
        axis=-1,
    )
    inwards = -_grid_normals(on_skin)
    half = 0.5 * thickness
    upper = on_skin + (deep - half)[None, :, None] * inwards
    lower = on_skin + (deep + half)[None, :, None] * inwards
    return closed_sheet(upper, lower)


def _dense(surface: _core.Surface, spacing: float) -> Floats:
    """Vertices and face centres of a surface subdivided to edges of at most twice ``spacing``."""
    vertices, faces = trimesh.remesh.subdivide_to_size(  # type: ignore[no-untyped-call]
        surface.vertices, surface.faces, max_edge=2.0 * spacing, max_iter=20
    )
    return np.concatenate([vertices, vertices[faces].mean(axis=1)])


def _axis(points: Floats) -> Floats:
    """Centre (x, y) of the circle that fits points seen from above best (Kasa 1976)."""
    x, y = points[:, 0], points[:, 1]
    middle = points[:, :2].mean(axis=0)
    table = np.stack([x - middle[0], y - middle[1], np.ones(len(x))], axis=1)
    right = (table[:, :2] ** 2).sum(axis=1)
    solution = np.linalg.lstsq(table, right, rcond=None)[0]
    return np.asarray(middle + 0.5 * solution[:2])


def _polar(points: Floats, centre: Floats) -> tuple[Floats, Floats]:
    """Angle from the front (-y) towards +x, and radius, about an upright axis."""
    away = points[:, :2] - centre
    return np.arctan2(away[:, 0], -away[:, 1]), np.hypot(away[:, 0], away[:, 1])


def _smoothed(values: Floats, width: int) -> Floats:
    """Running mean over 2 width + 1 columns, ends repeated."""
    padded = np.pad(values, width, mode="edge")
    return np.convolve(padded, np.full(2 * width + 1, 1.0 / (2 * width + 1)), mode="valid")


def _skin_radius(skin: _core.Surface, centre: Floats, angles: Floats, heights: Floats) -> Floats:
    """Outermost radius of the skin in each column at each of its heights, (rows, columns)."""
    corner = skin.vertices[skin.faces]
    angle, radius = _polar(corner.reshape(-1, 3), centre)
    angle, radius = angle.reshape(-1, 3), radius.reshape(-1, 3)
    # Faces behind the axis, where the angle jumps, are no part of a forehead.
    front = np.ptp(angle, axis=1) < np.pi / 2
    angle, radius, z = angle[front], radius[front], corner[front][:, :, 2]
    result = np.full(heights.shape, -np.inf)
    for i, at in enumerate(angles):
        # Where the column's plane crosses a face, height and radius along its two crossed sides.
        crossed = (angle.min(axis=1) <= at) & (angle.max(axis=1) > at)
        a, r, h = angle[crossed], radius[crossed], z[crossed]
        ends_r, ends_h = [], []
        for s in range(3):
            t = (s + 1) % 3
            over = (a[:, s] <= at) != (a[:, t] <= at)
            share = np.where(over, (at - a[:, s]) / np.where(over, a[:, t] - a[:, s], 1.0), np.nan)
            ends_r.append(r[:, s] + share * (r[:, t] - r[:, s]))
            ends_h.append(h[:, s] + share * (h[:, t] - h[:, s]))
        low_first = np.sort(np.stack(ends_h), axis=0)[:2]
        order = np.argsort(np.stack(ends_h), axis=0)[:2]
        r_ends = np.take_along_axis(np.stack(ends_r), order, axis=0)
        for row, height in enumerate(heights[:, i]):
            hit = (low_first[0] <= height) & (low_first[1] > height)
            span = low_first[1, hit] - low_first[0, hit]
            share = (height - low_first[0, hit]) / span
            found = r_ends[0, hit] + share * (r_ends[1, hit] - r_ends[0, hit])
            result[row, i] = max(found, default=-np.inf)
    if not np.isfinite(result).all():
        row, column = np.argwhere(~np.isfinite(result))[0]
        raise InputError(
            f"aponeurosis: no skin at {np.degrees(angles[column]):.1f} degrees from the front, "
            f"{1e3 * heights[row, column]:.1f} mm high; lower the top"
        )
    return result


def _grid_normals(points: Floats) -> Floats:
    """Outward unit normals of a grid of points (rows upwards, columns towards +x), smoothed."""
    along_rows, along_columns = np.gradient(points, axis=0), np.gradient(points, axis=1)
    normal = np.cross(along_columns, along_rows)
    for axis in (0, 1):
        width = min(4, points.shape[axis] // 2)
        normal = np.apply_along_axis(_smoothed, axis, normal, width)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def closed_sheet(upper: Floats, lower: Floats) -> trimesh.Trimesh:
    """The solid between two grids (rows, columns, 3): both and the strip round their rims."""
    rows, columns = upper.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    sheet = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    rim = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    following = np.roll(rim, -1)
    n = rows * columns
    strip = np.concatenate(
        [
            np.stack([rim, rim + n, following], axis=1),
            np.stack([following, rim + n, following + n], axis=1),
        ]
    )
    faces = np.concatenate([sheet, sheet[:, ::-1] + n, strip])
    vertices = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    return trimesh.Trimesh(vertices, faces, process=False)
