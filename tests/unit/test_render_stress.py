"""Stress of a run: what frames hold of it, and what the pictures show."""

import json
import subprocess
import sys

import h5py
import numpy as np
import pytest

import tledface as tf
from test_render import call, count, pixels, scene_of
from tledface.errors import InputError
from tledface.run import run_scene
from tledface.run_frames import RunFrames
from tledface.simulator import Simulator
from tledface.stress_picture import (
    SurfaceStress,
    VoxelStress,
    _Scale,
    cut_stress_panels,
    cut_stress_picture,
    skin_stress_panels,
    skin_stress_picture,
)
from tledface.surface import BoundSurface, boundary_surface

SOFT = tf.material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)


def sheet(model, z, n=9):
    """A square grid of vertices over the model at a height."""
    size = model.nodes.max(axis=0)
    x, y = np.meshgrid(np.linspace(0, size[0], n), np.linspace(0, size[1], n))
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1)
    lower = np.stack([corner, corner + 1, corner + n + 1], axis=1)
    upper = np.stack([corner, corner + n + 1, corner + n], axis=1)
    points = np.stack([x, y, np.full_like(x, z)], axis=-1).reshape(-1, 3)
    return points, np.concatenate([lower, upper])


def bluish(image):
    return int((image[..., 2] - image[..., 0] > 0.3).sum())


def hex_of(colour):
    return "#" + "".join(f"{round(255 * part):02x}" for part in colour)


def test_stress_of_elements_is_carried_to_the_surface_above_them():
    model = tf.Model.block((8, 6, 3), (8e-3, 6e-3, 3e-3), SOFT)
    points, faces = sheet(model, 3.2e-3)
    skin = BoundSurface.on(model, points, faces)
    x, _, z = model.centres.T
    # Only the upper layer counts, and what is linear along it stays so, but at its ends.
    found = skin.of_elements(np.where(z > 2e-3, 1e6 * x, 1e9))
    inner = (points[:, 0] > 0.9e-3) & (points[:, 0] < 7.1e-3)
    np.testing.assert_allclose(found[inner], 1e6 * points[inner, 0], rtol=1e-12)
    np.testing.assert_allclose(found[points[:, 0] == 0.0], 0.5e3, rtol=1e-12)
    # Beside the body the value of its edge, not what a line through the last two would give.
    beside = BoundSurface.on(model, np.add(points, (1e-3, 0.0, 0.0)), faces)
    found = beside.of_elements(1e6 * x)
    np.testing.assert_allclose(found[points[:, 0] > 7.9e-3], 7.5e3, rtol=1e-12)
    far = BoundSurface.on(model, points + [0, 0, 1e-3] * (points[:, :1] > 4e-3), faces, reach=5e-4)
    beyond = points[:, 0] > 4e-3
    assert np.isnan(far.of_elements(x)[beyond]).all() and np.isfinite(far.of_elements(x)).any()
    with pytest.raises(InputError, match=r"element field: got shape \(3,\)"):
        skin.of_elements(np.zeros(3))


