"""A cut through a model: the tissues of one layer of voxels, skin, bone and boundary nodes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.io._atomic import atomic_path
from tledface.picture import round_length
from tledface.tissue_colours import INK, NODE_COLOURS, node_kinds, tissue_colours
from tledface.voxel_view import require_voxels

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["cut_picture", "section"]

Floats = NDArray[np.float64]

# Axes of the picture for a cut across x, y, z: abscissa and ordinate.
_IN_PICTURE = {"x": (1, 2), "y": (0, 2), "z": (0, 1)}
_DETAIL = 30  # voxels, height of the detail
_AROUND = 4  # voxels left free around the cut
_BONE, _SKIN = "#8d97a0", "#2b2626"


def cut_picture(path: str | Path, model: Model, axis: str, at: float) -> Path:
    """Write a PNG of the layer of voxels that a plane cuts, and a detail of it.

    Args:
        path: A name ending in .png.
        model: The model.
        axis: "x", "y" or "z", the plane's normal.
        at: Where it is, m; a plane between two layers shows the upper one.

    Raises:
        InputError: an unknown axis, a plane that meets no voxel, another ending, no such folder.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"picture {path}: the name must end in .png")
    require_voxels("cut picture", model)
    if axis not in _IN_PICTURE:
        raise InputError(f"cut: got axis {axis!r}; allowed: x, y or z")
    normal = "xyz".index(axis)
    place = (at - model.origin[normal]) / model.voxel[normal]
    layer = int(np.floor(place + 1e-6))
    # The upper end of the body shows its last layer.
    last = int(model.cells[:, normal].max())
    layer = last if layer == last + 1 and abs(place - layer) < 1e-6 else layer
    elements = np.flatnonzero(model.cells[:, normal] == layer)
    if not len(elements):
        span = model.nodes[:, normal]
        raise InputError(
            f"cut: no voxel lies at {axis} = {1e3 * at:g} mm; the voxels span "
            f"{1e3 * span.min():.5g} to {1e3 * span.max():.5g} mm"
        )
    across, up = _IN_PICTURE[axis]
    cells = model.cells[elements][:, [across, up]]
    low, high = cells.min(axis=0) - _AROUND, cells.max(axis=0) + 1 + _AROUND
    size = high - low
    colours = tissue_colours(model)
    palette = np.array([to_rgb(colours[name]) for name in model.tissues])
    image = np.zeros((size[1], size[0], 4))
    column, row = (cells - low).T
    image[row, column, :3] = model.fractions[elements] @ palette
    image[row, column, 3] = 1.0
    edges, origin = model.voxel[[across, up]], model.origin[[across, up]]
    corner, end = 1e3 * (origin + low * edges), 1e3 * (origin + high * edges)
    middle = model.origin[normal] + (layer + 0.5) * model.voxel[normal]
    extent = (corner[0], end[0], corner[1], end[1])
    lines = _outlines(model, normal, middle)
    nodes = _nodes(model, normal, layer)

    span = end - corner
    scale = min(8.6 / span[0], 7.4 / span[1])  # inches in a mm
    width, height = span * scale
    # The detail stands beside a tall cut and is as tall; above it there is nothing.
    tall = max(height, 4.8)
    wide = min(5.6, tall)
    window = _detail(elements, cells, model, (edges, origin), wide / tall)
    window = (*_within(window[:2], extent[:2]), *_within(window[2:], extent[2:]))
    figure = Figure(figsize=(width + wide + 1.4, tall + 2.1), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    total = figure.get_size_inches()
    boxes = [(0.4, 1.25, width, height, extent), (width + 1.0, 1.25, wide, tall, window)]
    for number, (x, y, w, h, view) in enumerate(boxes):
        axes = figure.add_axes((x / total[0], y / total[1], w / total[0], h / total[1]))
        axes.imshow(image, origin="lower", extent=extent, interpolation="nearest", zorder=1)
        _draw(axes, lines, nodes, (across, up), dots=(2.2, 9.0)[number])
        axes.set_xlim(view[0], view[1])
        axes.set_ylim(view[2], view[3])
        axes.set_aspect("equal")
        axes.set_xticks([])
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_visible(bool(number))
            spine.set_color(INK)
        axes.set_title(
            ("", "detail (framed on the left)")[number], color=INK, fontsize=11, loc="left"
        )
        _scale_bar(axes, view, w)
        if not number:
            v = boxes[1][4]
            axes.add_patch(
                Rectangle((v[0], v[2]), v[1] - v[0], v[3] - v[2], fill=False, color=INK, zorder=6)
            )
    title = f"Cut at {axis} = {1e3 * at:.4g} mm: {len(elements):,} voxels"
    figure.text(0.4 / total[0], 1.0 - 0.14 / total[1], title, color=INK, fontsize=15, va="top")
    legend = _legend(model, elements, colours, lines, nodes)
    figure.legend(
        handles=legend, loc="lower left", ncols=max(2, int(total[0] / 2.1)), frameon=False,
        fontsize=10, bbox_to_anchor=(0.2 / total[0], 0.04 / total[1]), labelcolor=INK,
    )  # fmt: skip
    with atomic_path(path, "picture") as part:
        figure.savefig(part, format="png")
    return path


def section(vertices: Floats, faces: NDArray[np.integer], axis: int, at: float) -> Floats:
    """Return where triangles cross a plane across an axis: (n, 2, 3) ends of segments, m."""
    height = vertices[:, axis] - at
    # A vertex on the plane counts as above it: every triangle then crosses twice or not at all.
    above = height[faces] >= 0.0
    crossing = faces[above.any(axis=1) & ~above.all(axis=1)]
    ends = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        i, j = crossing[:, a], crossing[:, b]
        cut = (height[i] >= 0.0) != (height[j] >= 0.0)
        share = np.zeros(len(crossing))
        np.divide(height[i], height[i] - height[j], out=share, where=cut)
        point = vertices[i] + share[:, None] * (vertices[j] - vertices[i])
        ends.append(np.where(cut[:, None], point, np.nan))
    three = np.stack(ends, axis=1)
    there = np.isfinite(three[..., 0])
    result: Floats = three[there].reshape(-1, 2, 3)
    return result


def _outlines(model: Model, normal: int, at: float) -> list[tuple[str, str, Floats]]:
    lines = []
    for name, bound in model.surfaces.items():
        if name == "skin":
            lines.append(("skin", _SKIN, section(bound.vertices, bound.faces, normal, at)))
    bones = [section(s.vertices, s.faces, normal, at) for s in model.sliding.surfaces]
    if bones:
        lines.append(("bone that nodes slide on", _BONE, np.concatenate(bones)))
    return [line for line in lines if len(line[2])]


def _nodes(model: Model, normal: int, layer: int) -> list[tuple[str, Floats]]:
    """Bound nodes on the lower side of the layer of voxels."""
    corners = model.elements[model.cells[:, normal] == layer]
    beside = np.zeros(model.n_nodes, dtype=bool)
    beside[corners] = True
    beside &= model.node_ijk[:, normal] == layer
    found = []
    for kind, members in node_kinds(model).items():
        # A plane of symmetry in the cut would cover it.
        chosen = members & beside
        if chosen.any() and not (kind == "symmetry" and chosen.sum() > 0.25 * beside.sum()):
            found.append((kind, model.nodes[chosen]))
    return found


def _detail(
    elements: NDArray[np.int64],
    cells: NDArray[np.int32],
    model: Model,
    grid: tuple[Floats, Floats],
    shape: float,
) -> tuple[float, float, float, float]:
    """A window about the voxel with the most tissues in it, of those near the middle, mm."""
    edges, origin = grid
    several = (model.fractions[elements] > 0.02).sum(axis=1).astype(np.float64)
    around = np.abs(cells - np.median(cells, axis=0)) / np.maximum(np.ptp(cells, axis=0), 1)
    best = int(np.argmax(several - 2.0 * around.max(axis=1)))
    centre = 1e3 * (origin + (cells[best] + 0.5) * edges)
    tall = 0.5e3 * _DETAIL * float(edges.max())
    wide = shape * tall
    return centre[0] - wide, centre[0] + wide, centre[1] - tall, centre[1] + tall


def _within(part: tuple[float, float], whole: tuple[float, float]) -> tuple[float, float]:
    """A stretch moved into another, or to its middle where it is longer."""
    length = part[1] - part[0]
    room = whole[1] - whole[0] - length
    low = min(max(part[0], whole[0]), whole[1] - length) if room >= 0.0 else whole[0] + 0.5 * room
    return low, low + length


def _draw(
    axes: Axes,
    lines: list[tuple[str, str, Floats]],
    nodes: list[tuple[str, Floats]],
    picture: tuple[int, int],
    dots: float,
) -> None:
    for _, colour, ends in lines:
        segments = 1e3 * ends[:, :, list(picture)]
        axes.add_collection(LineCollection(list(segments), colors=colour, linewidths=1.3, zorder=3))
    for kind, points in nodes:
        x, y = 1e3 * points[:, picture[0]], 1e3 * points[:, picture[1]]
        axes.scatter(x, y, s=dots, color=NODE_COLOURS[kind], linewidths=0, zorder=4)


def _scale_bar(axes: Axes, view: tuple[float, float, float, float], inches: float) -> None:
    length = 1e3 * round_length(0.25e-3 * (view[1] - view[0]))
    share = length / (view[1] - view[0])
    down = -0.12 / inches
    axes.plot(
        [0, share], [down, down], color=INK, linewidth=2.5, clip_on=False, solid_capstyle="butt",
        transform=axes.transAxes,
    )  # fmt: skip
    axes.text(
        share + 0.02, down, f"{length:g} mm", color=INK, fontsize=11, va="center",
        transform=axes.transAxes,
    )  # fmt: skip


def _legend(
    model: Model,
    elements: NDArray[np.int64],
    colours: dict[str, str],
    lines: list[tuple[str, str, Floats]],
    nodes: list[tuple[str, Floats]],
) -> list[Any]:
    there = np.asarray((model.fractions[elements] > 0.0).any(axis=0))
    return [
        *(
            Patch(color=colours[name], label=name)
            for name, shown in zip(model.tissues, there, strict=True)
            if shown
        ),
        *(Line2D([], [], color=colour, label=name) for name, colour, _ in lines),
        *(
            Line2D(
                [], [], color=NODE_COLOURS[kind], marker="o", linestyle="", label=f"{kind} nodes"
            )
            for kind, _ in nodes
        ),
    ]
