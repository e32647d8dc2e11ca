"""Labelled voxel images as tissue volumes: reading, placing in space, surfaces of labels.

A voxel of an image covers half a step to each side of its centre. An image file says where the
centres lie by its affine (NIfTI), or by ``spacing`` and ``origin`` (NumPy).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface.errors import InputError
from tledface.geometry.surfaces import SurfaceFile

__all__ = ["LABEL_FORMATS", "LabelImage", "LabelVolume", "read_labels"]

Floats = NDArray[np.float64]

LABEL_FORMATS = (".nii", ".nii.gz", ".npy", ".npz")

_MAX_LABELS = 65_536
_TABLE = 1 << 20
_MAX_SAMPLES = 16
# Steps of two grids that agree to this part of a step are taken for equal.
_SAME = 1e-4
# Widths of the Gaussian that a surface is smoothed with, in voxels, widest first: the first that
# keeps the volume to `_SMOOTH_VOLUME` is taken, so that sheets one voxel thin are not lost.
_SMOOTHING = (1.0, 0.5, 0.0)
_SMOOTH_VOLUME = 0.03
_NIFTI_UNITS = {"meter": 1.0, "mm": 1e-3, "micron": 1e-6}


@dataclass(frozen=True, eq=False)
class LabelImage:
    """A labelled image in space.

    Attributes:
        path: The file.
        labels: (nx, ny, nz) uint16, index into ``values``.
        values: The labels that occur, as the file has them, rising.
        affine: (4, 4), from voxel index to the voxel's centre in m.
    """

    path: Path
    labels: NDArray[np.uint16]
    values: NDArray[np.int64]
    affine: Floats
    core: _core.LabelImage = field(repr=False)

    def members(self, labels: Sequence[int] | None, what: str) -> list[int]:
        """Return the indices into ``values`` of the labels; None: all but 0.

        Raises InputError, naming ``what``, for a label that no voxel has.
        """
        if labels is None:
            labels = [int(value) for value in self.values if value != 0]
        found = []
        for label in labels:
            index = int(np.searchsorted(self.values, label))
            if index == len(self.values) or self.values[index] != label:
                shown = ", ".join(str(value) for value in self.values[:20])
                more = ", ..." if len(self.values) > 20 else ""
                raise InputError(
                    f"{self.path}: {what}: no voxel has label {label}; labels there: {shown}{more}"
                )
            found.append(index)
        if not found:
            raise InputError(f"{self.path}: {what}: no label; at least one is needed")
        return found

    @property
    def steps(self) -> Floats | None:
        """Size of a voxel along x, y, z, m, or None if the image is turned or sheared."""
        matrix = np.abs(self.affine[:3, :3])
        largest = matrix.max(axis=0)
        straight = (matrix > _SAME * largest).sum(axis=0) == 1
        if not straight.all() or len(set(matrix.argmax(axis=0))) < 3:
            return None
        return np.asarray(matrix.max(axis=1))

    def _ratios(self, voxel: Floats) -> NDArray[np.int64] | None:
        """Voxels of the image along each edge of a voxel (1 if it is the larger), if whole."""
        if (steps := self.steps) is None:
            return None
        coarse = np.maximum(np.rint(voxel / steps), 1.0)
        fine = np.maximum(np.rint(steps / voxel), 1.0)
        if (np.abs(coarse * steps - fine * voxel) > _SAME * np.minimum(steps, voxel)).any():
            return None
        return coarse.astype(np.int64)

    def exact_samples(self, voxel: Floats, samples: int) -> int:
        """Return the fewest samples, at least those given, with which fractions are exact.

        Where voxel edges are whole multiples of the image's steps (or the other way round) that
        is a multiple of them all; elsewhere, or above 16, the given number.
        """
        ratios = self._ratios(voxel)
        if ratios is None:
            return samples
        common = math.lcm(*(int(ratio) for ratio in ratios))
        exact = -(-samples // common) * common
        return exact if exact <= _MAX_SAMPLES else samples

    def snapped(self, low: Floats, voxel: Floats) -> Floats:
        """Return the grid corner at or below ``low`` (m) whose voxel faces meet the image's."""
        if (steps := self.steps) is None or self._ratios(voxel) is None:
            return low
        pitch = np.minimum(steps, voxel)
        corner = self.affine[:3, 3] - 0.5 * np.abs(self.affine[:3, :3]).sum(axis=1)
        return np.asarray(corner + np.floor((low - corner) / pitch + _SAME) * pitch)


