"""Pictures of wrinkled surfaces without a graphics card: at rest, deformed, and a profile.

The surface is drawn by the NumPy z-buffer of `tledface.raster`, lit by a low light across the
folds with cast shadows, and darkened in its hollows; matplotlib puts the panels together.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError
from tledface.io._atomic import atomic_path
from tledface.metrics import detail, line_profile, wrinkles
from tledface.raster import Raster, box_mean, rasterise, view_axes

__all__ = ["render_surface", "round_length", "wrinkle_picture"]

Floats = NDArray[np.float64]
View = str | ArrayLike
Line = tuple[ArrayLike, ArrayLike]

_ELEVATION, _AZIMUTH = np.radians(35.0), np.radians(-22.0)
_SUPERSAMPLING = 2
_PROFILE_SAMPLES = 500
# m; a profile that rises more than this at rest is drawn without its shape.
_GREATEST_RISE = 0.01
# Linear colours: skin in full light, and the warmer tone that light scattered in skin leaves.
_LIT = np.array([0.80, 0.49, 0.36])
_SHADE = np.array([0.235, 0.085, 0.055])
_INK, _GREY, _ACCENT = "#2b2626", "#9a9290", "#b5443a"
# Corners sharper than this are shaded flat.
_CREASE_COSINE = 0.75


@dataclass(frozen=True, eq=False)
class _Camera:
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


def wrinkle_picture(
    path: str | Path,
    rest_vertices: ArrayLike,
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    view: View = "oblique",
    up: ArrayLike = (0.0, 0.0, 1.0),
    title: str | None = None,
    profile: Line | None = None,
) -> Path:
    """Write a PNG of a surface at rest and deformed, in one scale, and a profile across it.

    Args:
        path: A name ending in .png; replaced when complete.
        rest_vertices: (nv, 3) m.
        vertices: (nv, 3) m, deformed.
        faces: (nf, 3) int, counter-clockwise seen from outside.
        view: ``"oblique"`` (35 degrees above the horizon of ``up``), ``"top"`` (along ``up``),
            or a direction (3,) from the surface to the viewer, such as (0, -1, 0) for a face
            that looks along -y.
        up: (3,) direction of height for the named views, else what points up in the picture.
        title: A line above the picture.
        profile: Two points of a line; the profile is cut above it, along ``up`` for the named
            views, else along the view. None: through the middle, across the folds.

    Returns:
        The path.

    Raises:
        InputError: another ending, no such folder, arrays of a wrong shape or not finite, an
            unknown view.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"picture {path}: the name must end in .png")
    rest, deformed, triangles = _checked(rest_vertices, vertices, faces)
    camera = _camera(np.concatenate([rest[triangles], deformed[triangles]]), view, up, (780, 640))
    line = profile or _line_across_folds(rest, deformed, triangles, camera)
    rows, columns = camera.shape
    width = 16.0
    panel_width = 0.47 * width
    panel_height = min(panel_width * rows / columns, 8.0)
    height = panel_height + (4.3 if title else 3.95)
    figure = Figure(figsize=(width, height), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    bottom = 3.5 / height
    boxes = ((0.02, "at rest", rest), (0.51, "deformed", deformed))
    for left, label, points in boxes:
        axes = figure.add_axes((left, bottom, 0.47, panel_height / height))
        axes.imshow(_shade(points, triangles, camera), origin="lower", interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(label, color=_INK, fontsize=15, loc="left", pad=4)
        _scale_bar(axes, camera)
    _mark_line(axes, deformed, triangles, camera, line)
    _draw_profile(
        figure.add_axes((0.06, 0.62 / height, 0.91, 2.15 / height)),
        (rest, deformed),
        triangles,
        camera,
        line,
    )
    if title:
        figure.text(
            0.02, 1.0 - 0.16 / height, title, color=_INK, fontsize=19, weight="bold", va="top"
        )
    with atomic_path(path, "picture") as part:
        figure.savefig(part, format="png")
    return path


def render_surface(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    view: View = "oblique",
    up: ArrayLike = (0.0, 0.0, 1.0),
    size: tuple[int, int] = (1200, 900),
) -> NDArray[np.float32]:
    """Return a shaded picture of one surface.

    Args:
        vertices: (nv, 3) m.
        faces: (nf, 3) int, counter-clockwise seen from outside.
        view: As in `wrinkle_picture`.
        up: As in `wrinkle_picture`.
        size: Greatest width and height in pixels.

    Returns:
        (rows, columns, 4) float32 RGBA, 0 to 1, top row first; clear where there is no surface.

    Raises:
        InputError: arrays of a wrong shape or not finite, an unknown view.
    """
    points, _, triangles = _checked(vertices, vertices, faces)
    camera = _camera(points[triangles], view, up, size)
    return np.ascontiguousarray(_shade(points, triangles, camera)[::-1])


def _checked(
    rest_vertices: ArrayLike, vertices: ArrayLike, faces: ArrayLike
) -> tuple[Floats, Floats, NDArray[np.integer]]:
    rest = np.asarray(rest_vertices, dtype=np.float64)
    deformed = np.asarray(vertices, dtype=np.float64)
    triangles = np.asarray(faces)
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
        raise InputError(f"picture: faces have shape {triangles.shape}, need (nf, 3), nf above 0")
    for name, points in (("rest vertices", rest), ("vertices", deformed)):
        if points.ndim != 2 or points.shape[1] != 3 or points.shape != rest.shape:
            raise InputError(
                f"picture: {name} have shape {points.shape}, need (nv, 3), rest and deformed alike"
            )
        if not np.isfinite(points).all():
            raise InputError(f"picture: {name} are not all finite; the simulation has failed")
    if triangles.min() < 0 or triangles.max() >= len(rest):
        raise InputError(f"picture: faces name vertex {triangles.max()} of {len(rest)}")
    return rest, deformed, triangles


def _camera(corners: Floats, view: View, up: ArrayLike, size: tuple[int, int]) -> _Camera:
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
    return _Camera(
        axes, plan[2], plan[:2], low * scale - margin, scale, (int(shape[1]), int(shape[0]))
    )


def _shade(points: Floats, faces: NDArray[np.integer], camera: _Camera) -> NDArray[np.float32]:
    """Return (rows, columns, 4) sRGB with coverage, row 0 lowest."""
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
    colour = _SHADE + (_LIT - _SHADE) * np.clip(bright, 0.0, 1.15)[..., None]
    colour += (0.10 * lit * gloss)[..., None]
    colour[~covered] = 0.0

    def shrink(image: Floats) -> Floats:
        tiles = image.reshape(rows, factor, columns, factor, -1)
        result: Floats = tiles.mean(axis=(1, 3))
        return result

    coverage = shrink(covered.astype(np.float64))
    linear = shrink(colour) / np.maximum(coverage, 1e-9)
    srgb = np.clip(linear, 0.0, 1.0) ** (1.0 / 2.2)
    return np.concatenate([srgb, coverage], axis=2).astype(np.float32)


def _pixel_normals(
    points: Floats, faces: NDArray[np.integer], raster: Raster, camera: _Camera
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


def _light(camera: _Camera) -> Floats:
    """A low light from the left and above, about 30 degrees over the surface, in view axes."""
    right, back = camera.line_axes
    world = -0.80 * right + 0.30 * back + 0.52 * camera.height_axis
    light: Floats = camera.axes @ world
    return light / float(np.linalg.norm(light))


def _openness(height: Floats, camera: _Camera, factor: int) -> Floats:
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


def _line_across_folds(
    rest: Floats, deformed: Floats, faces: NDArray[np.integer], camera: _Camera
) -> tuple[Floats, Floats]:
    """The line through the middle, along one of the two level axes, with more new folds."""
    used = deformed[np.unique(faces)]
    middle = 0.5 * (used.min(axis=0) + used.max(axis=0))
    lines, scores = [], []
    for axis in camera.line_axes:
        along = (used - middle) @ axis
        line = (middle + along.min() * axis, middle + along.max() * axis)
        distance, heights = _profile(deformed, faces, line, camera)
        change = heights - _profile(rest, faces, line, camera)[1]
        metrics = wrinkles(change, distance[1])
        lines.append(line)
        scores.append(metrics.count * metrics.amplitude)
    return lines[int(np.argmax(scores))]


def _profile(
    points: Floats, faces: NDArray[np.integer], line: Line, camera: _Camera
) -> tuple[Floats, Floats]:
    start, end = (np.asarray(p, dtype=np.float64) for p in line)
    up = camera.height_axis
    run = end - start
    length = float(np.linalg.norm(run - (run @ up) * up))
    spacing = max(length, 1e-12) / _PROFILE_SAMPLES
    return line_profile(points, faces, start, end, spacing, direction=up)


def _mark_line(
    axes: Axes, points: Floats, faces: NDArray[np.integer], camera: _Camera, line: Line
) -> None:
    distance, heights = _profile(points, faces, line, camera)
    start, end = (np.asarray(p, dtype=np.float64) for p in line)
    up = camera.height_axis
    level = end - start - ((end - start) @ up) * up
    level /= np.linalg.norm(level)
    foot = start - (start @ up) * up
    trace = foot + distance[:, None] * level + heights[:, None] * up
    seen = camera.project(trace)
    axes.plot(seen[:, 0], seen[:, 1], color=_ACCENT, linewidth=1.1, alpha=0.8, dashes=(5, 3))
    axes.set_xlim(-0.5, camera.shape[1] - 0.5)
    axes.set_ylim(-0.5, camera.shape[0] - 0.5)


def _scale_bar(axes: Axes, camera: _Camera) -> None:
    width = camera.shape[1] / camera.scale
    length = round_length(0.2 * width)
    axes.plot([8, 8 + length * camera.scale], [0, 0], color=_INK, linewidth=2.5, clip_on=False)
    axes.text(
        14 + length * camera.scale, 0, f"{1e3 * length:g} mm", color=_INK, fontsize=12, va="center"
    )
    axes.set_xlim(-0.5, camera.shape[1] - 0.5)
    axes.set_ylim(-0.5, camera.shape[0] - 0.5)


def round_length(length: float) -> float:
    """The greatest 1, 2 or 5 times a power of ten that is not above ``length``."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)) * power)


def _draw_profile(
    axes: Axes,
    states: tuple[Floats, Floats],
    faces: NDArray[np.integer],
    camera: _Camera,
    line: Line,
) -> None:
    (distance, rest), (_, deformed) = (_profile(p, faces, line, camera) for p in states)
    spacing = float(distance[1])
    metrics = wrinkles(deformed, spacing)
    label = "height, mm"
    if np.nanmax(rest) - np.nanmin(rest) > _GREATEST_RISE:
        # The shape of a face would hide its folds.
        rest, deformed = detail(rest, spacing), detail(deformed, spacing)
        label = "height less shape, mm"
    level = min(np.nanmin(rest), np.nanmin(deformed))
    distance, rest, deformed = 1e3 * distance, 1e3 * (rest - level), 1e3 * (deformed - level)
    axes.plot(distance, rest, color=_GREY, linewidth=1.3, label="at rest")
    axes.plot(distance, deformed, color=_ACCENT, linewidth=2.0, label="deformed")
    axes.fill_between(distance, deformed, color=_ACCENT, alpha=0.10, linewidth=0)
    axes.set_xlabel("along the dashed line, mm", color=_INK, fontsize=12)
    axes.set_ylabel(label, color=_INK, fontsize=12)
    axes.set_xlim(0.0, float(distance[-1]))
    top = max(np.nanmax(rest), np.nanmax(deformed))
    axes.set_ylim(-0.06 * top, 1.12 * top + 1e-3)
    axes.tick_params(colors=_INK, labelsize=11)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    folds = f"{metrics.count} fold" + ("" if metrics.count == 1 else "s")
    if metrics.count > 1:
        folds += f", {1e3 * metrics.wavelength:.1f} mm apart"
    if metrics.count:
        folds += f", {1e3 * metrics.amplitude:.2g} mm high"
    axes.set_title(folds, color=_ACCENT, fontsize=14, loc="right", pad=4)
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.008, 0.98), ncols=2, frameon=False, fontsize=12
    )
