"""Plots of the verification studies: errors against refinement, and film wavelengths."""

from __future__ import annotations

import re

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_FORMS = {"physical": ("#b5443a", "-", "o"), "joldes": ("#4a6a8a", "--", "s")}


def _figure(width, height):
    figure = Figure(figsize=(width, height), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def draw_convergence(path, rows):
    """Error of every static case over the number of elements an edge, both hourglass forms."""
    rows = [r for r in rows if r["study"] == "statics" and not r["case"].endswith("bulge")]
    cases = list(dict.fromkeys(r["case"] for r in rows))
    if not cases:
        return
    figure = _figure(11, 6.5)
    for at, case in enumerate(cases):
        axes = figure.add_subplot(2, (len(cases) + 1) // 2, at + 1)
        for form, (colour, line, marker) in _FORMS.items():
            some = [r for r in rows if r["case"] == case and r["form"] == form]
            if not some:
                continue
            axes.loglog(
                [r["n"] for r in some],
                [abs(r["error"]) * 100 for r in some],
                line,
                color=colour,
                marker=marker,
                label={"physical": "physical", "joldes": "kappa"}[form],
            )
        for r in rows:
            if r["case"] == case and r["tolerance"] and r["n"] == 20:
                axes.axhline(r["tolerance"] * 100, color="#9a9290", lw=0.8, ls=":")
        ticks = sorted({r["n"] for r in rows if r["case"] == case})
        axes.set_xticks(ticks, [str(n) for n in ticks])
        axes.minorticks_off()
        axes.set_title(case, fontsize=8)
        axes.set_xlabel("elements an edge", fontsize=8)
        axes.set_ylabel("error, %", fontsize=8)
        axes.tick_params(labelsize=8)
        axes.legend(fontsize=8, frameon=False)
    figure.savefig(path)


def draw_film(path, rows):
    """Wavelength over the exact one by mesh, and that of the layered corneum by voxel."""
    rows = [r for r in rows if r["study"] == "film"]
    if not rows:
        return
    figure = _figure(10, 4)
    left, right = figure.subplots(1, 2)
    meshes = [(1, "2"), (1, "1"), (1, "0.5"), (2, "1"), (4, "1")]
    for ratio, colour in (("10", "#d9a441"), ("24.57", "#b5443a"), ("100", "#5c2d4a")):
        for how, marker in (("waves", "o"), ("shortened", "x")):
            points = [
                (at, r["got"])
                for at, (n, aspect) in enumerate(meshes)
                for r in rows
                if r["case"] == f"{how}, ratio {ratio}, boxes {aspect}:1, wavelength"
                and r["n"] == n
                and r["form"] == "physical"
            ]
            if points:
                label = f"ratio {ratio}" + (", shortened" if how == "shortened" else "")
                left.plot(*zip(*points, strict=True), marker, color=colour, label=label)
    names = ["1 layer, 2:1", "1, cubes", "1, 1:2", "2, cubes", "4, cubes"]
    left.set_xticks(range(len(names)), names, fontsize=8)
    left.axhline(1.0, color="#9a9290", lw=0.8)
    left.set_ylabel("wavelength over the exact one")
    left.legend(fontsize=7, frameon=False)
    for name, colour in (("section", "#b5443a"), ("blended", "#4a6a8a")):
        found = [
            (float(re.search(r"in ([\d.]+) mm", r["case"])[1]), r["got"])
            for r in rows
            if f", {name}, wavelength in mm" in r["case"]
        ]
        if found:
            right.loglog(*np.array(found).T, "o-", color=colour, label=name)
    right.axhline(0.88, color="#9a9290", lw=0.8, ls="--", label="exact, 0.88 mm")
    right.set_xlabel("voxel, mm")
    right.set_ylabel("wavelength, mm")
    ticks = [0.0625, 0.125, 0.25, 0.5]
    right.set_xticks(ticks, [str(t) for t in ticks])
    right.set_yticks([1, 2, 4, 8], ["1", "2", "4", "8"])
    right.minorticks_off()
    right.legend(fontsize=8, frameon=False)
    figure.savefig(path)
