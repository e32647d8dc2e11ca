"""Run the forehead's variants; print their table and draw them beside each other.

    python docs/make_forehead.py RUNS [--data ATLAS] [--full] [VARIANT ...]

Finished runs in the folder RUNS are kept, unfinished ones go on. By default the coarse half.
Pictures: `variants.png` of the skin, `variants-stress.png` of the stress under it,
`variants-stress-cut.png` of the stress in a cut.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tledface.examples import forehead
from tledface.picture import render_surface
from tledface.run import resume_run, run_scene
from tledface.run_checkpoints import any_in
from tledface.run_frames import RunFrames
from tledface.scene import Scene
from tledface.stress_picture import SurfaceStress, cut_stress_panels, skin_stress_panels

VIEW = (-0.4, -0.9, 0.2)
# Where the scales of stress end, Pa: skin exceeds it in half of the variants, the galea or the
# muscle in most. An end that none exceeds would leave the folds one colour.
SKIN_LIMIT, CUT_LIMIT = 0.8e6, 2e6
CUT = -0.03


def finished(folder: Path) -> bool:
    """Whether a run in the folder came to its end."""
    record = folder / "run.json"
    return record.exists() and json.loads(record.read_text()).get("state") == "finished"


def run(folder: Path, variant: str, data: Path | None, full: bool) -> None:
    """Run a variant into its folder, or go on with it."""
    if finished(folder):
        return
    if any_in(folder):
        resume_run(folder, quiet=True)
        return
    size = {"half": True} if full else {"coarse": True}
    choices = {**size, "data": data, **forehead.VARIANTS[variant]}
    scene = Scene.load(forehead.write(folder.with_name(f"{variant}-scene"), **choices))
    run_scene(scene, folder, device="native", quiet=True, force=True)


def row(folder: Path, variant: str) -> str:
    """A variant's row of the table on the scene's page."""
    result = json.loads((folder / "run.json").read_text())["result"]
    found = forehead.measure(folder)
    folds = " / ".join(str(count) for count in found.folds.values())
    apart = f"{1e3 * found.wavelength:.1f}" if np.isfinite(found.wavelength) else "–"
    low, high = (1e3 * height for height in found.heights)
    size = f"{low:.1f}–{high:.1f}" if high > 0.0 else "–"
    if found.upright and not any(found.folds.values()):
        folds, size = f"{found.upright} upright", f"to {1e3 * found.upright_height:.1f}"
    return (
        f"| `{variant}` | {1e3 * found.brow_rise:+.1f} | {1e3 * found.root_rise:+.1f} | {folds} | "
        f"{apart} | {size} | {result['steps']:,} of {1e6 * result['dt_s']:.1f} µs | "
        f"{100 * result['added_mass_share']:.0f} % |"
    ).replace(",", " ")


def draw(path: Path, folders: dict[str, Path]) -> None:
    """Draw the skin at rest and at the end of each run."""
    panels = {}
    for name, folder in folders.items():
        frames = RunFrames(folder)
        rest, moved, faces = frames.surface((0, frames.at(None)))
        panels.setdefault("at rest", (rest, faces))
        panels[name] = (moved, faces)
    columns = 3 if len(panels) > 4 else len(panels)
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(3.2 * columns, 3.9 * rows), dpi=95, facecolor="white")
    FigureCanvasAgg(figure)
    for place, (name, (moved, faces)) in enumerate(panels.items(), start=1):
        axes = figure.add_subplot(rows, columns, place)
        axes.imshow(render_surface(moved, faces, view=VIEW, size=(420, 480)))
        axes.set_axis_off()
        axes.set_title(name, fontsize=11, color="#2b2626")
    figure.tight_layout(pad=0.4)
    figure.savefig(path)


def draw_stress(skin: Path, cut: Path, folders: dict[str, Path]) -> None:
    """Draw the stress under the skin and in a cut, at rest and at the end of each run."""
    labels = ["at rest", *folders]
    surfaces, bodies = [], []
    for folder in folders.values():
        frames = RunFrames(folder)
        pair = (0, frames.at(None))
        *points, faces = frames.surface(pair)
        stress, voxels = frames.surface_stress(pair), frames.voxels(pair)
        # The rest state, without stress, is that of all.
        first = 0 if not bodies else 1
        for state in range(first, 2):
            surfaces.append(SurfaceStress(points[state], faces, stress[state]))
        bodies.append(replace(voxels, u=voxels.u[first:], stress=voxels.stress[first:]))
    skin_stress_panels(
        skin, surfaces, labels=labels, view=VIEW, columns=3, size=(270, 400), limit=SKIN_LIMIT
    )
    cut_stress_panels(
        cut, bodies, "x", CUT, labels=labels, columns=5, size=(220, 470), limit=CUT_LIMIT
    )


def main() -> None:
    """Run, print and draw what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("runs", type=Path)
    parser.add_argument("variants", nargs="*", default=list(forehead.VARIANTS))
    parser.add_argument("--data", type=Path)
    parser.add_argument("--full", action="store_true", help="the half at 0.5 mm")
    given = parser.parse_intermixed_args()  # variants may stand after options
    folders = {variant: given.runs / variant for variant in given.variants}
    for variant, folder in folders.items():
        run(folder, variant, given.data, given.full)
        print(row(folder, variant), flush=True)
    draw(given.runs / "variants.png", folders)
    in_skin, in_cut = given.runs / "variants-stress.png", given.runs / "variants-stress-cut.png"
    draw_stress(in_skin, in_cut, folders)


if __name__ == "__main__":
    main()
