"""Sliding nodes of a model: from Python, in a simulation, in the model's file."""

import numpy as np
import pytest
import trimesh

import tledface as tf
from shell_scene import CENTRE, build
from tledface.errors import InputError

SOFT = tf.material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)


def floor(z=0.0):
    vertices = [[-1, -1, z], [2, -1, z], [2, 2, z], [-1, 2, z]]
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False)


def test_a_triangle_without_area_at_an_open_rim_is_no_surface():
    """A spike of three points on a line: what slides beside it is kept to the sheet's rim."""
    z = -0.3e-3
    sheet = trimesh.Trimesh(
        [[0, 0, z], [2e-3, 0, z], [2e-3, 4e-3, z], [0, 4e-3, z]], [[0, 1, 2], [0, 2, 3]]
    )
    spike = [[2e-3, 2e-3, z], [3e-3, 2e-3, z], [4e-3, 2e-3, z]]
    both = trimesh.Trimesh(
        np.concatenate([sheet.vertices, spike]), [*sheet.faces, [4, 5, 6]], process=False
    )
    distances = []
    for surface in (sheet, both):
        model = tf.Model.block((4, 4, 2), (4e-3, 4e-3, 2e-3), SOFT)
        distances.append(model.slide(model.nodes[:, 2] < 1e-9, surface))
        sim = tf.Simulator(model, device="native")
        sim.step(20)
        assert abs(sim.u).max() < 1e-6  # it lies where it is held
    np.testing.assert_allclose(*distances, atol=1e-12)
    # In the sheet's own plane a node beyond its rim is on neither side: the run would diverge.
    sheet.vertices = sheet.vertices - [0.0, 0.0, z]
    with pytest.raises(InputError, match=r"slide: 10 of 25 nodes, such as that at .* open rim"):
        model.slide(model.nodes[:, 2] < 1e-9, sheet)


def rim_with(points, faces):
    """A sheet below half of a block's bottom, and more at its open rim: x = 2 mm, corners 1, 2."""
    z = -0.3e-3
    sheet = [[0, 0, z], [2e-3, 0, z], [2e-3, 4e-3, z], [0, 4e-3, z]]
    return trimesh.Trimesh(
        np.concatenate([sheet, np.reshape(points, (-1, 3))]),
        [[0, 1, 2], [0, 2, 3], *faces],
        process=False,
    )


def flap(height):
    """Along the rim, folded up steeply: half of the block, beyond it, is on its other side."""
    return rim_with([2e-3 + 0.13 * height, 2.3e-3, -0.3e-3 + height], [[1, 4, 2]])


def spike(width):
    """Out from below the rim, askew, 2 mm long."""
    begin = np.array([2.3e-3, 2.1e-3, -0.7e-3])
    way, across = np.array([1.9e-3, -0.5e-3, 0.4e-3]), np.array([0.2, 0.9, 0.3]) * width
    return rim_with([begin, begin + way, begin + 0.6 * way + across], [[4, 5, 6]])


@pytest.mark.parametrize("make", [flap, spike])
@pytest.mark.parametrize("share", [1e-5, 1e-7, 1e-9])
def test_slivers_at_an_open_rim_leave_a_run_where_it_is(make, share):
    """In single precision they threw nodes to the other side, or anywhere.

    Those within 1e-4 of a voxel of what they are joined to, and those whose height single
    precision does not tell from 0, are no surface.
    """
    model = tf.Model.block((4, 4, 2), (4e-3, 4e-3, 2e-3), SOFT)
    bottom = model.nodes[:, 2] < 1e-9
    of_sheet = model.slide(bottom, rim_with([], []))
    distance = model.slide(bottom, make(4e-3 * share))
    sim = tf.Simulator(model, device="native")
    sim.step(50)
    assert abs(sim.u).max() < 1e-7
    if make is flap or share < 1e-6:
        np.testing.assert_allclose(distance, of_sheet, atol=1e-7)


def test_nodes_whose_side_is_for_a_small_flap_to_say_are_refused():
    """Farther away than it is large, next to nothing decides what is nearest, and so the side."""
    model = tf.Model.block((4, 4, 2), (4e-3, 4e-3, 2e-3), SOFT)
    bottom = model.nodes[:, 2] < 1e-9
    with pytest.raises(InputError, match=r"slide: \d+ of 25 nodes, .* beyond the open rim"):
        model.slide(bottom, flap(1e-6))
    model.slide(bottom & (model.nodes[:, 0] < 2e-3), flap(1e-6))  # these are above the sheet
    sim = tf.Simulator(model, device="native")
    sim.step(20)
    assert abs(sim.u).max() < 1e-7


def test_slide_from_python_keeps_distances_and_the_last_call_holds():
    model = tf.Model.block((4, 4, 2), (4e-3, 4e-3, 2e-3), SOFT)
    bottom = model.nodes[:, 2] < 1e-9
    distance = model.slide(bottom, floor(-1e-3))
    np.testing.assert_allclose(distance, 1e-3, rtol=1e-12)
    np.testing.assert_array_equal(model.sliding.nodes, np.flatnonzero(bottom))
    assert model.slide(bottom, floor(5e-3), "lid") == pytest.approx(-5e-3)
    assert [model.sliding.surfaces[n].name for n in (0, 1)] == ["surface 1", "lid"]
    assert (model.sliding.surface == 1).all()
    model.fix(lambda X: X[:, 0] < 1e-9, "x")
    assert len(model.sliding) == 25
    model.fix(lambda X: X[:, 0] < 1e-9, "yz")
    assert len(model.sliding) == 20
    model.prescribe(lambda X: X[:, 0] > 3.9e-3, {"x": 0.0, "y": 0.0, "z": 1e-3})
    assert len(model.sliding) == 15
    corner = (model.nodes < 1e-9).all(axis=1)
    model.slide(corner, floor(-1e-3), "again")
    assert not model.fixed[corner].any() and np.flatnonzero(corner)[0] in model.sliding.nodes
    with pytest.raises(InputError, match="another surface 'lid'"):
        model.slide(bottom, floor(), "lid")
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0]], [[0, 1, 1]], process=False)
    for surface, word in ((flat, "no triangle"), (None, "NoneType"), (floor(np.nan), "finite")):
        with pytest.raises(InputError, match=word):
            model.slide(bottom, surface)


