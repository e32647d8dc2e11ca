"""Run Hung's block in all its forms; write JSON and a Markdown table, and the docs' pictures.

    python bench/verification/hung_block.py [--states DIR] [--voxel 0.5] [--bending blended] [-o O]

DIR (./hung-block-states) keeps the end of every run: what is there is not run again, so that the
study may be stopped and go on. `--voxel` and `--bending` run only a part; table and pictures show
what there is. The six runs of 0.5 mm blended take a minute on two cores, all 22 half an hour.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "tests" / "verification"))

from hung_pictures import draw_forms, draw_scenarios  # noqa: E402

import hung_scenarios  # noqa: E402
from tledface.examples import hung_block  # noqa: E402

VOXELS, BENDINGS = (0.5, 0.25), ("blended", "section")
CASES = [("base", 0.9), *((scenario, 0.6) for scenario in hung_block.SCENARIOS)]


def name_of(scenario, calcium, voxel, bending):
    """The name of a kept run."""
    return f"{scenario}-{calcium:g}-{voxel:g}-{bending}"


def study(states, voxels, bendings):
    """Do the runs that are not kept yet."""
    for voxel in voxels:
        for bending in bendings:
            for scenario, calcium in CASES:
                kept = states / f"{name_of(scenario, calcium, voxel, bending)}.npz"
                # Without a corneum there is nothing to blend.
                if kept.exists() or (scenario == "homogeneous-skin" and bending == "section"):
                    continue
                started = time.process_time()
                with tempfile.TemporaryDirectory() as folder:
                    done = hung_scenarios.run(
                        folder,
                        relax=True,
                        scenario=scenario,
                        calcium=calcium,
                        voxel=voxel,
                        bending=bending,
                    )
                hung_scenarios.save(kept, done)
                figures = {k: v for k, v in done.figures.items() if k not in ("voxel", "bending")}
                print(f"{kept.stem}: {time.process_time() - started:.0f} s of CPU, {figures}")


def kept_runs(states):
    """All kept runs, by voxel, bending, scenario and calcium."""
    found = {}
    for voxel in VOXELS:
        for bending in BENDINGS:
            for scenario, calcium in CASES:
                same = "blended" if scenario == "homogeneous-skin" else bending
                path = states / f"{name_of(scenario, calcium, voxel, same)}.npz"
                if path.exists():
                    found[voxel, bending, scenario, calcium] = hung_scenarios.load(path)
    return found


def table(runs):
    """Markdown of all runs."""
    lines = [
        "| voxel, mm | corneum | scenario | calcium | crests | spacing, mm | crest to trough, mm | "
        "first crest above the wall, mm | free end, mm |",
        "|---|---|---|---|---|---|---|---|---|",
        f"| [H] | | base | 0.9 | | {hung_scenarios.PAPER['spacing'] * 1e3:.2f} | | "
        f"{hung_scenarios.PAPER['first_crest'] * 1e3:.2f} | |",
    ]
    for (voxel, bending, scenario, calcium), found in runs.items():
        spacing = "–" if math.isnan(found.spacing) else f"{found.spacing * 1e3:.1f}"
        lines.append(
            f"| {voxel:g} | {bending} | {scenario} | {calcium:g} | {found.folds} | {spacing} | "
            f"{found.depth * 1e3:.2f} | {found.first_crest * 1e3:.2f} | {found.end * 1e3:.1f} |"
        )
    return "\n".join(lines) + "\n"


def judged(runs):
    """Markdown of the paper's trends, and those that must hold and do not."""
    lines = ["| voxel, mm | corneum | trend | got | allowed | holds |", "|---|---|---|---|---|---|"]
    missed = []
    for voxel in VOXELS:
        for bending in BENDINGS:
            some = {s: runs.get((voxel, bending, s, 0.6)) for s in hung_block.SCENARIOS}
            if None in some.values():
                continue
            for number, (what, got, limit, holds) in enumerate(hung_scenarios.trends(some), 1):
                bound = number == 4 and (voxel, bending) != (0.5, "blended")
                allowed = f"{'≥' if number == 2 else '<'} {limit:.2f}"
                answer = ("yes" if holds else "no") + (" (not asked for)" if bound else "")
                cells = (f"{voxel:g}", bending, what, f"{got:.2f}", allowed, answer)
                lines.append(f"| {' | '.join(cells)} |")
                if not holds and not bound:
                    missed.append(f"{what} ({voxel:g} mm, {bending}): {got:.2f}")
    return "\n".join(lines) + "\n", missed


def main():
    """Run what the command line asks for; 1 if a trend does not hold."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--states", type=Path, default=Path("hung-block-states"))
    parser.add_argument("--voxel", type=float, choices=VOXELS, nargs="*", default=VOXELS)
    parser.add_argument("--bending", choices=BENDINGS, nargs="*", default=BENDINGS)
    parser.add_argument("-o", "--output", type=Path, default=HERE / "results")
    parser.add_argument("--pictures", type=Path, default=HERE.parents[1] / "docs" / "images")
    options = parser.parse_args()
    options.states.mkdir(parents=True, exist_ok=True)
    options.output.mkdir(parents=True, exist_ok=True)
    study(options.states, options.voxel, options.bending)
    runs = kept_runs(options.states)
    text, missed = judged(runs)
    figures = [{**found.figures, "bending": key[1]} for key, found in runs.items()]
    plain = [
        {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}
        for row in figures
    ]
    file = options.output / "hung_block.json"
    file.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    page = table(runs) + "\n" + text
    (options.output / "hung_block.md").write_text(page, encoding="utf-8")
    draw_scenarios(options.pictures / "hung-block.png", runs)
    draw_forms(options.pictures / "hung-block-forms.png", runs)
    print(page)
    print(f"{len(runs)} runs, {len(missed)} trends that do not hold {missed or ''}")
    return 1 if missed else 0


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")
    sys.exit(main())
