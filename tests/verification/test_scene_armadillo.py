"""The body of three densities under gravity: its scene, its sag, and the equilibrium it ends in.

A body of boxes stands for the Armadillo wherever the scan is not at hand; it is symmetric, so its
two sides differ by their densities alone.
"""

import numpy as np
import pytest
import trimesh

import tledface as tf
from tledface.errors import InputError
from tledface.examples import armadillo
from tledface.io.surfaces import write_surface
from tledface.run import run_scene, simulator_of
from tledface.run_frames import RunFrames
from tledface.scene import Scene
from tledface.simulator import Simulator

WEIGHT = {"body": 1000.0, "left limbs": 1250.0, "right limbs": 750.0}


def write_body(path, up=(0, 1, 0), front=(0, 0, -1)):
    """A closed figure of cubes with arms out and legs apart, standing along ``up``."""
    parts = [  # cells from and to, in the frame of the scene: x to its left, -y forwards, z up
        ((6, 0, 8), (12, 5, 20)),  # trunk and head
        ((0, 1, 13), (6, 4, 16)), ((12, 1, 13), (18, 4, 16)),  # arms
        ((6, 1, 0), (8, 4, 8)), ((10, 1, 0), (12, 4, 8)),  # legs
    ]  # fmt: skip
    cells = np.concatenate(
        [np.stack(np.meshgrid(*map(np.arange, *part), indexing="ij"), -1).reshape(-1, 3)
         for part in parts]
    )  # fmt: skip
    soft = tf.material("neo_hookean", youngs_modulus=1e3, poissons_ratio=0.4, density=1000.0)
    grid = tf.Model.from_voxels(
        (1, 1, 1), (0, 0, 0), cells, ["a"], [soft], np.ones((len(cells), 1))
    )
    surface = tf.surface.boundary_surface(grid)
    up, forth = np.asarray(up, float), np.asarray(front, float)
    turn = np.stack([np.cross(up, forth), -forth, up])
    write_surface(path, surface.vertices @ turn, surface.faces)
    return path


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    return write_body(tmp_path_factory.mktemp("body") / "body.ply")


# 20 cells of 6 mm; stiff and damped enough to be at rest after 0.1 s.
SHORT = {"height": 120.0, "voxel": 6.0, "duration": 150.0, "damping": 80.0}


def means(model, u):
    """Mean downward movement of the outer half of each arm and of each foot, m, left and right."""
    share = (model.nodes - model.nodes.min(axis=0)) / np.ptp(model.nodes, axis=0)
    upper, lower = share[:, 2] > 0.5, share[:, 2] < 0.15
    hands = [-u[upper & side, 2].mean() for side in (share[:, 0] > 0.85, share[:, 0] < 0.15)]
    feet = [-u[lower & side, 2].mean() for side in (share[:, 0] > 0.5, share[:, 0] < 0.5)]
    return np.array(hands), np.array(feet)


def test_the_scene_has_its_densities_at_its_sides(body, tmp_path):
    scene = Scene.load(armadillo.write(tmp_path, data=body, **SHORT))
    model = scene.build()
    assert np.ptp(model.nodes, axis=0) == pytest.approx([108e-3, 30e-3, 120e-3])
    assert model.n_elements == 6 * 5 * 12 + 2 * 6 * 9 + 2 * 2 * 3 * 8
    assert dict(zip(model.tissues, (m.density for m in model.tissue_materials), strict=True)) == (
        WEIGHT
    )
    held = dict(zip(model.tissues, model.fractions.T, strict=True))
    x, _, z = model.centres.T
    middle = 0.5 * (model.nodes[:, 0].min() + model.nodes[:, 0].max())
    beyond, height = np.abs(x - middle), z - model.nodes[:, 2].min()
    limb = (height < 0.95 * 0.42 * 120e-3) | ((beyond > 0.42 * 60e-3) & (height > 60e-3))
    limb &= beyond > 0.09 * 54e-3
    # The figure's left is towards +x, as it looks along -y.
    assert (held["left limbs"][limb & (x > middle)] > 0.4).all()
    assert (held["right limbs"][limb & (x < middle)] > 0.4).all()
    assert (held["left limbs"][x < middle] == 0.0).all()
    assert held["left limbs"].sum() == pytest.approx(held["right limbs"].sum(), rel=1e-6)
    fixed = model.fixed.all(axis=1)
    assert (model.fixed.any(axis=1) == fixed).all() and fixed.sum() > 100
    inside = model.nodes[fixed]
    assert np.abs(inside[:, 0] - middle).max() < 0.3 * 54e-3 * 2
    assert model.gravity.tolist() == [0.0, 0.0, -9.81]


