"""Voxels left out: too little tissue, behind a bone's edge, loose, unconnected; each counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tledface import _core

__all__ = [
    "BEHIND_BONE",
    "MIN_NEIGHBOURS",
    "Box",
    "Cleaning",
    "behind_bone",
    "clean_voxels",
    "entry",
    "hand_inward",
    "in_boxes",
]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Box = tuple[Sequence[float], Sequence[float]]

# Bone counts as behind a place if the way from it runs against the way to the skin by less than
# this cosine; what the report counts where the scene does not say.
BEHIND_BONE = 0.35
MIN_NEIGHBOURS = 3


@dataclass(frozen=True)
class Cleaning:
    """Which voxels with tissue are left out.

    Attributes:
        largest_only: Keep only the largest face-connected part.
        min_neighbours: Keep no voxel with fewer face neighbours (0 keeps all). Those hang by an
            edge or a tip and are the first to invert. One layer of voxels is left alone.
        behind_bone: Leave out voxels where the cosine between the directions away from the
            nearest bone and towards the skin is below this, as where tissue runs behind the rim
            of the orbit. None keeps them.
        behind_bone_in: "all", or boxes (m): only there.
    """

    largest_only: bool = True
    min_neighbours: int = MIN_NEIGHBOURS
    behind_bone: float | None = None
    behind_bone_in: str | Sequence[Box] = "all"


def behind_bone(
    centres: Floats, normal: Floats, bones: Sequence[_core.Surface], limit: float
) -> Mask:
    """Return which places have their nearest bone beside or before them, seen from the skin.

    Args:
        centres: (n, 3) m.
        normal: (n, 3) unit gradient of the depth below the skin.
        bones: Closed surfaces.
        limit: Greatest cosine between the gradients of the distance from bone and to the skin.
    """
    nearest = np.full(len(centres), np.inf)
    cosine = np.full(len(centres), np.inf)
    for bone in bones:
        vertices = bone.vertices
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        beyond = np.maximum(np.maximum(low - centres, centres - high), 0.0)
        (near,) = np.nonzero((beyond**2).sum(axis=1) < nearest)
        distance2, _, point, side = bone.closest_points(centres[near])
        better = distance2 < nearest[near]
        near, way = near[better], (centres[near] - point)[better]
        distance = np.sqrt(distance2[better])
        nearest[near] = distance2[better]
        outward = way * side[better][:, None]
        along = -(outward * normal[near]).sum(axis=1)
        # On the bone itself there is no direction, and nothing lies behind.
        cosine[near] = np.divide(along, distance, out=np.ones(len(near)), where=distance > 0.0)
    return np.asarray(cosine < limit)


def in_boxes(points: Floats, boxes: str | Sequence[Box]) -> Mask:
    """Return which points, (n, 3), lie in one of the boxes; "all" has every point."""
    if isinstance(boxes, str):
        return np.ones(len(points), dtype=bool)
    mask = np.zeros(len(points), dtype=bool)
    for low, high in boxes:
        mask |= ((points >= low) & (points <= high)).all(axis=1)
    return mask


def clean_voxels(
    cells: NDArray[np.int32], fill: Floats, size: float, cleaning: Cleaning
) -> tuple[Mask, dict[str, Any]]:
    """Find loose and unconnected voxels, and leave them out where the cleaning says so.

    Args:
        cells: (n, 3), in lexicographic order.
        fill: (n,) tissue fraction of each.
        size: Volume of a voxel, m3.
        cleaning: What to leave out.

    Returns:
        Which to keep, (n,), and ``loose`` and ``unconnected``: voxels, volume (m3), whether left
        out; for the latter also the parts' sizes.
    """
    one_layer = bool((np.ptp(cells, axis=0) == 0).any())
    removes = cleaning.min_neighbours > 0
    wanted = 0 if one_layer else cleaning.min_neighbours if removes else MIN_NEIGHBOURS
    tight, n_loose, _ = _core.clean_cells(cells, wanted, False)
    keep = tight if removes else np.ones(len(cells), dtype=bool)
    largest, _, parts = _core.clean_cells(cells, wanted if removes else 0, True)
    return (largest if cleaning.largest_only else keep), {
        "loose": entry(n_loose, fill[~tight].sum() * size, removed=removes),
        "unconnected": entry(
            sum(parts), fill[keep & ~largest].sum() * size, removed=cleaning.largest_only
        )
        | {"parts": [int(part) for part in parts]},
    }


def entry(voxels: int, volume: float, *, removed: bool) -> dict[str, Any]:
    """One kind of voxels in the report."""
    return {"voxels": int(voxels), "volume": float(volume), "removed": removed}


def hand_inward(found: dict[str, Any], keep: Mask, voxel: Floats) -> None:
    """Add the tissue of voxels not kept to the kept neighbour inwards of each, if there is one."""
    cells, normal = found["cells"].astype(np.int64), found["normal"]
    dropped = np.flatnonzero(~keep)
    axis = np.abs(normal[dropped]).argmax(axis=1)
    along = normal[dropped, axis]
    target = cells[dropped]
    target[np.arange(len(dropped)), axis] += np.where(along > 0.0, 1, -1)
    extent = cells.max(axis=0) + 3
    # Cells are in lexicographic order, so these keys rise; the shift by 1 keeps -1 within range.
    stride = np.array([extent[1] * extent[2], extent[2], 1])
    keys, wanted = (cells + 1) @ stride, (target + 1) @ stride
    slot = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    meets = (keys[slot] == wanted) & keep[slot]
    source, slot = dropped[meets], slot[meets]
    # Depths are counted from the receiver's centre, which lies deeper by this much.
    deeper = (np.abs(along) * voxel[axis])[meets][:, None]
    share, first, second = (found[name][source] for name in ("shares", "first", "second"))
    np.add.at(found["shares"], slot, share)
    np.add.at(found["first"], slot, first - deeper * share)
    np.add.at(found["second"], slot, second - 2.0 * deeper * first + deeper**2 * share)
