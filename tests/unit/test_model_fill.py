"""Partly filled elements: density, stiffness, laws and muscles in proportion, kept in files."""

import numpy as np
import pytest
import trimesh

from tledface.constitutive import material
from tledface.errors import InputError
from tledface.model import Model
from tledface.scene import Scene
from tledface.simulator import Simulator

SOFT = material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.45, density=1100.0)
RUBBER = material("mooney_rivlin", c10=4e3, c01=2e3, bulk_modulus=1e5, density=1000.0)
CELLS = np.argwhere(np.ones((3, 2, 2)))


def model(fill=None):
    share = np.linspace(0.2, 0.8, len(CELLS))
    made = Model.from_voxels(
        (1e-3, 1e-3, 1e-3), (0, 0, 0), CELLS, ["fat", "rubber"], [SOFT, RUBBER],
        np.stack([share, 1 - share], axis=1), fill=fill,
    )  # fmt: skip
    made.add_muscle("m", CELLS[:, 0] > 0, (1, 1, 0), sigma_act=2e3, weight=0.7)
    return made


def forces(made):
    sim = Simulator(made, device="native", precision="double")
    sim.activate("m", 0.5)
    u = np.random.default_rng(0).uniform(-1e-4, 1e-4, made.nodes.shape)
    sim.set_state(u)
    return sim


def test_a_fill_of_a_half_halves_masses_and_forces():
    whole, half = forces(model()), forces(model(np.full(len(CELLS), 0.5)))
    np.testing.assert_allclose(half.mass, 0.5 * whole.mass, rtol=1e-12)
    expected = 0.5 * whole.internal_force()
    assert np.abs(expected).max() > 1e-5
    np.testing.assert_allclose(half.internal_force(), expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(half.dt_crit, whole.dt_crit, rtol=1e-9)


def test_fill_by_element():
    fill = np.linspace(0.3, 1.0, len(CELLS))
    plain, filled = model().element_parameters(), model(fill).element_parameters()
    for key in ("mu", "bulk", "density", "youngs_modulus"):
        np.testing.assert_allclose(filled[key], fill * plain[key])
    np.testing.assert_allclose(filled["poissons_ratio"], plain["poissons_ratio"])


def test_fill_comes_back_from_a_file(tmp_path):
    fill = np.linspace(0.3, 1.0, len(CELLS))
    model(fill).save(tmp_path / "m.h5")
    np.testing.assert_array_equal(Model.load(tmp_path / "m.h5").fill, fill)
    model().save(tmp_path / "m.h5")
    assert Model.load(tmp_path / "m.h5").fill is None


@pytest.mark.parametrize("bad", [0.0, 1.5, np.nan])
def test_fill_out_of_range(bad):
    fill = np.full(len(CELLS), 0.5)
    fill[3] = bad
    with pytest.raises(InputError, match=r"fill: element 3 has .*, need above 0, up to 1"):
        model(fill)
    with pytest.raises(InputError, match=r"fill: got shape \(2,\)"):
        model([1, 1])


def scene(folder, **geometry):
    trimesh.creation.box(bounds=[[0, 0, 0], [4, 4, 3.75]]).export(folder / "skin.stl")
    trimesh.creation.box(bounds=[[-1, -1, -1], [5, 5, 0.5]]).export(folder / "bone.stl")
    trimesh.creation.box(bounds=[[0, 0, 0], [4, 4, 2]]).export(folder / "muscle.stl")
    tissue = {
        "model": "neo_hookean",
        "youngs_modulus": "50 kPa",
        "poissons_ratio": 0.4,
        "density": 1000,
    }
    tables = {
        "schema": 1,
        "units": "mm",
        "geometry": {"skin": "skin.stl", "bones": ["bone.stl"], "voxel": 1.0} | geometry,
        "layers": [
            {"name": "dermis", "thickness": 2.5, "material": tissue},
            {"name": "fat", "material": tissue},
        ],
        "muscles": [
            {
                "name": "m",
                "surfaces": ["muscle.stl"],
                "fibre": [1, 0, 0],
                "sigma_act": "1 kPa",
                "material": tissue,
            }
        ],
        "solver": {"duration": "1 ms"},
    }
    return Scene.from_dict(tables, folder)


def test_scene_keys_reach_the_model(tmp_path):
    whole = scene(tmp_path).build()
    assert whole.fill is None
    volume = whole.report["tissue_volume"]
    scaled = scene(tmp_path, partial="scaled").build()
    mass = (scaled.element_parameters()["density"] * 1e-9).sum()
    assert mass == pytest.approx(1000 * volume) == pytest.approx(1000 * 52e-9)
    bone = scene(tmp_path, partial="bone-full").build()
    assert sorted(set(np.round(bone.fill, 9))) == [0.75, 1.0]
    top = [[[-1, -1, 3.7], [5, 5, 3.8]]]
    default = scene(tmp_path, outer=top).build().muscles[0].weight.sum()
    above = scene(tmp_path, outer=top, priority=["bones", "dermis"]).build()
    # The dermis ends at 1.25, half way through the muscle above the bone.
    assert above.muscles[0].weight.sum() < 0.7 * default
    assert (
        above.fractions[:, 0].sum() > 1.2 * scene(tmp_path, outer=top).build().fractions[:, 0].sum()
    )
    deep = scene(tmp_path, outer=top, depth_in=[{"box": [[-1, -1, -1], [2, 5, 5]], "depth": 1.5}])
    left = deep.build()
    assert left.cells[left.cells[:, 0] < 2, 2].min() > left.cells[left.cells[:, 0] > 1, 2].min()
    with pytest.raises(
        InputError, match=r"geometry\.priority: got 'bone'; allowed: bones, muscles"
    ):
        scene(tmp_path, priority=["bone"])
