"""Runs killed at random moments go on to the same end, bit for bit."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest

from tledface.examples import curved_block, flat_block

pytestmark = pytest.mark.skipif(os.name == "nt", reason="SIGKILL is of POSIX")

# Frames and checkpoints in a hurry: a kill falls into the writing of one as often as not.
_OUTPUT = 'fps = 4000\ncheckpoint_every = "50 us"\n'
_RUN = "from tledface.cli import main; main()"


def start(*words):
    return subprocess.Popen(
        [sys.executable, "-c", _RUN, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process):
    out, err = process.communicate(timeout=900)
    assert process.returncode == 0, err
    return out, err


def wait_for(path, process):
    while not path.exists() and process.poll() is None:
        time.sleep(0.001)
    return time.perf_counter()


def arrays_of(path):
    """Every dataset and attribute of an HDF5 file."""
    found = {}
    with h5py.File(path) as file:

        def visit(name, item):
            found.update({f"{name}@{key}": np.asarray(v) for key, v in item.attrs.items()})
            if isinstance(item, h5py.Dataset):
                found[name] = item[()]

        file.visititems(visit)
    return found


def figures_of(folder):
    result = json.loads((folder / "run.json").read_text())["result"]
    for key in ("directory", "files", "wall_s", "melem_steps_per_s"):
        result.pop(key)
    return result


@dataclass
class Whole:
    """The run that nobody kills, and how long it takes from its first checkpoint on."""

    scene: Path
    folder: Path
    seconds: float


def flat_block_scene(folder):
    """Skin that is held at its ends, and how long it is simulated."""
    return flat_block.write(folder, voxel=2.0, voxel_height=1.5, triangle=3.0), "20 ms"


def curved_block_scene(folder):
    """Skin that slides on bone: a checkpoint must hold what is known of its surface."""
    return curved_block.write(folder, half=True, voxel=2.0), "8 ms"


SCENES = (flat_block_scene, curved_block_scene)


def run_whole(write, root, precision):
    scene, end = write(root / "scene")
    text = scene.read_text().replace('over = "50 ms"', f'over = "{end}"')
    text = text.replace('duration = "50 ms"', f'duration = "{end}"\nprecision = "{precision}"')
    scene.write_text(text.replace("fps = 200\n", _OUTPUT))
    process = start("run", scene, "-o", root / "whole", "--device", "native")
    begun = wait_for(root / "whole" / "checkpoint.h5", process)
    finish(process)
    return Whole(scene, root / "whole", time.perf_counter() - begun)


@pytest.fixture(scope="module", params=["single", pytest.param("double", marks=pytest.mark.slow)])
def wholes(request, tmp_path_factory):
    return [
        run_whole(write, tmp_path_factory.mktemp(write.__name__), request.param) for write in SCENES
    ]


def assert_same_end(folder, whole):
    names = sorted(path.name for path in whole.folder.iterdir())
    assert sorted(path.name for path in folder.iterdir()) == names
    for name in ("frames.vtkhdf", "frames_surface.vtkhdf"):
        expected, got = arrays_of(whole.folder / name), arrays_of(folder / name)
        assert list(got) == list(expected)
        for key, values in expected.items():
            # Skin beyond the body has no stress, which is not a number.
            equal_nan = values.dtype.kind == "f"
            assert np.array_equal(values, got[key], equal_nan=equal_nan), key
    for name in names:
        if name.endswith((".ply", ".png")):
            assert (folder / name).read_bytes() == (whole.folder / name).read_bytes(), name
    assert figures_of(folder) == figures_of(whole.folder)


def readable_steps(folder):
    """Frames a reader finds in the file of a run that was killed."""
    path = next(path for path in folder.glob("frames*.vtkhdf") if "surface" not in path.name)
    with h5py.File(path) as file:
        steps = file["VTKHDF/Steps"]
        n, rows = int(steps.attrs["NSteps"]), len(file["VTKHDF/Points"])
        assert (np.diff(steps["Values"][:n]) > 0).all()
        assert len(file["VTKHDF/PointData/displacement"]) >= n * rows
        return n


def kill_and_resume(whole, folder, rng):
    """How often the run was killed: at a random moment, and its resumption, until one ends."""
    kills, words = 0, ("run", whole.scene, "-o", folder, "--device", "native")
    while True:
        process = start(*words)
        if kills == 0:
            wait_for(folder / "checkpoint.h5", process)
        # A resumption is killed while it reads, simulates or writes; a third try may finish.
        longest = whole.seconds if kills == 0 else whole.seconds + 1.0
        if kills < 2:
            time.sleep(rng.uniform(0.0, longest))
            process.kill()
        _, err = process.communicate(timeout=900)
        if process.returncode == 0:
            return kills
        assert process.returncode == -signal.SIGKILL, err
        if json.loads((folder / "run.json").read_text())["state"] == "finished":
            return kills + 1  # all was written, the report was not yet printed
        kills += 1
        assert readable_steps(folder) >= 1
        words = ("resume", folder)


def check_kills(wholes, folder, count):
    """Kill runs of each scene in turn until so many kills are done, of each scene one or more."""
    seed = random.randrange(1 << 30)
    rng, trials, done = random.Random(seed), 0, [0] * len(wholes)
    while sum(done) < count or not all(done):
        which = trials % len(wholes)
        trials += 1
        assert trials <= 4 * count, "the runs end before they can be killed"
        at = folder / str(trials)
        done[which] += kill_and_resume(wholes[which], at, rng)
        assert_same_end(at, wholes[which])
    print(f"{done} kills over {trials} runs, seed {seed}: every end the same bit for bit")


def test_killed_runs_end_the_same(wholes, tmp_path):
    check_kills(wholes, tmp_path, 3)


@pytest.mark.slow
def test_fifty_killed_runs_end_the_same(wholes, tmp_path):
    check_kills(wholes, tmp_path, 50)
