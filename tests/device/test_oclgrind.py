"""The kernels of GPUs under Oclgrind, which sees races and accesses out of bounds."""

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


def complaints(oclgrind, log, *arguments, **environment):
    """What Oclgrind says of some steps."""
    settings = {
        "TLEDFACE_OPENCL_LIBRARY": str(oclgrind),
        "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_CHECK_API": "1",
        "OCLGRIND_MAX_ERRORS": "100",
        "OCLGRIND_LOG": str(log),
    }
    done = subprocess.run(
        [sys.executable, EVERYTHING, *arguments],
        env={**os.environ, **settings, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[:3] == ["Oclgrind", "Simulator", arguments[0]]
    if "TLEDFACE_KERNELS" not in environment:
        assert done.stdout.split()[3:] == ["True", "True"]
    return log.read_text() if log.exists() else ""


@pytest.mark.parametrize("laws", ["laws", "no laws"])
@pytest.mark.parametrize("hourglass", ["physical", "joldes"])
@pytest.mark.parametrize("kernels", ["tile", "gather"])
def test_no_race_and_no_invalid_access(oclgrind, tmp_path, kernels, hourglass, laws):
    assert complaints(oclgrind, tmp_path / "log", kernels, "single", hourglass, laws) == ""


def test_no_race_in_double(oclgrind, tmp_path):
    assert complaints(oclgrind, tmp_path / "log", "tile", "double", "physical", "laws") == ""


@pytest.mark.parametrize(
    ("text", "instead", "what"),
    [
        ("barrier(CLK_LOCAL_MEM_FENCE);", "", "data race at local memory"),
        ("(plane & 1) * n_items", "0 * n_items", "data race at local memory"),
        ("owned && block < n_blocks", "block < n_blocks", "Invalid read of size 4 at local"),
        ("i > 0 && j > 0 && plane > 0", "i > 0 && j > 0", "data race at global memory"),
    ],
    ids=["no barrier", "one buffer", "nodes of the halo", "nodes of the tile below"],
)
def test_what_is_wrong_is_seen(oclgrind, tmp_path, text, instead, what):
    """The checks above can fail: each of these mistakes is reported."""
    folder = tmp_path / "kernels"
    shutil.copytree(KERNELS, folder)
    source = (folder / "tile.cl").read_text()
    assert source.count(text) == 1
    (folder / "tile.cl").write_text(source.replace(text, instead))
    said = complaints(
        oclgrind,
        tmp_path / "log",
        *("tile", "single", "physical", "no laws"),
        TLEDFACE_KERNELS=str(folder),
    )
    assert what in said
