"""Folds of a run's surface: measured along the fibres of the muscle that pulls hardest.

Lines run along the mean fibre direction, over the part of the outer surface that lies above the
contracted muscle (the steps at its ends are its own bulge, not folds); heights are along that
surface's mean normal at rest. The line with the median number of folds (of several such, the one
with the highest) stands for all.

What is lower than the steps of the voxels make it is no fold: see `_steps`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tledface.metrics import MIN_PROMINENCE, WrinkleMetrics, line_profile, wrinkles
from tledface.model import Model
from tledface.muscle import Muscle
from tledface.surface import boundary_surface

__all__ = ["Folds", "measure_folds"]

Floats = NDArray[np.float64]
Line = tuple[Floats, Floats]
Boxes = Sequence[tuple[tuple[float, float, float], tuple[float, float, float]]]

_LINES = 9
_SAMPLES = 800
_NEAREST_SAMPLES = 400
# Of the height of a voxel's step that a bound surface may show, see `_steps`.
_STEP_SHARE = 1.0 / 3.0
# m; of what a surface that is the voxels' own boundary is away from it.
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Folds:
    """Folds over a muscle: number, mean distance (m, NaN below two folds), mean height (m).

    ``line`` holds the two ends (3,) m of the line that was measured, ``up`` (3,) the unit
    direction of its heights. What stands out less than ``min_prominence`` (m) was not counted.
    """

    muscle: str
    count: int
    wavelength: float
    amplitude: float
    line: tuple[Floats, Floats]
    up: Floats
    min_prominence: float = MIN_PROMINENCE

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI units; a wavelength that is not there is None."""
        return {
            "muscle": self.muscle,
            "count": self.count,
            "wavelength_m": self.wavelength if math.isfinite(self.wavelength) else None,
            "amplitude_m": self.amplitude,
            "min_prominence_m": self.min_prominence,
            "line_m": [end.tolist() for end in self.line],
            "up": self.up.tolist(),
        }

    def text(self) -> str:
        """One line for a person."""
        if self.count == 0:
            return f"no wrinkles over {self.muscle}"
        spacing = f", {self.wavelength * 1e3:.1f} mm apart" if self.count > 1 else ""
        folds = "fold" if self.count == 1 else "folds"
        height = self.amplitude * 1e3
        return f"wrinkles over {self.muscle}: {self.count} {folds}{spacing}, {height:.2f} mm high"


