"""Pictures of models and runs: what they show, not just that they are there."""

import json
import struct

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import tledface as tf
from test_build import MATERIAL, box, export
from tledface.cli import app
from tledface.cut_picture import cut_picture, section
from tledface.errors import InputError
from tledface.model_picture import boundary_picture, default_views, model_pictures, tissue_picture
from tledface.run import run_scene, save_built
from tledface.scene import Scene
from tledface.tissue_colours import NODE_COLOURS, node_kinds, tissue_colours
from tledface.voxel_view import VIEWS, VoxelView, opposite

SOFT = tf.material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)
STIFF = tf.material("neo_hookean", youngs_modulus=90e3, poissons_ratio=0.49, density=1100.0)


def pixels(path):
    from matplotlib.image import imread

    return imread(path)[..., :3]


def count(image, colour, tolerance=0.02):
    """Pixels of a colour, "#rrggbb"."""
    wanted = np.array([int(colour[n : n + 2], 16) / 255 for n in (1, 3, 5)])
    return int((np.abs(image - wanted) < tolerance).all(axis=2).sum())


@pytest.fixture
def layered():
    """A slab of two layers, 12 x 8 x 6 voxels of 1 mm, with a muscle in the lower one."""
    model = tf.Model.block((12, 8, 6), (12e-3, 8e-3, 6e-3), SOFT, tissue="fat")
    model.set_material(lambda c: c[:, 2] > 4e-3, STIFF, name="skin")
    model.set_material(lambda c: (c[:, 2] < 2e-3) & (c[:, 0] > 6e-3), SOFT, name="band")
    model.add_muscle(
        "band", lambda c: (c[:, 2] < 2e-3) & (c[:, 0] > 6e-3), (1, 0, 0), sigma_act=1e5
    )
    model.fix(lambda X: X[:, 0] < 1e-9)
    model.fix(lambda X: X[:, 0] > 11.9e-3, "x")
    floor = trimesh.creation.box(bounds=[[-1, -1, -1], [1, 1, 0]])
    model.slide(lambda X: (X[:, 2] < 1e-9) & (X[:, 0] > 1e-9), floor, "floor")
    return model


def test_a_view_shows_each_element_where_it_is(layered):
    """Colours by element: what a pixel shows is the nearest element along the view."""
    rng = np.random.default_rng(0)
    colours = rng.uniform(0.2, 1.0, (layered.n_elements, 3))
    for view, (direction, _) in VIEWS.items():
        sight = VoxelView(layered, view, (300, 300))
        image = sight.elements(colours)
        spots = rng.integers(0, sight.shape, (200, 2))
        centres = sight.project(layered.centres)
        half = 0.5 * layered.voxel[0] * sight.scale
        for row, column in spots:
            beneath = (np.abs(centres[:, :2] - [column, row]) < half - 1).all(axis=1)
            if not beneath.any():
                continue
            nearest = np.flatnonzero(beneath)[np.argmax(centres[beneath, 2])]
            assert image[row, column, 3] == 1.0
            shown = image[row, column, :3] / image[row, column, :3].sum()
            # Light changes the brightness, not the hue.
            if image[row, column, :3].max() < 1.0:
                np.testing.assert_allclose(shown, colours[nearest] / colours[nearest].sum())
        assert abs(np.asarray(direction) @ sight.axes[2] - 1.0) < 1e-12
        corners = [[0, 0, 0], [12e-3, 8e-3, 6e-3]]
        assert opposite(opposite(view)) == view and len(corners) == 2


def test_points_hide_behind_voxels(layered):
    sight = VoxelView(layered, "top", (300, 300))
    image = sight.elements(np.full((layered.n_elements, 3), 0.5))
    top, bottom = [6.2e-3, 4.2e-3, 6e-3], [3.2e-3, 4.2e-3, 0.0]
    red, blue = [1.0, 0, 0], [0, 0, 1.0]
    shown = sight.points(
        image, np.array([top, bottom]), np.array([red, blue]), radius=0.4, hidden=0.0
    )
    for point, colour, there in ((top, red, True), (bottom, blue, False)):
        column, row = np.rint(sight.project([point])[0, :2]).astype(int)
        assert (shown[row, column, :3] == colour).all() == there
    faint = sight.points(image, np.array([bottom]), np.array([blue]), radius=0.4, hidden=0.3)
    column, row = np.rint(sight.project([bottom])[0, :2]).astype(int)
    expected = 0.7 * image[row, column, :3] + 0.3 * np.array(blue)
    np.testing.assert_allclose(faint[row, column, :3], expected)


