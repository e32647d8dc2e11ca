"""Wrinkles measured: how many folds, how far apart, how high.

A line of heights is split into shape and detail by a local fit of fourth degree under a Gaussian
window (Savitzky and Golay's smoothing with a Gaussian weight), which leaves slopes and domes to
the shape right up to the ends of the line. Folds are the ridges of the detail whose prominence
passes two thresholds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface._model_checks import (
    check_number,
    checked_faces,
    checked_points,
    floats,
    is_number,
    vector,
)
from tledface.errors import InputError
from tledface.raster import rasterise, view_axes

__all__ = [
    "MIN_PROMINENCE",
    "HeightMap",
    "WrinkleMetrics",
    "detail",
    "height_map",
    "line_profile",
    "wrinkles",
]

Floats = NDArray[np.float64]

# m; lower ridges are the grain of a surface's triangles.
MIN_PROMINENCE = 5e-5
_MIN_SAMPLES = 7
_MOST_SAMPLES = 1e8
# m; wrinkles of skin are closer together, the features of a face further apart.
_SHAPE_WAVELENGTH = 0.02
_SHAPE_SHARE = 1.0 / 3.0
_DEGREE = 4
# Standard deviation of the window over the wavelength of which the fit keeps half:
# (1 + q + q^2/2) exp(-q) = 1/2 with q = (2 pi s / wavelength)^2 / 2.
_WINDOW = 0.368
# Samples; with less the neighbours count for too little to fit a polynomial.
_LEAST_WINDOW = 0.7
# Standard deviations past which the window is nothing beside 1 in float64.
_REACH = 9.0


_NO_FOLDS = (np.empty(0), np.empty(0), np.empty(0, dtype=bool))


@dataclass(frozen=True, eq=False)
class WrinkleMetrics:
    """Folds of a line, or of a patch taken line by line.

    Attributes:
        count: Number of folds; for a patch the median over its lines, rounded.
        wavelength: m, mean distance between neighbouring ridges; NaN with fewer than two.
        amplitude: m, mean height of the ridges above the chord between their two valleys (peak
            to valley, less shape); 0 without folds. Ridges that the end of the line cuts off
            from one valley count only if there are no others.
        positions: m, positions of the ridges along each line, one array per line.
        heights: m, height of each of those ridges above its chord.
        counts: Folds of each line.
    """

    count: int
    wavelength: float
    amplitude: float
    positions: list[Floats] = field(repr=False)
    heights: list[Floats] = field(repr=False)
    counts: NDArray[np.int64] = field(repr=False)


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights of a surface seen along a direction.

    Attributes:
        heights: (rows, columns) m along ``axes[2]``, NaN where there is no surface; rows are
            lines along ``axes[0]``, row 0 lowest along ``axes[1]``.
        spacing: m between samples, the same both ways.
        origin: (2,) m, position of sample (0, 0) along ``axes[0]`` and ``axes[1]``.
        axes: (3, 3) rows right, up and towards the viewer.
    """

    heights: Floats
    spacing: float
    origin: Floats
    axes: Floats


def wrinkles(
    heights: ArrayLike,
    spacing: float,
    *,
    shape_wavelength: float | None = None,
    min_prominence: float = MIN_PROMINENCE,
    relative_prominence: float = 0.2,
) -> WrinkleMetrics:
    """Count and measure the folds of a line or a patch.

    Of a sine the height comes out within 5 % up to 0.4 ``shape_wavelength`` and up to 20 % low
    at 0.6 ``shape_wavelength``.

    Args:
        heights: (n,) a line, or (lines, n) a patch whose rows are lines across the folds, m.
            Of a line with NaN only the longest finite stretch counts.
        spacing: m between samples.
        shape_wavelength: m, longer waves are shape, not folds (at this wavelength half is).
            None: a third of the length of the line, at most 20 mm.
        min_prominence: m, a ridge must stand out at least this much.
        relative_prominence: and at least this share of the line's most prominent ridge.

    Raises:
        InputError: wrong dimensions, no line, fewer than 7 samples, a spacing that is not
            positive or too coarse for the shape's wavelength, or a prominence out of range.

    A ridge is a local maximum of heights less shape, inside the line and with a valley inside
    the line on one side at least. Prominence is the ridge's height above the higher of the two
    lowest points that separate it from higher ground or from the end of the line.
    """
    patch, window = _checked_lines(heights, spacing, shape_wavelength)
    check_number("wrinkles: min_prominence", min_prominence, least=0.0, unit="m")
    check_number(
        "wrinkles: relative_prominence", relative_prominence, least=0.0, most=1.0, unit="a share"
    )
    positions, amplitudes, whole = [], [], []
    for line in patch:
        start, stop = _longest_finite(line)
        ridges, folds, bounded = _NO_FOLDS
        if stop - start >= _MIN_SAMPLES:
            ridges, folds, bounded = _line_folds(
                line[start:stop], window, min_prominence, relative_prominence
            )
        positions.append((start + ridges) * spacing)
        amplitudes.append(folds)
        whole.append(bounded)
    counts = np.array([len(ridges) for ridges in positions])
    gaps = np.concatenate([np.diff(ridges) for ridges in positions])
    folds, bounded = np.concatenate(amplitudes), np.concatenate(whole)
    folds = folds[bounded] if bounded.any() else folds
    return WrinkleMetrics(
        count=int(np.floor(np.median(counts) + 0.5)),
        wavelength=float(gaps.mean()) if len(gaps) else float("nan"),
        amplitude=float(folds.mean()) if len(folds) else 0.0,
        positions=positions,
        heights=amplitudes,
        counts=counts,
    )


