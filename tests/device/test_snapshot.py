"""Snapshots: the state of a moment, whatever comes after it, and without waiting for the device."""

import itertools
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import tledface as tf
from conftest import required
from tledface.device import pyopencl_queue

sys.path.insert(0, str(Path(__file__).parent))
from everything import body_of_everything, contracted

WATCHDOG = 60.0  # s, until a host that waits for a device that waits for it is let go


@pytest.mark.parametrize("precision", ["single", "double"])
def test_later_steps_leave_a_snapshot_as_it_is(executor, precision):
    """Displacement, and stress of laws with a past, of the moments they were taken at."""
    sim = contracted(body_of_everything(), precision=precision, dt=2e-6, **executor.kwargs)
    taken = []
    for n in (0, 1, 60, 61):
        sim.step(n)
        first, second = sim.snapshot(), sim.snapshot()
        taken.append((first, second, sim.u, sim.stress(), sim.von_mises(), sim.time, sim.n_steps))
    sim.step(50)
    for first, second, u, stress, von_mises, time, n_steps in taken:
        assert (first.time, first.n_steps, first.playback_time) == (time, n_steps, time)
        assert np.array_equal(first.u, u) and np.array_equal(second.u, u)
        assert np.array_equal(first.stress(), stress)
        assert np.array_equal(second.von_mises(), von_mises)
    us = [u for _, _, u, *_ in taken]
    assert all(np.any(late != early) for early, late in itertools.pairwise(us))


def test_many_snapshots_between_few_steps(executor):
    """The buffer that a snapshot comes from is written again two steps later."""
    sim, twin = (
        contracted(body_of_everything(laws=False), dt=2e-6, **executor.kwargs) for _ in range(2)
    )
    snaps = []
    for _ in range(60):
        sim.step(1)
        snaps.append(sim.snapshot())
    for snap in snaps:
        twin.step(1)
        assert np.array_equal(snap.u, twin.u)


def test_a_snapshot_keeps_its_simulator(executor):
    sim = contracted(body_of_everything(laws=False), dt=2e-6, **executor.kwargs)
    sim.step(5)
    snap, expected = sim.snapshot(), sim.u
    core = snap._core
    del sim, snap
    assert np.array_equal(core.displacement(), expected)


def test_a_state_that_is_not_finite_is_named(executor):
    sim = contracted(body_of_everything(laws=False), dt=2e-6, **executor.kwargs)
    sim.step(2)
    u = sim.u
    u[7] = np.nan
    sim._core.set_state(u, np.empty(0), 0.0)
    with pytest.raises(tf.SimulationError, match=r"no longer finite: seen at step 0, .* element"):
        _ = sim.snapshot().u


@pytest.fixture
def gate(opencl):
    """A device that holds back whatever is enqueued until it is let go; who waits for it is told.

    ``shut(device)`` begins it, ``open()`` ends it, ``late`` says that nobody else did.
    """
    cl = required("pyopencl")

    class Gate:
        late = False

        def shut(self, device):
            queue = pyopencl_queue(device)
            self.event = cl.UserEvent(queue.context)
            cl.enqueue_barrier(queue, wait_for=[self.event])
            queue.flush()
            self.timer = threading.Timer(WATCHDOG, self.give_up)
            self.timer.start()

        def give_up(self):
            self.late = True
            self.event.set_status(cl.command_execution_status.COMPLETE)

        def open(self):
            self.timer.cancel()
            if not self.late:
                self.event.set_status(cl.command_execution_status.COMPLETE)

    return Gate()


def started(opencl):
    """A simulator that will not look at its limit for some hundred steps, which waits."""
    sim = contracted(body_of_everything(laws=False), device=opencl, dt=1e-6)
    while sim._watch.until_check < 300:
        sim.step(sim._watch.until_check)
    return sim


@pytest.mark.parametrize("command_buffers", ["0", "1"])
def test_a_snapshot_is_taken_before_its_steps_begin(opencl, gate, monkeypatch, command_buffers):
    monkeypatch.setenv("TLEDFACE_COMMAND_BUFFERS", command_buffers)
    sim, twin = started(opencl), started(opencl)
    gate.shut(sim._device)
    sim.step(100)
    snap = sim.snapshot()
    sim.step(100)
    assert not gate.late, "a snapshot waits for the device"
    gate.open()
    twin.step(100)
    assert np.array_equal(snap.u, twin.u)
    twin.step(100)
    assert np.array_equal(sim.u, twin.u)


def test_a_run_goes_on_to_the_next_frame_without_the_device(opencl, gate):
    """Two frames and the steps between them are enqueued before the device does any of it."""
    sim, twin = started(opencl), started(opencl)
    begin, snaps, expected = sim.time, [], []

    def on_frame(sim):
        snaps.append(sim.snapshot())
        if len(snaps) == 2:
            assert not gate.late, "a run waits for the device between two frames"
            gate.open()

    gate.shut(sim._device)
    fps = 1 / (50 * sim.dt)
    sim.run(until=begin + 150 * sim.dt, on_frame=on_frame, fps=fps, wait=False)
    twin.run(until=begin + 150 * sim.dt, on_frame=lambda s: expected.append(s.u), fps=fps)
    assert len(snaps) == len(expected) >= 2
    for snap, u in zip(snaps, expected, strict=True):
        assert np.array_equal(snap.u, u)
