"""Where a muscle's fibres begin and end, as nodes of its grid."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tledface.errors import InputError
from tledface.fibre_kinds import BoxEnd, CurveEnd
from tledface.geometry.fibres.potential import MuscleGrid

__all__ = ["end_nodes", "end_values", "polyline_points"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def end_values(grid: MuscleGrid, start: Mask, end: Mask) -> Floats:
    """Return the potential (n,) at the ends, 0 and 1, NaN elsewhere.

    Raises InputError where the ends overlap or leave nothing between them.
    """
    name = grid.solid.name
    if (start & end).any():
        raise InputError(f"{name}: from and to hold the same part of the muscle; set them apart")
    values = np.full(len(grid.nodes), np.nan)
    values[start], values[end] = 0.0, 1.0
    if not np.isnan(values).any():
        raise InputError(f"{name}: from and to hold the whole muscle; make them smaller")
    return values


def end_nodes(grid: MuscleGrid, end: BoxEnd | CurveEnd, key: str) -> Mask:
    """Which nodes (n,) lie in an end; raises InputError, naming ``key``, if none does."""
    positions = grid.positions
    if isinstance(end, BoxEnd):
        low, high = np.asarray(end.low), np.asarray(end.high)
        found = np.asarray(((positions >= low) & (positions <= high)).all(axis=1))
        what = f"the box {_show(np.stack([low, high]))}"
    else:
        line = polyline_points(np.asarray(end.points), 0.5 * grid.spacing)
        distance = np.asarray(cKDTree(line).query(positions)[0])
        # A line drawn on a muscle's rim is to hold the whole rim, from one face to the other.
        thickness = 2.0 * grid.solid.volume / grid.solid.area
        reach = end.reach or distance.min() + thickness + grid.spacing
        found = distance <= reach
        what = f"the line of {len(end.points)} points from {_show(line[[0, -1]])}"
        # A line that misses the muscle by more than its thickness is a slip, not an edge.
        if end.reach is None and distance.min() > 2.0 * thickness + grid.spacing:
            found[:] = False
            what += f", {1e3 * distance.min():.3g} mm away,"
    if not found.any():
        span = np.stack([positions.min(axis=0), positions.max(axis=0)])
        raise InputError(
            f"{grid.solid.name}: {key}: {what} holds no part of the muscle, which spans "
            f"{_show(span)}; move it"
        )
    return found


def polyline_points(corners: Floats, spacing: float) -> Floats:
    """Points (n, 3) along a polyline, no farther apart than ``spacing``, corners included."""
    points = [corners[:1]]
    for a, b in pairwise(corners):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing)))
        points.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a))
    return np.concatenate(points)


def _show(box: Floats) -> str:
    low, high = ("(" + ", ".join(f"{1e3 * x:.5g}" for x in corner) + ")" for corner in box)
    return f"{low} to {high} mm"