def measure_folds(
    model: Model,
    surface: str,
    u: Floats,
    strengths: Mapping[str, float],
    outer: Boxes | None = None,
) -> Folds | None:
    """Measure the folds over the strongest muscle.

    None if no muscle pulls, or along no length, or if no face of the surface moves.

    Arguments: ``surface``, a name in ``model.surfaces``; ``u`` (n_nodes, 3) m; ``strengths``,
    active stress (Pa) by muscle name; ``outer``, boxes (low, high corner, m) that hold the outer
    faces of the surface (None: all faces may be outer ones).
    """
    pulling = [muscle for muscle in model.muscles if strengths.get(muscle.name, 0.0) > 0.0]
    if not pulling:
        return None
    muscle = max(pulling, key=lambda m: strengths[m.name] * float(m.weight.sum()))
    bound = model.surfaces[surface]
    if not len(bound.bound_faces):
        return None
    faces = bound.bound_faces
    centres = model.centres[muscle.elements]
    up = _outward(bound.vertices, faces, centres, outer)
    along = _mean_fibre(muscle)
    along -= (along @ up) * up
    if not np.linalg.norm(along) > 1e-6:
        return None
    along /= np.linalg.norm(along)
    across = np.cross(up, along)
    now = centres + u[model.elements[muscle.elements]].mean(axis=1)
    start, end = np.quantile(now @ along, [0.02, 0.98])
    if end - start < model.shortest_edge:
        return None  # a muscle of a voxel or two has no line to measure along
    lines = list(_lines(now, along, across, up))
    # Of the material that is measured: where it was at rest.
    steps = _steps(model, bound.vertices, faces, list(_lines(centres, along, across, up)), up)
    least = max(MIN_PROMINENCE, steps)
    moved = bound.displaced(u)
    found = []
    for ends in lines:
        line = _measure(moved, faces, ends, up, least)
        found.append(
            Folds(muscle.name, line.count, line.wavelength, line.amplitude, ends, up, least)
        )
    counts = sorted(folds.count for folds in found)
    median = counts[len(counts) // 2]
    likely = [number for number, folds in enumerate(found) if folds.count == median]
    # Where nothing folds, the line in the middle stands for all.
    return found[max(likely, key=lambda n: (found[n].amplitude, -abs(n - _LINES // 2)))]


def _lines(centres: Floats, along: Floats, across: Floats, up: Floats) -> Iterator[Line]:
    """Lines over a muscle whose voxels have these centres."""
    start, end = np.quantile(centres @ along, [0.02, 0.98])
    height = float((centres @ up).mean())
    for offset in np.quantile(centres @ across, np.linspace(0.2, 0.8, _LINES)):
        foot = offset * across + height * up
        yield foot + start * along, foot + end * along


def _measure(
    vertices: Floats, faces: NDArray[np.integer], ends: Line, up: Floats, least: float
) -> WrinkleMetrics:
    heights, spacing = _heights(vertices, faces, ends, up)
    return wrinkles(heights, spacing, min_prominence=least)


def _heights(
    vertices: Floats, faces: NDArray[np.integer], ends: Line, up: Floats
) -> tuple[Floats, float]:
    spacing = float(np.linalg.norm(ends[1] - ends[0])) / _SAMPLES
    return line_profile(vertices, faces, *ends, spacing, direction=up)[1], spacing


def _steps(
    model: Model, vertices: Floats, faces: NDArray[np.integer], lines: list[Line], up: Floats
) -> float:
    """How high ripples may be (m) that only the steps of the voxels make, by lines at rest.

    A smooth surface over stepped voxels lies now nearer, now farther from them. A vertex outside
    its voxel moves on by that voxel's strain times its distance, so the surface ripples by a step's
    height times the strain: where muscles shorten the skin by a third, by a third. (In the shipped
    ``curved-block`` of one material, which does not fold, by 0.16 of it.) A surface that is the
    voxels' own boundary has the steps themselves, and as much more. Where voxels lie in level
    layers, as in a flat block, there are no steps; nor are there in conforming meshes.
    """
    if model.is_conforming:
        return 0.0
    boundary = boundary_surface(model)
    highest = 0.0
    for ends in lines:
        smooth, spacing = _heights(vertices, faces, ends, up)
        stepped, _ = _heights(boundary.vertices, boundary.faces, ends, up)
        away = stepped - smooth
        own = not (np.abs(away[np.isfinite(away)]) > _SAME).any()
        found = wrinkles(stepped if own else away, spacing, min_prominence=0.0).heights[0]
        share = 1.0 + _STEP_SHARE if own else _STEP_SHARE
        highest = max(highest, share * min(found.max(initial=0.0), float(model.voxel @ np.abs(up))))
    return highest


def _mean_fibre(muscle: Muscle) -> Floats:
    """The axis closest to all fibres, whose signs do not matter."""
    spread = np.einsum("e,ei,ej->ij", muscle.weight, muscle.fibre, muscle.fibre)
    return np.array(np.linalg.eigh(spread)[1][:, -1])


def _outward(
    vertices: Floats, faces: NDArray[np.integer], centres: Floats, outer: Boxes | None
) -> Floats:
    """The mean unit normal of the outer faces nearest to the muscle."""
    corners = vertices[faces]
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if outer is not None:
        inside = np.zeros(len(middle), dtype=bool)
        for low, high in outer:
            inside |= ((middle >= low) & (middle <= high)).all(axis=1)
        if inside.any():
            middle, normal = middle[inside], normal[inside]
    chosen = centres[:: max(1, len(centres) // _NEAREST_SAMPLES)]
    nearest = [int(((middle - centre) ** 2).sum(axis=1).argmin()) for centre in chosen]
    size = np.linalg.norm(normal[nearest], axis=1, keepdims=True)
    mean = (normal[nearest] / np.maximum(size, np.finfo(float).tiny)).sum(axis=0)
    norm = float(np.linalg.norm(mean))
    return mean / norm if norm > 0.0 else np.array([0.0, 0.0, 1.0])
