"""Shaded images of triangle surfaces: a camera, a low light with cast shadows, dark hollows.

Drawn by the NumPy z-buffer of `tledface.raster`. The light comes from low over the surface and
across the view, so that folds stand out; where a surface is painted (as with stress) the same
light acts on the paint.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError
from tledface.raster import Raster, box_mean, rasterise, view_axes

__all__ = ["Camera", "View", "camera_on", "shade", "values_seen"]

Floats = NDArray[np.float64]
View = str | ArrayLike
# Values (n,), NaN where there are none, to sRGB (n, 3), 0 to 1.
Paint = Callable[[Floats], Floats]

_ELEVATION, _AZIMUTH = np.radians(35.0), np.radians(-22.0)
_SUPERSAMPLING = 2
# Linear colours: skin in full light, and the warmer tone that light scattered in skin leaves.
_LIT = np.array([0.80, 0.49, 0.36])
_SHADE = np.array([0.235, 0.085, 0.055])
# Light on paint in the deepest shadow, as a share of full light.
_PAINT_SHADE = 0.15
# Corners sharper than this are shaded flat.
_CREASE_COSINE = 0.75


@dataclass(frozen=True, eq=False)
class Camera:
    """An orthographic view.

    Attributes:
        axes: (3, 3) rows right, up and towards the viewer.
        height_axis: (3,) unit direction of heights: for the named views what points up in space.
        line_axes: (2, 3) the two level axes.
        low: (2,) pixel coordinates of the image's lower left corner.
        scale: Pixels in a metre.
        shape: Rows and columns of the image.
    """

    axes: Floats
    height_axis: Floats
    line_axes: Floats
    low: Floats
    scale: float
    shape: tuple[int, int]

    def project(self, points: Floats, factor: int = 1) -> Floats:
        """Pixel coordinates and height in pixels, at a multiple of the resolution."""
        seen = points @ self.axes.T * (self.scale * factor)
        seen[:, :2] -= self.low * factor
        seen[:, :2] += 0.5 * (factor - 1)
        return seen


def camera_on(corners: Floats, view: View, up: ArrayLike, size: tuple[int, int]) -> Camera:
    """Fit points (..., 3) m into an image of at most ``size`` (width, height) pixels.

    Args: ``view`` and ``up`` as in `tledface.picture.wrinkle_picture`.
    Raises InputError: an unknown view.
    """
    if isinstance(view, str):
        upward = np.asarray(up, dtype=np.float64)
        reference = np.array([0.0, 1.0, 0.0])
        if upward.shape == (3,) and abs(upward[1]) > 0.9 * np.linalg.norm(upward):
            reference = np.array([0.0, 0.0, -1.0])
        plan = view_axes(upward, reference)
        right, back, high = plan
        if view == "top":
            axes = plan
        elif view == "oblique":
            level = np.sin(_AZIMUTH) * right - np.cos(_AZIMUTH) * back
            axes = view_axes(np.cos(_ELEVATION) * level + np.sin(_ELEVATION) * high, high)
        else:
            raise InputError(
                f"picture: view {view!r} is not known; allowed: 'oblique', 'top' or a direction"
            )
    else:
        plan = axes = view_axes(view, up)
    seen = corners.reshape(-1, 3) @ axes[:2].T
    low, high_corner = seen.min(axis=0), seen.max(axis=0)
    span = np.maximum(high_corner - low, 1e-12)
    margin = 8
    scale = float(((np.array(size) - 2 * margin) / span).min())
    shape = np.ceil(span * scale).astype(int) + 2 * margin
    return Camera(
        axes, plan[2], plan[:2], low * scale - margin, scale, (int(shape[1]), int(shape[0]))
    )


def shade(
    points: Floats,
    faces: NDArray[np.integer],
    camera: Camera,
    *,
    values: Floats | None = None,
    paint: Paint | None = None,
) -> NDArray[np.float32]:
    """Return (rows, columns, 4) sRGB with coverage, row 0 lowest.

    Args:
        points: (nv, 3) m.
        faces: (nf, 3) int, counter-clockwise seen from outside.
        camera: The view.
        values: (nv,) that ``paint`` turns into colours; None: the colour of skin.
        paint: Values (n,) to sRGB (n, 3), 0 to 1.
    """
    factor = _SUPERSAMPLING
    rows, columns = camera.shape
    raster = rasterise(camera.project(points, factor), faces, (rows * factor, columns * factor))
    normals = _pixel_normals(points, faces, raster, camera)
    light = _light(camera)
    covered = raster.triangle >= 0
    key = np.clip(normals @ light, 0.0, None)
    # Light that enters skin comes out around the edge of the lit side.
    soft = np.clip((normals @ light + 0.35) / 1.35, 0.0, None) ** 1.5
    sky = 0.5 + 0.5 * (normals @ camera.axes @ camera.height_axis)
    half = light + np.array([0.0, 0.0, 1.0])
    gloss = np.clip(normals @ (half / np.linalg.norm(half)), 0.0, None) ** 28
    open_sky = _openness(raster.height, camera, factor)
    lit = 1.0 - 0.72 * _cast_shadow(raster.height, light, factor)
    bright = open_sky * (0.20 + 0.26 * sky) + lit * (0.34 * key + 0.30 * soft)
    if values is None or paint is None:
        colour = _SHADE + (_LIT - _SHADE) * np.clip(bright, 0.0, 1.15)[..., None]
        colour += (0.10 * lit * gloss)[..., None]
    else:
        # No gloss and no dark shadows, which would be taken for other values.
        colour = np.zeros((*raster.triangle.shape, 3))
        colour[covered] = paint(_at_pixels(raster, faces, values)) ** 2.2
        colour *= (_PAINT_SHADE + (1.0 - _PAINT_SHADE) * np.clip(bright, 0.0, 1.2))[..., None]
    colour[~covered] = 0.0

    def shrink(image: Floats) -> Floats:
        tiles = image.reshape(rows, factor, columns, factor, -1)
        result: Floats = tiles.mean(axis=(1, 3))
        return result

    coverage = shrink(covered.astype(np.float64))
    linear = shrink(colour) / np.maximum(coverage, 1e-9)
    srgb = np.clip(linear, 0.0, 1.0) ** (1.0 / 2.2)
    return np.concatenate([srgb, coverage], axis=2).astype(np.float32)


def values_seen(
    points: Floats, faces: NDArray[np.integer], camera: Camera, values: Floats
) -> Floats:
    """The values (nv,) of a surface at the pixels that it covers, (n,)."""
    raster = rasterise(camera.project(points), faces, camera.shape)
    return _at_pixels(raster, faces, values)


def _at_pixels(raster: Raster, faces: NDArray[np.integer], values: Floats) -> Floats:
    covered = raster.triangle >= 0
    corners = values[faces[raster.triangle[covered]]]
    result: Floats = (raster.barycentric[covered] * corners).sum(axis=1)
    return result


def _pixel_normals(
    points: Floats, faces: NDArray[np.integer], raster: Raster, camera: Camera
) -> Floats:
    """Unit normals in view axes, smooth except across creases."""
    corners = points[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    smooth = np.zeros_like(points)
    for axis in range(3):
        smooth[:, axis] = np.bincount(
            faces.reshape(-1), np.repeat(flat[:, axis], 3), minlength=len(points)
        )
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1), 1e-300)[:, None]
    flat /= np.maximum(np.linalg.norm(flat, axis=1), 1e-300)[:, None]
    at_corner = smooth[faces]
    sharp = np.einsum("ijk,ik->ij", at_corner, flat) < _CREASE_COSINE
    at_corner = np.where(sharp[..., None], flat[:, None, :], at_corner) @ camera.axes.T
    covered = raster.triangle >= 0
    face = raster.triangle[covered]
    normals = np.zeros((*raster.triangle.shape, 3))
    seen = np.einsum("ij,ijk->ik", raster.barycentric[covered], at_corner[face])
    # A surface seen from behind, through a hole, is lit like its front.
    seen *= np.where(seen[:, 2:] < 0.0, -1.0, 1.0)
    seen /= np.maximum(np.linalg.norm(seen, axis=1), 1e-300)[:, None]
    normals[covered] = seen
    return normals


def _light(camera: Camera) -> Floats:
    """A low light from the left and above, about 30 degrees over the surface, in view axes."""
    right, back = camera.line_axes
    world = -0.80 * right + 0.30 * back + 0.52 * camera.height_axis
    light: Floats = camera.axes @ world
    return light / float(np.linalg.norm(light))


def _openness(height: Floats, camera: Camera, factor: int) -> Floats:
    """1 on open ground, less in hollows: the height against its mean around, at three sizes."""
    seen = height[::factor, ::factor] / factor
    covered = np.isfinite(seen)
    # Along the axis of height, so that a plane seen at an angle has no hollow at its far edge.
    x, y, z = camera.axes @ camera.height_axis
    rows, columns = (np.arange(n) for n in seen.shape)
    level = np.where(covered, x * columns + y * rows[:, None] + z * seen, 0.0)
    level -= level[covered].mean() if covered.any() else 0.0
    level[~covered] = 0.0
    result = np.ones_like(level)
    for reach in (5, 13, 34):
        weight = box_mean(box_mean(covered.astype(np.float64), reach), reach)
        mean = box_mean(box_mean(level, reach), reach) / np.maximum(weight, 1e-9)
        sunk = np.where(covered, np.clip(mean - level, 0.0, None), 0.0) / reach
        result *= 1.0 / (1.0 + 1.5 * np.minimum(sunk, 1.2))
    return np.repeat(np.repeat(result, factor, axis=0), factor, axis=1)


def _cast_shadow(height: Floats, light: Floats, factor: int) -> Floats:
    """0 in the light to 1 in the shadow of higher ground, by steps towards the light."""
    ground = np.where(np.isfinite(height), height, -np.inf)[::factor, ::factor].astype(np.float32)
    rows, columns = ground.shape
    level = max(float(np.hypot(light[0], light[1])), 1e-9)
    slope = light[2] / level * factor
    shade = np.zeros_like(ground)
    base = np.where(np.isfinite(ground), ground, np.float32(0.0))
    for step in range(2, 60, 2):
        across = round(light[0] / level * step)
        along = round(light[1] / level * step)
        to_rows = slice(max(0, -along), rows - max(0, along))
        to_columns = slice(max(0, -across), columns - max(0, across))
        from_rows = slice(max(0, along), rows - max(0, -along))
        from_columns = slice(max(0, across), columns - max(0, -across))
        over = ground[from_rows, from_columns] - base[to_rows, to_columns] - slope * step
        # Penumbra: the further the edge, the softer.
        target = shade[to_rows, to_columns]
        np.maximum(target, over / (factor * (1.0 + 0.25 * step)), out=target)
    soft = np.clip(shade, 0.0, 1.0).astype(np.float64)
    return np.repeat(np.repeat(box_mean(soft, 1), factor, axis=0), factor, axis=1)