def test_von_mises_is_that_of_the_deviator():
    model = tf.Model.block((2, 2, 2), (2e-3, 2e-3, 2e-3), SOFT)
    sim = Simulator(model, device="native", precision="double")
    gradient = np.array([[0.1, 0.05, 0.0], [0.0, -0.08, 0.2], [0.02, 0.0, 0.03]])
    sim.set_state(model.nodes @ gradient.T)
    xx, yy, zz, xy, yz, xz = sim.stress()[0]
    sigma = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    a, b, c = np.linalg.eigvalsh(sigma)
    expected = np.sqrt(0.5 * ((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2))
    assert expected > 1e3
    np.testing.assert_allclose(sim.von_mises(), expected, rtol=1e-10)


def test_the_scale_ends_at_a_percentile_and_has_even_colours():
    drawn = np.append(np.linspace(0.0, 50e3, 1000), 9e6)
    scale = _Scale([np.zeros(5000), drawn])
    assert scale.limit == pytest.approx(np.percentile(drawn, 98.0))
    assert scale.text() == "the scale ends at the 98th percentile, 49 kPa (greatest 9000 kPa)"
    # Lightness falls all the way, in steps that differ by less than a factor of four.
    colours = scale.paint(np.linspace(0.0, scale.limit, 65))
    light = np.cbrt(colours**2.2 @ [0.2126, 0.7152, 0.0722])
    steps = -np.diff(light)
    assert (steps > 0.0).all() and steps.max() < 4 * steps.min()
    np.testing.assert_array_equal(scale.paint(np.array([9e6])), colours[-1:])
    np.testing.assert_array_equal(scale.paint(np.array([np.nan])), [[0.75, 0.75, 0.75]])
    for top, unit in ((3.0, "Pa"), (2e6, "MPa")):
        assert _Scale([np.full(4, top)]).unit == unit
    # An end that is given holds for all, and each panel then says how far its stress goes.
    given = _Scale([np.zeros(5000), drawn], 25e3)
    assert given.text() == "the scale ends at 25 kPa (greatest 9000 kPa)"
    np.testing.assert_array_equal(given.paint(np.array([25e3, 9e6])), colours[[-1, -1]])
    assert given.named(["a", "b"]) == [("a", "no stress"), ("b", "98 % below 49 kPa")]
    assert scale.named(["a", "b"]) == [("a", ""), ("b", "")]
    still = _Scale([np.zeros(9)])
    assert "0 Pa" in still.text() and np.isfinite(still.paint(np.zeros(1))).all()


def test_a_stressed_surface_has_its_colours(tmp_path):
    model = tf.Model.block((8, 8, 2), (8e-3, 8e-3, 2e-3), SOFT)
    points, faces = sheet(model, 2e-3, 33)
    stress = np.where(points[:, 0] > 4e-3, 30e3, 0.0)
    states = (points, points)
    path = skin_stress_picture(
        tmp_path / "s.png", states, faces, (0.0 * stress, stress), view="top"
    )
    image = pixels(path)
    height, width = image.shape[:2]
    middle = image[height // 2]

    def hue(column):
        return middle[column] / middle[column].sum()

    ends = _Scale([stress]).paint(np.array([0.0, 30e3]))
    none, full = ends**1.0 / ends.sum(axis=1, keepdims=True)
    # The light on a level sheet changes brightness alone.
    for share, wanted in ((0.15, none), (0.35, none), (0.65, none), (0.9, full)):
        np.testing.assert_allclose(hue(int(share * width)), wanted, atol=0.02)
    with pytest.raises(InputError, match=r"stress has shape \(3,\)"):
        skin_stress_picture(tmp_path / "s.png", states, faces, (stress, np.zeros(3)))
    with pytest.raises(InputError, match=r"must end in \.png"):
        skin_stress_picture(tmp_path / "s.jpg", states, faces, (stress, stress))


def test_a_cut_shows_the_stress_of_its_layer_where_it_is(tmp_path):
    model = tf.Model.block((12, 8, 6), (12e-3, 8e-3, 6e-3), SOFT)
    here = (model.centres[:, 0] > 7e-3) & (model.centres[:, 0] < 8e-3)
    # One column of voxels under stress, in the layer at y = 2.5 mm only.
    stressed = here & (np.abs(model.centres[:, 1] - 2.5e-3) < 1e-4)
    u = np.zeros_like(model.nodes)
    u[:, 0] = 0.5 * model.nodes[:, 0]

    def voxels(muscle):
        stress = np.where(stressed, 50e3, 0.0)
        return VoxelStress(
            model.nodes, model.elements, (0.0 * u, u), (0.0 * stress, stress), muscle
        )

    none = np.zeros(model.n_elements, dtype=bool)
    top = hex_of(_Scale([np.full(3, 50e3)]).paint(np.array([50e3]))[0])
    path = tmp_path / "c.png"
    image = pixels(cut_stress_picture(path, voxels(none), "y", 2.5e-3))
    assert bluish(image) == 0
    body = image[: -130 if len(image) > 130 else None]
    mark = (np.abs(body - np.array([int(top[n : n + 2], 16) / 255 for n in (1, 3, 5)])) < 0.02).all(
        axis=2
    )
    columns = np.flatnonzero(mark.any(axis=0))
    # After the stretch the column is 7 to 8 of 12 parts from the left, 1.5 mm of 18 wide.
    left = 30 + (body.shape[1] - 60) * np.array([7 / 12, 8 / 12])
    assert columns.min() == pytest.approx(left[0], abs=4)
    assert columns.max() == pytest.approx(left[1], abs=4)
    assert (
        count(pixels(cut_stress_picture(path, voxels(none), "y", 3.5e-3)), top)
        < count(image, top) // 3
    )
    assert bluish(pixels(cut_stress_picture(path, voxels(here), "y", 2.5e-3))) > 1000
    for axis in "xyz":
        cut_stress_picture(path, voxels(here), axis)
        cut_stress_picture(path, voxels(here), axis, model.nodes.max(axis=0)["xyz".index(axis)])
    with pytest.raises(InputError, match="no voxel lies at x = 13 mm; the voxels span 0 to 12 mm"):
        cut_stress_picture(path, voxels(none), "x", 13e-3)
    with pytest.raises(InputError, match="got axis 'w'"):
        cut_stress_picture(path, voxels(none), "w")


def colour_at(image, row, column):
    """The colour in the middle of a panel, whatever its brightness."""
    colour = image[round(row), round(column)]
    return colour / colour.sum()


def test_the_bar_of_a_narrow_picture_has_its_unit(tmp_path, monkeypatch):
    model = tf.Model.block((4, 4, 12), (4e-3, 4e-3, 12e-3), SOFT)
    rest, stress = np.zeros_like(model.nodes), np.full(model.n_elements, 5e3)
    none = np.zeros(model.n_elements, dtype=bool)
    figures = []
    monkeypatch.setattr(
        "tledface.stress_picture._save", lambda figure, path: figures.append(figure)
    )
    voxels = VoxelStress(model.nodes, model.elements, (rest, rest), (stress, stress), none)
    cut_stress_picture(tmp_path / "c.png", voxels, "y", 1.5e-3)
    (figure,) = figures
    assert figure.get_size_inches()[0] == 7.6
    (unit,) = (text for text in figure.texts if text.get_text() == "kPa")
    end = unit.get_window_extent()
    assert figure.axes[-1].get_window_extent().x1 + 5 < end.x0 and end.x1 < 755


def test_panels_of_several_surfaces_have_one_scale(tmp_path):
    model = tf.Model.block((8, 8, 2), (8e-3, 8e-3, 2e-3), SOFT)
    points, faces = sheet(model, 2e-3)
    stresses = np.array([0.0, 10e3, 20e3, 5e6])
    states = [
        # Each surface may have triangles of its own.
        SurfaceStress(points, faces[number % 2 :], np.full(len(points), stress))
        for number, stress in enumerate(stresses)
    ]
    options = {"view": "top", "columns": 3, "size": (200, 200), "limit": 20e3}
    path = skin_stress_panels(tmp_path / "s.png", states, labels="abcd", **options)
    image = pixels(path)
    # Three panels of 200 pixels and one below the first, with 30 between and 104 above.
    assert image.shape[:2] == (104 + 200 + 68 + 200 + 128, 760)
    colours = _Scale([stresses], 20e3).paint(stresses)
    places = [(204, 130), (204, 360), (204, 590), (472, 130)]
    for place, colour in zip(places, colours, strict=True):
        np.testing.assert_allclose(colour_at(image, *place), colour / colour.sum(), atol=0.02)
    assert (image[400:560, 240:] == 1.0).all()
    with pytest.raises(InputError, match="got 3 labels, need 4"):
        skin_stress_panels(tmp_path / "s.png", states, labels="abc", **options)


def test_panels_of_several_bodies_are_cut_at_one_place(tmp_path):
    bodies, stresses = [], []
    # Bodies may have other voxels, and several states.
    for n, some in ((4, (0.0, 10e3)), (8, (20e3,)), (4, (5e6,))):
        model = tf.Model.block((n, n, n), (8e-3, 8e-3, 8e-3), SOFT)
        still, no_muscle = np.zeros_like(model.nodes), np.zeros(model.n_elements, dtype=bool)
        layer = np.abs(model.centres[:, 0] - 2e-3) <= 0.5 * model.voxel[0] + 1e-9
        fields = tuple(np.where(layer, stress, 0.0) for stress in some)
        u = (still,) * len(some)
        bodies.append(VoxelStress(model.nodes, model.elements, u, fields, no_muscle))
        stresses += some
    options = {"columns": 4, "size": (160, 160), "limit": 20e3}
    path = cut_stress_panels(tmp_path / "c.png", bodies, "x", 2.1e-3, labels="abcd", **options)
    image = pixels(path)
    assert image.shape[:2] == (104 + 160 + 128, 30 + 4 * 190)
    for number, colour in enumerate(_Scale([np.array(stresses)], 20e3).paint(np.array(stresses))):
        found = colour_at(image, 184, 110 + 190 * number)
        np.testing.assert_allclose(found, colour / colour.sum(), atol=0.02)
    with pytest.raises(InputError, match="got 2 labels, need 4"):
        cut_stress_panels(tmp_path / "c.png", bodies, "x", labels="ab", **options)


# -- a run ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stress")
    scene = scene_of(folder)
    tables = {**scene.source, "output": {"fps": 4000}}
    scene = tf.Scene.from_dict(tables, folder)
    run_scene(scene, folder / "run", device="native", quiet=True)
    return scene, folder / "run"


def test_frames_hold_the_stress_of_their_moment(run):
    scene, folder = run
    model = scene.build()
    frames = RunFrames(folder)
    assert frames.times == pytest.approx([0.0, 0.25e-3, 0.5e-3], abs=2e-5)
    pair = (0, frames.at(None))
    voxels = frames.voxels(pair)
    sim = Simulator(model, device="native", precision="double")
    sim.activate("band", 0.5)
    sim.set_state(voxels.u[1])
    assert sim.von_mises().max() > 10e3
    np.testing.assert_allclose(voxels.stress[1], sim.von_mises(), rtol=1e-3, atol=5.0)
    skin = model.surfaces["skin"].of_elements(voxels.stress[1])
    np.testing.assert_allclose(frames.surface_stress(pair)[1], skin, rtol=1e-5, atol=1e-2)
    assert voxels.muscle.sum() == 6 * 4 * 2
    assert frames.at(0.2e-3) == 1
    before, after, faces = frames.surface(pair)
    assert np.abs(after - before).max() > 1e-7 and faces.max() < len(before)


def test_render_verb_draws_stress(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, folder = run
    result = call("render", folder, "-o", "p", "--stress", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["pictures"] == ["p/stress.png", "p/stress-cut-x.png"]
    options = ["--view", "-y", "--view", "0.3,-1,0.5", "--at", "0.25 ms", "--cut", "y=4",
               "--cut", "y=5"]  # fmt: skip
    result = call("render", folder, "-o", "p", "--stress", "--json", *options)
    assert result.exit_code == 0, result.output
    names = [name.rpartition("/")[2] for name in json.loads(result.stdout)["pictures"]]
    assert names == ["stress--y.png", "stress-0.3_-1_0.5.png", "stress-cut-y-1.png",
                     "stress-cut-y-2.png"]  # fmt: skip
    # An earlier frame is another picture, of the skin too.
    for more, name in (([], "late"), (["--at", "250 us"], "early")):
        assert call("render", folder, "-o", name, *more).exit_code == 0
    late, early = pixels("late/skin.png"), pixels("early/skin.png")
    assert late.shape != early.shape or (late != early).any()


def test_a_run_without_muscles_is_drawn_without_a_profile(run, tmp_path):
    scene, folder = run
    still = {**scene.source, "muscles": []}
    still["geometry"] = {**still["geometry"], "outer": "all"}
    still["solver"] = {**still["solver"], "gravity": [0, 0, "-9.81 m/s^2"]}
    scene = tf.Scene.from_dict(still, folder.parent)
    run_scene(scene, tmp_path / "run", device="native", quiet=True)
    assert call("render", tmp_path / "run", "-o", tmp_path / "p").exit_code == 0
    own = pixels(tmp_path / "run" / "wrinkles.png")
    np.testing.assert_array_equal(pixels(tmp_path / "p" / "skin.png"), own)
    assert len(own) < len(pixels(folder / "wrinkles.png")) - 250


def test_render_draws_the_stress_of_a_run_that_was_killed(run, tmp_path):
    _, folder = run
    killed = tmp_path / "killed"
    killed.mkdir()
    (killed / "run.json").write_bytes((folder / "run.json").read_bytes())
    for stem in ("frames", "frames_surface"):
        (killed / f"{stem}.part.vtkhdf").write_bytes((folder / f"{stem}.vtkhdf").read_bytes())
    assert call("render", killed, "-o", tmp_path / "p", "--stress").exit_code == 0
    # And of one that goes on: its writer holds the file.
    code = "import h5py, sys; f = h5py.File(sys.argv[1], 'r+'); print(1, flush=True); input()"
    writer = subprocess.Popen(
        [sys.executable, "-c", code, killed / "frames.part.vtkhdf"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    assert writer.stdout.readline() == b"1\n"
    result = call("render", killed, "-o", tmp_path / "q", "--stress")
    writer.communicate(b"\n")
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--cut", "x=0"], "add --stress for the stress in the cut"),
        (["--stress", "--cut", "x=400"], "no voxel lies at x = 400 mm"),
        (["--stress", "--at", "2 ms"], "--at: got 2 ms; the frames of run span 0 to 0.5"),
        (["--at", "2"], "--at: unit missing: got '2'"),
        (["--view", "up"], "allowed: front, back, side, other side, top, bottom, oblique, a side"),
        (["--view", "0,0,0"], "three numbers as 0.3,-1,0.2"),
        (["--view", "*y"], "view: got '*y'"),
    ],
)
def test_render_of_a_run_refuses_in_one_line(run, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(run[1].parent)
    result = call("render", "run", "-o", tmp_path / "p", *options)
    assert result.exit_code == 2, result.output
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1 and words in lines[0], lines
    assert not (tmp_path / "p").exists() or not list((tmp_path / "p").glob("skin*"))


def test_frames_without_stress_and_models_say_so(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, folder = run
    old = tmp_path / "old"
    old.mkdir()
    (old / "run.json").write_bytes((folder / "run.json").read_bytes())
    for name in ("frames.vtkhdf", "frames_surface.vtkhdf"):
        (old / name).write_bytes((folder / name).read_bytes())
        with h5py.File(old / name, "r+") as file:
            for group in ("PointData", "CellData"):
                if "von_mises" in file["VTKHDF"][group]:
                    del file["VTKHDF"][group]["von_mises"]
    model = tf.Model.block((2, 2, 2), (2e-3, 2e-3, 2e-3), SOFT)
    model.surfaces["skin"] = boundary_surface(model)
    model.save(tmp_path / "m.h5")
    for source, option, words in (
        ("old", "--stress", "its frames hold no stress"),
        ("m.h5", "--stress", "--stress: m.h5 is not the folder of a run"),
        ("m.h5", "--at=1 ms", "--at: m.h5 is not the folder of a run"),
    ):
        result = call("render", source, "-o", "p", option)
        assert result.exit_code == 2 and words in result.stderr, result.output
        assert len(result.stderr.strip().splitlines()) == 1
    assert call("render", "old", "-o", "p").exit_code == 0