@dataclass(frozen=True, eq=False)
class LabelVolume:
    """Some labels of an image as a volume.

    Attributes:
        name: For messages: file and what it is.
        image: The image.
        members: Indices of the labels, into the image's ``values``.
        surface: The volume's boundary, for depth, fibres and drawing.
    """

    name: str
    image: LabelImage
    members: list[int]
    surface: SurfaceFile

    @property
    def core(self) -> tuple[_core.LabelImage, list[int]]:
        """What the sampler takes."""
        return self.image.core, self.members

    @property
    def bounds(self) -> Floats:
        """Low and high corner of the box of the labelled voxels, (2, 3) m."""
        mask = _mask(self.image, self.members)
        ends = [np.flatnonzero(mask.any(axis=_others(axis))) for axis in range(3)]
        low = np.array([end[0] - 0.5 for end in ends])
        high = np.array([end[-1] + 0.5 for end in ends])
        corners = np.array(
            [[(low, high)[b][a] for a, b in enumerate(c)] for c in np.ndindex(2, 2, 2)]
        )
        points = corners @ self.image.affine[:3, :3].T + self.image.affine[:3, 3]
        return np.stack([points.min(axis=0), points.max(axis=0)])

    @classmethod
    def of(
        cls, image: LabelImage, labels: Sequence[int] | None, what: str, *, smooth: bool = True
    ) -> LabelVolume:
        """Take labels of an image (None: all but 0) as a volume.

        Args:
            image: The image.
            labels: As the file has them.
            what: The volume's name, for messages.
            smooth: Surface by marching cubes of the smoothed labels; else the voxels' own faces.

        Raises:
            InputError: a label that no voxel has; scikit-image missing.
        """
        members = image.members(labels, what)
        mask = _mask(image, members)
        vertices, faces = _smooth_surface(mask) if smooth else _voxel_faces(mask)
        points = vertices @ image.affine[:3, :3].T + image.affine[:3, 3]
        if np.linalg.det(image.affine[:3, :3]) < 0.0:
            faces = faces[:, ::-1]
        name = f"{image.path} ({what})"
        triangles = np.ascontiguousarray(faces, dtype=np.int32)
        solid = _core.prepare_surface(points, triangles, name)
        return cls(name, image, members, SurfaceFile(image.path, points, triangles, solid))


def read_labels(
    path: str | Path,
    *,
    unit_scale: float = 1.0,
    spacing: ArrayLike | None = None,
    origin: ArrayLike | None = None,
) -> LabelImage:
    """Read a labelled image: NIfTI (``.nii``, ``.nii.gz``) or NumPy (``.npy``, ``.npz``).

    Args:
        path: The file. An ``.npz`` holds ``labels`` and may hold ``spacing`` and ``origin``.
        unit_scale: Metres in one unit of a NumPy file, and of a NIfTI file that names none.
        spacing: (3,) m, voxel size; needed for ``.npy``.
        origin: (3,) m, centre of the first voxel; 0 if neither here nor in the file.

    Raises:
        InputError: no such file, not readable as that format, not three-dimensional, values that
            are not whole numbers, an affine that is singular or not finite, no spacing, NiBabel
            missing.
    """
    path = Path(path)
    ending = next((e for e in LABEL_FORMATS if path.name.lower().endswith(e)), None)
    if not path.is_file():
        raise InputError(f"{path}: no such label image; check the path")
    if ending is None:
        raise InputError(f"{path}: ending is not known; allowed: {', '.join(LABEL_FORMATS)}")
    try:
        if ending.startswith(".nii"):
            if spacing is not None or origin is not None:
                raise InputError(f"{path}: spacing and origin are the file's own; leave them out")
            data, affine = _read_nifti(path, unit_scale)
        else:
            data, affine = _read_numpy(path, unit_scale, spacing, origin)
    except InputError:
        raise
    except MemoryError:
        raise
    # The readers raise whatever the damage provokes.
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{path}: cannot be read as {ending[1:]} ({reason}); export it again"
        ) from None
    if not np.isfinite(affine).all() or abs(np.linalg.det(affine[:3, :3])) < 1e-30:
        raise InputError(f"{path}: the affine has no inverse or is not finite; repair its header")
    while data.ndim > 3 and data.shape[-1] == 1:
        data = data[..., 0]
    if data.ndim != 3 or 0 in data.shape:
        raise InputError(f"{path}: has shape {data.shape}, a labelled image has three axes")
    values, labels = _compact(data, path)
    to_index = np.linalg.inv(affine)[:3]
    return LabelImage(path, labels, values, affine, _core.LabelImage(labels, to_index))


def _read_nifti(path: Path, unit_scale: float) -> tuple[NDArray[Any], Floats]:
    try:
        import nibabel
    except ImportError:
        raise InputError(
            f'{path}: reading NIfTI needs NiBabel; pip install "tledface[volumes]"'
        ) from None
    image = nibabel.load(path)
    scale = _NIFTI_UNITS.get(image.header.get_xyzt_units()[0], unit_scale)
    affine = np.array(image.affine, dtype=np.float64)
    affine[:3] *= scale
    return np.asanyarray(image.dataobj), affine


