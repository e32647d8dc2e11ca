"""The atlas' forehead as a model: tissues, fibres, boundary nodes, sliding under contraction."""

import numpy as np
import pytest

import tledface as tf
from tledface import _core
from tledface.examples import forehead
from tledface.geometry import read_surface
from tledface.scene import Scene


@pytest.fixture(scope="module")
def scene(shared_data, tmp_path_factory):
    """Right half at 1 mm: plumbing, not wrinkles."""
    atlas = shared_data / "bodyparts3d"
    if not atlas.is_dir():
        pytest.skip("the atlas is not on this machine")
    folder = tmp_path_factory.mktemp("forehead")
    return Scene.load(forehead.write(folder, data=atlas, voxel=1.0, half=True))


@pytest.fixture(scope="module")
def half(scene):
    return scene.build()


def muscle(model, name):
    return next(m for m in model.muscles if m.name == name)


def test_every_tissue_is_there(half):
    share = half.fractions.sum(axis=0) / half.n_elements
    assert 25_000 < half.n_elements < 45_000
    assert (share > 0).all()
    volume = dict(zip(half.tissues, share * half.n_elements, strict=True))  # mm3
    assert volume["frontalis"] == pytest.approx(7500, rel=0.15)  # 7.98 cm3 less what lies in bone
    assert volume["galea"] > 800
    # The galea is in touch with the muscle that it goes on from.
    galea = half.fractions[:, half.tissues.index("galea")]
    frontalis = half.fractions[:, half.tissues.index("frontalis")]
    assert np.count_nonzero((galea > 0.1) & (frontalis > 0.1)) > 60


def test_fibres_run_as_the_muscles_do(half, figure):
    up = abs(muscle(half, "frontalis").fibre[:, 2])
    # The sheet leans back with the forehead, most at its top.
    figure("frontalis: median |z|", np.median(up), 0.95, absolute=0.06)
    across = abs(muscle(half, "corrugator_r").fibre[:, 0])
    figure("corrugator: mean |x|", across.mean(), 0.78, absolute=0.1)
    upright = abs(muscle(half, "procerus").fibre[:, 2])
    figure("procerus: mean |z|", upright.mean(), 0.93, absolute=0.07)


def test_nodes_slide_on_the_outside_of_the_bone_only(half):
    sliding = half.sliding
    assert 4_000 < len(sliding) < 9_000
    assert {s.name for s in sliding.surfaces} >= {"FMA52734"}
    # In front of the bone's middle surface, above the rim, not held.
    x = half.nodes[sliding.nodes]
    assert x[:, 2].min() > 1.545
    assert not half.fixed[sliding.nodes].all(axis=1).any()
    assert abs(sliding.distance).max() < 3e-3
    on_plane = abs(half.nodes[:, 0]) < 1e-9
    assert half.fixed[on_plane, 0].all()


def test_skin_is_bound_vertex_for_vertex(half, scene):
    skin = half.surfaces["skin"]
    written = read_surface(scene.geometry.skin, unit_scale=1e-3)
    # The atlas' 27 860 triangles, each in four, in the order of the file.
    assert len(skin.faces) == 4 * 27_860
    np.testing.assert_array_equal(skin.vertices, written.vertices)
    assert np.array_equal(skin.displaced(np.zeros_like(half.nodes)), skin.vertices)
    moved = skin.displaced(np.tile([0.0, 0.0, 1e-3], (half.n_nodes, 1))) - skin.vertices
    assert set(np.round(moved[:, 2], 12)) == {0.0, 1e-3}  # near the voxels, or at rest


def test_brow_rises_and_slides(half, figure):
    """A gentle contraction: the brow goes up along the bone, every distance is kept."""
    sim = tf.Simulator(half, device="native", damping=200.0, mass_scaling=10.0)
    sim.activate("frontalis", tf.ramp(0.0, 0.15, 4e-3))
    sim.run(until=6e-3)
    frontalis = muscle(half, "frontalis").elements
    low = half.centres[frontalis, 2] < 1.556
    brow = np.unique(half.elements[frontalis[low]])
    free = brow[abs(half.nodes[brow, 0]) < 0.04]
    rise = 1e3 * np.median(sim.u[free, 2])
    figure("rise of the muscle's lower edge, mm", rise, 5.0, absolute=1.0)
    bone = half.sliding.surfaces[0]
    mine = half.sliding.surface == 0
    x = (half.nodes + sim.u)[half.sliding.nodes[mine]]
    centre = bone.vertices.mean(axis=0)
    squares, _ = _core.grid_nearest(
        tf.device.resolve("native"), "double", bone.vertices - centre, bone.faces, x - centre
    )
    off = abs(np.sqrt(squares) - abs(half.sliding.distance[mine])).max()
    figure("error of sliding distances over the voxel", off / 1e-3, at_most=1e-4)


@pytest.mark.slow
def test_half_millimetre_voxels(shared_data, tmp_path, figure):
    """The size that wrinkles need."""
    import resource

    atlas = shared_data / "bodyparts3d"
    model = Scene.load(forehead.write(tmp_path, data=atlas)).build()
    figure("elements", model.n_elements, 552_000, rel=0.05)
    figure("sliding nodes", len(model.sliding), 52_600, rel=0.05)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    assert peak < 4e9