def detail(heights: ArrayLike, spacing: float, *, shape_wavelength: float | None = None) -> Floats:
    """Return heights less the shape that `wrinkles` removes.

    Args:
        heights, spacing, shape_wavelength: As for `wrinkles`.

    Returns:
        m, of the shape of ``heights``. Of a line with NaN only the longest finite stretch is kept,
        the rest is NaN.

    Raises:
        InputError: as `wrinkles`.
    """
    patch, window = _checked_lines(heights, spacing, shape_wavelength)
    result = np.full(patch.shape, np.nan)
    for line, kept in zip(patch, result, strict=True):
        start, stop = _longest_finite(line)
        if stop - start >= _MIN_SAMPLES:
            kept[start:stop] = _detail(line[start:stop], window)
    return result.reshape(np.shape(heights))


def height_map(
    vertices: ArrayLike,
    faces: ArrayLike,
    spacing: float,
    *,
    direction: ArrayLike = (0.0, 0.0, 1.0),
    up: ArrayLike = (0.0, 1.0, 0.0),
) -> HeightMap:
    """Sample the heights of a surface on a square grid seen along a direction.

    Args:
        vertices: (nv, 3) m.
        faces: (nf, 3) int.
        spacing: m between samples.
        direction: From the surface to the viewer; heights are along it, the highest counts.
        up: Direction of the columns; rows run along ``up x direction``.

    Raises:
        InputError: no faces or of vertices that are not there, a spacing that is not positive or
            gives over 10^8 samples, or ``up`` parallel to ``direction``.
    """
    points = checked_points("height map", vertices)
    triangles = checked_faces("height map", faces, len(points))
    axes = view_axes(direction, up)
    seen = points @ axes.T
    used = seen[np.unique(triangles)]
    low = used[:, :2].min(axis=0)
    span = used[:, :2].max(axis=0) - low
    if not (is_number(spacing) and spacing > 0.0) or (span / spacing + 1).prod() > _MOST_SAMPLES:
        raise InputError(
            f"height map: spacing {spacing!r} m over {span[0]:.4g} by {span[1]:.4g} m; "
            "must be above 0 and give at most 10^8 samples"
        )
    columns, rows = (np.floor(span / spacing + 1e-9).astype(int) + 1).tolist()
    seen[:, :2] = (seen[:, :2] - low) / spacing
    raster = rasterise(seen, triangles, (rows, columns))
    return HeightMap(raster.height, float(spacing), low, axes)