def _read_numpy(
    path: Path, unit_scale: float, spacing: ArrayLike | None, origin: ArrayLike | None
) -> tuple[NDArray[Any], Floats]:
    loaded = np.load(path, allow_pickle=False)
    if path.suffix.lower() == ".npz":
        with loaded:
            if "labels" not in loaded:
                held = ", ".join(loaded.files) or "nothing"
                raise InputError(f"{path}: holds {held}; an array named labels is needed")
            data = loaded["labels"]
            if spacing is None and "spacing" in loaded:
                spacing = loaded["spacing"] * unit_scale
            if origin is None and "origin" in loaded:
                origin = loaded["origin"] * unit_scale
    else:
        data = loaded
    if spacing is None:
        raise InputError(f"{path}: says no voxel size; give spacing = [x, y, z]")
    steps = np.asarray(spacing, dtype=np.float64)
    start = np.zeros(3) if origin is None else np.asarray(origin, dtype=np.float64)
    if steps.shape != (3,) or start.shape != (3,) or not (steps > 0.0).all():
        raise InputError(
            f"{path}: spacing {steps.tolist()} and origin {start.tolist()} m, need three numbers "
            "each, spacing above 0"
        )
    affine = np.eye(4)
    affine[:3, :3] = np.diag(steps)
    affine[:3, 3] = start
    return data, affine


def _compact(data: NDArray[Any], path: Path) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    """Return the values that occur and the image as indices into them."""
    if data.dtype.kind not in "biuf":
        raise InputError(f"{path}: holds {data.dtype}, labels are whole numbers")
    if data.dtype.kind == "f" and not (np.isfinite(data) & (data == np.rint(data))).all():
        raise InputError(
            f"{path}: has values that are not whole numbers; labels are whole (a grey image must "
            "be segmented first)"
        )
    low, high = int(data.min()), int(data.max())
    if high > np.iinfo(np.int64).max:
        raise InputError(f"{path}: has the label {high}; allowed: up to 2^63 - 1")
    if high - low < _TABLE:  # a look-up per voxel; sorting 10^8 of them takes minutes
        wide = np.int32 if data.dtype.itemsize <= 2 else np.int64
        place = data.astype(wide) - low
        present = np.zeros(high - low + 1, dtype=bool)
        present[place.ravel()] = True
        values = np.flatnonzero(present) + low
    else:
        values = np.unique(data)
    if len(values) > _MAX_LABELS:
        raise InputError(
            f"{path}: has {len(values)} labels, allowed are up to {_MAX_LABELS}; is it segmented?"
        )
    if high - low < _TABLE:
        labels = (np.cumsum(present) - 1).astype(np.uint16)[place]
    else:
        labels = np.searchsorted(values, data).astype(np.uint16)
    return values.astype(np.int64), np.ascontiguousarray(labels)


def _others(axis: int) -> tuple[int, int]:
    return tuple(other for other in range(3) if other != axis)  # type: ignore[return-value]


def _mask(image: LabelImage, members: Sequence[int]) -> NDArray[np.bool_]:
    table = np.zeros(len(image.values), dtype=bool)
    table[list(members)] = True
    return np.asarray(table[image.labels])


def _smooth_surface(mask: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.int64]]:
    """Return the half level of the smoothed mask, in index coordinates, wound outwards."""
    try:
        from scipy.ndimage import gaussian_filter
        from skimage.measure import marching_cubes
    except ImportError:
        raise InputError(
            'labels: smooth surfaces need scikit-image; pip install "tledface[volumes]", or take '
            'surface = "voxels"'
        ) from None
    ends = [np.flatnonzero(mask.any(axis=_others(axis))) for axis in range(3)]
    low = np.array([end[0] for end in ends])
    within = mask[tuple(slice(end[0], end[-1] + 1) for end in ends)]
    margin = 4
    padded = np.pad(within, margin).astype(np.float32)
    wanted = np.count_nonzero(within)
    for width in _SMOOTHING:
        level = gaussian_filter(padded, width, truncate=3.0) if width else padded
        if level.max() <= 0.5:
            continue
        vertices, faces, _, _ = marching_cubes(level, 0.5)
        corners = vertices.astype(np.float64)[faces]
        volume = (
            np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
        )
        if width == 0.0 or abs(abs(volume) - wanted) <= _SMOOTH_VOLUME * wanted:
            break
    if volume < 0.0:
        faces = faces[:, ::-1]
    return vertices.astype(np.float64) - margin + low, faces.astype(np.int64)


def _voxel_faces(mask: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.int64]]:
    """Return the mask's own boundary, in index coordinates, two triangles a face, outwards."""
    padded = np.pad(mask, 1)
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        step = np.diff(padded.astype(np.int8), axis=axis)
        for sign in (1, -1):
            # A step up at i enters the volume: its face looks down the axis.
            cell = np.argwhere(step == sign).astype(np.float64)
            corner = np.repeat((cell - 1.0)[:, None], 4, axis=1)
            corner[..., axis] += 0.5
            round_u, round_v = np.array([-0.5, 0.5, 0.5, -0.5]), np.array([-0.5, -0.5, 0.5, 0.5])
            corner[..., u] += round_u if sign < 0 else round_v
            corner[..., v] += round_v if sign < 0 else round_u
            quads.append(corner)
    corners = np.concatenate(quads)
    points, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    quad = index.reshape(-1, 4)
    return points, np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
