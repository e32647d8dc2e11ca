"""The kernels of GPUs under Oclgrind, which sees races and accesses out of bounds."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tledface import _core

EVERYTHING = Path(__file__).parent / "everything.py"
KERNELS = Path(_core.__file__).parent / "kernels_cl"


@pytest.fixture(scope="module")
def oclgrind():
    """Oclgrind's library, to be used instead of an OpenCL loader."""
    program = shutil.which("oclgrind")
    if program is None:
        pytest.skip("oclgrind is not installed (Debian, Ubuntu: apt-get install oclgrind)")
    prefix = Path(program).resolve().parents[1]
    found = sorted(prefix.glob("lib*/oclgrind/liboclgrind-rt.so"))
    if not found:
        pytest.skip(f"oclgrind at {program} has no liboclgrind-rt.so beside it")
    return found[0]


# A simulator that leaves its kernels open, as on any GPU; smaller than what is timed on one.
AUTO = """
import functools
import tledface as tf
from tledface import autotune

autotune._WARM_UP = autotune._ROUNDS = 1
autotune._STEPS = 2
autotune.fastest = functools.partial(autotune.fastest, cells=(4, 4, 2))
soft = tf.material("neo_hookean", youngs_modulus=5e4, poissons_ratio=0.4, density=1e3)
model = tf.Model.block(cells=(4, 4, 2), size=(4e-3, 4e-3, 2e-3), material=soft)
sim = tf.Simulator(model)
sim.step(2)
print(sim._device.info.kind, sim._core.kernels, abs(sim.u).max() == 0)
"""


def run(oclgrind, *arguments, **environment):
    """Output of a Python program whose OpenCL library is Oclgrind."""
    done = subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "TLEDFACE_OPENCL_LIBRARY": str(oclgrind), **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def complaints(oclgrind, log, *arguments, **environment):
    """What Oclgrind says of some steps."""
    settings = {
        "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_CHECK_API": "1",
        "OCLGRIND_MAX_ERRORS": "100",
        "OCLGRIND_LOG": str(log),
    }
    said = run(oclgrind, EVERYTHING, *arguments, **{**settings, **environment})
    assert said[:3] == ["Oclgrind", "Simulator", arguments[0]]
    if "TLEDFACE_KERNELS" not in environment:
        assert said[3:] == ["True", "True"]
    return log.read_text() if log.exists() else ""


@pytest.mark.parametrize(
    ("kernels", "precision", "hourglass", "laws"),
    [
        ("tile", "single", "physical", "laws"),
        ("tile", "single", "joldes", "no laws"),
        ("tile", "double", "physical", "no laws"),
        ("gather", "single", "physical", "laws"),
        ("gather", "single", "joldes", "no laws"),
    ],
)
def test_no_race_and_no_invalid_access(oclgrind, tmp_path, kernels, precision, hourglass, laws):
    assert complaints(oclgrind, tmp_path / "log", kernels, precision, hourglass, laws) == ""


OWNED = "if (owns_node(w, at, plane)) {\n    __local"
BARRIER_OF_PLANES = f"barrier(CLK_LOCAL_MEM_FENCE);\n  {OWNED}"
BARRIER_OF_FIRST = "barrier(CLK_LOCAL_MEM_FENCE);  // the first plane's buffer is written again"


@pytest.mark.parametrize(
    ("file", "text", "instead", "what"),
    [
        ("tile.cl", BARRIER_OF_PLANES, OWNED, "data race at local memory"),
        ("tile.cl", BARRIER_OF_FIRST, "", "data race at local memory"),
        ("tile.cl", " turn * w->plane_reals;", " 0;", "data race at local memory"),
        ("tile.cl", "(turn * w->n_items", "(0 * w->n_items", "data race at local memory"),
        (
            "tile.cl",
            "w->has_column && plane > 0",
            "plane > 0",
            "Invalid read of size 4 at local",
        ),
        ("tile.cl", "w->has_column && plane > 0", "w->has_column", "data race at global memory"),
        ("device_checks.cl", "if (item >= n_left) return;", "", "data race at global memory"),
    ],
    ids=[
        "no barrier",
        "no barrier before the first plane",
        "one buffer of displacements",
        "one buffer",
        "nodes of the halo",
        "nodes of the tile below",
        "a look",
    ],
)
def test_what_is_wrong_is_seen(oclgrind, tmp_path, file, text, instead, what):
    """The checks above can fail: each of these mistakes is reported."""
    folder = tmp_path / "kernels"
    shutil.copytree(KERNELS, folder)
    source = (folder / file).read_text()
    assert source.count(text) == 1
    (folder / file).write_text(source.replace(text, instead))
    said = complaints(
        oclgrind,
        tmp_path / "log",
        *("tile", "single", "physical", "no laws"),
        TLEDFACE_KERNELS=str(folder),
    )
    assert what in said


def test_a_gpu_chooses_its_kernels(oclgrind, tmp_path):
    """Oclgrind is a GPU to those who ask: the first simulator times, the next remembers."""
    cache = tmp_path / "tledface" / "kernels.json"
    kind, kernels, at_rest = run(oclgrind, "-c", AUTO, XDG_CACHE_HOME=str(tmp_path))
    assert kind == "gpu" and at_rest == "True"
    (entry,) = json.loads(cache.read_text()).values()
    assert entry["chosen"].startswith(kernels)
    assert set(entry["ms_per_step"]) == {"gather", "tile 16x8", "tile 32x8", "tile 16x16"}
    for other in ("gather", "tile 16x8"):
        entry["chosen"] = other
        cache.write_text(json.dumps({key: entry for key in json.loads(cache.read_text())}))
        _, kernels, _ = run(oclgrind, "-c", AUTO, XDG_CACHE_HOME=str(tmp_path))
        assert kernels == other.split()[0]
    _, kernels, _ = run(oclgrind, "-c", AUTO, XDG_CACHE_HOME=str(tmp_path), TLEDFACE_AUTOTUNE="0")
    assert kernels == "gather"
