"""Figures of the forehead's run: how far the brow went, and the folds of the skin.

Folds are counted on the bound skin along upright lines 15 and 30 mm beside the midline, heights
forwards; only those count that are 1 mm high or more from ridge to valley, less those that the
shape at rest has. The upright lines of a frown are counted along a level line between the brows.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.metrics import line_profile, wrinkles
from tledface.run_frames import RunFrames

__all__ = ["Measures", "measure", "measure_surfaces"]

Floats = NDArray[np.float64]

# m. Lines beside the midline, their ends in height, and the least height of a fold.
_BESIDE = (15e-3, 30e-3)
_LOW, _HIGH = 1.545, 1.618
_LEAST = 1e-3
_SPACING = 2e-4
# The level line's height and how far it goes beside the midline, and the least height of its folds:
# those of a frown are lower and closer than those of a raised brow.
_LEVEL, _BETWEEN, _LEAST_UPRIGHT = 1.545, 25e-3, 0.3e-3
# The brow: skin within this of a point 30 mm beside the midline, or on it.
_BROW, _ROOT, _REACH = (30e-3, 1.551), (0.0, 1.547), 3e-3


@dataclass(frozen=True)
class Measures:
    """Lengths in m.

    Attributes:
        brow_rise: Median rise of the brow's skin 30 mm beside the midline.
        root_rise: The same between the brows, on the midline.
        folds: Folds of 1 mm and more beyond the rest shape's, by line (mm beside the midline).
        wavelength: Mean distance of those lines' ridges; NaN with fewer than two on each.
        heights: Least and greatest height of those folds; 0 without folds.
        upright: Upright folds of 0.3 mm and more between the brows beyond the rest shape's, of both
            sides; of a half model what the whole would have. Folds of a raised brow that arch
            across that line count too.
        upright_height: Greatest height of those; 0 without.
    """

    brow_rise: float
    root_rise: float
    folds: dict[str, int]
    wavelength: float
    heights: tuple[float, float]
    upright: int
    upright_height: float

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI units."""
        plain = asdict(self)
        if not np.isfinite(self.wavelength):
            plain["wavelength"] = None
        return plain

    def text(self) -> str:
        """A line for a person."""
        folds = ", ".join(f"{count} at {where} mm" for where, count in self.folds.items())
        low, high = (1e3 * height for height in self.heights)
        apart = f", {1e3 * self.wavelength:.1f} mm apart" if np.isfinite(self.wavelength) else ""
        size = f", {low:.1f} to {high:.1f} mm high" if high > 0.0 else ""
        upright = (
            f"; upright: {self.upright}, up to {1e3 * self.upright_height:.1f} mm high"
            if self.upright and not any(self.folds.values())
            else ""
        )
        return (
            f"brow {1e3 * self.brow_rise:+.1f} mm, "
            f"between the brows {1e3 * self.root_rise:+.1f} mm; "
            f"folds of 1 mm and more: {folds}{apart}{size}{upright}"
        )


def measure(directory: str | Path) -> Measures:
    """Measure a run of the forehead at its last frame; raises InputError if there is none."""
    frames = RunFrames(directory)
    return measure_surfaces(*frames.surface((0, frames.at(None))))


def measure_surfaces(rest: ArrayLike, moved: ArrayLike, faces: ArrayLike) -> Measures:
    """Measure the skin, at rest and moved: vertices (nv, 3) m each, faces (nf, 3).

    Where there is tissue on both sides of the midline, a line's folds are the mean of both, less
    halves.
    """
    before, after = np.asarray(rest, dtype=np.float64), np.asarray(moved, dtype=np.float64)
    triangles = np.asarray(faces)
    used = np.zeros(len(before), dtype=bool)
    used[triangles] = True
    sides = [side for side in (-1.0, 1.0) if (side * before[used, 0]).max() > 35e-3]
    counts, gaps, heights = {}, [], []
    for beside in _BESIDE:
        extra = []
        for side in sides:
            ridges, high = _folds(after, triangles, side * beside)
            extra.append(len(ridges) - len(_folds(before, triangles, side * beside)[0]))
            gaps.append(np.diff(ridges))
            heights.append(high)
        counts[f"{1e3 * beside:g}"] = max(0, int(np.floor(np.mean(extra))))
    apart, tall = np.concatenate(gaps), np.concatenate(heights)
    rise = after[:, 2] - before[:, 2]
    upright = _upright(after, triangles, sides)
    return Measures(
        brow_rise=float(np.median(rise[used & _near(before, *_BROW)])),
        root_rise=float(np.median(rise[used & _near(before, *_ROOT)])),
        folds=counts,
        wavelength=float(apart.mean()) if len(apart) else float("nan"),
        heights=(float(tall.min()), float(tall.max())) if len(tall) else (0.0, 0.0),
        upright=max(0, len(upright) - len(_upright(before, triangles, sides))),
        upright_height=float(upright.max(initial=0.0)),
    )


def _folds(vertices: Floats, faces: NDArray[np.int64], x: float) -> tuple[Floats, Floats]:
    """Positions and heights of the folds of an upright line that are high enough to count."""
    ends = (np.array([x, 0.0, _LOW]), np.array([x, 0.0, _HIGH]))
    profile = line_profile(vertices, faces, *ends, _SPACING, direction=(0.0, -1.0, 0.0))[1]
    found = wrinkles(profile, _SPACING)
    high = found.heights[0] >= _LEAST
    return found.positions[0][high], found.heights[0][high]


def _upright(vertices: Floats, faces: NDArray[np.int64], sides: list[float]) -> Floats:
    """Heights of the folds of the level line between the brows that are high enough to count."""
    ends = [np.array([x, 0.0, _LEVEL]) for x in (-_BETWEEN, 0.0, _BETWEEN)]
    halves = [
        line_profile(vertices, faces, pair[0], pair[1], _SPACING, direction=(0.0, -1.0, 0.0))[1]
        for side, pair in ((-1.0, ends[:2]), (1.0, ends[:0:-1]))
        if side in sides
    ]
    if not halves:
        return np.zeros(0)
    # Both run inwards; of a half the other is its mirror image.
    found = wrinkles(np.concatenate([halves[0], halves[-1][-2::-1]]), _SPACING)
    return found.heights[0][found.heights[0] >= _LEAST_UPRIGHT]


def _near(rest: Floats, beside: float, height: float) -> NDArray[np.bool_]:
    """Skin in front within reach of a place (m) beside the midline."""
    front = rest[:, 1] < np.median(rest[:, 1])
    off = np.hypot(abs(rest[:, 0]) - beside, rest[:, 2] - height)
    return np.asarray(front & (off < _REACH))
