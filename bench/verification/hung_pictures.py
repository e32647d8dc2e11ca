"""Side views of Hung's block: the voxels of its middle plane, coloured by tissue."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

INK = "#2b2626"
# Skin, subcutis, muscle; the corneum is a line on top.
COLOURS = {1: "#eecfb8", 2: "#f2e2a0", 3: "#b5564a"}
LABELS = {
    "base": "base",
    "homogeneous-skin": "1: homogeneous skin",
    "soft-skin": "2: half the skin's stiffness",
    "thick-subcutis": "3: twice the subcutis",
    "thin-skin": "4: half the skin",
}


def draw_scenarios(path, runs):
    """All six runs of 0.5 mm, blended."""
    keys = [(0.5, "blended", "base", 0.9)]
    keys += [(0.5, "blended", scenario, 0.6) for scenario in LABELS]
    names = ["base, calcium 0.9", *(f"{label}, calcium 0.6" for label in LABELS.values())]
    _draw(path, [(runs.get(key), name) for key, name in zip(keys, names, strict=True)])


def draw_forms(path, runs):
    """Base and thin skin at calcium 0.6 in all forms."""
    panels = []
    for voxel in (0.5, 0.25):
        for bending in ("blended", "section"):
            for scenario in ("base", "thin-skin"):
                name = f"{LABELS[scenario]}, {voxel:g} mm, {bending}"
                panels.append((runs.get((voxel, bending, scenario, 0.6)), name))
    _draw(path, panels)


def _draw(path, panels):
    rows = math.ceil(len(panels) / 2)
    figure = Figure(figsize=(10.0, 2.0 * rows), dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    for place, (run, name) in enumerate(panels):
        axes = figure.add_subplot(rows, 2, place + 1)
        axes.set_axis_off()
        if run is not None:
            _draw_side(axes, run, name)
    figure.subplots_adjust(left=0.01, right=0.99, top=0.95, bottom=0.01, hspace=0.22, wspace=0.04)
    figure.savefig(path, format="png", bbox_inches="tight")


def _draw_side(axes, run, name):
    nodes = run.places * 1e3
    quads = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], axis=2)
    for tissue, colour in COLOURS.items():
        part = quads[np.isin(run.tissue, (0, 1) if tissue == 1 else (tissue,))]
        axes.add_collection(PolyCollection(part, facecolors=colour, edgecolors=INK, lw=0.1))
    top, wall = nodes[:, -1], nodes[0, -1, 1]
    axes.plot(top[:, 0], top[:, 1], color=INK, lw=1.2)
    axes.plot([0.0, 0.0], [-0.3, wall + 0.3], color=INK, lw=3.0)
    if run.folds > 1:
        axes.plot(run.crests[:, 0] * 1e3, wall + run.crests[:, 1] * 1e3 + 0.4, "v", color=INK, ms=3)
    axes.set_xlim(-0.5, 30.2)
    axes.set_ylim(-0.4, 10.2)
    axes.set_aspect("equal")
    said = "no wrinkles"
    if run.folds > 1:
        said = f"{run.spacing * 1e3:.1f} mm apart, {run.depth * 1e3:.2f} mm deep"
    axes.set_title(f"{name}: {said}", loc="left", fontsize=9, color=INK)
