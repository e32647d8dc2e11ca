"""Pictures of von Mises stress: on a surface and in a cut through the voxels, before and after.

Both states have one scale, from 0 to a percentile of what is drawn, so that a few elements at an
edge do not take all the colours; the picture says which, and how far the rest goes.
"""

from __future__ import annotations

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

from tledface.errors import InputError
from tledface.io._atomic import atomic_path
from tledface.picture import checked_surface, round_length, scale_bar
from tledface.shading import View, camera_on, shade, values_seen

__all__ = ["VoxelStress", "cut_stress_picture", "skin_stress_picture"]

Floats = NDArray[np.float64]

# Perceptually uniform, and light where there is no stress, so that relief shows.
_MAP = mpl.colormaps["inferno_r"]
# Of the map, its yellow to violet: what lies beyond is the paper or too dark to be shaded.
_MAP_ENDS = (0.04, 0.76)
_PERCENTILE = 98.0
_NO_STRESS = (0.75, 0.75, 0.75)
_INK, _MUSCLE = "#2b2626", "#1f6fb4"
# Local corners of the four edges along an axis of a hexahedron, going round it.
_EDGES = {
    "x": ((0, 1), (3, 2), (7, 6), (4, 5)),
    "y": ((0, 3), (1, 2), (5, 6), (4, 7)),
    "z": ((0, 4), (1, 5), (2, 6), (3, 7)),
}
# Axes of the picture for a cut across x, y, z: abscissa and ordinate.
_IN_PICTURE = {"x": (1, 2), "y": (0, 2), "z": (0, 1)}