def test_pictures_show_tissues_nodes_and_muscles(layered, tmp_path):
    colours = tissue_colours(layered)
    assert len(set(colours.values())) == 3
    kinds = node_kinds(layered)
    assert {kind: int(where.sum()) for kind, where in kinds.items()} == {
        "held": 9 * 7, "sliding": 12 * 9, "partly held": 9 * 6
    }  # fmt: skip
    boundary = pixels(boundary_picture(tmp_path / "b.png", layered, view="top"))
    for kind in ("held", "sliding", "partly held"):
        assert count(boundary, NODE_COLOURS[kind]) > 400, kind
    assert count(boundary, NODE_COLOURS["ligament"]) == 0
    half = boundary.shape[1] // 2
    # The floor is seen from below only: right of the middle.
    body = boundary[60:-90]
    assert count(body[:, half:], NODE_COLOURS["sliding"]) > 20 * max(
        1, count(body[:, :half], NODE_COLOURS["sliding"])
    )
    tissue_picture(tmp_path / "t.png", layered, view="front")
    with pytest.raises(InputError, match="view: got 'up'; allowed: front"):
        tissue_picture(tmp_path / "t.png", layered, view="up")
    with pytest.raises(InputError, match=r"must end in \.png"):
        boundary_picture(tmp_path / "t.jpg", layered)


def test_a_cut_shows_its_own_layer(layered, tmp_path):
    colours = tissue_colours(layered)
    through = pixels(cut_picture(tmp_path / "x9.png", layered, "x", 9e-3))
    before = pixels(cut_picture(tmp_path / "x3.png", layered, "x", 3e-3))
    for image, has_muscle in ((through, True), (before, False)):
        body = image[: -int(0.2 * len(image))]
        # Two of six rows each are skin and, right of the middle, muscle.
        skin, muscle = count(body, colours["skin"]), count(body, colours["band"])
        assert skin > 5_000
        assert (0.7 < muscle / skin < 1.2) if has_muscle else muscle == 0
    for axis, at in (("y", 4e-3), ("z", 0.0), ("z", 6e-3), ("x", 12e-3)):
        cut_picture(tmp_path / "c.png", layered, axis, at)
    with pytest.raises(InputError, match=r"no voxel lies at x = 13 mm; the voxels span 0 to 12 mm"):
        cut_picture(tmp_path / "c.png", layered, "x", 13e-3)


def test_a_section_of_a_ball_is_a_circle():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=2.0)
    ends = section(np.asarray(ball.vertices), np.asarray(ball.faces), 2, 1.0)
    assert (ends[..., 2] == 1.0).all() or np.abs(ends[..., 2] - 1.0).max() < 1e-12
    radius = np.linalg.norm(ends[..., :2], axis=2)
    assert radius == pytest.approx(np.sqrt(3.0), rel=2e-3)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    assert length == pytest.approx(2 * np.pi * np.sqrt(3.0), rel=2e-3)
    # Through vertices: still one closed line.
    equator = section(np.asarray(ball.vertices), np.asarray(ball.faces), 2, 0.0)
    assert np.linalg.norm(equator[:, 1] - equator[:, 0], axis=1).sum() == pytest.approx(
        4 * np.pi, rel=2e-3
    )


def test_a_flat_body_is_shown_from_the_top_too(layered, tmp_path):
    flat = tf.Model.block((12, 12, 2), (12e-3, 12e-3, 2e-3), SOFT)
    assert default_views(flat) == ["front", "side", "top"]
    files = model_pictures(flat, tmp_path / "flat")
    names = sorted(path.name for path in files)
    assert names == sorted(
        [f"{kind}-{view}.png" for kind in ("tissues", "boundary") for view in default_views(flat)]
        + ["cut-x.png"]
    )
    assert sorted(path.name for path in (tmp_path / "flat").iterdir()) == names


# -- the command line ----------------------------------------------------------------------------


def scene_of(folder):
    export(box([0, 0, 0], [10, 8, 6]), folder / "skin.stl")
    export(box([2, 2, 1], [8, 6, 3]), folder / "muscle.obj")
    export(box([-1, -1, -3], [11, 9, 1]), folder / "bone.stl")
    return Scene.from_dict(
        {
            "schema": 1,
            "units": "mm",
            "geometry": {"skin": "skin.stl", "voxel": 1.0, "bones": ["bone.stl"],
                         "outer": [[[0, 0, 5.9], [10, 8, 6.1]]]},
            "layers": [{"name": "fat", "material": MATERIAL}],
            "muscles": [{"name": "band", "surfaces": ["muscle.obj"], "fibre": [1, 0, 0],
                         "sigma_act": "100 kPa", "material": MATERIAL, "activation": 0.5}],
            "surfaces": [{"name": "face", "file": "skin.stl"}],
            "boundary": {"fixed": [{"box": [[0, 0, 0], [0, 8, 6]]}]},
            "solver": {"duration": "0.5 ms"},
        },
        folder,
    )  # fmt: skip


