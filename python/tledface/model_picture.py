"""Pictures of a model: its tissues, fibres, boundary nodes, and cuts through it."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from tledface.cut_picture import cut_picture
from tledface.errors import InputError
from tledface.io._atomic import atomic_path, check_new_folder
from tledface.picture import round_length
from tledface.surface import boundary_faces
from tledface.tissue_colours import INK, NODE_COLOURS, node_kinds, tissue_colours
from tledface.voxel_view import VIEWS, VoxelView, opposite, require_voxels

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["boundary_picture", "default_views", "model_pictures", "tissue_picture"]

Floats = NDArray[np.float64]

_GREY = np.array(to_rgb("#d9d4cf"))
# How much of a muscle shows through the skin.
_SHOW_THROUGH = 0.8
_FIBRES_DRAWN = 2500


def default_views(model: Model) -> list[str]:
    """Front and side; from the top too where the body is flat."""
    span = np.ptp(model.nodes, axis=0)
    return ["front", "side", *(["top"] if span[2] < 0.5 * span[:2].max() else [])]


def model_pictures(
    model: Model,
    folder: str | Path,
    *,
    views: Sequence[str] | None = None,
    cuts: Sequence[tuple[str, float]] | None = None,
) -> list[Path]:
    """Write pictures of a model into a folder.

    Args:
        model: The model.
        folder: Where to; made if it is not there.
        views: Names of ``VIEWS``; None: `default_views`.
        cuts: Axis and place (m) of planes to cut at; None: across x through the middle.

    Returns:
        The files: ``tissues-VIEW.png``, ``boundary-VIEW.png``, with muscles ``fibres-VIEW.png``,
        and ``cut-AXIS.png`` (numbered where an axis has several).

    Raises:
        InputError: an unknown view, a cut that meets no voxel, a folder that cannot be written.
    """
    require_voxels("pictures of a model", model)
    folder = Path(folder)
    chosen = default_views(model) if views is None else list(dict.fromkeys(views))
    for view in chosen:
        if view not in VIEWS:
            raise InputError(f"view: got {view!r}; allowed: {', '.join(VIEWS)}")
    if cuts is None:
        middle = 0.5 * (model.nodes[:, 0].min() + model.nodes[:, 0].max())
        cuts = [("x", float(middle))]
    check_new_folder(folder, "pictures")
    folder.mkdir(exist_ok=True)
    files = []
    for view in chosen:
        name = view.replace(" ", "-")
        files.append(tissue_picture(folder / f"tissues-{name}.png", model, view=view))
        if model.muscles:
            files.append(_fibres(folder / f"fibres-{name}.png", model, view))
        files.append(boundary_picture(folder / f"boundary-{name}.png", model, view=view))
    axes = [axis for axis, _ in cuts]
    for number, (axis, at) in enumerate(cuts):
        mark = f"-{axes[: number + 1].count(axis)}" if axes.count(axis) > 1 else ""
        files.append(cut_picture(folder / f"cut-{axis}{mark}.png", model, axis, at))
    return files


def tissue_picture(path: str | Path, model: Model, *, view: str = "front") -> Path:
    """Write a PNG of the tissues: muscles through the skin, and the tissue seen from behind.

    Args:
        path: A name ending in .png; replaced when complete.
        model: A voxel model.
        view: A name of ``VIEWS``.

    Returns:
        The path.

    Raises:
        InputError: an unknown view, no such folder.
    """
    colours = tissue_colours(model)
    mixed = model.fractions @ np.array([to_rgb(colours[name]) for name in model.tissues])
    sight = VoxelView(model, view)
    image = sight.elements(mixed)
    layers = np.ones(model.n_elements, dtype=bool)
    for muscle in model.muscles:
        layers[muscle.elements[muscle.weight >= 0.5]] = False
    inner = np.flatnonzero(~layers)
    if len(inner):
        pure = np.array([to_rgb(colours[name]) for name in model.tissues])
        through = sight.elements(pure[np.argmax(_of_muscles(model), axis=1)], inner)
        alpha = _SHOW_THROUGH * through[..., 3:]
        image[..., :3] = (1.0 - alpha) * image[..., :3] + alpha * through[..., :3]
    behind = VoxelView(model, opposite(view))
    panels = [
        (f"{view}, muscles seen through the skin" if len(inner) else view, image, sight),
        (f"from the {_side(opposite(view))}", behind.elements(mixed), behind),
    ]
    held = model.fractions.sum(axis=0) > 0.0
    legend = [
        Patch(color=colours[name], label=name)
        for name, there in zip(model.tissues, held, strict=True)
        if there
    ]
    return _write(path, f"Tissues: {model.n_elements:,} voxels of {_size(model)}", panels, legend)


def _of_muscles(model: Model) -> Floats:
    """The fractions with those of other tissues taken out, (n_elem, n_tissues)."""
    names = {muscle.name for muscle in model.muscles}
    chosen: Floats = model.fractions * np.array([name in names for name in model.tissues])
    return chosen


def boundary_picture(path: str | Path, model: Model, *, view: str = "front") -> Path:
    """Write a PNG of the outermost nodes that are held or slide, from a view and from behind.

    Nodes that voxels hide are faint.

    Args:
        path: A name ending in .png; replaced when complete.
        model: A voxel model.
        view: A name of ``VIEWS``.

    Returns:
        The path.

    Raises:
        InputError: an unknown view, no such folder.
    """
    outermost = np.unique(boundary_faces(model))
    kinds = node_kinds(model)
    legend, nodes, colours = [], [], []
    for kind, members in kinds.items():
        shown = outermost[members[outermost]]
        colour = NODE_COLOURS[kind]
        legend.append(Patch(color=colour, label=f"{kind}: {np.count_nonzero(members):,} nodes"))
        nodes.append(shown)
        colours.append(np.tile(to_rgb(colour), (len(shown), 1)))
    chosen = np.concatenate([*nodes, np.empty(0, dtype=np.int64)]).astype(np.int64)
    paint = np.concatenate([*colours, np.empty((0, 3))])
    grey = np.tile(_GREY, (model.n_elements, 1))
    panels = []
    for name in (view, opposite(view)):
        sight = VoxelView(model, name)
        image = sight.elements(grey)
        if len(chosen):
            points = model.nodes[chosen]
            image = sight.points(image, points, paint, radius=0.46, hidden=0.12)
        panels.append((view if name == view else f"from the {_side(name)}", image, sight))
    title = f"Boundary nodes of {model.n_nodes:,}" if legend else "No node is held or slides"
    return _write(path, title, panels, legend)


def _fibres(path: Path, model: Model, view: str) -> Path:
    """Draw the fibre field; the one place that chooses how."""
    try:
        fields = importlib.import_module("tledface.fibre_picture")
    except ImportError:
        return _fibre_lines(path, model, view)
    fields.fibre_picture(path, model, view=VIEWS[view][0])
    return path


def _fibre_lines(path: Path, model: Model, view: str) -> Path:
    """Draw a line along the fibre of every few elements of each muscle."""
    colours = tissue_colours(model)
    sight = VoxelView(model, view)
    image = sight.elements(np.tile(_GREY, (model.n_elements, 1)))
    lines, legend = [], []
    length = 1.8 * float(model.voxel.max())
    total = sum(len(muscle.elements) for muscle in model.muscles)
    for muscle in model.muscles:
        chosen = slice(None, None, max(1, total // _FIBRES_DRAWN))
        centre, fibre = model.centres[muscle.elements[chosen]], muscle.fibre[chosen]
        ends = [sight.project(centre + side * length * fibre)[:, :2] for side in (-1.0, 1.0)]
        colour = colours.get(muscle.name, INK)
        lines.append(LineCollection(list(np.stack(ends, axis=1)), colors=colour, linewidths=0.9))
        legend.append(Patch(color=colour, label=muscle.name))
    return _write(path, "Fibres", [(view, image, sight)], legend, lines)


def _write(
    path: str | Path,
    title: str,
    panels: Sequence[tuple[str, Floats, VoxelView]],
    legend: Sequence[Patch],
    lines: Sequence[LineCollection] = (),
) -> Path:
    """Put images side by side, with title, scale bars and a legend below."""
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"picture {path}: the name must end in .png")
    dpi, gap = 100, 24
    width = sum(sight.shape[1] for _, _, sight in panels) + gap * (len(panels) + 1)
    width = max(width, 760)
    tallest = max(sight.shape[0] for _, _, sight in panels)
    columns = max(1, min(len(legend), width // 200))
    below = 30 + 26 * -(-len(legend) // columns)
    height = 92 + tallest + 44 + below
    figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    left = gap
    for name, image, sight in panels:
        rows, shown = sight.shape
        axes = figure.add_axes((left / width, (below + 44) / height, shown / width, rows / height))
        axes.imshow(image, origin="lower", interpolation="nearest")
        axes.set_axis_off()
        axes.set_title(name, color=INK, fontsize=12, loc="left", pad=6)
        for line in lines:
            axes.add_collection(line)
        axes.set_xlim(-0.5, shown - 0.5)
        axes.set_ylim(-0.5, rows - 0.5)
        left += shown + gap
        scale_bar(axes, sight.scale, shown)
    figure.text(gap / width, 1.0 - 14 / height, title, color=INK, fontsize=15, va="top")
    if legend:
        figure.legend(
            handles=list(legend), loc="lower left", ncols=columns, frameon=False, fontsize=11,
            bbox_to_anchor=(0.5 * gap / width, 6 / height), labelcolor=INK,
        )  # fmt: skip
    with atomic_path(path, "picture") as part:
        figure.savefig(part, format="png")
    return path


def scale_bar(axes: Axes, scale: float, columns: int) -> None:
    """Draw a bar of a round length below an image of ``scale`` pixels a metre."""
    length = round_length(0.25 * columns / scale)
    axes.plot(
        [0, length * scale], [-16, -16], color=INK, linewidth=2.5, clip_on=False,
        solid_capstyle="butt",
    )  # fmt: skip
    axes.text(length * scale + 8, -16, f"{1e3 * length:g} mm", color=INK, fontsize=11, va="center")
    axes.set_xlim(-0.5, columns - 0.5)


def _side(view: str) -> str:
    return view if "side" in view or view in ("top", "bottom", "front") else "back (bone side)"


def _size(model: Model) -> str:
    edges = [f"{1e3 * edge:.4g}" for edge in model.voxel]
    return f"{edges[0]} mm" if len(set(edges)) == 1 else f"{' x '.join(edges)} mm"
