"""Time scaling: conditions written in the time of the playback, simulated faster."""

import json
import warnings

import h5py
import numpy as np
import pytest

import tledface as tf
from tledface.errors import InputError
from tledface.examples import flat_block
from tledface.run import resume_run, run_scene
from tledface.run_checkpoints import RunCheckpoints
from tledface.scene import Scene
from tledface.time_step import TimeScalingWarning

PLAIN = {"youngs_modulus": 34e3, "poissons_ratio": 0.45, "density": 1100.0}
S = 5.0


def driven(law=None):
    """A block whose every kind of condition is a function of time."""
    model = tf.Model.block(
        (6, 4, 4), (6e-3, 4e-3, 4e-3), law or tf.material("neo_hookean", **PLAIN)
    )
    model.add_muscle("m", lambda c: c[:, 2] < 2e-3, (1, 0.3, 0), sigma_act=4e4)
    model.fix(lambda X: X[:, 0] < 1e-9)
    model.prescribe(lambda X: X[:, 0] > 5.999e-3, {"y": lambda t: 2e-2 * t})
    model.prescribe(
        lambda X: (X[:, 2] > 3.999e-3) & (abs(X[:, 0] - 3e-3) < 1e-4),
        {"z": lambda t, X: -3e-2 * t * X[:, 1] / 4e-3},
    )
    model.body_force(np.ones(96, bool), lambda t: (0.0, 0.0, 2e5 * np.sin(100 * t)))
    model.pressure(lambda c, n: n[:, 1] < -0.5, lambda t: 5e4 * t)
    model.gravity = (0.0, 30.0, -9.81)
    return model


def test_it_is_mass_scaling_by_its_square_seen_in_the_playback():
    """The same bodies step for step: s^2 the mass, s times the step, 1/s of the damping."""
    dt = 8e-6
    kinds = {
        "time": {"time_scaling": S, "damping": 300.0, "dt": dt},
        "mass": {"mass_scaling": S**2, "damping": 300.0 / S, "dt": S * dt},
        "neither": {"damping": 300.0, "dt": dt},
    }
    sims = {}
    for name, options in kinds.items():
        sim = tf.Simulator(driven(), device="native", precision="double", **options)
        sim.activate("m", tf.ramp(0.0, 0.6, over=0.02, begin=1e-3, shape="cosine"))
        sim.step(600)
        sims[name] = sim
    size = abs(sims["mass"].u).max()
    assert size > 2e-4
    assert abs(sims["time"].u - sims["mass"].u).max() < 1e-9 * size
    assert abs(sims["time"].u - sims["neither"].u).max() > 0.05 * size
    assert sims["time"].time == pytest.approx(600 * dt)
    assert sims["time"].playback_time == pytest.approx(sims["mass"].time) == 600 * S * dt
    assert sims["neither"].playback_time == sims["neither"].time


def test_an_equilibrium_takes_conditions_of_the_playback():
    """At one moment of the playback the equilibrium is the same, whatever the factor."""
    found = []
    for factor in (1.0, S):
        sim = tf.Simulator(driven(), device="native", precision="double", time_scaling=factor)
        sim.activate("m", lambda t: min(1.0, 30 * t))
        sim.set_state(np.zeros((sim.model.n_nodes, 3)), time=0.01 / factor)
        assert sim.relax(1e-7).converged
        found.append(sim.u)
    assert abs(found[0] - found[1]).max() < 1e-5 * abs(found[0]).max()


@pytest.mark.parametrize("factor", [0.5, 0.0, -2, "fast", True, np.nan, None])
def test_bad_factors_are_named(factor):
    with pytest.raises(InputError, match=r"time_scaling: got .*; allowed: a factor of 1 or more"):
        tf.Simulator(driven(), device="native", time_scaling=factor)


J2 = {"mu": 1e4, "bulk_modulus": 1e5, "density": 1100.0, "yield_stress": 4e3}


@pytest.mark.parametrize(
    ("law", "word"),
    [
        (tf.material("neo_hookean", **PLAIN, prony=[(0.3, 0.02)]), "prony of 'tissue' are simula"),
        (tf.material("j2_plastic", **J2, yield_stress_end=1e3), "falling yield stress of 'tissue'"),
        (tf.material("j2_plastic", **J2), None),
        (tf.material("neo_hookean", **PLAIN), None),
    ],
)
def test_laws_with_times_of_their_own_are_named(law, word):
    if word is None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tf.Simulator(driven(law), device="native", time_scaling=S)
        return
    with pytest.warns(TimeScalingWarning, match=word):
        tf.Simulator(driven(law), device="native", time_scaling=S)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tf.Simulator(driven(law), device="native")


def test_a_checkpoint_keeps_the_factor(tmp_path):
    model = driven()
    model.prescribed.clear()
    model.body_forces.clear()
    model.pressures.clear()
    sim = tf.Simulator(model, device="native", time_scaling=S)
    sim.activate("m", tf.ramp(0.0, 0.6, over=0.02))
    sim.step(100)
    sim.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    assert again.playback_time == sim.playback_time == S * sim.time > 0
    for one in (sim, again):
        one.step(200)
    assert np.array_equal(sim.u, again.u)


