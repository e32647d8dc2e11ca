"""The choice of a GPU's kernels: measured, kept, and whatever is in the way of keeping it."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import tledface as tf
from tledface import _core, autotune
from tledface.autotune import Kernels, fastest, tune
from tledface.device import resolve

GATHER, TILE, WIDE = Kernels("gather"), Kernels("tile"), Kernels("tile", (16, 16, 0))
LIMITED = Kernels("tile", registers=96)
CANDIDATES = (GATHER, TILE, WIDE)
OPTIONS = {"precision": "single", "hourglass": "physical", "cells": (8, 4, 4)}


@pytest.fixture
def device(opencl):
    return resolve(opencl)


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("TLEDFACE_AUTOTUNE", raising=False)
    forget(monkeypatch)


def forget(monkeypatch):
    """What another process does not know."""
    monkeypatch.setattr(autotune, "_chosen", {})


class Clock:
    """Lets as many seconds pass between two looks as each candidate in turn takes."""

    def __init__(self, *seconds):
        self.seconds, self.looks, self.now = seconds, 0, 0.0

    def __call__(self):
        if self.looks % 2:
            self.now += self.seconds[self.looks // 2 % len(self.seconds)]
        self.looks += 1
        return self.now


def no_clock():
    raise AssertionError("it was timed again")


def choose(device, clock, **options):
    return fastest(device, **{"candidates": CANDIDATES, **OPTIONS, **options}, clock=clock)


@pytest.mark.parametrize("best", range(3))
def test_the_fastest_is_chosen_and_kept(device, monkeypatch, best):
    seconds = [3.0, 3.0, 3.0]
    seconds[best] = 2.0
    assert choose(device, Clock(*seconds)) == CANDIDATES[best]
    assert choose(device, no_clock) == CANDIDATES[best]  # in this process
    forget(monkeypatch)
    assert choose(device, no_clock) == CANDIDATES[best]  # in the next
    (key,) = kept = json.loads(autotune.cache_file().read_text())
    for part in (device.info.name, device.info.driver, tf.__version__, "single", "physical"):
        assert part in key
    assert kept[key]["chosen"] == str(CANDIDATES[best])
    assert kept[key]["ms_per_step"][str(CANDIDATES[best])] == 50.0  # of 40 steps


def test_one_slow_turn_does_not_decide(device):
    # The first candidate stumbles in its first round; its best round is the best of all.
    assert choose(device, Clock(9.0, 3.0, 3.0, *([2.0, 3.0, 3.0] * 4))) == GATHER


@pytest.mark.parametrize(
    "other", [{"precision": "double"}, {"hourglass": "joldes"}, {"cells": (4, 4, 8)}, {}]
)
def test_each_kind_of_run_has_its_own(device, monkeypatch, other):
    assert choose(device, Clock(1.0, 2.0, 2.0)) == GATHER
    if not other:  # another version of tledface, then
        monkeypatch.setattr(autotune, "version", lambda _: "9.9")
    assert choose(device, Clock(2.0, 1.0, 2.0), **other) == TILE
    assert len(json.loads(autotune.cache_file().read_text())) == 2


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: text[: len(text) // 2],
        lambda text: "\x00\xff" * 20,
        lambda text: "[]",
        lambda text: "3",
        lambda text: text.replace('"gather"', '"no such kernels"'),
        lambda text: text.replace('"chosen"', '"other"'),
        lambda text: json.dumps(dict.fromkeys(json.loads(text), 3)),
        lambda text: json.dumps(dict.fromkeys(json.loads(text))),
    ],
)
def test_a_damaged_cache_is_begun_anew(device, monkeypatch, damage):
    assert choose(device, Clock(1.0, 2.0, 2.0)) == GATHER
    path = autotune.cache_file()
    path.write_text(damage(path.read_text()))
    forget(monkeypatch)
    assert choose(device, Clock(2.0, 1.0, 2.0)) == TILE
    forget(monkeypatch)
    assert choose(device, no_clock) == TILE


def test_a_cache_that_is_no_text_is_begun_anew(device):
    path = autotune.cache_file()
    path.parent.mkdir(parents=True)
    path.write_bytes(b"\xff\xfe\x00")
    assert choose(device, Clock(2.0, 1.0, 2.0)) == TILE
    assert json.loads(path.read_text())


def test_no_room_for_a_cache_is_no_error(device, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", "/proc/nowhere"):
        monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
        forget(monkeypatch)
        assert choose(device, Clock(2.0, 2.0, 1.0)) == WIDE
        assert choose(device, no_clock) == WIDE
    assert (tmp_path / "file").read_text() == ""


def test_what_the_device_cannot_do_is_left_out(device):
    huge = Kernels("tile", (4096, 4096, 0))
    # Its time would win; two candidates are left, and the clock sees these only.
    assert choose(device, Clock(2.0, 1.0), candidates=(huge, GATHER, TILE)) == TILE
    if not device.info.limits_registers:
        options = {"hourglass": "joldes", "candidates": (LIMITED, GATHER, WIDE)}
        assert choose(device, Clock(1.0, 2.0), **options) == GATHER


def test_nothing_runs(device):
    assert choose(device, no_clock, candidates=(Kernels("tile", (1, 1, 0)),)) == GATHER
    assert not autotune.cache_file().exists()


def test_a_real_clock_chooses_one_that_runs(device):
    chosen = fastest(device, **{**OPTIONS, "cells": (16, 16, 4)})
    kept = next(iter(json.loads(autotune.cache_file().read_text()).values()))
    assert kept["chosen"] == str(chosen)
    times = kept["ms_per_step"]
    assert times[str(chosen)] == min(times.values()) > 0
    assert {"gather", "tile 16x8", "tile 16x16"} <= set(times)


def test_auto_is_timed_on_gpus_only(monkeypatch):
    asked, told = [], []
    monkeypatch.setattr(autotune, "fastest", lambda gpu, **_: asked.append(gpu) or LIMITED)
    monkeypatch.setattr(autotune._core, "choose_kernels", lambda *a, **k: told.append((*a, k)))
    gpu = SimpleNamespace(info=SimpleNamespace(kind="gpu", id="opencl:7"))
    cpu = SimpleNamespace(info=SimpleNamespace(kind="cpu", id="opencl:8"))
    tune(cpu, precision="single", hourglass="joldes")
    assert not asked and not told
    tune(gpu, precision="single", hourglass="joldes")
    assert asked == [gpu]
    kernels = {"kernels": "tile", "tile": (16, 8, 0), "registers": 96}
    assert told == [("opencl:7", "single", "joldes", kernels)]
    monkeypatch.setenv("TLEDFACE_AUTOTUNE", "0")
    tune(gpu, precision="single", hourglass="joldes")
    assert len(asked) == len(told) == 1


def test_a_simulator_takes_what_was_chosen(device, monkeypatch):
    soft = tf.material("neo_hookean", youngs_modulus=5e4, poissons_ratio=0.4, density=1e3)
    model = tf.Model.block(cells=(8, 4, 4), size=(8e-3, 4e-3, 4e-3), material=soft)

    def tuned(device, *, precision, hourglass):
        chosen = {"kernels": "tile", "tile": (16, 16, 0), "registers": 96}
        _core.choose_kernels(device.info.id, precision, hourglass, **chosen)

    monkeypatch.setattr("tledface.simulator.tune", tuned)
    try:
        sim = tf.Simulator(model, device=device)
        assert sim._core.kernels == "tile"
        # The choice is of one precision and form, and only for those who leave it open.
        monkeypatch.setattr("tledface.simulator.tune", lambda *_, **__: None)
        for options in ({"hourglass": "joldes"}, {"precision": "double"}, {"kernels": "gather"}):
            other = tf.Simulator(model, device=device, **options)
            assert other._core.kernels != "tile"
        assert tf.Simulator(model, device="native")._core.kernels == "rows"
    finally:
        _core.choose_kernels(device.info.id, "single", "physical", kernels="auto")
    assert tf.Simulator(model, device=device)._core.kernels != "tile"
    assert sim._options["kernels"] == "auto"
    sim.step(3)
    assert np.isfinite(sim.u).all()


def test_a_chosen_tile_that_a_model_has_no_room_for_gives_way(opencl):
    soft = tf.material("neo_hookean", youngs_modulus=5e4, poissons_ratio=0.4, density=1e3)
    model = tf.Model.block(cells=(8, 4, 4), size=(8e-3, 4e-3, 4e-3), material=soft)
    kind = (opencl, "single", "physical")
    _core.choose_kernels(*kind, kernels="tile", tile=(4096, 4096, 0))
    try:
        assert tf.Simulator(model, device=opencl)._core.kernels == "gather"
    finally:
        _core.choose_kernels(*kind, kernels="auto")


def test_no_such_kernels_are_not_chosen():
    with pytest.raises(tf.InputError, match="kernels: got 'fast'"):
        _core.choose_kernels("native", "single", "physical", kernels="fast")
