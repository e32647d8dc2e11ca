"""Surfaces sampled into voxels with tissue fractions, layers and the section of layered voxels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface.errors import InputError
from tledface.geometry.memory import check_memory, estimate_voxels

__all__ = ["VoxelSet", "outer_faces", "section_ratio", "voxelise"]

Floats = NDArray[np.float64]
Box = tuple[Sequence[float], Sequence[float]]

# A surface this far (in voxels) past a voxel face still counts as lying on it, so that rounding of
# coordinates does not add a row of empty voxels.
_ON_FACE = 1e-6
_MAX_CELLS = 2_000_000
# Voxels with fewer face neighbours hang by an edge or a tip and are the first to invert.
_MIN_NEIGHBOURS = 3


@dataclass(frozen=True, eq=False)
class VoxelSet:
    """Voxels that hold tissue, in lexicographic order of their grid index.

    Attributes:
        origin: (3,) m, low corner of cell (0, 0, 0).
        voxel: (3,) m.
        cells: (n, 3) int32.
        fill: (n,) tissue fraction of each voxel's own volume, 0 to 1.
        fractions: (n, n_tissues), rows sum to 1; the layers, then the muscle surfaces.
        first, second: (n, n_tissues) m and m2, moments of the fractions about the depth of the
            voxel's centre: fraction times mean z and mean z2.
        normal: (n, 3) unit gradient of the depth below the outer surface; voxels of one tissue
            below the last boundary may have that of a voxel nearby.
        report: Voxels removed as loose or unconnected, memory estimate.
    """

    origin: Floats
    voxel: Floats
    cells: NDArray[np.int32]
    fill: Floats
    fractions: Floats
    first: Floats
    second: Floats
    normal: Floats
    report: dict[str, Any]


def voxelise(
    skin: _core.Surface,
    *,
    voxel: ArrayLike,
    boundaries: Sequence[float] = (),
    bones: Sequence[_core.Surface] = (),
    muscles: Sequence[_core.Surface] = (),
    samples: int = 4,
    depth: float | None = None,
    region: Box | None = None,
    outer: str | Sequence[Box] = "all",
    fill: float = 0.5,
    clean: bool = True,
    align: Sequence[float | None] = (None, None, None),
) -> VoxelSet:
    """Sample tissue into voxels with ``samples``^3 points each.

    Args:
        skin: Tissue lies inside it. The grid starts at the low corner of its box (or of the
            part of the box in ``region``).
        voxel: One length or three, m.
        boundaries: Depth at which each layer but the last ends, m, rising; the last takes the
            rest. Depth is the distance to the outer surface, exact and clipped: a layer may be
            far thinner than a sample.
        bones: No tissue inside them. Bone takes precedence over muscle, muscle over layers.
        muscles: Muscle surfaces; samples in several of them are shared equally.
        samples: Points along each edge of a voxel, 1 to 16.
        depth: Tissue deeper than this is left out, m.
        region: Tissue outside this box is left out, m.
        outer: "all", or boxes: depth is measured from the skin faces with their centroid in one.
        fill: A voxel is kept if at least this fraction of it is tissue. What a voxel left out
            holds goes to the kept one below it, so that a thin layer does not vanish with it;
            fractions are then scaled to sum to 1, as if the tissue just filled the voxel.
        clean: Keep only the largest face-connected part, and no voxel with fewer than three face
            neighbours (unless the voxels are one layer).
        align: Along x, y, z a coordinate (m) on which voxel faces lie, or None: the grid then
            starts up to a voxel earlier.

    Raises:
        InputError: more memory than there is, boxes that hold no skin face, no voxel left, a
            layer boundary that does not rise.
    """
    edges = np.broadcast_to(np.asarray(voxel, dtype=np.float64), (3,)).copy()
    vertices = skin.vertices
    box = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    if region is not None:
        limits = np.asarray(region, dtype=np.float64)
        box = np.stack([np.maximum(box[0], limits[0]), np.minimum(box[1], limits[1])])
        if not (box[0] < box[1]).all():
            raise InputError(
                f"region: {_show_box(limits)} does not meet the skin {skin.name}, which spans "
                f"{_show_box(np.stack([vertices.min(axis=0), vertices.max(axis=0)]))}"
            )
    box[0] = aligned(box[0], edges, align)
    if any(b <= a for a, b in zip((0.0, *boundaries), boundaries, strict=False)):
        raise InputError(f"layers: boundaries must rise from above 0, got {list(boundaries)} m")
    mask = outer_faces(skin, outer)
    n_tissues = len(boundaries) + 1 + len(muscles)
    volume = skin.volume if depth is None else min(skin.volume, skin.area * depth)
    needed = check_memory(estimate_voxels(edges, box, volume, skin.area), n_tissues, edges)
    count = np.maximum(np.ceil((box[1] - box[0]) / edges - _ON_FACE), 1.0)
    if count.max() > _MAX_CELLS:
        raise InputError(
            f"voxel: {1e3 * edges.min():g} mm gives {count.max():.3g} cells along an axis, "
            f"allowed are {_MAX_CELLS}; take larger voxels"
        )
    everywhere = np.full(3, np.finfo(np.float64).max)
    found = _core.voxelise(
        skin=skin,
        outer=mask,
        bones=list(bones),
        parts=list(muscles),
        origin=box[0].tolist(),
        voxel=edges.tolist(),
        count=count.astype(int).tolist(),
        samples=samples,
        boundaries=list(boundaries),
        cap=np.inf if depth is None else depth,
        region_low=list(-everywhere if region is None else region[0]),
        region_high=list(everywhere if region is None else region[1]),
    )
    own = found["shares"].sum(axis=1)
    # Rounding of a sum of samples must not decide whether a voxel is kept.
    keep = own >= fill - 1e-9
    report: dict[str, Any] = {"memory_estimate": needed, "loose": 0, "unconnected": []}
    if keep.any():
        _hand_inward(found, keep, edges)
    if clean and keep.any():
        keep[keep], report["loose"], report["unconnected"] = _clean(found["cells"][keep])
    if not keep.any():
        raise InputError(
            f"voxel: no voxel of {' x '.join(f'{1e3 * edge:g}' for edge in edges)} mm holds "
            f"{fill:g} or more of tissue; take smaller voxels, a lower fill, or check that bones, "
            "depth and region leave tissue"
        )
    total = found["shares"][keep].sum(axis=1)[:, None]
    return VoxelSet(
        origin=box[0].copy(),
        voxel=edges,
        cells=found["cells"][keep],
        fill=np.minimum(own[keep], 1.0),
        fractions=found["shares"][keep] / total,
        first=found["first"][keep] / total,
        second=found["second"][keep] / total,
        normal=found["normal"][keep],
        report=report,
    )


def section_ratio(voxels: VoxelSet, youngs_modulus: ArrayLike) -> Floats:
    """Return the bending over the mean modulus of each voxel's layered section, (n,).

    Args:
        voxels: The voxels with their moments.
        youngs_modulus: (n_tissues,) Pa.

    ``E_b = 12 (<E z2> - <E z>2 / <E>) / h2`` about the section's own neutral axis, over ``<E>``;
    ``h2 / 12`` is taken as the second moment of the tissue itself, so a voxel of one tissue has
    ratio 1 whatever its slope and fill.
    """
    modulus = np.asarray(youngs_modulus, dtype=np.float64)
    mean = voxels.fractions @ modulus
    offset = (voxels.first @ modulus) / mean
    bending = (voxels.second @ modulus) / mean - offset**2
    plain = voxels.second.sum(axis=1) - voxels.first.sum(axis=1) ** 2
    ratio = np.ones(len(mean))
    mixed = (voxels.fractions > 0.0).sum(axis=1) > 1
    np.divide(bending, plain, out=ratio, where=mixed & (plain > 0.0))
    return np.maximum(ratio, 0.0)


def aligned(low: Floats, voxel: Floats, planes: Sequence[float | None]) -> Floats:
    """Return the grid's low corner moved down so that voxel faces lie on the given planes."""
    result = low.copy()
    for axis, plane in enumerate(planes):
        if plane is not None:
            steps = np.ceil((plane - low[axis]) / voxel[axis] - _ON_FACE)
            result[axis] = plane - steps * voxel[axis]
    return result


