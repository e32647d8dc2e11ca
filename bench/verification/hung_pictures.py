"""Side views of Hung's block: the voxels of its middle plane, coloured by tissue."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

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
    high = 2.05 * rows + 0.35
    figure = Figure(figsize=(10.0, high), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    for place, (run, name) in enumerate(panels):
        axes = figure.add_subplot(rows, 2, place + 1)
        axes.set_axis_off()
        if run is not None:
            _draw_side(axes, run, name)
    figure.subplots_adjust(
        left=0.01, right=0.99, top=1 - 0.25 / high, bottom=0.35 / high, hspace=0.18, wspace=0.04
    )
    names = ("skin", "subcutis", "frontalis")
    legend = [Patch(color=c, label=n) for c, n in zip(COLOURS.values(), names, strict=True)]
    legend.insert(0, Line2D([], [], color=INK, lw=1.2, label="stratum corneum"))
    legend.append(Line2D([], [], color=INK, lw=0.0, marker="v", ms=4, label="crests"))
    figure.legend(handles=legend, loc="lower center", ncols=5, frameon=False, fontsize=9)
    figure.savefig(path, format="png")


def _draw_side(axes, run, name):
    nodes = run.places * 1e3
    quads = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], axis=2)
    for tissue, colour in COLOURS.items():
        part = quads[np.isin(run.tissue, (0, 1) if tissue == 1 else (tissue,))]
        axes.add_collection(PolyCollection(part, facecolors=colour, lw=0.0, antialiased=False))
    # Lines that were straight and a millimetre apart.
    every = round(1.0 / run.voxel)
    for line in (*nodes[::every], *nodes[:, ::every].swapaxes(0, 1)):
        axes.plot(line[:, 0], line[:, 1], color=INK, lw=0.3)
    top, wall = nodes[:, -1], nodes[0, -1, 1]
    axes.plot(top[:, 0], top[:, 1], color=INK, lw=1.2)
    axes.plot([0.0, 0.0], [-0.3, wall + 0.3], color=INK, lw=3.0)
    if run.folds > 1:
        axes.plot(run.crests[:, 0] * 1e3, wall + run.crests[:, 1] * 1e3 + 0.4, "v", color=INK, ms=3)
    axes.plot([25.0, 30.0], [9.6, 9.6], color=INK, lw=1.2)
    axes.text(27.5, 9.75, "5 mm", ha="center", va="bottom", fontsize=8, color=INK)
    axes.set_xlim(-0.5, 30.2)
    axes.set_ylim(-0.4, 10.6)
    axes.set_aspect("equal")
    said = "no wrinkles"
    if run.folds > 1:
        said = f"{run.spacing * 1e3:.1f} mm apart, {run.depth * 1e3:.2f} mm deep"
    axes.set_title(f"{name}: {said}", loc="left", fontsize=9, color=INK)
