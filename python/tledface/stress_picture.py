"""Pictures of von Mises stress: on a surface and in a cut through the voxels, before and after.

All states have one scale, from 0 to a percentile of what is drawn, so that a few elements at an
edge do not take all the colours; the picture says which, and how far the rest goes. Where bodies
with much and with little stress stand in one picture the scale's end is given instead, and each
panel says how far its own stress goes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from tledface._model_checks import checked_faces, checked_points
from tledface.errors import InputError
from tledface.io._atomic import atomic_path
from tledface.picture import round_length, scale_bar
from tledface.shading import View, camera_on, shade, values_seen

__all__ = [
    "SurfaceStress",
    "VoxelStress",
    "cut_stress_panels",
    "cut_stress_picture",
    "skin_stress_panels",
    "skin_stress_picture",
]

Floats = NDArray[np.float64]

# Perceptually uniform, and light where there is no stress, so that relief shows.
_MAP = mpl.colormaps["inferno_r"]
# Of the map, its yellow to violet: what lies beyond is the paper or too dark to be shaded.
_MAP_ENDS = (0.04, 0.76)
_PERCENTILE = 98.0
_NO_STRESS = (0.75, 0.75, 0.75)
_INK, _MUSCLE = "#2b2626", "#1f6fb4"
# Pixels between panels and at the edges, and for a second line under a panel's name.
_GAP, _SECOND_LINE = 30, 20
# Local corners of the four edges along an axis of a hexahedron, going round it.
_EDGES = {
    "x": ((0, 1), (3, 2), (7, 6), (4, 5)),
    "y": ((0, 3), (1, 2), (5, 6), (4, 7)),
    "z": ((0, 4), (1, 5), (2, 6), (3, 7)),
}
# Axes of the picture for a cut across x, y, z: abscissa and ordinate.
_IN_PICTURE = {"x": (1, 2), "y": (0, 2), "z": (0, 1)}


@dataclass(frozen=True, eq=False)
class SurfaceStress:
    """A surface in one state, with the stress under it.

    Attributes:
        points: (nv, 3) m.
        faces: (nf, 3) int, counter-clockwise seen from outside.
        stress: (nv,) Pa; NaN is grey.
    """

    points: ArrayLike
    faces: ArrayLike
    stress: ArrayLike


@dataclass(frozen=True, eq=False)
class VoxelStress:
    """Voxels in one state or several, with their stress.

    Attributes:
        nodes: (n_nodes, 3) m, at rest.
        elements: (n_elem, 8) int, VTK hexahedron order.
        u: (n_nodes, 3) m for each state, displacement.
        stress: (n_elem,) Pa for each state.
        muscle: (n_elem,) bool, elements of which half or more is muscle.
    """

    nodes: Floats
    elements: NDArray[np.integer]
    u: tuple[Floats, ...]
    stress: tuple[Floats, ...]
    muscle: NDArray[np.bool_]


def skin_stress_picture(
    path: str | Path,
    states: tuple[ArrayLike, ArrayLike],
    faces: ArrayLike,
    stress: tuple[ArrayLike, ArrayLike],
    *,
    view: View = "oblique",
    up: ArrayLike = (0.0, 0.0, 1.0),
    labels: tuple[str, str] = ("before", "after"),
) -> Path:
    """Write a PNG of a surface in two states, side by side, coloured by stress.

    Args:
        path: A name ending in .png; replaced when complete.
        states: (nv, 3) m, before and after.
        faces: (nf, 3) int, counter-clockwise seen from outside.
        stress: (nv,) Pa, before and after; NaN is grey.
        view: As in `tledface.picture.wrinkle_picture`.
        up: As in `tledface.picture.wrinkle_picture`.
        labels: What the two states are.

    Raises:
        InputError: another ending, no such folder, arrays of a wrong shape or not finite, an
            unknown view.
    """
    pair = [
        SurfaceStress(points, faces, field) for points, field in zip(states, stress, strict=True)
    ]
    return skin_stress_panels(path, pair, labels=labels, view=view, up=up)


def skin_stress_panels(
    path: str | Path,
    states: Sequence[SurfaceStress],
    *,
    labels: Sequence[str],
    view: View = "oblique",
    up: ArrayLike = (0.0, 0.0, 1.0),
    columns: int = 2,
    size: tuple[int, int] = (760, 760),
    limit: float | None = None,
) -> Path:
    """Write a PNG of surfaces coloured by stress, in rows of panels with one camera and scale.

    Args:
        path: A name ending in .png; replaced when complete.
        states: What each panel shows.
        labels: What the states are.
        view: As in `tledface.picture.wrinkle_picture`.
        up: As in `tledface.picture.wrinkle_picture`.
        columns: Panels in a row.
        size: Greatest width and height of a panel, pixels.
        limit: Where the scale ends, Pa; each panel then says its own percentile. None: at the
            greatest of these.

    Raises:
        InputError: as `skin_stress_picture`; another number of labels than of states.
    """
    drawn = []
    for state in states:
        points = checked_points("picture", state.points)
        triangles = checked_faces("picture", state.faces, len(points))
        field = np.asarray(state.stress, dtype=np.float64)
        if field.shape != (len(points),):
            raise InputError(f"picture: stress has shape {field.shape}, need ({len(points)},)")
        drawn.append((points, triangles, field))
    corners = np.concatenate([points[triangles].reshape(-1, 3) for points, triangles, _ in drawn])
    camera = camera_on(corners, view, up, size)
    seen = [values_seen(points, triangles, camera, field) for points, triangles, field in drawn]
    scale = _Scale(seen, limit)
    grid = _Grid(camera.shape[::-1], columns, scale.named(labels))
    for number, (points, triangles, field) in enumerate(drawn):
        image = shade(points, triangles, camera, values=field, paint=scale.paint)
        grid.axes[number].imshow(image, origin="lower", interpolation="antialiased")
        if number in grid.barred:
            scale_bar(grid.axes[number], camera, down=16)
    _finish(grid, "Von Mises stress (Cauchy) under the surface", scale)
    return _save(grid.figure, path)


def cut_stress_picture(
    path: str | Path,
    voxels: VoxelStress,
    axis: str,
    at: float | None = None,
    *,
    labels: tuple[str, str] = ("before", "after"),
) -> Path:
    """Write a PNG of the tissue in a plane, where it is before and after, coloured by stress.

    Args:
        path: A name ending in .png; replaced when complete.
        voxels: Two states.
        axis: "x", "y" or "z", the normal of the plane.
        at: Where the plane is in the body at rest, m; what moves out of it is drawn as if it had
            not. None: through the median voxel.
        labels: What the two states are.

    Raises:
        InputError: an unknown axis, a plane that meets no voxel, another ending, no such folder.
    """
    return cut_stress_panels(path, [voxels], axis, at, labels=labels)


def cut_stress_panels(
    path: str | Path,
    bodies: Sequence[VoxelStress],
    axis: str,
    at: float | None = None,
    *,
    labels: Sequence[str],
    columns: int | None = None,
    size: tuple[int, int] | None = None,
    limit: float | None = None,
) -> Path:
    """Write a PNG of the tissue of bodies in a plane, in rows of panels with one scale.

    Args:
        path: A name ending in .png; replaced when complete.
        bodies: Their states follow each other.
        axis: As in `cut_stress_picture`.
        at: As in `cut_stress_picture`; None: through the median voxel of the first body.
        labels: What the states of all bodies are.
        columns: Panels in a row; None: two, one if the cut is flat.
        size: Greatest width and height of a panel, pixels; None: what suits two.
        limit: As in `skin_stress_panels`.

    Raises:
        InputError: as `cut_stress_picture`; another number of labels than of states.
    """
    if axis not in _EDGES:
        raise InputError(f"cut: got axis {axis!r}; allowed: x, y or z")
    if at is None:
        height = bodies[0].nodes[bodies[0].elements, "xyz".index(axis)]
        at = float(np.median(0.5 * (height.min(axis=1) + height.max(axis=1))))
    drawn = [panel for body in bodies for panel in _cut(body, axis, at)]
    everything = np.concatenate([quads.reshape(-1, 2) for quads, _, _ in drawn])
    corner, end = everything.min(axis=0), everything.max(axis=0)
    span = np.maximum(end - corner, 1e-9)
    # A flat cut stands above the other, a tall one beside it.
    flat = span[0] > 1.4 * span[1]
    columns = columns or (1 if flat else 2)
    size = size or ((1400, 430) if flat else (700, 800))
    extent = np.ceil(span * min(size / span)).astype(int)
    fields = [field for _, field, _ in drawn]
    scale = _Scale(fields, limit)
    grid = _Grid(extent, columns, scale.named(labels))
    for number, (quads, field, outline) in enumerate(drawn):
        axes = grid.axes[number]
        colours = scale.paint(field)
        # Drawn a hair larger, so that no paper shows between neighbours.
        axes.add_collection(
            PolyCollection(list(quads), facecolors=colours, edgecolors=colours, linewidths=0.3)
        )
        axes.add_collection(LineCollection(list(outline), colors=_MUSCLE, linewidths=1.1))
        axes.set_xlim(corner[0], end[0])
        axes.set_ylim(corner[1], end[1])
        if number in grid.barred:
            _length_bar(axes, float(span[0]), int(extent[1]))
    title = f"Von Mises stress (Cauchy) in the tissue at {axis} = {1e3 * at:.4g} mm"
    framed = any(len(outline) for _, _, outline in drawn)
    _finish(grid, title, scale, "framed blue: muscle" if framed else "")
    return _save(grid.figure, path)


def _cut(voxels: VoxelStress, axis: str, at: float) -> list[tuple[Floats, Floats, Floats]]:
    """Of each state what a plane meets.

    Returns quads (n, 4, 2) mm in the plane, their stress (n,) and lines (m, 2, 2) about muscle.
    """
    normal = "xyz".index(axis)
    height = voxels.nodes[voxels.elements, normal]
    low, high = height.min(axis=1), height.max(axis=1)
    # A plane between two layers shows the upper one, at the upper end of the body the last one.
    chosen = np.flatnonzero((low <= at + 1e-9) & (at + 1e-9 < high))
    if not len(chosen):
        chosen = np.flatnonzero(np.abs(high - at) < 1e-9)
    if not len(chosen):
        raise InputError(
            f"cut: no voxel lies at {axis} = {1e3 * at:g} mm; the voxels span "
            f"{1e3 * low.min():.5g} to {1e3 * high.max():.5g} mm"
        )
    across = list(_IN_PICTURE[axis])
    ends = voxels.elements[chosen][:, _EDGES[axis]]
    heights = voxels.nodes[ends, normal]
    share = ((at - heights[..., 0]) / (heights[..., 1] - heights[..., 0]))[..., None]
    outline = _outline(voxels.elements[chosen], voxels.muscle[chosen], axis)
    found = []
    for u, stress in zip(voxels.u, voxels.stress, strict=True):
        place = (voxels.nodes + u)[ends][..., across]
        quads = 1e3 * ((1.0 - share) * place[..., 0, :] + share * place[..., 1, :])
        lines = quads[outline[:, 0]][np.arange(len(outline))[:, None], outline[:, 1:]]
        found.append((quads, stress[chosen], lines))
    return found


class _Grid:
    """A figure with rows of panels, room above for a title and below for a bar of colours.

    Attributes:
        figure: The figure.
        axes: Of each panel.
        barred: Which panels get a bar of length: both of two, else the first of the last row.
    """

    def __init__(self, size: Sequence[int], columns: int, names: list[tuple[str, str]]) -> None:
        columns = min(columns, len(names))
        rows = -(-len(names) // columns)
        across, tall = (int(length) for length in size)
        last = (rows - 1) * columns
        self.barred = range(2) if len(names) == 2 else range(last, last + 1)
        # Between rows stand the names, and of two panels the first's bar.
        above, below, between = 84, 128, 66 if len(names) == 2 else 48
        if any(second for _, second in names):
            above, between = above + _SECOND_LINE, between + _SECOND_LINE
        width = max(760, columns * across + (columns + 1) * _GAP)
        height = above + below + rows * tall + (rows - 1) * between
        self.figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor="white")
        FigureCanvasAgg(self.figure)
        self.axes = []
        for number, (name, second) in enumerate(names):
            row, column = divmod(number, columns)
            left, bottom = (
                _GAP + column * (across + _GAP),
                below + (rows - 1 - row) * (tall + between),
            )
            axes = self.figure.add_axes(
                (left / width, bottom / height, across / width, tall / height), clip_on=False
            )
            axes.set_axis_off()
            pad = 6 + 0.72 * (_SECOND_LINE if second else 0)
            axes.set_title(name, color=_INK, fontsize=12, loc="left", pad=pad)
            axes.text(
                0.0, 1.0 + 8 / tall, second, color=_INK, fontsize=10, transform=axes.transAxes
            )
            self.axes.append(axes)


class _Scale:
    """The colours of stress, from 0 to a percentile of what is drawn, or to a given end."""

    def __init__(self, drawn: list[Floats], limit: float | None = None) -> None:
        there = [values[np.isfinite(values)] for values in drawn]
        # Of each state apart, as one may be without stress.
        self.tops = [float(np.percentile(v, _PERCENTILE)) if len(v) else 0.0 for v in there]
        self.greatest = max((float(v.max()) for v in there if len(v)), default=0.0)
        self.given = limit is not None
        top = limit if limit is not None else max(self.tops, default=0.0) or self.greatest
        # A body without stress has one colour, whatever the scale.
        self.limit = top if top > 0.0 else 1.0
        self.factor, self.unit = next(
            (factor, unit)
            for least, factor, unit in ((1e6, 1e-6, "MPa"), (1e3, 1e-3, "kPa"), (0.0, 1.0, "Pa"))
            if self.limit >= least
        )

    def paint(self, values: Floats) -> Floats:
        """The colours of stresses (n,) Pa: sRGB (n, 3)."""
        low, high = _MAP_ENDS
        share = np.clip(np.nan_to_num(values) / self.limit, 0.0, 1.0)
        colours: Floats = np.array(_MAP(low + (high - low) * share))[:, :3]
        colours[~np.isfinite(values)] = _NO_STRESS
        return colours

    def text(self) -> str:
        """What the upper end of the scale is."""
        limit, most = self.show(self.limit), self.show(self.greatest)
        if self.given:
            return f"the scale ends at {limit} (greatest {most})"
        return f"the scale ends at the {_PERCENTILE:g}th percentile, {limit} (greatest {most})"

    def named(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Names of the states, and how far their stress goes where the scale does not say it.

        Raises:
            InputError: another number of labels than of states.
        """
        if len(labels) != len(self.tops):
            raise InputError(f"picture: got {len(labels)} labels, need {len(self.tops)}")
        if not self.given:
            return [(label, "") for label in labels]
        return [
            (
                label,
                f"{_PERCENTILE:g} % below {self.show(top)}"
                if top > 1e-6 * self.limit
                else "no stress",
            )
            for label, top in zip(labels, self.tops, strict=True)
        ]

    def show(self, stress: float) -> str:
        """A stress (Pa) in the scale's unit."""
        return f"{float(f'{self.factor * stress:.3g}'):g} {self.unit}"