def outer_faces(skin: _core.Surface, outer: str | Sequence[Box]) -> NDArray[np.bool_]:
    """Which faces of the skin ``outer`` names, see `voxelise`; raises InputError if none."""
    centroids = skin.vertices[skin.faces].mean(axis=1)
    if isinstance(outer, str):
        if outer != "all":
            raise InputError(f"outer: got {outer!r}, allowed is 'all' or a list of boxes")
        return np.ones(len(centroids), dtype=bool)
    mask = np.zeros(len(centroids), dtype=bool)
    for low, high in outer:
        mask |= ((centroids >= low) & (centroids <= high)).all(axis=1)
    if not mask.any():
        span = np.stack([centroids.min(axis=0), centroids.max(axis=0)])
        raise InputError(
            f"outer: none of the {len(mask)} faces of {skin.name} has its centroid in the boxes; "
            f"centroids span {_show_box(span)}"
        )
    return mask


def _hand_inward(found: dict[str, Any], keep: NDArray[np.bool_], voxel: Floats) -> None:
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


def _clean(cells: NDArray[np.int32]) -> tuple[NDArray[np.bool_], int, list[int]]:
    one_layer = bool((np.ptp(cells, axis=0) == 0).any())
    keep, loose, dropped = _core.clean_cells(cells, 0 if one_layer else _MIN_NEIGHBOURS)
    return keep, loose, dropped


def _show_box(box: Floats) -> str:
    low, high = ("(" + ", ".join(f"{1e3 * x:.5g}" for x in corner) + ")" for corner in box)
    return f"{low} to {high} mm"