def call(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_render_verb_draws_a_model(tmp_path):
    scene = scene_of(tmp_path)
    save_built(scene, scene.build(), tmp_path / "m.h5")
    options = ["--view", "top", "--cut", "y=4", "--cut", "x=0.2 cm", "--json"]
    result = call("render", tmp_path / "m.h5", "-o", tmp_path / "p", *options)
    assert result.exit_code == 0, result.output
    files = json.loads(result.stdout)["pictures"]
    names = [path.rpartition("/")[2] for path in files]
    assert names == ["tissues-top.png", "fibres-top.png", "boundary-top.png", "cut-y.png",
                     "cut-x.png"]  # fmt: skip
    for path in files:
        with open(path, "rb") as file:
            head = file.read(24)
        width, height = struct.unpack(">II", head[16:24])
        assert width >= 700 and height >= 300


def test_render_verb_draws_a_run(tmp_path):
    result = run_scene(scene_of(tmp_path), tmp_path / "run", device="native", quiet=True)
    assert (tmp_path / "run" / "face.obj").exists()
    assert result.files["surface face"].name == "face.obj"
    shown = call("render", tmp_path / "run", "-o", tmp_path / "p", "--quiet")
    assert shown.exit_code == 0, shown.output
    # The picture that the run itself made.
    np.testing.assert_array_equal(
        pixels(tmp_path / "p" / "skin.png"), pixels(tmp_path / "run" / "wrinkles.png")
    )
    shown = call(
        "render", tmp_path / "run", "-o", tmp_path / "p", "--view", "top", "--view", "front"
    )
    assert shown.exit_code == 0, shown.output
    assert (tmp_path / "p" / "skin-top.png").exists() and (
        tmp_path / "p" / "skin-front.png"
    ).exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["gone.h5"], "no such file"),
        (["empty"], "no run; give the folder of"),
        (["m.h5", "--view", "up"], "view: got 'up'; allowed: front"),
        (["m.h5", "--cut", "4"], "--cut: got '4'; allowed: an axis and a place"),
        (["m.h5", "--cut", "x=4 kg"], "--cut: got '4 kg'"),
        (["m.h5", "--cut", "x=400"], "no voxel lies at x = 400 mm"),
        (["empty", "--cut", "x=0"], "is a run's folder; add --stress"),
        (["m.h5", "-o", "none/p"], "there is no folder"),
        (["mesh.h5"], "the model is a conforming mesh; allowed: a model of voxels"),
        (["skin.stl"], "not an HDF5 file"),
        (["brow.toml"], "is a scene; `tledface build brow.toml -o MODEL.h5` makes a model"),
    ],
)
def test_render_refuses_in_one_line(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    scene = scene_of(tmp_path)
    model = scene.build()
    save_built(scene, model, tmp_path / "m.h5")
    model.as_hexahedra().save(tmp_path / "mesh.h5")
    (tmp_path / "empty").mkdir()
    output = [] if "-o" in arguments else ["-o", "p"]
    result = call("render", *arguments, *output)
    assert result.exit_code == 2, result.output
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1 and words in lines[0]


def test_check_and_build_say_what_binds_nodes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = scene_of(tmp_path)
    text = (
        'schema = 1\nunits = "mm"\n[geometry]\nskin = "skin.stl"\nbones = ["bone.stl"]\nvoxel = 1\n'
        "outer = [[[0, 0, 5.9], [10, 8, 6.1]]]\n[[layers]]\n"
        'name = "fat"\nmaterial = { model = "neo_hookean", youngs_modulus = "50 kPa", '
        'poissons_ratio = 0.49, density = 1000 }\n[boundary]\nsliding = ["bones"]\n'
        "fixed = [{ box = [[-inf, -inf, -inf], [0, inf, inf]] }]\n"
        'ligaments = [{ name = "stay", points = [[0, 4, 3], [3, 4, 3]], radius = 1 }]\n'
        '[solver]\nduration = "1 ms"\n'
    )
    (tmp_path / "s.toml").write_text(text)
    assert scene.boundary.sliding is None
    built = call("build", "s.toml", "-o", "s.h5", "--json")
    assert built.exit_code == 0, built.output
    boundary = json.loads(built.stdout)["boundary"]
    assert boundary["sliding_nodes"] == 10 * 9
    named = {(g["kind"], g["name"]): g["nodes"] for g in boundary["groups"]}
    assert named["sliding", "bone"] == 90 and named["fixed", "fixed[0]"] == 6 * 9
    twice = {(e["first"], e["second"]): e["nodes"] for e in boundary["bound_twice"]}
    assert twice == {("fixed[0]", "sliding"): 9, ("fixed[0]", "ligament stay"): 5}
    for source in ("s.toml", "s.h5"):
        checked = call("check", source, "--device", "native")
        assert checked.exit_code == 0, checked.output
        assert f"{source}: valid" in checked.stdout
        assert "90 sliding" in checked.stdout and "bone: 90 nodes (sliding)" in checked.stdout
        assert "9 nodes bound twice, by fixed[0] and sliding: rigid" in checked.stdout
        assert "skin " in checked.stdout
    run = call("run", "s.h5", "-o", "out", "--device", "native", "--quiet")
    assert run.exit_code == 0, run.output


def test_help_lists_every_view():
    text = " ".join(CliRunner().invoke(app, ["render", "--help"]).stdout.replace("│", " ").split())
    assert f"front (from -y, +z up), back, side (from +x), {', '.join(list(VIEWS)[3:])};" in text
