"""Two thousand damaged surface files, and one of a million triangles: no crash, no wrong volume."""

import json
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tledface.geometry import read_surface, voxelise

CASES = 2000
PROCESSES = 2
SLOWEST = 10.0  # s of CPU a case; the usual one takes 0.02
WHOLE = 600.0  # s for all, on a machine that is busy


def campaign(first, count):
    """Start the cases in a process of their own, which a crash or a hang takes down alone."""
    script = Path(__file__).with_name("mesh_damage.py")
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", str(script), str(first), str(count)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def results_of(process, seconds):
    try:
        out, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        err += " (hung)"
    rows = [json.loads(line) for line in out.splitlines()]
    begun = [row["begins"] for row in rows if "begins" in row]
    done = [row for row in rows if "seed" in row]
    assert process.returncode == 0 and len(begun) == len(done), (
        f"case {begun[-1:]} ended its process with {process.returncode}: {err[-2000:]}"
    )
    return done


def test_damaged_files_end_in_an_error_or_a_right_volume():
    share = CASES // PROCESSES
    started = [campaign(n * share, share) for n in range(PROCESSES)]
    results = [row for process in started for row in results_of(process, WHOLE)]
    assert len(results) == CASES
    failures = [row for row in results if "failure" in row]
    assert not failures, "\n".join(json.dumps(row) for row in failures[:20])
    assert max(row["seconds"] for row in results) < SLOWEST
    # The damage is such that each way to end is taken often.
    outcomes = Counter(row["outcome"] for row in results)
    assert min(outcomes[kind] for kind in ("refused", "repaired", "as it is")) > CASES / 20


def test_a_million_triangles(tmp_path):
    mesh = trimesh.creation.icosphere(subdivisions=8, radius=50.0)
    assert len(mesh.faces) > 1e6
    path = tmp_path / "fine.stl"
    path.write_bytes(trimesh.exchange.stl.export_stl(mesh))
    start = time.process_time()
    surface = read_surface(path, unit_scale=1e-3)
    voxels = voxelise(surface.solid, voxel=5e-3, fill=1e-9, clean=False, boundaries=(2e-3,))
    assert time.process_time() - start < 60.0
    assert float(voxels.fill.sum()) * 5e-3**3 == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=2e-3)
    assert not any(surface.solid.report[key] for key in ("holes_filled", "flipped_faces"))