def line_profile(
    vertices: ArrayLike,
    faces: ArrayLike,
    start: ArrayLike,
    end: ArrayLike,
    spacing: float,
    *,
    direction: ArrayLike = (0.0, 0.0, 1.0),
) -> tuple[Floats, Floats]:
    """Return the highest points of a surface above a straight line.

    Args:
        vertices: (nv, 3) m.
        faces: (nf, 3) int.
        start: (3,) m, first point of the line; its height does not matter.
        end: (3,) m, last point, not above ``start`` along ``direction``.
        spacing: m between samples.
        direction: Direction of the heights.

    Returns:
        distance along the line and height, (n,) m each; NaN where there is no surface.

    Raises:
        InputError: no faces, a line without length, a spacing that is not positive or gives over
            10^8 samples.

    Exact: triangles are cut by the plane of the line and the heights.
    """
    points = checked_points("line profile", vertices)
    triangles = checked_faces("line profile", faces, len(points))
    first = vector("line profile: start", start)
    last = vector("line profile: end", end)
    upward = vector("line profile: direction", direction)
    if not upward.any():
        raise InputError("line profile: got direction (0, 0, 0); allowed: a direction of a length")
    upward /= float(np.linalg.norm(upward))
    along: Floats = last - first - ((last - first) @ upward) * upward
    length = float(np.linalg.norm(along))
    fits = is_number(spacing) and length / _MOST_SAMPLES <= spacing <= length
    if not length > 0.0 or not fits:
        raise InputError(
            f"line profile: spacing {spacing!r} m on a line of {length:.4g} m; the line needs a "
            "length across the direction, and the spacing must be above 0, at most that length, "
            "and give at most 10^8 samples"
        )
    along /= length
    across = np.cross(upward, along)
    local = (points - first) @ np.stack([along, across, upward]).T
    n_samples = int(np.floor(length / spacing + 1e-9)) + 1
    corners = local[triangles]
    side = corners[..., 1] > 0.0
    cut = corners[side.any(axis=1) & ~side.all(axis=1)]
    side = cut[..., 1] > 0.0
    # The corner that is alone on its side, then the two others.
    alone = np.argmax(side == (side.sum(axis=1) == 1)[:, None], axis=1)
    row = np.arange(len(cut))
    tip = cut[row, alone]
    ends = []
    for turn in (1, 2):
        other = cut[row, (alone + turn) % 3]
        share = tip[:, 1] / (tip[:, 1] - other[:, 1])
        ends.append((tip + share[:, None] * (other - tip))[:, [0, 2]])
    swap = ends[0][:, 0] > ends[1][:, 0]
    left = np.where(swap[:, None], ends[1], ends[0])
    right = np.where(swap[:, None], ends[0], ends[1])
    slack = 1e-9 * length
    low = np.clip(np.ceil((left[:, 0] - slack) / spacing), 0, n_samples).astype(int)
    high = np.clip(np.floor((right[:, 0] + slack) / spacing) + 1, 0, n_samples).astype(int)
    count = np.maximum(high - low, 0)
    segment = np.repeat(np.arange(len(cut)), count)
    sample = np.arange(len(segment)) - np.repeat(np.cumsum(count) - count - low, count)
    run = np.maximum(right[segment, 0] - left[segment, 0], 1e-300)
    share = np.clip((sample * spacing - left[segment, 0]) / run, 0.0, 1.0)
    height = left[segment, 1] + share * (right[segment, 1] - left[segment, 1])
    heights = np.full(n_samples, -np.inf)
    np.maximum.at(heights, sample, height + first @ upward)
    heights[np.isneginf(heights)] = np.nan
    distance: Floats = np.arange(n_samples, dtype=np.float64) * float(spacing)
    return distance, heights


def _checked_lines(
    heights: ArrayLike, spacing: float, shape_wavelength: float | None
) -> tuple[Floats, float]:
    """Heights as lines (lines, n), and the standard deviation of the window in samples."""
    patch = floats("wrinkles: heights", heights)
    if patch.ndim not in (1, 2) or patch.shape[-1] < _MIN_SAMPLES:
        raise InputError(
            f"wrinkles: heights have shape {patch.shape}, need (n,) or (lines, n) with n of at "
            f"least {_MIN_SAMPLES}"
        )
    if not len(patch):
        raise InputError(f"wrinkles: heights have shape {patch.shape}, need one line at least")
    for name, value in (("spacing", spacing), ("shape_wavelength", shape_wavelength)):
        if value is None and name != "spacing":
            continue
        if not (is_number(value) and value > 0.0):
            raise InputError(f"wrinkles: {name} must be metres above 0, got {value!r}")
    wavelength = shape_wavelength or min(
        patch.shape[-1] * spacing * _SHAPE_SHARE, _SHAPE_WAVELENGTH
    )
    window = _WINDOW * wavelength / spacing
    if window < _LEAST_WINDOW:
        most = _WINDOW * wavelength / _LEAST_WINDOW
        raise InputError(
            f"wrinkles: a spacing of {spacing:.4g} m is too coarse for a shape_wavelength of "
            f"{wavelength:.4g} m; allowed: at most {most:.4g} m (heights and spacing are in metres)"
        )
    return np.atleast_2d(patch), window


