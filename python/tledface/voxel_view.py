"""Orthographic images of a model's voxels: shaded faces in colour, and points in front of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError
from tledface.raster import Raster, box_mean, rasterise, view_axes
from tledface.surface import HEX_CORNERS, exposed_corners

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["VIEWS", "VoxelView", "opposite", "require_voxels"]

Floats = NDArray[np.float64]

# The way from the body to the viewer, and what points up. Anatomical frames here have +z up and
# faces that look along -y.
VIEWS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "front": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "back": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "side": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "other side": ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "top": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "bottom": ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
}
_OPPOSITES = ("front", "back", "side", "other side", "top", "bottom")
_MARGIN = 10  # pixels around the body
# Steps of voxels are smoothed over this many voxels before they are lit.
_SMOOTH = 1.5
_LIGHT = np.array([-0.45, 0.55, 0.70]) / np.linalg.norm([-0.45, 0.55, 0.70])


def require_voxels(what: str, model: Model) -> None:
    """Refuse a conforming mesh: pictures of models are of voxels."""
    if model.is_conforming:
        raise InputError(
            f"{what}: the model is a conforming mesh; allowed: a model of voxels. Viewers of "
            "meshes show the file that it was read from, and the frames of its runs"
        )


def opposite(view: str) -> str:
    """The view from the other side."""
    return _OPPOSITES[_OPPOSITES.index(view) ^ 1]


class VoxelView:
    """A camera on a model's voxels.

    Attributes:
        scale: Pixels in a metre.
        shape: Rows and columns of the images, row 0 lowest.
        axes: (3, 3) rows right, up and towards the viewer.
    """

    def __init__(self, model: Model, view: str, size: tuple[int, int] = (760, 660)) -> None:
        """Fit the model into ``size`` (width, height) pixels; InputError for an unknown view."""
        if view not in VIEWS:
            raise InputError(f"view: got {view!r}; allowed: {', '.join(VIEWS)}")
        self._model = model
        self.axes = view_axes(*VIEWS[view])
        seen = model.nodes @ self.axes[:2].T
        low, high = seen.min(axis=0), seen.max(axis=0)
        self.scale = float(((np.array(size) - 2 * _MARGIN) / (high - low)).min())
        self._low = low * self.scale - _MARGIN
        columns, rows = np.ceil((high - low) * self.scale).astype(int) + 2 * _MARGIN
        self.shape = (int(rows), int(columns))

    def project(self, points: ArrayLike) -> Floats:
        """Pixel coordinates and height in pixels of points (n, 3) m."""
        seen: Floats = np.asarray(points, dtype=np.float64) @ self.axes.T * self.scale
        seen[:, :2] -= self._low
        return seen

    def elements(self, colours: Floats, chosen: NDArray[np.int64] | None = None) -> Floats:
        """Return a shaded image of elements: (rows, columns, 4), clear where there are none.

        Args:
            colours: (n_elem, 3) sRGB, 0 to 1, of all the model's elements.
            chosen: Elements to draw, all others are taken away; None: all.
        """
        raster, owner = self._raster(chosen)
        covered = raster.triangle >= 0
        light = self._light(raster.height)
        image = np.zeros((*self.shape, 4))
        image[covered, :3] = colours[owner[raster.triangle[covered]]] * light[covered, None]
        image[covered, 3] = 1.0
        return np.clip(image, 0.0, 1.0)

    def points(
        self, image: Floats, points: Floats, colours: Floats, *, radius: float, hidden: float
    ) -> Floats:
        """Return an image with discs at points on it, the nearest on top.

        Args:
            image: (rows, columns, 4), from `elements` of all the model's elements.
            points: (n, 3) m.
            colours: (n, 3) sRGB.
            radius: Of a disc, in voxels.
            hidden: Opacity of points that voxels hide.
        """
        rows, columns = self.shape
        height = self._raster(None)[0].height
        seen = self.project(points)
        place = np.rint(seen[:, :2]).astype(np.int64)
        place = np.clip(place, 0, [columns - 1, rows - 1])
        edge = float(self._model.voxel.max()) * self.scale
        ground = height[place[:, 1], place[:, 0]]
        # A node on the silhouette may lie beside the last covered pixel.
        visible = ~(seen[:, 2] < ground - 0.75 * edge)
        size = max(1.0, radius * edge)
        reach = np.arange(-int(size), int(size) + 1)
        offsets = [(x, y) for x in reach for y in reach if x * x + y * y <= size * size]
        result = image.copy()
        for shown, opacity in ((~visible, hidden), (visible, 1.0)):
            if opacity == 0.0 or not shown.any():
                continue
            order = np.flatnonzero(shown)[np.argsort(seen[shown, 2], kind="stable")]
            layer = np.full((rows, columns), -1, dtype=np.int64)
            for x, y in offsets:
                spot = place[order] + (x, y)
                inside = ((spot >= 0) & (spot < (columns, rows))).all(axis=1)
                # Of points at one pixel the last written, the nearest, stays.
                layer[spot[inside, 1], spot[inside, 0]] = np.maximum(
                    layer[spot[inside, 1], spot[inside, 0]], np.flatnonzero(inside)
                )
            drawn = layer >= 0
            colour = colours[order[layer[drawn]]]
            result[drawn, :3] = (1.0 - opacity) * result[drawn, :3] + opacity * colour
            result[drawn, 3] = np.maximum(result[drawn, 3], opacity)
        return result

    def _raster(self, chosen: NDArray[np.int64] | None) -> tuple[Raster, NDArray[np.int64]]:
        """Rasterise exposed faces that look at the viewer; returns the element of each triangle."""
        model = self._model
        numbers = np.arange(model.n_elements) if chosen is None else chosen
        codes = exposed_corners(model.cells[numbers])
        corners = model.cells[numbers[codes // 8]] + HEX_CORNERS[codes % 8]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        codes = codes[normal @ self.axes[2] > 1e-9]
        owner = numbers[codes[:, 0] // 8]
        nodes = model.elements.reshape(-1)[8 * numbers[codes // 8] + codes % 8]
        triangles = np.concatenate([nodes[:, [0, 1, 2]], nodes[:, [0, 2, 3]]])
        raster = rasterise(self.project(model.nodes), triangles, self.shape)
        return raster, np.concatenate([owner, owner])

    def _light(self, height: Floats) -> Floats:
        """0.5 to 1.1: light on the slope of the smoothed height, and depth behind edges."""
        covered = np.isfinite(height)
        if not covered.any():
            return np.ones_like(height)
        edge = float(self._model.voxel.max()) * self.scale
        reach = max(1, round(0.5 * _SMOOTH * edge))
        base = np.where(covered, height - height[covered].mean(), 0.0)
        level, weight = base, covered.astype(np.float64)
        for _ in range(2):
            level, weight = box_mean(level, reach), box_mean(weight, reach)
        level = level / np.maximum(weight, 1e-9)
        down, across = np.gradient(np.where(weight > 1e-3, level, 0.0))
        slope = np.clip(np.stack([-across, -down], axis=-1), -4.0, 4.0)
        length = np.sqrt((slope**2).sum(axis=-1) + 1.0)
        lit = (slope @ _LIGHT[:2] + _LIGHT[2]) / length
        light: Floats = 0.55 + 0.5 * np.clip(lit, 0.0, 1.0)
        return light
