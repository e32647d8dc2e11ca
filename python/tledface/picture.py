"""Pictures of wrinkled surfaces without a graphics card: at rest, deformed, and a profile.

The surface is drawn by `tledface.shading`; matplotlib puts the panels together.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from tledface._model_checks import checked_faces, checked_points, show
from tledface.errors import InputError
from tledface.io._atomic import atomic_path
from tledface.metrics import MIN_PROMINENCE, detail, line_profile, wrinkles
from tledface.shading import Camera, View, camera_on, shade

__all__ = ["render_surface", "round_length", "scale_bar", "wrinkle_picture"]

Floats = NDArray[np.float64]
Line = tuple[ArrayLike, ArrayLike]

_PROFILE_SAMPLES = 500
# m; a profile that rises more than this at rest is drawn without its shape.
_GREATEST_RISE = 0.01
_INK, _GREY, _ACCENT = "#2b2626", "#9a9290", "#b5443a"


def wrinkle_picture(
    path: str | Path,
    rest_vertices: ArrayLike,
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    view: View = "oblique",
    up: ArrayLike = (0.0, 0.0, 1.0),
    title: str | None = None,
    profile: Line | bool = True,
    min_prominence: float = MIN_PROMINENCE,
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
            views, else along the view. True: through the middle, across the folds. False: none,
            for bodies that have no folds.
        min_prominence: m, what stands out less in the profile is not counted as a fold; see
            `tledface.metrics.wrinkles`.

    Returns:
        The path.

    Raises:
        InputError: another ending, no such folder, arrays of a wrong shape or not finite, an
            unknown view, a profile's line off the surface.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"picture {path}: the name must end in .png")
    rest, deformed, triangles = _checked_states(rest_vertices, vertices, faces)
    camera = camera_on(np.concatenate([rest[triangles], deformed[triangles]]), view, up, (780, 640))
    line = None if isinstance(profile, bool) else profile
    if profile is True:
        line = _line_across_folds(rest, deformed, triangles, camera)
    rows, columns = camera.shape
    width = 16.0
    panel_width = 0.47 * width
    panel_height = min(panel_width * rows / columns, 8.0)
    below = 3.5 if line else 0.45
    height = panel_height + below + (0.8 if title else 0.45)
    figure = Figure(figsize=(width, height), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    bottom = below / height
    boxes = ((0.02, "at rest", rest), (0.51, "deformed", deformed))
    for left, label, points in boxes:
        axes = figure.add_axes((left, bottom, 0.47, panel_height / height))
        axes.imshow(shade(points, triangles, camera), origin="lower", interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(label, color=_INK, fontsize=15, loc="left", pad=4)
        scale_bar(axes, camera)
    if line:
        _mark_line(axes, deformed, triangles, camera, line)
        below_panels = figure.add_axes((0.06, 0.62 / height, 0.91, 2.15 / height))
        _draw_profile(below_panels, (rest, deformed), triangles, camera, line, min_prominence)
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
    points = checked_points("picture", vertices)
    triangles = checked_faces("picture", faces, len(points))
    camera = camera_on(points[triangles], view, up, size)
    return np.ascontiguousarray(shade(points, triangles, camera)[::-1])


def _checked_states(
    rest_vertices: ArrayLike, vertices: ArrayLike, faces: ArrayLike
) -> tuple[Floats, Floats, NDArray[np.integer]]:
    """The arrays of a picture as they are drawn; InputError for wrong shapes or numbers."""
    rest = checked_points("picture", rest_vertices)
    deformed = checked_points("picture", vertices)
    if deformed.shape != rest.shape:
        raise InputError(
            f"picture vertices: got {len(rest)} at rest and {len(deformed)} deformed; allowed: as "
            "many of both"
        )
    return rest, deformed, checked_faces("picture", faces, len(rest))


def _line_across_folds(
    rest: Floats, deformed: Floats, faces: NDArray[np.integer], camera: Camera
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
    points: Floats, faces: NDArray[np.integer], line: Line, camera: Camera
) -> tuple[Floats, Floats]:
    start, end = (np.asarray(p, dtype=np.float64) for p in line)
    up = camera.height_axis
    run = end - start
    length = float(np.linalg.norm(run - (run @ up) * up))
    spacing = max(length, 1e-12) / _PROFILE_SAMPLES
    return line_profile(points, faces, start, end, spacing, direction=up)


def _mark_line(
    axes: Axes, points: Floats, faces: NDArray[np.integer], camera: Camera, line: Line
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


def scale_bar(axes: Axes, camera: Camera, down: float = 0.0) -> None:
    """Draw a bar of a round length ``down`` pixels below the lower left of a camera's image."""
    width = camera.shape[1] / camera.scale
    length = round_length(0.2 * width)
    long = length * camera.scale
    axes.plot([8, 8 + long], [-down, -down], color=_INK, linewidth=2.5, clip_on=False)
    axes.text(14 + long, -down, f"{1e3 * length:g} mm", color=_INK, fontsize=12, va="center")
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
    camera: Camera,
    line: Line,
    min_prominence: float,
) -> None:
    (distance, rest), (_, deformed) = (_profile(p, faces, line, camera) for p in states)
    ends = [show(np.asarray(end, dtype=np.float64)) for end in line]
    for state, heights in (("at rest", rest), ("deformed", deformed)):
        if not np.isfinite(heights).any():
            raise InputError(
                f"profile: no surface {state} along the line from {ends[0]} to {ends[1]} m; "
                "allowed: two points with the surface between them, seen by the viewer"
            )
    spacing = float(distance[1])
    metrics = wrinkles(deformed, spacing, min_prominence=min_prominence)
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
    folds = f"{metrics.count or 'no'} fold" + ("" if metrics.count == 1 else "s")
    if metrics.count > 1:
        folds += f", {1e3 * metrics.wavelength:.1f} mm apart"
    if metrics.count:
        folds += f", {1e3 * metrics.amplitude:.2g} mm high"
    axes.set_title(folds, color=_ACCENT, fontsize=14, loc="right", pad=4)
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.008, 0.98), ncols=2, frameon=False, fontsize=12
    )
