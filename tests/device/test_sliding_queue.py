"""Nodes that left their balls, looked at by work-groups: as on the host, without races."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from test_oclgrind import KERNELS, oclgrind  # noqa: F401  (a fixture)

SPEED, STEPS = 40, 8  # times the benchmark's: nodes change triangles within these steps

CORNER = """
import sys
import numpy as np
import tledface as tf
import trimesh
kernels, file, steps, speed = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
held = sys.argv[5] == "held"
soft = tf.material("neo_hookean", youngs_modulus=30e3, poissons_ratio=0.45, density=1000.0)
model = tf.Model.block((6, 6, 1), (3e-3, 3e-3, 0.5e-3), soft)
# Its corner is under the middle of the tissue, whose nodes pass over it and over its edges.
box = trimesh.creation.box((4e-3, 4e-3, 4e-3)).apply_translation((-0.4e-3, -0.7e-3, -2.3e-3))
i, j, k = model.node_ijk.T
model.slide((k == 0) & ((i + j) % 2 == 0), box)
if held:
    model.fix((k == 0) & (i % 4 == 0), "z")
found = "native" if kernels == "rows" else "opencl:0"
sim = tf.Simulator(model, device=found, kernels=kernels, precision="single", damping=200.0)
velocity = np.zeros_like(model.nodes)
velocity[:, 0], velocity[:, 1] = speed, 0.6 * speed
sim.set_state(np.zeros_like(velocity), velocity)
sim.step(steps)
np.save(file, sim.u)
"""
PROGRAM = """
import sys
import numpy as np
from tledface import _core, device
kernels, file, speed, steps = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
found = "native" if kernels == "rows" else "opencl:0"
body = _core.Workload("face", 300)
core = _core.Simulator(
    device.resolve(found), body.model, precision="single", hourglass="physical", kappa=0.075,
    damping=0.0, kernels=kernels, sliding=body.sliding,
)
core.dt = 0.8 * core.bound_at_rest()[0]
velocity = np.zeros((body.n_nodes, 3))
velocity[:, 1] = speed * body.speed / core.dt
core.set_state(np.zeros_like(velocity), velocity, 0.0)
core.step(steps, np.zeros((steps, 1)))
core.finish()
np.save(file, core.displacement())
"""


def displacement(folder, kernels, program=PROGRAM, arguments=(SPEED, STEPS), **environment):
    file = folder / f"{kernels}.npy"
    done = ended(file, kernels, program, arguments, **environment)
    assert done.returncode == 0, done.stderr
    return np.load(file)


def ended(file, kernels, program, arguments, **environment):
    return subprocess.run(
        [sys.executable, "-c", program, kernels, str(file), *map(str, arguments)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )


def under(library, log, **environment):
    return {
        "TLEDFACE_OPENCL_LIBRARY": str(library),
        "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_CHECK_API": "1",
        "OCLGRIND_MAX_ERRORS": "20",
        "OCLGRIND_LOG": str(log),
        **environment,
    }


@pytest.mark.parametrize("kernels", ["gather", "tile"])
def test_groups_find_what_a_single_item_finds(oclgrind, tmp_path, kernels):  # noqa: F811
    """The first step seeks every node's surface (levels 3 and 4), later ones change zones."""
    log = tmp_path / "log"
    u = displacement(tmp_path, kernels, **under(oclgrind, log))
    assert not log.exists() or log.read_text() == ""
    expected = displacement(tmp_path, "rows")
    assert abs(expected).max() > 0.2e-3
    assert abs(u - expected).max() < 2e-6 * abs(expected).max()


@pytest.mark.parametrize("held", ["free", "held"])
def test_nodes_pass_over_edges_and_a_corner(oclgrind, tmp_path, held):  # noqa: F811
    """Over edges and the corner no zone holds for nodes with a held component: groups find
    those anew.
    """
    steps = (CORNER, (60, 1.0, held))
    log = tmp_path / "log"
    u = displacement(tmp_path, "tile", *steps, **under(oclgrind, log))
    assert not log.exists() or log.read_text() == ""
    expected = displacement(tmp_path, "rows", *steps)
    assert abs(expected).max() > (1e-3 if held == "free" else 0.5e-3)
    assert abs(u - expected).max() < 1e-5 * abs(expected).max()


@pytest.mark.parametrize("kernels", ["gather", "tile"])
def test_a_run_that_diverges_keeps_to_its_arrays(oclgrind, tmp_path, kernels):  # noqa: F811
    """All lanes of a row wait then, whether they have a sliding node or not."""
    log = tmp_path / "log"
    steps = (40, 15.0, "free")
    done = ended(tmp_path / "u.npy", kernels, CORNER, steps, **under(oclgrind, log))
    assert "no longer finite" in done.stderr
    assert not log.exists() or log.read_text() == ""


def test_a_race_for_the_queue_is_seen(oclgrind, tmp_path):  # noqa: F811
    folder = tmp_path / "kernels"
    shutil.copytree(KERNELS, folder)
    file = folder / "sliding_still.cl"
    text, counted = file.read_text(), "atomic_inc(slide_queue + parity)"
    assert text.count(counted) == 1
    file.write_text(text.replace(counted, "slide_queue[parity]++"))
    log = tmp_path / "log"
    displacement(tmp_path, "gather", **under(oclgrind, log, TLEDFACE_KERNELS=str(folder)))
    assert "data race at global memory" in log.read_text()
