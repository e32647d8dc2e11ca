"""Volumes sampled into voxels with tissue fractions, layers and the section of layered voxels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface.errors import InputError
from tledface.geometry.cleaning import (
    BEHIND_BONE,
    Box,
    Cleaning,
    behind_bone,
    clean_voxels,
    entry,
    hand_inward,
    in_boxes,
)
from tledface.geometry.labels import LabelVolume
from tledface.geometry.memory import check_memory, estimate_voxels
from tledface.geometry.relations import gaps, relations

__all__ = ["PARTIAL", "Ranks", "VoxelSet", "outer_faces", "section_ratio", "voxelise"]

Floats = NDArray[np.float64]
Volume = _core.Surface | LabelVolume

# Weights of partly filled voxels, see `voxelise`.
PARTIAL = ("full", "scaled", "bone-full")

# A surface this far (in voxels) past a voxel face still counts as lying on it, so that rounding of
# coordinates does not add a row of empty voxels.
_ON_FACE = 1e-6
_MAX_CELLS = 2_000_000


class Ranks(NamedTuple):
    """Order of volumes where they overlap: the lowest number has the place.

    Muscle surfaces of one rank share it equally. One number per muscle surface and per layer.
    """

    bones: int
    muscles: Sequence[int]
    layers: Sequence[int]


@dataclass(frozen=True, eq=False)
class VoxelSet:
    """Voxels that hold tissue, in lexicographic order of their grid index.

    Attributes:
        origin: (3,) m, low corner of cell (0, 0, 0).
        voxel: (3,) m.
        cells: (n, 3) int32.
        fill: (n,) tissue fraction of each voxel's own volume, 0 to 1.
        weight: (n,) what density and stiffness are multiplied by, above 0 to 1: see ``partial``.
        fractions: (n, n_tissues), rows sum to 1; the layers, then the muscle surfaces.
        first, second: (n, n_tissues) m and m2, moments of the fractions about the depth of the
            voxel's centre: fraction times mean z and mean z2.
        normal: (n, 3) unit gradient of the depth below the outer surface; voxels of one tissue
            below the last boundary may have that of a voxel nearby.
        report: What was found, volumes in m3: ``tissue_volume`` (kept), ``left_out`` (too deep,
            below the fill, behind bone, loose, unconnected), ``volumes``, ``overlaps`` and
            ``gaps`` (`geometry.relations`), ``samples`` along an edge, ``memory_estimate``.
    """

    origin: Floats
    voxel: Floats
    cells: NDArray[np.int32]
    fill: Floats
    weight: Floats
    fractions: Floats
    first: Floats
    second: Floats
    normal: Floats
    report: dict[str, Any]


def voxelise(
    skin: Volume,
    *,
    voxel: ArrayLike,
    boundaries: Sequence[ArrayLike] = (),
    bones: Sequence[Volume] = (),
    muscles: Sequence[Volume] = (),
    samples: int = 4,
    depth: float | None = None,
    depth_in: Sequence[tuple[Box, float]] = (),
    region: Box | None = None,
    outer: str | Sequence[Box] = "all",
    fill: float = 0.5,
    partial: str = "full",
    ranks: Ranks | None = None,
    clean: bool | Cleaning = True,
    align: Sequence[float | None] = (None, None, None),
) -> VoxelSet:
    """Sample tissue into voxels with ``samples``^3 points each.

    Args:
        skin: Tissue lies inside it. The grid starts at the low corner of its box (or of the
            part of the box in ``region``).
        voxel: One length or three, m.
        boundaries: Depth at which each layer but the last ends, m, rising; the last takes the
            rest. One value, or one per vertex of the skin's surface, linear on its faces and not
            falling from layer to layer. Depth is the distance to the outer surface, exact and
            clipped: a layer may be far thinner than a sample.
        bones: No tissue inside them.
        muscles: Muscle surfaces.
        samples: Points along each edge of a voxel, 1 to 16. With labels on a grid that the
            voxels' faces meet, more where that makes the fractions exact.
        depth: Tissue deeper than this is left out, m.
        depth_in: Boxes with a depth of their own, m; of several that hold a place the last counts.
        region: Tissue outside this box is left out, m.
        outer: "all", or boxes: depth is measured from the skin faces with their centroid in one.
        fill: A voxel is kept if at least this fraction of it is tissue. What a voxel left out
            holds goes to the kept one below it, so that a thin layer does not vanish with it.
        partial: Fractions are scaled to sum to 1, and a voxel weighs: "full": as if tissue just
            filled it; "scaled": by its tissue fraction; "bone-full": so, with what is bone, too
            deep or outside the region counted as tissue.
        ranks: Who has a place where volumes overlap; None: bone before muscle before layers,
            equal shares to muscle surfaces.
        clean: Which voxels to leave out; True: the defaults of `Cleaning`, False: none.
        align: Along x, y, z a coordinate (m) on which voxel faces lie, or None: the grid then
            starts up to a voxel earlier.

    Raises:
        InputError: more memory than there is, boxes that hold no skin face, no voxel left, a
            layer boundary that does not rise.
    """
    edges = np.broadcast_to(np.asarray(voxel, dtype=np.float64), (3,)).copy()
    surface = _surface(skin)
    ends = _checked_boundaries(boundaries, surface)
    if partial not in PARTIAL:
        raise InputError(f"partial: got {partial!r}, allowed: {', '.join(PARTIAL)}")
    box = _grid_box(skin, edges, region)
    box[0] = aligned(box[0], edges, align)
    if isinstance(skin, LabelVolume):
        samples = skin.image.exact_samples(edges, samples)
    mask = outer_faces(surface, outer)
    n_tissues = len(boundaries) + 1 + len(muscles)
    caps = [np.inf if depth is None else depth, *(cap for _, cap in depth_in)]
    tissue = min(surface.volume, surface.area * max(caps))
    needed = check_memory(estimate_voxels(edges, box, tissue, surface.area), n_tissues, edges)
    count = np.maximum(np.ceil((box[1] - box[0]) / edges - _ON_FACE), 1.0)
    if count.max() > _MAX_CELLS:
        raise InputError(
            f"voxel: {1e3 * edges.min():g} mm gives {count.max():.3g} cells along an axis, "
            f"allowed are {_MAX_CELLS}; take larger voxels"
        )
    everywhere = np.full(3, np.finfo(np.float64).max)
    ranks = ranks or Ranks(0, [1] * len(muscles), [2] * (len(boundaries) + 1))
    found = _core.voxelise(
        skin=_core_volume(skin),
        outer_surface=surface,
        outer=mask,
        bones=[_core_volume(bone) for bone in bones],
        parts=[_core_volume(muscle) for muscle in muscles],
        origin=box[0].tolist(),
        voxel=edges.tolist(),
        count=count.astype(int).tolist(),
        samples=samples,
        boundaries=ends,
        cap=caps[0],
        local_caps=[([*low, *high], cap) for (low, high), cap in depth_in],
        region_low=list(-everywhere if region is None else region[0]),
        region_high=list(everywhere if region is None else region[1]),
        bone_rank=ranks.bones,
        part_ranks=list(ranks.muscles),
        layer_ranks=list(ranks.layers),
    )
    size = float(np.prod(edges))
    names = _names([*bones, *muscles])
    report = {
        "memory_estimate": needed,
        "samples": samples,
        **relations(names, found["tally"], size / samples**3),
        "gaps": gaps(
            names, [_surface(v) for v in (*bones, *muscles, skin)], box[0], edges, found["cells"]
        ),
    }
    cleaning = clean if isinstance(clean, Cleaning) else Cleaning(clean, 3 if clean else 0)
    own, keep = _kept(found, box[0], edges, [_surface(bone) for bone in bones], fill, cleaning)
    report["left_out"] = found["left_out"]
    if not keep.any():
        size_mm = " x ".join(f"{1e3 * edge:.3g}" for edge in np.ptp(surface.vertices, axis=0))
        raise InputError(
            f"voxel: no voxel of {' x '.join(f'{1e3 * edge:g}' for edge in edges)} mm holds "
            f"{fill:g} or more of tissue; the skin measures {size_mm} mm: check units if that is "
            "wrong, else take smaller voxels, a lower fill, or check that bones, depth and region "
            "leave tissue"
        )
    own = np.minimum(own[keep], 1.0)
    report["tissue_volume"] = float(own.sum()) * size
    total = found["shares"][keep].sum(axis=1)[:, None]
    return VoxelSet(
        origin=box[0].copy(),
        voxel=edges,
        cells=found["cells"][keep],
        fill=own,
        weight=_weights(partial, own, found["inner"][keep]),
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


def _surface(volume: Volume) -> _core.Surface:
    return volume.surface.solid if isinstance(volume, LabelVolume) else volume


def _core_volume(volume: Volume) -> Any:
    return volume.core if isinstance(volume, LabelVolume) else volume


def _names(volumes: Sequence[Volume]) -> list[str]:
    """Return short distinct names: of files without their folder, where that is enough."""
    full = [volume.name for volume in volumes]
    short = [Path(name).name for name in full]
    names = [s if short.count(s) == 1 else f for s, f in zip(short, full, strict=True)]
    return [f"{n} ({i})" if names.count(n) > 1 else n for i, n in enumerate(names)]


def _grid_box(skin: Volume, edges: Floats, region: Box | None) -> Floats:
    whole = box = skin.bounds if isinstance(skin, LabelVolume) else _bounds(skin)
    if region is not None:
        limits = np.asarray(region, dtype=np.float64)
        box = np.stack([np.maximum(box[0], limits[0]), np.minimum(box[1], limits[1])])
        if not (box[0] < box[1]).all():
            raise InputError(
                f"region: {_show_box(limits)} does not meet the skin {skin.name}, which spans "
                f"{_show_box(whole)}"
            )
    if isinstance(skin, LabelVolume):
        box = np.stack([skin.image.snapped(box[0], edges), box[1]])
    return box


def _bounds(surface: _core.Surface) -> Floats:
    vertices = surface.vertices
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def _checked_boundaries(boundaries: Sequence[ArrayLike], skin: _core.Surface) -> list[Floats]:
    """Return one array per boundary, of one value or one per vertex of the skin."""
    ends = [np.atleast_1d(np.asarray(end, dtype=np.float64)) for end in boundaries]
    n_vertices = len(skin.vertices)
    above = np.zeros(1)
    for number, end in enumerate(ends):
        if end.shape not in ((1,), (n_vertices,)):
            raise InputError(
                f"layers: boundary {number} has shape {end.shape}, need a number or ({n_vertices},)"
            )
        rises = (end >= above).all() and (end > above).any()
        if not np.isfinite(end).all() or not rises:
            shown = [float(e.max()) for e in ends]
            raise InputError(f"layers: boundaries must rise from above 0, got {shown} m")
        above = end
    return ends


def _kept(
    found: dict[str, Any],
    origin: Floats,
    edges: Floats,
    bones: Sequence[_core.Surface],
    fill: float,
    cleaning: Cleaning,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the tissue fraction of every voxel and which to keep; counts go to found["left_out"].

    What voxels left out for their fill hold is handed to those below them.
    """
    size = float(np.prod(edges))
    own = found["shares"].sum(axis=1)
    # Rounding of a sum of samples must not decide whether a voxel is kept.
    keep = own >= fill - 1e-9
    left_out = {
        "too_deep": {"volume": found["too_deep"] * size, "removed": True},
        "below_fill": entry(int(np.count_nonzero(~keep)), own[~keep].sum() * size, removed=True),
    }
    if keep.any():
        hand_inward(found, keep, edges)
    if bones and keep.any():
        limit = BEHIND_BONE if cleaning.behind_bone is None else cleaning.behind_bone
        kept = np.flatnonzero(keep)
        centres = origin + (found["cells"][kept] + 0.5) * edges
        kept = kept[in_boxes(centres, cleaning.behind_bone_in)]
        centres = origin + (found["cells"][kept] + 0.5) * edges
        behind = kept[behind_bone(centres, found["normal"][kept], bones, limit)]
        removed = cleaning.behind_bone is not None
        left_out["behind_bone"] = entry(len(behind), own[behind].sum() * size, removed=removed)
        left_out["behind_bone"]["cosine"] = limit
        keep[behind] = not removed
    if keep.any():
        rest, loose = clean_voxels(found["cells"][keep], own[keep], size, cleaning)
        keep[keep] = rest
        left_out |= loose
    found["left_out"] = left_out
    return own, keep


def _weights(partial: str, own: Floats, inner: Floats) -> Floats:
    if partial == "full":
        return np.ones(len(own))
    if partial == "scaled":
        return own
    return np.minimum(own + inner, 1.0)


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
    if isinstance(outer, str) and outer != "all":
        raise InputError(f"outer: got {outer!r}, allowed is 'all' or a list of boxes")
    centroids = skin.vertices[skin.faces].mean(axis=1)
    # What closes a large hole is a cut: no layer follows it.
    mask = in_boxes(centroids, outer) & ~skin.is_cap
    if not mask.any():
        span = np.stack([centroids.min(axis=0), centroids.max(axis=0)])
        raise InputError(
            f"outer: none of the {len(mask)} faces of {skin.name} has its centroid in the boxes; "
            f"centroids span {_show_box(span)}"
        )
    return mask


def _show_box(box: Floats) -> str:
    low, high = ("(" + ", ".join(f"{1e3 * x:.5g}" for x in corner) + ")" for corner in box)
    return f"{low} to {high} mm"