def test_gravity_pulls_the_heavy_side_down_further(body, tmp_path, figure):
    scene = Scene.load(armadillo.write(tmp_path, data=body, **SHORT))
    model = scene.build()
    sim = simulator_of(scene, model, "native")
    sim.run(until=scene.solver.duration)
    hands, feet = means(model, sim.u)
    # Each limb moves by its own density, and a little by the other's, which tilts the trunk.
    assert hands[0] > 1e-3 and 1.6 < hands[0] / hands[1] < 1.9
    assert feet[0] > 1e-4 and 1.5 < feet[0] / feet[1] < 1.8
    assert np.isfinite(sim.u).all() and abs(sim.velocity).max() < 5e-3
    # At rest the supports carry the weight, and it is the equilibrium that relaxation finds.
    weight = 9.81 * float(
        model.volumes @ (model.fractions @ [m.density for m in model.tissue_materials])
    )
    force = sim.reaction(model.fixed.all(axis=1))
    figure("force of the supports, N: the weight", force[2], weight, rel=0.01)
    assert np.abs(force[:2]).max() < 0.01 * weight
    ends = sim.u
    static = simulator_of(scene, model, "native")
    assert static.relax().converged
    off = np.abs(static.u - ends).max() / np.abs(static.u).max()
    figure("end of the run against relaxation", off, at_most=0.02)
    # So small a movement is linear: the sides' mean is the sag of a body of the mean density.
    model.set_material(lambda c: c[:, 2] > -np.inf, model.tissue_materials[0], name="body")
    even = Simulator(model, device="native")
    assert even.relax().converged
    one, other = means(model, even.u)[0]
    assert one == pytest.approx(other, rel=0.01)
    figure("mean sag of the hands, mm: of one density", 1e3 * hands.mean(), 1e3 * one, rel=0.02)


def test_the_body_may_stand_along_any_axis(body, tmp_path):
    turned = write_body(tmp_path / "turned.obj", up=(0, 0, -1), front=(1, 0, 0))
    one = Scene.load(armadillo.write(tmp_path / "a", data=body, **SHORT)).build()
    other = Scene.load(
        armadillo.write(tmp_path / "b", data=turned, up="-z", front="+x", **SHORT)
    ).build()
    assert one.n_elements == other.n_elements
    # Turned, not mirrored: faces that looked outwards do so still.
    for name in "ab":
        assert trimesh.load(tmp_path / name / "skin.ply", process=False).volume > 0.0
    np.testing.assert_allclose(
        np.ptp(one.surfaces["skin"].vertices, axis=0),
        np.ptp(other.surfaces["skin"].vertices, axis=0),
        rtol=1e-6,
    )
    np.testing.assert_allclose(one.fractions.sum(axis=0), other.fractions.sum(axis=0), rtol=1e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"data": None}, "tledface demo armadillo --data Armadillo.ply"),
        ({"height": 0.0}, "armadillo height: got 0.0"),
        ({"voxel": float("nan")}, "armadillo voxel: got nan"),
        ({"modulus": -3.0}, "armadillo modulus: got -3.0"),
        ({"damping": -1.0}, "armadillo damping: got -1.0"),
        ({"up": "up"}, "armadillo up: got 'up'; allowed: -x, +x"),
        ({"front": "+y"}, "armadillo front: got '+y', the axis of up"),
    ],
)
def test_bad_settings_are_one_line(body, tmp_path, options, words):
    with pytest.raises(InputError) as error:
        armadillo.write(tmp_path / "new", **{"data": body, **options})
    assert words in str(error.value) and "\n" not in str(error.value)
    assert not (tmp_path / "new").exists()


def test_each_variant_is_a_scene(body, tmp_path):
    assert next(iter(armadillo.VARIANTS)) == "reference" and armadillo.VARIANTS["reference"] == {}
    assert set(armadillo.ABOUT_VARIANTS) == set(armadillo.VARIANTS)
    for name, options in armadillo.VARIANTS.items():
        Scene.load(armadillo.write(tmp_path / name, data=body, **options))


@pytest.fixture(scope="module")
def scan(shared_data):
    path = shared_data / "stanford" / "armadillo.off"
    if not path.exists():
        pytest.skip("the Stanford Armadillo is not on this machine")
    return path


def test_the_armadillo_is_the_paper_s_model(scan, tmp_path, figure):
    """Table II: 15 107 elements, 19 698 nodes, a step of 0.15 ms."""
    scene = Scene.load(armadillo.write(tmp_path, data=scan))
    model = scene.build()
    figure("elements", model.n_elements, 15_107, rel=0.005)
    figure("nodes", model.n_nodes, 19_698, rel=0.02)
    sim = simulator_of(scene, model, "native")
    figure("time step, ms", 1e3 * sim.dt, 0.15, rel=0.02)
    sim.step(20)
    assert np.isfinite(sim.u).all() and (means(model, sim.u)[0] > 0.0).all()


@pytest.mark.slow
def test_the_armadillo_sags_and_comes_to_rest(scan, tmp_path, figure):
    scene = Scene.load(armadillo.write(tmp_path / "scene", data=scan))
    run_scene(scene, tmp_path / "run", device="native", quiet=True)
    frames = RunFrames(tmp_path / "run")
    last = len(frames.times) - 1
    model = scene.build()
    voxels = frames.voxels((last - 1, last))
    before, after = voxels.u
    assert np.isfinite(after).all()
    assert np.abs(after - before).max() < 0.02 * np.abs(after).max()
    hands, feet = means(model, after)
    # Its hands are not alike; the figures of docs/scenes/armadillo.md.
    assert hands == pytest.approx([11.3e-3, 6.07e-3], rel=0.05)
    assert feet == pytest.approx([2.31e-3, 1.03e-3], rel=0.05)
    static = simulator_of(scene, model, "native")
    assert static.relax().converged
    off = np.abs(static.u - after).max() / np.abs(static.u).max()
    figure("end of the whole run against relaxation", off, at_most=0.02)
