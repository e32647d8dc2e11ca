"""Runs of steps replayed as command buffers: the bits of launches one by one, whatever changes."""

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tledface as tf
from conftest import EXECUTORS, unless_required
from tledface import _core, autotune
from tledface.device import devices, resolve

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
sys.path.insert(0, str(Path(__file__).parent))
from everything import body_of_everything, contracted

from scenes import soft

ABLE = {d.id for d in devices() if d.command_buffers}
VARIABLE = "TLEDFACE_COMMAND_BUFFERS"
STATE = ("u", "u_prev", "history", "sliding", "levels")


@pytest.fixture(params=[e for e in EXECUTORS if e.device in ABLE] or [None], ids=str)
def able(request):
    """Executors of devices that have command buffers which are right."""
    if request.param is None:
        unless_required("no OpenCL device has command buffers (cl_khr_command_buffer)")
    return request.param


@pytest.fixture(autouse=True)
def chosen_by_none(monkeypatch):
    """What tests choose for a device ends with them."""
    monkeypatch.delenv(VARIABLE, raising=False)
    yield
    for device in ABLE:
        _core.choose_recording(device, False)


def both(monkeypatch, make, drive):
    """The driven simulators: launched one by one, and replayed."""
    sims = []
    for wanted in ("0", "1"):
        monkeypatch.setenv(VARIABLE, wanted)
        sim = make()
        assert sim._core.records == (wanted == "1")
        drive(sim)
        assert sim._core.records == (wanted == "1")  # none was refused
        sims.append(sim)
    return sims


def assert_same_bits(one_by_one, replayed):
    expected, got = (sim._core.raw_state() for sim in (one_by_one, replayed))
    assert np.any(expected["u"] != expected["u_prev"])
    for name in STATE:
        assert np.array_equal(expected[name], got[name]), name


@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_bits_are_those_of_launches_one_by_one(monkeypatch, able, precision):
    """Runs that begin with either buffer, tables that are not full, relaxation, a state given."""
    model = body_of_everything()
    turning = tf.RigidMotion(axis=(0, 1, 0), angle=0.05, share=tf.ramp(0, 1, 2e-3))
    model.move_surface(model.sliding.surfaces[0].name, turning)

    def make():
        return contracted(model, precision=precision, dt=2e-6, **able.kwargs)

    def drive(sim):
        for n in (1, 300, 33, 64):
            sim.step(n)
        sim.relax(max_steps=40)
        sim.step(97)
        sim.set_state(0.5 * sim.u)
        while sim._watch.until_check < 32:
            sim.step(sim._watch.until_check)
        sim.step(32)  # a whole run, but for its last step, whose normals are kept

    sims = both(monkeypatch, make, drive)
    assert_same_bits(*sims)
    one_by_one, replayed = (sim._core.sliding_normals() for sim in sims)
    assert (one_by_one[:, 0] > 1e-3).all()  # they turn with the bone
    assert np.array_equal(one_by_one, replayed)


def test_levels_of_subcycling_may_change(monkeypatch, able):
    """What was recorded for other blocks is recorded again."""
    if able.kernels != "rows":
        pytest.skip("these kernels take steps of one length")
    model = tf.Model.block((12, 10, 12), (6e-3, 5e-3, 6e-3), soft(20e3, 0.45))
    model.set_material((model.cells >= (8, 6, 8)).all(axis=1), soft(10e6, 0.45), name="stiff")
    model.fix(lambda X: X[:, 2] < 1e-6)
    model.add_muscle("pull", lambda c: c[:, 2] < 2e-3, fibre=(1, 0, 0), sigma_act=4e5)
    levels = []

    def make():
        return tf.Simulator(model, subcycling=8, **able.kwargs)

    def drive(sim):
        sim.activate("pull", tf.ramp(0.0, 0.8, 5e-4))
        for _ in range(8):
            sim.step(40)
            levels.append(sim._core.raw_state()["levels"])

    assert_same_bits(*both(monkeypatch, make, drive))
    assert any(np.any(later != levels[0]) for later in levels)


@pytest.fixture(params=sorted(ABLE) or [None])
def device(request):
    """Each device that has them."""
    if request.param is None:
        unless_required("no OpenCL device has command buffers (cl_khr_command_buffer)")
    return resolve(request.param)


class Clock:
    """Lets so many seconds pass in each timing of the two ways, in turns."""

    def __init__(self, one_by_one, replayed):
        self.seconds, self.looks, self.now = (one_by_one, replayed), 0, 0.0

    def __call__(self):
        if self.looks % 2:
            self.now += self.seconds[self.looks // 2 % 2]
        self.looks += 1
        return self.now


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(autotune, "_pays", {})
    return autotune.cache_file


@pytest.mark.parametrize(("replayed", "pays"), [(0.5, True), (0.99, False), (2.0, False)])
def test_a_clock_decides_once(device, cache, monkeypatch, replayed, pays):
    def no_clock():
        raise AssertionError("it was timed again")

    assert autotune.recording_pays(device, clock=Clock(1.0, replayed)) == pays
    assert autotune.recording_pays(device, clock=no_clock) == pays
    monkeypatch.setattr(autotune, "_pays", {})
    assert autotune.recording_pays(device, clock=no_clock) == pays  # in another process
    assert f"{device.info.name}, driver {device.info.driver}" in cache().read_text()


def test_gpus_are_timed_and_cpus_are_not(monkeypatch):
    told = {}
    monkeypatch.delenv("TLEDFACE_AUTOTUNE", raising=False)
    monkeypatch.setattr(autotune, "recording_pays", lambda device: True)
    monkeypatch.setattr(autotune._core, "choose_recording", told.__setitem__)

    def tuned(kind, *, able=True):
        told.clear()
        info = SimpleNamespace(kind=kind, id="opencl:7", command_buffers=able)
        autotune.tune_recording(SimpleNamespace(info=info))
        return told.get("opencl:7")

    assert tuned("gpu") is True
    assert tuned("cpu") is False
    assert tuned("gpu", able=False) is None
    monkeypatch.setenv("TLEDFACE_AUTOTUNE", "0")
    assert tuned("gpu") is False
    for value in ("0", "1"):
        monkeypatch.setenv(VARIABLE, value)
        assert tuned("gpu") == tuned("cpu") == (value == "1")
    monkeypatch.setenv(VARIABLE, "yes")
    with pytest.raises(tf.InputError, match=r"TLEDFACE_COMMAND_BUFFERS: got 'yes'; allowed: 0 or"):
        tuned("cpu")


def test_another_thread_launches_while_one_records(monkeypatch, able):
    """Simulators that share a device: what one launches is no part of what another records."""
    monkeypatch.setenv(VARIABLE, "1")
    options = {**able.kwargs, "device": resolve(able.device)}
    model = tf.Model.block((6, 5, 4), (3e-3, 2.5e-3, 2e-3), soft(20e3, 0.45))
    start = np.random.default_rng(1).normal(size=(model.n_nodes, 3))

    def stepped(sim):
        sim.set_state(0.0 * start, 0.05 * start)
        sim.step(320)
        return sim._core.raw_state()["u"]

    def make():
        sim = tf.Simulator(model, dt=2e-6, **options)
        assert sim._core.records
        return sim

    expected = stepped(make())
    for _ in range(4):
        sims = [make() for _ in range(4)]
        with ThreadPoolExecutor(len(sims)) as pool:
            results = list(pool.map(stepped, sims))
        assert all(np.array_equal(expected, got) for got in results)