@pytest.fixture
def scenes(tmp_path):
    """The flat block, coarse: 6 ms as they are, and as 30 ms of a playback five times slower."""
    path = flat_block.write(tmp_path, voxel=3.0, voxel_height=1.5, triangle=4.0)
    text = path.read_text().replace("[solver]", '[solver]\nprecision = "double"')
    plain = text.replace('duration = "50 ms"', 'duration = "6 ms"').replace(
        "fps = 200", "fps = 500"
    )
    path.write_text(plain)
    slow = tmp_path / "slow.toml"
    changes = {
        'over = "50 ms"': 'over = "250 ms"',
        'duration = "50 ms"': 'duration = "30 ms"',
        "mass_scaling = 10": "mass_scaling = 10\ntime_scaling = 5",
        "fps = 200": 'fps = 100\ncheckpoint_every = "5 ms"',
    }
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    slow.write_text(text)
    return Scene.load(path), Scene.load(slow)


def test_a_scene_is_written_in_the_time_of_its_playback(scenes, tmp_path, monkeypatch):
    """The same steps and frames as the scene in simulated time, at five times the times."""
    taken = []
    take = RunCheckpoints.take

    def noted(self, sim, *rest):
        taken.append(sim.playback_time)
        take(self, sim, *rest)

    monkeypatch.setattr(RunCheckpoints, "take", noted)
    runs = [
        run_scene(scene, tmp_path / name, device="native", quiet=True)
        for scene, name in zip(scenes, ("plain", "slow"), strict=True)
    ]
    assert runs[0].steps == runs[1].steps
    assert runs[1].simulated == runs[0].simulated == pytest.approx(6e-3, rel=1e-3)
    assert runs[1].played == pytest.approx(30e-3, rel=1e-3)
    assert runs[1].max_displacement == pytest.approx(runs[0].max_displacement, rel=1e-9)
    times = []
    for run in runs:
        for role in ("frames", "surface frames"):
            with h5py.File(run.files[role]) as file:
                steps = file["VTKHDF/Steps"]
                times.append((steps["Values"][()], steps.attrs.get("TimeScaling")))
    assert np.allclose(times[2][0], 5 * times[0][0], rtol=1e-12)
    assert len(times[0][0]) == 4 and np.array_equal(times[2][0], times[3][0])
    assert [factor for _, factor in times] == [None, None, 5.0, 5.0]
    assert taken == pytest.approx([0.0, 5e-3, 10e-3, 15e-3, 20e-3, 25e-3, 30e-3], abs=2e-4)
    facts = json.loads((tmp_path / "slow" / "run.json").read_text())["result"]
    assert facts["time_scaling"] == 5.0
    assert facts["played_s"] == 5 * facts["simulated_s"]
    assert facts["added_mass_share"] == pytest.approx(9.0)
    assert facts["added_mass_kg"] == pytest.approx(9 * 1100 * 60e-3 * 60e-3 * 4.5e-3)
    text = runs[1].text()
    played = f"{runs[1].simulated:.3g} s simulated, {runs[1].played:.3g} s played"
    assert f"time scaling 5: {played}; inertia as of 250 times the true mass" in text
    assert "mass scaling: 0.16 kg added, 10 times the true mass" in text
    assert "time scaling" not in runs[0].text()


def test_a_stopped_run_goes_on_at_its_pace(scenes, tmp_path, monkeypatch):
    whole = run_scene(scenes[1], tmp_path / "whole", device="native", quiet=True)
    take, count = RunCheckpoints.take, []

    def stopping(self, *rest):
        count.append(1)
        if len(count) == 4:
            raise KeyboardInterrupt
        take(self, *rest)

    monkeypatch.setattr(RunCheckpoints, "take", stopping)
    with pytest.raises(KeyboardInterrupt, match=r"interrupted at t = 0\.015"):
        run_scene(scenes[1], tmp_path / "out", device="native", quiet=True)
    monkeypatch.undo()
    again = resume_run(tmp_path / "out", quiet=True)
    assert (again.steps, again.frames, again.played) == (whole.steps, whole.frames, whole.played)
    for role in ("surface", "picture"):
        assert again.files[role].read_bytes() == whole.files[role].read_bytes()
    with h5py.File(again.files["frames"]) as file:
        assert file["VTKHDF/Steps"].attrs["TimeScaling"] == 5.0


def test_a_bad_factor_in_a_scene_is_named(scenes, tmp_path):
    path = tmp_path / "slow.toml"
    path.write_text(path.read_text().replace("time_scaling = 5", "time_scaling = 0.5"))
    with pytest.raises(InputError, match=r"solver\.time_scaling: got 0\.5; allowed: at least 1"):
        Scene.load(path)
    path.write_text(path.read_text().replace('"30 ms"', '"1 us"').replace("= 0.5", "= 5"))
    with pytest.raises(InputError, match=r"got 1e-06 s, shorter than one step of"):
        run_scene(Scene.load(path), tmp_path / "out", device="native", quiet=True)