def _detail(line: Floats, window: float) -> Floats:
    """Heights less shape of a finite line."""
    level = line - line.mean()
    kernels, fit = _local_fit(len(line), window)
    shape = sum(fit[:, power] * _about(level, kernel) for power, kernel in enumerate(kernels))
    return np.asarray(level - shape)


def _longest_finite(line: Floats) -> tuple[int, int]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.isfinite(line), [0]])))
    if not len(edges):
        return 0, 0
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    return int(edges[2 * longest]), int(edges[2 * longest + 1])


def _about(line: Floats, kernel: Floats) -> Floats:
    """Sums over a line (n,) about each of its samples, weighted by a kernel of odd length."""
    reach = len(kernel) // 2
    result: Floats = np.convolve(line, kernel[::-1])[reach : reach + len(line)]
    return result


@lru_cache(maxsize=8)
def _local_fit(n: int, window: float) -> tuple[Floats, Floats]:
    """Of a polynomial fit about each sample under a Gaussian of that standard deviation.

    Returns:
        kernels (degree + 1, k): the Gaussian times each power of the way from the sample; and
        what the sums under them count for in the fit at each sample (n, degree + 1).
    """
    reach = min(n - 1, int(np.ceil(_REACH * window)))
    t = np.arange(-reach, reach + 1) / window
    kernels = np.exp(-0.5 * t**2) * t ** np.arange(2 * _DEGREE + 1)[:, None]
    moments = np.stack([_about(np.ones(n), kernel) for kernel in kernels])
    gram = np.stack([moments[power : power + _DEGREE + 1] for power in range(_DEGREE + 1)])
    at_zero = np.zeros((n, _DEGREE + 1, 1))
    at_zero[:, 0] = 1.0
    fit = np.linalg.solve(gram.transpose(2, 0, 1), at_zero)[..., 0]
    return kernels[: _DEGREE + 1], fit.astype(np.float64)


def _line_folds(
    line: Floats, window: float, min_prominence: float, relative_prominence: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Ridge positions in samples, fold heights, and whether both valleys lie in the line."""
    level = _detail(line, window)
    # Ridges by runs of equal values, so that a flat top counts once, at its middle.
    starts = np.flatnonzero(np.concatenate([[True], level[1:] != level[:-1]]))
    stops = np.append(starts[1:], len(level))
    value = level[starts]
    rise = np.diff(value)
    runs = np.flatnonzero((rise[:-1] > 0.0) & (rise[1:] < 0.0)) + 1
    ridges = (starts[runs] + stops[runs] - 1) // 2
    prominence = np.array([_prominence(level, ridge) for ridge in ridges])
    if not len(ridges):
        return _NO_FOLDS
    ridges = ridges[prominence >= max(min_prominence, relative_prominence * prominence.max())]
    if not len(ridges):
        return _NO_FOLDS
    reach = int(np.ceil(np.diff(ridges).mean())) if len(ridges) > 1 else len(level)
    last = len(level) - 1
    bounds = [max(0, ridges[0] - reach), *ridges, min(last, ridges[-1] + reach)]
    valleys = np.array([a + int(np.argmin(level[a : b + 1])) for a, b in pairwise(bounds)])
    left, right = valleys[:-1], valleys[1:]
    # The end of a line cuts through a slope. It is no valley: the other one serves alone, and a
    # slope that comes down from the end makes no ridge, though the fit may leave one there.
    open_left, open_right = left == 0, right == last
    kept = ~(open_left & open_right)
    kept &= ~(open_left & (line[0] > line[ridges])) & ~(open_right & (line[last] > line[ridges]))
    ridges, left, right = ridges[kept], left[kept], right[kept]
    whole = ~(open_left | open_right)[kept]
    left, right = np.where(left > 0, left, right), np.where(right < last, right, left)
    share = np.where(left < right, (ridges - left) / np.maximum(right - left, 1), 0.0)
    chord = level[left] + share * (level[right] - level[left])
    before, top, after = level[ridges - 1], level[ridges], level[ridges + 1]
    bend = before - 2.0 * top + after
    offset = np.divide(0.5 * (before - after), bend, out=np.zeros(len(bend)), where=bend < 0.0)
    return ridges + offset, top - chord, whole


def _prominence(level: Floats, ridge: int) -> float:
    higher = np.flatnonzero(level > level[ridge])
    place = int(np.searchsorted(higher, ridge))
    left = int(higher[place - 1]) if place > 0 else 0
    right = int(higher[place]) if place < len(higher) else len(level) - 1
    base = max(level[left : ridge + 1].min(), level[ridge : right + 1].min())
    return float(level[ridge] - base)
