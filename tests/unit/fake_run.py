"""A scene, its model and a simulator that makes waves without computing: for tests of a run."""

from __future__ import annotations

import tomllib
from types import SimpleNamespace
from typing import ClassVar

import numpy as np

from tledface.constitutive import material
from tledface.errors import SimulationError
from tledface.model import Model
from tledface.scene import Scene
from tledface.time_step import AddedMass

SCENE = """
schema = 1
units = "mm"
[geometry]
skin = "skin.stl"
voxel = 1
outer = [[[-1, -1, 3.9], [61, 13, 5]]]
[[layers]]
name = "dermis"
material = SOFT
[[muscles]]
name = "pull"
surfaces = ["pull.stl"]
fibre = [1, 0, 0]
sigma_act = "5 MPa"
material = SOFT
activation = { ramp = [0, 0.75], over = "10 ms" }
[solver]
duration = "10 ms"
damping = "200 1/s"
mass_scaling = 10
[output]
fps = 500
""".replace(
    "SOFT",
    '{ model = "neo_hookean", youngs_modulus = "34 kPa", poissons_ratio = 0.49, density = 1100 }',
)


def scene_tables() -> dict:
    return tomllib.loads(SCENE)


def write_scene(folder, text=SCENE):
    for name in ("skin.stl", "pull.stl"):
        (folder / name).touch()
    path = folder / "brow.toml"
    path.write_text(text)
    return path


def make_model(*_: object) -> Model:
    soft = material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)
    model = Model.block(
        cells=(60, 12, 4), size=(0.06, 0.012, 0.004), material=soft, tissue="dermis"
    )
    model.add_muscle("pull", lambda x: x[:, 2] < 0.002, (1, 0, 0), sigma_act=5e6)
    model.fix(lambda x: x[:, 2] == 0.0)
    model.report = {
        "elements": model.n_elements,
        "dropped_components": [3, 1],
        "dropped_loose_voxels": 2,
        "tissue_volume": 1e-6,
        "left_out": {"too_deep": {"volume": 2e-7, "removed": True}},
        "volumes": {"skin": {"volume": 1e-6, "covered_twice": 0.0, "inside_out": 0.0}},
        "overlaps": [],
        "gaps": [{"names": ["bone.stl", "skin"], "volume": 3e-9}],
        "surfaces": {},
        "repairs": ["skin.stl: 2 faces turned"],
    }
    return model


class FakeSimulator:
    """Waves of 2 mm at the end; ``fail_at`` ends in a state that is not finite."""

    dt = 1e-5
    substeps = 1
    dt_crit = 1.1e-5
    dt_crit_tissue = "pull"
    added_mass = AddedMass(kg=0.028512, share=9.0, elements=2880)
    fail_at = np.inf
    made: ClassVar[list[FakeSimulator]] = []

    def __init__(self, model, **options):
        self.model, self.options = model, options
        self.n_steps, self.schedules = 0, {}
        self._device = options.get("device")
        FakeSimulator.made.append(self)

    @property
    def time(self):
        return self.n_steps * self.dt

    @property
    def playback_time(self):
        return self.time * self.options.get("time_scaling", 1.0)

    @property
    def u(self):
        x, z = self.model.nodes[:, 0], self.model.nodes[:, 2]
        u = np.zeros_like(self.model.nodes)
        u[:, 2] = 0.1 * self.time * np.cos(2 * np.pi * (x - 0.03) / 0.012) * (z / 0.004)
        return u

    def von_mises(self):
        return 1e3 * self.time * self.model.centres[:, 2]

    def activate(self, name, schedule):
        self.schedules[name] = schedule

    def step(self, n):
        self.n_steps += n

    def snapshot(self):
        moment = ("time", "playback_time", "n_steps", "dt", "u")
        stress = self.von_mises()
        return SimpleNamespace(
            **{name: getattr(self, name) for name in moment}, von_mises=lambda: stress
        )

    def _require_finite(self):
        pass

    def run(self, until, on_frame, fps, *, wait):
        assert not wait  # a run takes snapshots
        for frame in range(1, round(until * fps) + 1):
            self.n_steps = round(frame / fps / self.dt)
            if self.time >= self.fail_at:
                raise SimulationError("step 7: not finite")
            on_frame(self)


def install(monkeypatch):
    """Put the fakes in place of building, devices and simulating."""
    FakeSimulator.made.clear()
    device = SimpleNamespace(info=SimpleNamespace(name="fake CPU", id="native"))
    monkeypatch.setattr("tledface.device.resolve", lambda wanted: device)
    monkeypatch.setattr("tledface.simulator.Simulator", FakeSimulator)
    monkeypatch.setattr(Scene, "build", make_model)