def test_a_simulation_keeps_what_the_scene_lets_slide():
    model = tf.Model.block((2, 2, 2), (2e-3, 2e-3, 2e-3), SOFT)
    model.slide(lambda X: X[:, 2] < 1e-9, floor())
    model.gravity = (3.0, 0.0, 9.81)
    sim = tf.Simulator(model, device="native", precision="double")
    sim.step(50)
    bottom = model.sliding.nodes
    assert abs(sim.u[bottom, 2]).max() < 1e-15 and sim.u[bottom, 0].min() > 1e-9
    assert sim.reaction(lambda X: X[:, 2] < 1e-9)[2] < 0.0  # it holds the body down


def test_all_of_it_survives_the_model_file(tmp_path):
    x, y, z = CENTRE
    boundary = {
        "ligaments": [{"name": "a", "points": [[x, y, z - 10]], "radius": 2}],
        "attachments": [{"muscle": "lid", "reach": 1}],
        "sliding": ["bones"],
    }
    model = build(tmp_path, boundary=boundary)
    model.save(tmp_path / "m.h5")
    again = tf.Model.load(tmp_path / "m.h5")
    for name in ("nodes", "surface", "distance"):
        np.testing.assert_array_equal(
            getattr(again.sliding, name), getattr(model.sliding, name), strict=True
        )
    for one, other in zip(again.sliding.surfaces, model.sliding.surfaces, strict=True):
        assert one.name == other.name
        np.testing.assert_array_equal(one.vertices, other.vertices, strict=True)
        np.testing.assert_array_equal(one.faces, other.faces, strict=True)
    assert [(g.kind, g.name) for g in again.groups] == [(g.kind, g.name) for g in model.groups]
    for one, other in zip(again.groups, model.groups, strict=True):
        np.testing.assert_array_equal(one.nodes, other.nodes)
    assert again.report["boundary"] == model.report["boundary"]
    assert again.report["warnings"] == []


def test_files_of_the_version_before_load_and_damage_is_named(tmp_path):
    import h5py

    model = tf.Model.block((2, 2, 2), (2e-3, 2e-3, 2e-3), SOFT)
    path = tmp_path / "m.h5"
    model.save(path)

    def change(**attributes):
        with h5py.File(path, "a") as file:
            file.attrs.update(attributes)

    change(version=1)
    old = tf.Model.load(path)
    assert old.n_elements == 8 and len(old.sliding) == 0 and old.groups == [] and old.report == {}
    change(version=3)
    with pytest.raises(InputError, match="version 3, this tledface reads versions 1 to 2; build"):
        tf.Model.load(path)
    model.slide(lambda X: X[:, 2] < 1e-9, floor())
    for key, value, word in (
        ("nodes", np.arange(20, 29), "node or a surface that is not there"),
        ("surface", np.full(9, 1), "node or a surface that is not there"),
        ("distance", np.zeros(8), "different lengths"),
    ):
        model.save(path)
        with h5py.File(path, "a") as file:
            del file["sliding"][key]
            file["sliding"][key] = value
        with pytest.raises(InputError, match=word) as caught:
            tf.Model.load(path)
        assert str(path) in str(caught.value)


def test_a_refused_state_of_sliding_nodes_leaves_the_simulator_as_it_was():
    """It is checked whole before any of it is written: what follows has the same bits."""
    model = tf.Model.block((4, 4, 2), (4e-3, 4e-3, 2e-3), SOFT)
    model.slide(lambda X: X[:, 2] < 1e-9, floor(-1e-3))
    model.gravity = (3.0, 0.0, -9.81)
    asked, never = (tf.Simulator(model, device="native") for _ in range(2))
    for sim in (asked, never):
        sim.step(20)
    earlier = tf.Simulator(model, device="native")
    earlier.step(7)
    raw = earlier._core.raw_state()
    spoilt = raw["sliding"].copy()
    spoilt[0] += 2  # another layout
    raw["levels"] = np.ones_like(raw["levels"])
    with pytest.raises(InputError, match="levels of subcycling are not those"):
        asked._core.set_raw_state(**raw)
    del raw["levels"]
    layouts = f"in layout {spoilt[0]}, this version has layout {raw['sliding'][0]}"
    for sliding, word in ((raw["sliding"][:-1], "bytes of sliding nodes"), (spoilt, layouts)):
        with pytest.raises(InputError, match=word):
            asked._core.set_raw_state(**{**raw, "sliding": sliding, "dt": 2 * raw["dt"]})
        now, expected = (sim._core.raw_state() for sim in (asked, never))
        for name, value in expected.items():
            np.testing.assert_array_equal(now[name], value, err_msg=name)
    for sim in (asked, never):
        sim.step(20)
    assert asked.time == never.time
    np.testing.assert_array_equal(asked.u, never.u)