@dataclass(frozen=True, eq=False)
class VoxelStress:
    """Voxels in two states, with their stress.

    Attributes:
        nodes: (n_nodes, 3) m, at rest.
        elements: (n_elem, 8) int, VTK hexahedron order.
        u: (n_nodes, 3) m, displacement before and after.
        stress: (n_elem,) Pa, before and after.
        muscle: (n_elem,) bool, elements of which half or more is muscle.
    """

    nodes: Floats
    elements: NDArray[np.integer]
    u: tuple[Floats, Floats]
    stress: tuple[Floats, Floats]
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
    before, after, triangles = checked_surface(*states, faces)
    values = tuple(np.asarray(field, dtype=np.float64) for field in stress)
    for field in values:
        if field.shape != (len(before),):
            raise InputError(f"picture: stress has shape {field.shape}, need ({len(before)},)")
    corners = np.concatenate([before[triangles], after[triangles]])
    camera = camera_on(corners, view, up, (760, 760))
    moved = list(zip((before, after), values, strict=True))
    scale = _Scale([values_seen(points, triangles, camera, field) for points, field in moved])
    rows, columns = camera.shape
    gap, above, below = 30, 84, 128
    width, height = 2 * columns + 3 * gap, rows + above + below
    figure = _figure(width, height)
    for number, (points, field) in enumerate(moved):
        left = gap + number * (columns + gap)
        axes = figure.add_axes((left / width, below / height, columns / width, rows / height))
        image = shade(points, triangles, camera, values=field, paint=scale.paint)
        axes.imshow(image, origin="lower", interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(labels[number], color=_INK, fontsize=12, loc="left", pad=6)
        scale_bar(axes, camera, down=16)
    _finish(figure, "Von Mises stress (Cauchy) under the surface", scale, gap)
    return _save(figure, path)


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
    if axis not in _EDGES:
        raise InputError(f"cut: got axis {axis!r}; allowed: x, y or z")
    normal = "xyz".index(axis)
    height = voxels.nodes[voxels.elements, normal]
    low, high = height.min(axis=1), height.max(axis=1)
    if at is None:
        at = float(np.median(0.5 * (low + high)))
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
    quads = []
    for u in voxels.u:
        place = (voxels.nodes + u)[ends][..., across]
        quads.append(1e3 * ((1.0 - share) * place[..., 0, :] + share * place[..., 1, :]))
    fields = [field[chosen] for field in voxels.stress]
    scale = _Scale(fields)
    outline = _outline(voxels.elements[chosen], voxels.muscle[chosen], axis)
    everything = np.concatenate(quads).reshape(-1, 2)
    corner, end = everything.min(axis=0), everything.max(axis=0)
    span = np.maximum(end - corner, 1e-9)
    # A flat cut stands above the other, a tall one beside it.
    stacked = span[0] > 1.4 * span[1]
    per_mm = min((1400 if stacked else 700) / span[0], (430 if stacked else 800) / span[1])
    columns, rows = np.ceil(span * per_mm).astype(int)
    gap, above, below, between = 30, 84, 128, 66
    width = max(760, (columns if stacked else 2 * columns + gap) + 2 * gap)
    total = above + below + (2 * rows + between if stacked else rows)
    figure = _figure(width, total)
    for number, (quad, field) in enumerate(zip(quads, fields, strict=True)):
        left = gap if stacked else gap + number * (columns + gap)
        bottom = below + (rows + between if stacked and number == 0 else 0)
        axes = figure.add_axes(
            (left / width, bottom / total, columns / width, rows / total), clip_on=False
        )
        colours = scale.paint(field)
        # Drawn a hair larger, so that no paper shows between neighbours.
        axes.add_collection(
            PolyCollection(list(quad), facecolors=colours, edgecolors=colours, linewidths=0.3)
        )
        lines = quad[outline[:, 0]][np.arange(len(outline))[:, None], outline[:, 1:]]
        axes.add_collection(LineCollection(list(lines), colors=_MUSCLE, linewidths=1.1))
        axes.set_xlim(corner[0], end[0])
        axes.set_ylim(corner[1], end[1])
        axes.set_axis_off()
        axes.set_title(labels[number], color=_INK, fontsize=12, loc="left", pad=6)
        _length_bar(axes, float(span[0]), rows)
    title = f"Von Mises stress (Cauchy) in the tissue at {axis} = {1e3 * at:.4g} mm"
    _finish(figure, title, scale, gap, "framed blue: muscle" if len(outline) else "")
    return _save(figure, path)


class _Scale:
    """The colours of stress, from 0 to a percentile of what is drawn in both states."""

    def __init__(self, drawn: list[Floats]) -> None:
        there = [values[np.isfinite(values)] for values in drawn]
        # Of each state apart, as one may be without stress.
        tops = [float(np.percentile(v, _PERCENTILE)) for v in there if len(v)]
        self.greatest = max((float(v.max()) for v in there if len(v)), default=0.0)
        top = max(tops, default=0.0) or self.greatest
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
        limit, most = (
            f"{float(f'{self.factor * stress:.3g}'):g} {self.unit}"
            for stress in (self.limit, self.greatest)
        )
        return f"the scale ends at the {_PERCENTILE:g}th percentile, {limit} (greatest {most})"


def _finish(figure: Figure, title: str, scale: _Scale, gap: int, note: str = "") -> None:
    """Add title, colour bar and what the bar means."""
    width, height = 100.0 * figure.get_size_inches()
    figure.text(gap / width, 1.0 - 14 / height, title, color=_INK, fontsize=15, va="top")
    bar = figure.add_axes(
        (gap / width, 66 / height, min(640, width - 2 * gap) / width, 14 / height)
    )
    ramp = scale.paint(np.linspace(0.0, scale.limit, 256))
    shown = ScalarMappable(
        Normalize(0.0, scale.factor * scale.limit), mpl.colors.ListedColormap(ramp)
    )
    colours = figure.colorbar(shown, cax=bar, orientation="horizontal", extend="max")
    colours.ax.tick_params(colors=_INK, labelsize=11)
    colours.set_label("")
    unit = (gap + 650) / width if width > 760 + gap else None
    if unit:
        figure.text(unit, 73 / height, scale.unit, color=_INK, fontsize=12, va="center")
    said = scale.text() + (f"; {note}" if note else "")
    figure.text(gap / width, 12 / height, said, color=_INK, fontsize=11, va="bottom")


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


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: str | Path) -> Path:
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"picture {path}: the name must end in .png")
    with atomic_path(path, "picture") as part:
        figure.savefig(part, format="png")
    return path
