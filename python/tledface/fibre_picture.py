"""Pictures of the fibres in a voxel model: short lines along them over the muscles' silhouettes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError
from tledface.io._atomic import atomic_path
from tledface.raster import rasterise, view_axes
from tledface.voxel_view import require_voxels

if TYPE_CHECKING:
    from tledface.model import Model
    from tledface.muscle import Muscle

__all__ = ["VIEWS", "fibre_picture"]

Floats = NDArray[np.float64]

# Direction from the model to the viewer: a face looks along -y, z is up.
VIEWS = {
    "front": (0.0, -1.0, 0.0),
    "back": (0.0, 1.0, 0.0),
    "left": (1.0, 0.0, 0.0),
    "right": (-1.0, 0.0, 0.0),
    "top": (0.0, 0.0, 1.0),
    "oblique": (0.5, -1.0, 0.4),
}
_WIDTH, _HEIGHT = 1500, 1000
_MARGIN = 40
# Pixels between the beginnings of lines, and half the length of a line.
_APART, _REACH = 14.0, 22.0
_INK = "#2b2626"
_BODY, _MUSCLE = np.array([0.945, 0.94, 0.935]), np.array([0.80, 0.775, 0.76])
# One colour for each axis of the picture: a fibre takes their mix by its components.
_COLOURS = np.array([[0.84, 0.19, 0.15], [0.10, 0.60, 0.31], [0.13, 0.35, 0.75]])
# Corners of a voxel's six faces in the order of VTK's hexahedron, counter-clockwise from outside.
_FACES = np.array(
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [2, 3, 7, 6], [0, 4, 7, 3], [1, 2, 6, 5]]
)
_NORMALS = np.array(
    [[0, 0, -1], [0, 0, 1], [0, -1, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0]], dtype=np.float64
)


def fibre_picture(
    path: str | Path,
    model: Model,
    *,
    muscles: Sequence[str] | None = None,
    view: str | ArrayLike = "front",
    title: str | None = None,
) -> Path:
    """Write a PNG of the fibres of a model's muscles.

    Args:
        path: A name ending in .png; replaced when complete.
        model: A model with muscles.
        muscles: Names of those to draw; None: all.
        view: A key of ``VIEWS``, or a direction (3,) from the model to the viewer. Up is z, or y
            where the view is along z.
        title: A line above the picture; None: the names of the muscles.

    Returns:
        The path.

    Lines follow the fibres through the voxels nearest to the viewer; their colour is a mix of red,
    green and blue by the direction's components across the picture, into it and upwards. Muscles
    are grey, what else there is of the model is paler.

    Raises:
        InputError: another ending, no such folder, a model without muscles, an unknown muscle or
            view.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"picture {path}: the name must end in .png")
    require_voxels("fibre picture", model)
    chosen = _chosen(model, muscles)
    axes = _view(view)
    drawn = np.unique(np.concatenate([muscle.elements for muscle in chosen]))
    corners = model.nodes[np.unique(model.elements[drawn])] @ axes.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    span = np.maximum(high - low, 1e-12)[:2]
    scale = float(min((_WIDTH - 2 * _MARGIN) / span[0], (_HEIGHT - 2 * _MARGIN) / span[1]))
    columns, rows = (int(x) for x in np.ceil(span * scale) + 2 * _MARGIN)

    def project(points: Floats) -> Floats:
        seen = (points @ axes.T - [*low[:2], 0.0]) * scale
        seen[:, :2] += _MARGIN
        return np.asarray(seen)

    image = _background(model, drawn, project(model.nodes), (rows, columns), axes)
    lines, colours = [], []
    for muscle in chosen:
        for line in _streamlets(model, muscle, project, scale):
            lines.append(line[:, :2])
            colours.append(_colour(line[-1] - line[0]))
    figure = Figure(figsize=(columns / 100, (rows + 90) / 100), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    share = rows / (rows + 90)
    area = figure.add_axes((0.0, 0.0, 1.0, share))
    area.imshow(image, origin="lower", interpolation="antialiased")
    area.add_collection(LineCollection(lines, colors=colours, linewidths=1.2, capstyle="round"))
    area.set_axis_off()
    area.set_xlim(0, columns)
    area.set_ylim(0, rows)
    label = title or "fibres of " + ", ".join(muscle.name for muscle in chosen)
    # A letter is about three quarters of its size in points wide, in pixels.
    size = min(17.0, 0.96 * columns / (0.78 * len(label)))
    figure.text(0.02, 1.0 - 0.25 * (1.0 - share), label, color=_INK, fontsize=size, va="center")
    _legend(figure, 1.0 - 0.7 * (1.0 - share), columns)
    _scale_bar(area, scale, columns)
    with atomic_path(path, "picture") as part:
        figure.savefig(part, format="png")
    return path


def _chosen(model: Model, names: Sequence[str] | None) -> list[Muscle]:
    known = {muscle.name: muscle for muscle in model.muscles}
    if not known:
        raise InputError("picture: the model has no muscle; add one before drawing its fibres")
    for name in names or ():
        if name not in known:
            raise InputError(f"picture: no muscle {name!r}; allowed: {', '.join(known)}")
    return list(known.values()) if names is None else [known[name] for name in names]


def _view(view: str | ArrayLike) -> Floats:
    if isinstance(view, str):
        if view not in VIEWS:
            raise InputError(
                f"picture: view {view!r} is not known; allowed: {', '.join(VIEWS)}, or a direction"
            )
        view = VIEWS[view]
    toward = np.asarray(view, dtype=np.float64)
    upright = toward.shape == (3,) and abs(toward[2]) > 0.95 * np.linalg.norm(toward)
    return view_axes(toward, (0.0, 1.0, 0.0) if upright else (0.0, 0.0, 1.0))


def _background(
    model: Model,
    drawn: NDArray[np.int64],
    seen: Floats,
    shape: tuple[int, int],
    axes: Floats,
) -> Floats:
    """The muscles in grey on the rest of the model, (rows, columns, 3), row 0 lowest."""
    image = np.ones((*shape, 3))
    for elements, colour in ((np.arange(model.n_elements), _BODY), (drawn, _MUSCLE)):
        quads, side = _outer_faces(model, elements)
        facing = _NORMALS @ axes[2]
        front = facing[side] > 0.05
        if not front.any():
            continue
        quads, side = quads[front], side[front]
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        raster = rasterise(seen, triangles, shape)
        covered = raster.triangle >= 0
        # Sides that face away a little are a little darker, which shows the shape.
        light = 0.82 + 0.18 * np.tile(facing[side], 2)
        image[covered] = colour * light[raster.triangle[covered]][:, None]
    return image


def _outer_faces(
    model: Model, elements: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Corner nodes (n, 4) of the faces that belong to one element only, and which of six it is."""
    faces = model.elements[elements][:, _FACES].reshape(-1, 4).astype(np.int64)
    # Two corners across a face name it.
    ordered = np.sort(faces, axis=1)
    keys = ordered[:, 0] * model.n_nodes + ordered[:, 3]
    _, first, count = np.unique(keys, return_index=True, return_counts=True)
    outer = first[count == 1]
    return faces[outer], outer % 6


def _streamlets(
    model: Model, muscle: Muscle, project: Callable[[Floats], Floats], scale: float
) -> list[Floats]:
    """Short lines (k, 3) along the fibres of the voxels nearest to the viewer, in pixels."""
    seen = project(model.centres[muscle.elements])
    # The nearest voxel in each square of the picture.
    place = np.floor(seen[:, :2] / _APART).astype(np.int64)
    order = np.lexsort((-seen[:, 2], place[:, 1], place[:, 0]))
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(place[order], axis=0) != 0).any(axis=1)
    seeds = order[first]
    forward = _trace(model, muscle, seeds, 1.0, scale)
    backward = _trace(model, muscle, seeds, -1.0, scale)
    lines = []
    for ahead, behind in zip(forward, backward, strict=True):
        line = np.concatenate([behind[:0:-1], ahead])
        if len(line) > 1:
            lines.append(project(line))
    return lines


def _trace(
    model: Model, muscle: Muscle, seeds: NDArray[np.int64], way: float, scale: float
) -> list[Floats]:
    """Points (k, 3) m along the fibres from the centres of some voxels, till they leave."""
    cells = model.cells[muscle.elements].astype(np.int64)
    low, extent = cells.min(axis=0) - 1, np.ptp(cells, axis=0) + 3
    keys = np.ravel_multi_index(tuple((cells - low).T), tuple(extent))
    order = np.argsort(keys)
    step = 0.5 * float(model.voxel.min())
    steps = max(2, int(_REACH / (scale * step)))
    points = model.centres[muscle.elements[seeds]].copy()
    heading = way * np.asarray(muscle.fibre)[seeds]
    alive = np.ones(len(seeds), dtype=bool)
    track, counts = [points.copy()], np.ones(len(seeds), dtype=np.int64)
    for _ in range(steps):
        points = points + step * heading
        place = np.floor((points - model.origin) / model.voxel).astype(np.int64) - low
        place = np.clip(place, 0, extent - 1)
        wanted = np.ravel_multi_index(tuple(place.T), tuple(extent))
        slot = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
        row = order[slot]
        alive &= keys[row] == wanted
        fibre = np.asarray(muscle.fibre)[row]
        same = np.einsum("ij,ij->i", fibre, heading) > 0.0
        heading = np.where(same[:, None], fibre, -fibre)
        counts += alive
        track.append(points.copy())
    tracks = np.stack(track, axis=1)
    return [line[:count] for line, count in zip(tracks, counts, strict=True)]


def _colour(way: Floats) -> Floats:
    """The mix of the axes' colours by the squares of a direction's components in the picture."""
    # Across, upwards and towards the viewer.
    weights = way**2 / max(float(way @ way), 1e-300)
    result: Floats = weights[[0, 2, 1]] @ _COLOURS
    return result


def _legend(figure: Figure, height: float, columns: int) -> None:
    left = 0.02
    for text, colour in zip(("across", "into the picture", "upwards"), _COLOURS, strict=True):
        figure.text(left, height, text, color=tuple(colour), fontsize=13, va="center")
        left += (9.0 * len(text) + 26.0) / columns


def _scale_bar(axes: Axes, scale: float, columns: int) -> None:
    length = next((mm for mm in (50, 20, 10, 5, 2, 1) if 1e-3 * mm * scale < 0.3 * columns), 1)
    end = columns - 20
    start = end - 1e-3 * length * scale
    axes.plot([start, end], [14, 14], color=_INK, linewidth=3, solid_capstyle="butt")
    axes.text(0.5 * (start + end), 20, f"{length} mm", color=_INK, fontsize=11, ha="center")
