"""Bones of a scene that move, rub and let go."""

import numpy as np
import pytest

import tledface as tf
from shell_scene import CENTRE, build
from tledface.errors import InputError


def test_a_bone_of_a_scene_moves_rubs_and_is_refused_by_name(tmp_path):
    """The skull takes the shell about it along, wherever that is turned to on it."""
    motion = {
        "bone": "skull",
        "about": [float(c) for c in CENTRE + np.array([0.0, 20.0, 0.0])],
        "axis": [0, 0, 2],
        "degrees": 10,
        "share": {"ramp": [0.0, 1.0], "over": "20 ms", "shape": "cosine"},
    }
    sliding = {"on": ["skull"], "friction": 5.0, "release": True}
    model = build(tmp_path, boundary={"sliding": sliding, "motions": [motion]}, voxel=2.0)
    assert (model.sliding.friction == 5.0).all()
    assert model.sliding.release.all()
    model.save(tmp_path / "m.h5")
    model = tf.Model.load(tmp_path / "m.h5")
    sim = tf.Simulator(model, device="native", damping=500.0)
    sim.run(until=40e-3)
    angle = np.radians(10.0)
    way = 20e-3 * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
    assert sim.u.mean(axis=0) == pytest.approx(way, abs=0.02 * way[0])
    motion["bone"] = "jaw"
    with pytest.raises(InputError, match=r"boundary\.motions: got bone 'jaw'.*'skull'"):
        build(tmp_path, boundary={"sliding": sliding, "motions": [motion]}, voxel=2.0)
