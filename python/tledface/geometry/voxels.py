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

__all__ = ["VoxelSet", "section_ratio", "voxelise"]

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
        fill: (n,) tissue fraction of each voxel before normalising, 0 to 1.
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
        fill: A voxel is kept if at least this fraction of it is tissue; its fractions are then
            scaled to sum to 1, as if its tissue filled it.
        clean: Keep only the largest face-connected part, and no voxel with fewer than three face
            neighbours (unless the voxels are one layer).

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
    if any(b <= a for a, b in zip((0.0, *boundaries), boundaries, strict=False)):
        raise InputError(f"layers: boundaries must rise from above 0, got {list(boundaries)} m")
    mask = _outer_faces(skin, outer)
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
        fill=fill,
    )
    report: dict[str, Any] = {"memory_estimate": needed, "loose": 0, "unconnected": []}
    keep = np.ones(len(found["cells"]), dtype=bool)
    if clean and len(keep):
        keep, report["loose"], report["unconnected"] = _clean(found["cells"])
    if not keep.any():
        raise InputError(
            f"voxel: no voxel of {' x '.join(f'{1e3 * edge:g}' for edge in edges)} mm holds "
            f"{fill:g} or more of tissue; take smaller voxels, a lower fill, or check that bones, "
            "depth and region leave tissue"
        )
    if not keep.all():
        found = {name: array[keep] for name, array in found.items()}
    return VoxelSet(origin=box[0].copy(), voxel=edges, report=report, **found)


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


def _outer_faces(skin: _core.Surface, outer: str | Sequence[Box]) -> NDArray[np.bool_]:
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


def _clean(cells: NDArray[np.int32]) -> tuple[NDArray[np.bool_], int, list[int]]:
    one_layer = bool((np.ptp(cells, axis=0) == 0).any())
    keep, loose, dropped = _core.clean_cells(cells, 0 if one_layer else _MIN_NEIGHBOURS)
    return keep, loose, dropped


def _show_box(box: Floats) -> str:
    low, high = ("(" + ", ".join(f"{1e3 * x:.5g}" for x in corner) + ")" for corner in box)
    return f"{low} to {high} mm"
