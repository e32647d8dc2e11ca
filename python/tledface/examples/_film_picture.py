"""The picture of the film example: strips of both hourglass forms, and their wrinkles' growth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from tledface.io._atomic import atomic_path

if TYPE_CHECKING:
    from tledface.examples.film import FilmRun

__all__ = ["draw"]

_COLOURS = {"physical": "#b5443a", "joldes": "#4a6a8a"}
_LABELS = {"physical": "physical form", "joldes": "kappa form, 0.075"}
_INK, _SOFT = "#2b2626", "#eeded6"


def draw(path: Path, runs: list[FilmRun], wavelength: float, strain: float) -> None:
    """Write the picture; ``wavelength`` (m) and ``strain`` are those of the exact onset."""
    figure = Figure(figsize=(10.0, 7.2), dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    rows = figure.add_gridspec(3, 1, height_ratios=(1.0, 1.0, 1.5), hspace=0.35)
    for row, run in enumerate(runs):
        _draw_strip(figure.add_subplot(rows[row]), run)
    _draw_growth(figure.add_subplot(rows[2]), runs, wavelength, strain)
    with atomic_path(path, "picture") as part:
        figure.savefig(part, format="png", bbox_inches="tight")


def _draw_strip(axes: Axes, run: FilmRun) -> None:
    model = run.model
    place = (model.nodes + run.u)[:, [0, 2]] * 1e3
    # The face of every element at low y: corners 0, 1, 5, 4 of a VTK hexahedron.
    quads = place[model.elements[:, [0, 1, 5, 4]]]
    film = model.fractions[:, model.tissues.index("film")] > 0.5
    for part, colour in ((~film, _SOFT), (film, _COLOURS[run.hourglass])):
        patches = PolyCollection(list(quads[part]), facecolors=colour, edgecolors=colour, lw=0.3)
        axes.add_collection(patches)
    high = place[:, 1].max()
    axes.set_xlim(place[:, 0].min(), place[:, 0].max())
    axes.set_ylim(0.45 * high, 1.04 * high)
    axes.set_aspect("equal")
    axes.set_axis_off()
    found = (
        f"wavelength {run.wavelength * 1e3:.2f} mm"
        if np.isfinite(run.wavelength)
        else "no wrinkles"
    )
    axes.set_title(
        f"{_LABELS[run.hourglass]}: {found}, here at {run.strains[-1]:.1%} shortening",
        loc="left",
        fontsize=10,
        color=_INK,
    )


def _draw_growth(axes: Axes, runs: list[FilmRun], wavelength: float, strain: float) -> None:
    for run in runs:
        axes.plot(
            run.strains * 100,
            run.amplitudes * 1e3,
            color=_COLOURS[run.hourglass],
            label=_LABELS[run.hourglass],
        )
        if np.isfinite(run.onset):
            axes.plot(run.onset * 100, 0.0, "o", color=_COLOURS[run.hourglass], clip_on=False)
    axes.axvline(
        strain * 100,
        color=_INK,
        lw=0.8,
        ls="--",
        label=f"exact onset (Biot 1963), wavelength {wavelength * 1e3:.2f} mm",
    )
    axes.set_xlabel("shortening, %")
    axes.set_ylabel("height of the largest wave, mm")
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=9, loc="upper left")
