"""Frames are written behind the steps: in order, few at a time, and none after one that failed."""

import errno
import json
import threading
import time

import h5py
import numpy as np
import pytest

import tledface as tf
from conftest import EXECUTORS
from tledface.errors import SimulationError
from tledface.examples import flat_block
from tledface.frame_queue import IN_FLIGHT, FrameQueue
from tledface.io.vtkhdf import VTKHDFWriter
from tledface.run import resume_run, run_scene, simulator_of
from tledface.run_checkpoints import RunCheckpoints
from tledface.scene import Scene

PATIENCE = 60.0  # s, for what must come without waiting for anything


class Writing:
    """Writes numbers when it is let; fails at one of them."""

    def __init__(self, fails_at=None):
        self.may, self.written, self.fails_at = threading.Semaphore(0), [], fails_at

    def __call__(self, frame):
        assert self.may.acquire(timeout=PATIENCE)
        if frame == self.fails_at:
            raise OSError(errno.ENOSPC, "No space left on device")
        self.written.append(frame)

    def let(self, n):
        for _ in range(n):
            self.may.release()


def soon(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_whoever_puts_goes_on_and_order_is_kept():
    writing = Writing()
    with FrameQueue(writing) as queue:
        for frame in range(IN_FLIGHT):
            queue.put(frame)
        assert writing.written == []
        writing.let(5)
        for frame in range(IN_FLIGHT, 5):
            queue.put(frame)
        queue.settle()
        assert writing.written == [0, 1, 2, 3, 4]


def test_no_more_than_two_are_under_way():
    writing, put = Writing(), []
    with FrameQueue(writing) as queue:

        def put_all():
            for frame in range(IN_FLIGHT + 1):
                queue.make_room()
                put.append(frame)
                queue.put(frame)

        thread = threading.Thread(target=put_all)
        thread.start()
        soon(lambda: len(put) == IN_FLIGHT)
        time.sleep(0.05)  # long enough for one more, were there room
        assert len(put) == IN_FLIGHT
        writing.let(1)
        soon(lambda: len(put) == IN_FLIGHT + 1)
        writing.let(IN_FLIGHT)
        thread.join()
    assert writing.written == list(range(IN_FLIGHT + 1))


def test_an_error_ends_the_writing_and_is_told_once():
    writing = Writing(fails_at=1)
    writing.let(9)
    with FrameQueue(writing) as queue:
        queue.put(0)
        queue.put(1)
        with pytest.raises(OSError, match="No space left"):
            queue.settle()
        queue.put(2)
        queue.settle()
    assert writing.written == [0]  # no gap


def test_an_error_is_told_to_the_next_that_puts():
    writing = Writing(fails_at=0)
    queue = FrameQueue(writing)
    with pytest.raises(OSError, match="No space left"), queue:
        queue.put(0)
        writing.let(1)
        soon(lambda: queue._under_way[0].done())
        queue.put(1)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SimulationError])
def test_frames_under_way_are_written_when_something_else_fails(error):
    writing = Writing(fails_at=1)
    threading.Timer(0.05, writing.let, [IN_FLIGHT]).start()
    with pytest.raises(error), FrameQueue(writing) as queue:
        queue.put(0)
        queue.put(1)  # which fails: the first error is the one that is told
        raise error("elsewhere")
    assert writing.written == [0]


# -- a run ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = flat_block.write(
        tmp_path_factory.mktemp("scene"), voxel=3.0, voxel_height=1.5, triangle=4.0
    )
    text = path.read_text().replace('"50 ms"', '"6 ms"').replace("fps = 200\n", "fps = 1000\n")
    path.write_text(text.replace("[output]\n", '[output]\ncheckpoint_every = "2 ms"\n'))
    return Scene.load(path)


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    return run_scene(scene, tmp_path_factory.mktemp("whole") / "out", device="native", quiet=True)


def frames_in(folder):
    """Times, displacements and stresses of the frames of a run."""
    with h5py.File(folder / "frames.vtkhdf") as file:
        root = file["VTKHDF"]
        n = int(root["Steps"].attrs["NSteps"])
        u = root["PointData/displacement"][()].reshape(-1, len(root["Points"]), 3)[:n]
        stress = root["CellData/von_mises"][()].reshape(-1, root["NumberOfCells"][0])[:n]
        return root["Steps/Values"][:n], u, stress


@pytest.mark.parametrize("device", sorted({executor.device for executor in EXECUTORS}))
def test_steps_go_on_while_a_frame_is_written(scene, tmp_path, monkeypatch, device):
    """A frame that waits for steps after it gets them; and it is still the frame of its time."""
    append, sims, seen = VTKHDFWriter.append, [], []
    snapshot = tf.Simulator.snapshot

    def taken(sim):
        sims.append(sim)
        return snapshot(sim)

    def late(writer, at, u, **fields):
        if 2.5e-3 < at < 3.5e-3:  # no checkpoint waits for this one
            soon(lambda: sims[-1].time > at + 0.1e-3)
            seen.append(at)
        append(writer, at, u, **fields)

    plain = run_scene(scene, tmp_path / "plain", device=device, quiet=True)
    monkeypatch.setattr(tf.Simulator, "snapshot", taken)
    monkeypatch.setattr(VTKHDFWriter, "append", late)
    held = run_scene(scene, tmp_path / "held", device=device, quiet=True)
    assert len(seen) == 1
    assert held.frames == plain.frames == 7
    for expected, got in zip(frames_in(plain.directory), frames_in(held.directory), strict=True):
        assert np.array_equal(expected, got)


def test_frames_are_those_of_the_state_at_their_times(scene, whole):
    """Bit for bit what a simulator has that is stopped at each frame."""
    times, u, stress = frames_in(whole.directory)
    model = scene.build()
    sim = simulator_of(scene, model, "native")
    for at, moved, von_mises in zip(times, u, stress, strict=True):
        while sim.time < at:
            sim.step(1)
        assert sim.time == at
        assert np.array_equal(sim.u.astype(np.float32), moved)
        assert np.array_equal(sim.von_mises().astype(np.float32), von_mises)


@pytest.mark.parametrize("where", [(tf.Simulator, "snapshot"), (RunCheckpoints, "take")])
def test_a_state_that_is_lost_is_in_no_frame_and_no_checkpoint(
    scene, whole, tmp_path, monkeypatch, where
):
    """Lost just before either is taken: what was written before stays, and the run goes on."""
    taken = getattr(*where)

    def losing(*arguments):
        sim = next(a for a in arguments if isinstance(a, tf.Simulator))
        if sim.time > 2.5e-3:
            u = sim.u
            u[0] = np.nan
            sim._core.set_state(u, np.empty(0), sim.time)
        return taken(*arguments)

    monkeypatch.setattr(*where, losing)
    out = tmp_path / "out"
    with pytest.raises(SimulationError, match=r"no longer finite.*; the frames until then are in"):
        run_scene(scene, out, device="native", quiet=True)
    monkeypatch.undo()
    times, u, _ = frames_in(out)
    assert times[-1] == pytest.approx(2e-3 if where[1] == "snapshot" else 4e-3, rel=0.05)
    assert np.isfinite(u).all()
    assert json.loads((out / "run.json").read_text())["state"] == "failed"
    resume_run(out, quiet=True)
    for expected, got in zip(frames_in(whole.directory), frames_in(out), strict=True):
        assert np.array_equal(expected, got)
