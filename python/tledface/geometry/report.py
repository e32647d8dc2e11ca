"""What model creation found and did, as lines for a person."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tledface import _core

__all__ = ["GEOMETRY_KEYS", "geometry_lines", "surface_repairs"]

# The parts of ``Model.report`` about volumes.
GEOMETRY_KEYS = (
    "elements",
    "tissue_volume",
    "left_out",
    "volumes",
    "overlaps",
    "gaps",
    "surfaces",
    "repairs",
)

# Overlaps and gaps below this part of the tissue are not worth a line.
_WORTH_A_LINE = 1e-5
_MOST_LINES = 8

_REASONS = {
    "too_deep": "too deep",
    "below_fill": "in voxels below the fill",
    "behind_bone": "behind bone",
    "loose": "loose",
    "unconnected": "unconnected",
}


def surface_repairs(surface: _core.Surface) -> list[str]:
    """Return one line for each kind of repair that a surface needed; empty if none."""
    report = surface.report
    lines = []

    def add(text: str) -> None:
        lines.append(f"{Path(surface.name).name}: {text}")

    if report["seams_joined"]:
        add("vertices a rounding apart joined")
    if report["degenerate_faces"]:
        add(f"{report['degenerate_faces']:,} faces without area removed")
    if report["duplicate_faces"]:
        add(f"{report['duplicate_faces']:,} repeated faces removed")
    if report["flipped_faces"]:
        add(f"{report['flipped_faces']:,} faces turned")
    if report["inverted_components"]:
        add(f"{report['inverted_components']} parts were inside out")
    if report["cavities"]:
        add(f"{report['cavities']} cavities kept")
    if count := report["holes_filled"] + report["holes_closed"]:
        large, around = report["holes_closed"], f"{1e3 * report['largest_hole']:.3g} mm around"
        what = f"{count} holes closed, {large} of them large, the largest {around}"
        if count == 1:
            what = f"a {'large' if large else 'small'} hole closed, {around}"
        add(f"{what}; half balls over them would be {1e9 * report['hole_volume']:.3g} mm3")
    return lines


def geometry_lines(report: dict[str, Any]) -> list[tuple[str, str]]:
    """Return label and text of each line about a built model's geometry.

    Args:
        report: ``Model.report`` of a scene.
    """
    tissue = report["tissue_volume"]
    lines = [("tissue", f"{_mm3(tissue)} in {report['elements']:,} voxels")]
    for reason, found in report["left_out"].items():
        if not found["volume"] > _WORTH_A_LINE * tissue:
            continue
        voxels = f" in {found['voxels']:,} voxels" if found.get("voxels") else ""
        word = "left out" if found["removed"] else "kept"
        lines.append((word, f"{_mm3(found['volume'])}{voxels}: {_REASONS[reason]}"))
    for name, volume in report["volumes"].items():
        least = _WORTH_A_LINE * volume["volume"]
        if volume["covered_twice"] > least:
            lines.append(("overlap", f"{_mm3(volume['covered_twice'])}: {name} with itself"))
        if volume["inside_out"] > least:
            lines.append(("inverted", f"{_mm3(volume['inside_out'])} of {name} is inside out"))
        if volume.get("outside_skin", 0.0) > least:
            lines.append(("outside", f"{_mm3(volume['outside_skin'])} of {name} outside the skin"))
    for kind in ("overlaps", "gaps"):
        worth = [p for p in report[kind] if p["volume"] > _WORTH_A_LINE * tissue]
        for pair in worth[:_MOST_LINES]:
            first, second = pair["names"]
            what = f"{first} and {second}"
            thin = " are less than a voxel apart" if kind == "gaps" else ""
            lines.append((kind[:-1], f"{_mm3(pair['volume'])}: {what}{thin}"))
        if len(worth) > _MOST_LINES:
            lines.append((kind[:-1], f"and {len(worth) - _MOST_LINES} more pairs"))
    lines += [("repair", repair) for repair in report["repairs"]]
    return lines


def _mm3(volume: float) -> str:
    return f"{1e9 * volume:,.4g} mm3" if 1e9 * volume < 1e4 else f"{1e9 * volume:,.0f} mm3"