def _finish(grid: _Grid, title: str, scale: _Scale, note: str = "") -> None:
    """Add title, colour bar and what the bar means."""
    figure = grid.figure
    width, height = 100.0 * figure.get_size_inches()
    figure.text(_GAP / width, 1.0 - 14 / height, title, color=_INK, fontsize=15, va="top")
    bar = figure.add_axes(
        (_GAP / width, 66 / height, min(640, width - 2 * _GAP) / width, 14 / height)
    )
    ramp = scale.paint(np.linspace(0.0, scale.limit, 256))
    shown = ScalarMappable(
        Normalize(0.0, scale.factor * scale.limit), mpl.colors.ListedColormap(ramp)
    )
    colours = figure.colorbar(shown, cax=bar, orientation="horizontal", extend="max")
    colours.ax.tick_params(colors=_INK, labelsize=11)
    colours.set_label("")
    unit = (_GAP + 650) / width  # a figure is wide enough, see _Grid
    figure.text(unit, 73 / height, scale.unit, color=_INK, fontsize=12, va="center")
    said = scale.text() + (f"; {note}" if note else "")
    figure.text(_GAP / width, 12 / height, said, color=_INK, fontsize=11, va="bottom")


def _outline(
    elements: NDArray[np.integer], muscle: NDArray[np.bool_], axis: str
) -> NDArray[np.int64]:
    """Sides of quads where muscle ends, (n, 3): the quad and the two corners of the side."""
    lower = elements[:, [edge[0] for edge in _EDGES[axis]]]
    sides = np.stack([lower, np.roll(lower, -1, axis=1)], axis=2).reshape(-1, 2)
    sides.sort(axis=1)
    inside = np.repeat(muscle, 4)
    _, inverse = np.unique(sides, axis=0, return_inverse=True)
    of_muscle = np.bincount(inverse.reshape(-1), inside)
    chosen = np.flatnonzero(inside & (of_muscle[inverse.reshape(-1)] == 1))
    quad, corner = chosen // 4, chosen % 4
    return np.stack([quad, corner, (corner + 1) % 4], axis=1)


def _length_bar(axes: Any, span: float, rows: int) -> None:
    """A bar of a round length (mm) below an axes that spans ``span`` mm."""
    length = 1e3 * round_length(0.25e-3 * span)
    down = -18 / rows
    axes.plot(
        [0, length / span], [down, down], color=_INK, linewidth=2.5, clip_on=False,
        solid_capstyle="butt", transform=axes.transAxes,
    )  # fmt: skip
    axes.text(
        length / span + 0.012, down, f"{length:g} mm", color=_INK, fontsize=11, va="center",
        transform=axes.transAxes,
    )  # fmt: skip


def _save(figure: Figure, path: str | Path) -> Path:
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"picture {path}: the name must end in .png")
    with atomic_path(path, "picture") as part:
        figure.savefig(part, format="png")
    return path
