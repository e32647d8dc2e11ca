"""A fibre field for a closed surface: made by its kind, asked at points, averaged over voxels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface._model_checks import floats, unlike
from tledface.errors import InputError
from tledface.fibre_kinds import Fibre, make_fibre
from tledface.geometry.fibres.axes import long_axes
from tledface.geometry.fibres.curves import check_curves, curve_field, read_curves
from tledface.geometry.fibres.harmonic import sheet_field, sphincter_field, spindle_field
from tledface.geometry.fibres.nurbs import fit_volume
from tledface.geometry.fibres.potential import MuscleGrid

__all__ = ["FibreField", "VoxelFibres", "fibre_field", "make_field", "mean_fibres"]

Floats = NDArray[np.float64]

_POINTS_AT_ONCE = 500_000


class FibreField(Protocol):
    """Fibre directions in one muscle surface."""

    def directions(self, points: Floats) -> Floats:
        """Unit vectors (n, 3) at points (n, 3), m."""
        ...


@dataclass(frozen=True, eq=False)
class _Constant:
    direction: Floats

    def directions(self, points: Floats) -> Floats:
        return np.tile(self.direction, (len(points), 1))


@dataclass(frozen=True, eq=False)
class VoxelFibres:
    """Fibres of a muscle's voxels.

    Attributes:
        fibre: (m, 3) unit vectors.
        alignment: (m,) length of the mean over samples: 1 where all are parallel.
        sampled: (m,) whether a sample of the voxel lies in the muscle; others took the direction
            at their centre.
    """

    fibre: Floats
    alignment: Floats
    sampled: NDArray[np.bool_]


def make_field(
    solid: _core.Surface,
    fibre: Fibre | Sequence[float] | Floats | str,
    *,
    unit_scale: float = 1.0,
) -> FibreField:
    """Return the fibre field of a closed surface.

    Args:
        solid: The surface.
        fibre: A kind with its options, ``"long-axis"``, or a direction (3,).
        unit_scale: Metres in one unit of curve files.

    Raises:
        InputError: ends that hold no part of the muscle, a sphincter without a hole, a curve file
            that cannot be used, ...
    """
    if isinstance(fibre, str):
        return _Constant(long_axes([solid])[0])
    if not isinstance(fibre, Fibre):
        direction = np.asarray(fibre, dtype=np.float64)
        return _Constant(direction / np.linalg.norm(direction))
    grid = MuscleGrid(solid)
    if fibre.kind == "curves":
        read = [read_curves(path, unit_scale=unit_scale) for path in fibre.curves]
        return curve_field(grid, [curve for curves in read for curve in curves])
    make: dict[str, Callable[[MuscleGrid, Fibre], FibreField]] = {
        "nurbs": fit_volume,
        "spindle": spindle_field,
        "sheet": sheet_field,
        "sphincter": sphincter_field,
    }
    return make[fibre.kind](grid, fibre)


def fibre_field(
    surface: Any, kind: str | ArrayLike, points: ArrayLike, **options: Any
) -> NDArray[np.float64]:
    """Return the fibre directions that a muscle has at some points.

    Args:
        surface: The muscle's closed surface: a ``SurfaceFile``, a ``trimesh.Trimesh`` in metres, or
            a checked solid.
        kind: ``"nurbs"``, ``"spindle"``, ``"sheet"``, ``"sphincter"``, ``"curves"``,
            ``"long-axis"``, or a direction (3,).
        points: (n, 3) m; outside the surface the direction is that of the muscle nearby.
        **options: Of the kind, lengths in m: ``start`` and ``to`` (the ends: ``"+z"``, a direction,
            ``{"box": ...}``, ``{"points": ..., "reach": ...}``), ``axis``, ``centre``, ``degree``,
            ``curves`` (files, in metres, or a list of arrays (n, 3)).

    Returns:
        (n, 3) unit vectors, all of one sense along the muscle.

    Raises:
        InputError: an unusable surface, an unknown kind or option, ends that hold no part of the
            muscle, a sphincter without a hole, curves that cannot be used.

    Example: ``fibre_field(mesh, "sheet", points, to="+z")``.
    """
    at = floats("points", points)
    fits = at.ndim == 2 and at.shape[1] == 3
    if not fits or not np.isfinite(at).all():
        got = unlike(at, shape_fits=fits)
        raise InputError(f"points: got {got}; allowed: finite metres of shape (n, 3)")
    solid = _solid(surface)
    if not isinstance(kind, str):
        direction = np.asarray(kind, dtype=np.float64)
        if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
            raise InputError(f"kind: got {kind!r}; allowed: a name or a direction (3,), not all 0")
        field = make_field(solid, direction)
    elif kind == "long-axis":
        field = make_field(solid, kind)
    elif kind == "curves" and _holds_arrays(options.get("curves")):
        field = curve_field(MuscleGrid(solid), check_curves(options["curves"], "curves"))
    else:
        given = {"from" if key == "start" else key: value for key, value in options.items()}
        field = make_field(solid, make_fibre(kind, given))
    return _in_parts(field, at)


def mean_fibres(
    fields: Sequence[FibreField],
    solids: Sequence[_core.Surface],
    cells: NDArray[np.integer],
    *,
    origin: ArrayLike,
    voxel: ArrayLike,
    samples: int,
) -> VoxelFibres:
    """Average a muscle's fibres over the samples of each voxel that lie in its surfaces.

    Args:
        fields: One for each surface.
        solids: The surfaces.
        cells: (m, 3) voxels that hold some of the muscle, without repetition.
        origin: (3,) m, low corner of cell (0, 0, 0).
        voxel: (3,) m.
        samples: Along each edge of a voxel.

    Directions of one surface have one sense, so their mean does not cancel. Another surface in the
    same voxel is added with the sense that agrees.
    """
    corner, edges = np.asarray(origin, dtype=np.float64), np.asarray(voxel, dtype=np.float64)
    total, count = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for field, solid in zip(fields, solids, strict=True):
        mean, n = _mean_over_samples(field, solid, cells, corner, edges, samples)
        agree = np.where(np.einsum("ij,ij->i", total, mean) < 0.0, -1.0, 1.0)
        total += agree[:, None] * mean
        count += n
    length = np.linalg.norm(total, axis=1)
    sampled = count > 0.0
    alignment = np.divide(length, count, out=np.zeros(len(cells)), where=sampled)
    # No sample, or fibres that cancel: the direction at the centre, of the nearest surface.
    poor = np.flatnonzero(alignment < 1e-3)
    if len(poor):
        centres = corner + edges * (cells[poor] + 0.5)
        distance = np.stack([solid.closest_points(centres)[0] for solid in solids])
        nearest = distance.argmin(axis=0)
        for number, field in enumerate(fields):
            mine = poor[nearest == number]
            if len(mine):
                total[mine] = field.directions(corner + edges * (cells[mine] + 0.5))
        length[poor] = 1.0
        alignment[poor] = np.where(sampled[poor], alignment[poor], 1.0)
    return VoxelFibres(total / length[:, None], np.minimum(alignment, 1.0), sampled)


def _mean_over_samples(
    field: FibreField,
    solid: _core.Surface,
    cells: NDArray[np.integer],
    origin: Floats,
    voxel: Floats,
    samples: int,
) -> tuple[Floats, Floats]:
    """Sum of directions (m, 3) and number of samples (m,) of each cell in a surface."""
    total, count = np.zeros((len(cells), 3)), np.zeros(len(cells))
    vertices = solid.vertices
    first = np.floor((vertices.min(axis=0) - origin) / voxel).astype(np.int64)
    extent = np.floor((vertices.max(axis=0) - origin) / voxel).astype(np.int64) - first + 1
    found, inside = _core.samples_inside(
        solid, (origin + voxel * first).tolist(), voxel.tolist(), extent.tolist(), samples
    )
    # Rows of found among cells.
    local = cells.astype(np.int64) - first
    meets = np.flatnonzero(((local >= 0) & (local < extent)).all(axis=1))
    mine = np.ravel_multi_index(tuple(local[meets].T), tuple(extent))
    theirs = np.ravel_multi_index(tuple(found.astype(np.int64).T), tuple(extent))
    place = np.searchsorted(theirs, mine)
    place[place == len(theirs)] = 0
    hits = theirs[place] == mine if len(theirs) else np.zeros(len(mine), dtype=bool)
    rows, place = meets[hits], place[hits]
    at = np.stack(np.meshgrid(*[np.arange(samples)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    offsets = (at + 0.5) / samples
    step = max(1, _POINTS_AT_ONCE // len(offsets))
    for start in range(0, len(rows), step):
        part = rows[start : start + step]
        cell, sample = np.nonzero(inside[place[start : start + step]])
        points = origin + voxel * (cells[part][cell] + offsets[sample])
        directions = field.directions(points)
        for axis in range(3):
            total[part, axis] = np.bincount(cell, directions[:, axis], minlength=len(part))
        count[part] = np.bincount(cell, minlength=len(part))
    return total, count


def _in_parts(field: FibreField, points: Floats) -> Floats:
    starts = range(0, len(points), _POINTS_AT_ONCE)
    parts = [field.directions(points[start : start + _POINTS_AT_ONCE]) for start in starts]
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def _holds_arrays(curves: Any) -> bool:
    return isinstance(curves, list | tuple) and any(isinstance(c, np.ndarray) for c in curves)


def _solid(surface: Any) -> _core.Surface:
    if isinstance(surface, _core.Surface):
        return surface
    solid = getattr(surface, "solid", None)
    if isinstance(solid, _core.Surface):
        return solid
    vertices, faces = getattr(surface, "vertices", None), getattr(surface, "faces", None)
    if vertices is None or faces is None:
        raise InputError(
            f"surface: got {type(surface).__name__}; allowed: a SurfaceFile or trimesh.Trimesh"
        )
    return _core.prepare_surface(np.asarray(vertices), np.asarray(faces, dtype=np.int32), "surface")
