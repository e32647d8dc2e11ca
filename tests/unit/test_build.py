"""Scenes built into models: the flat block, errors, muscles, held nodes, real anatomy."""

import re
import time
import warnings

import numpy as np
import pytest
import trimesh

from tledface.build import BuildWarning, build_model
from tledface.errors import InputError
from tledface.examples import flat_block
from tledface.geometry import long_axes, read_surface
from tledface.run import run_scene
from tledface.run_picture import run_pictures
from tledface.scene import Scene

MATERIAL = {
    "model": "neo_hookean",
    "youngs_modulus": "50 kPa",
    "poissons_ratio": 0.49,
    "density": "1000 kg/m^3",
}


def export(mesh, path):
    mesh.export(path)
    return path.name


def box(low, high):
    return trimesh.creation.box(bounds=[low, high])


def tables(folder, **changes):
    """A 10 x 8 x 6 mm block with one muscle in it."""
    export(box([0, 0, 0], [10, 8, 6]), folder / "skin.stl")
    export(box([2, 2, 1], [8, 6, 3]), folder / "muscle.obj")
    scene = {
        "schema": 1,
        "units": "mm",
        "geometry": {"skin": "skin.stl", "voxel": 1.0},
        "layers": [
            {"name": "dermis", "thickness": 1.5, "material": MATERIAL},
            {"name": "fat", "material": MATERIAL | {"youngs_modulus": "10 kPa"}},
        ],
        "muscles": [
            {
                "name": "band",
                "surfaces": ["muscle.obj"],
                "fibre": [2, 0, 0],
                "sigma_act": "5 MPa",
                "material": MATERIAL,
            }
        ],
        "solver": {"duration": "1 ms", "gravity": [0, 0, "-9.81 m/s^2"]},
    }
    for key, value in changes.items():
        scene[key] = scene[key] | value if isinstance(scene.get(key), dict) else value
    return scene


def build(folder, **changes):
    return build_model(Scene.from_dict(tables(folder, **changes), folder))


def test_block_scene(tmp_path):
    held = {"box": [[-1, -1, -1], [0, 9, 7]], "components": "xy"}
    model = build(tmp_path, boundary={"fixed": [held]})
    assert model.n_elements == 480
    assert model.tissues == ["dermis", "fat", "band"]
    np.testing.assert_allclose(model.voxel, 1e-3)
    np.testing.assert_allclose(model.nodes.max(axis=0), [0.010, 0.008, 0.006])
    (muscle,) = model.muscles
    assert len(muscle.elements) == 6 * 4 * 2
    np.testing.assert_allclose(muscle.weight, 1.0)
    np.testing.assert_array_equal(muscle.fibre, np.tile([1.0, 0, 0], (48, 1)))
    assert muscle.sigma_pas == muscle.sigma_act == 5e6
    at_wall = np.abs(model.nodes[:, 0]) < 1e-9
    np.testing.assert_array_equal(model.fixed[:, 0], at_wall)
    assert not model.fixed[:, 2].any()
    assert model.gravity[2] == pytest.approx(-9.81)
    assert model.report["elements"] == 480
    assert model.report["muscle_elements"] == {"band": 48}
    skin = model.surfaces["skin"]
    np.testing.assert_allclose(skin.displaced(np.zeros_like(model.nodes)), skin.vertices)
    shear = model.nodes * [[2.0, 0.5, -1.0]] + [1, 2, 3]
    np.testing.assert_allclose(
        skin.displaced(shear), skin.vertices * [[3, 1.5, 0]] + [1, 2, 3], atol=1e-12
    )


def test_layers_blend_when_asked(tmp_path):
    assert build(tmp_path).section_ratio is not None
    assert build(tmp_path, layer_bending="blended").section_ratio is None


def test_flat_block(tmp_path):
    start = time.perf_counter()
    model = Scene.load(flat_block.write(tmp_path)).build()
    assert time.perf_counter() - start < 30
    assert (model.n_elements, model.n_nodes) == (129_600, 146_410)
    height = model.cells[:, 2]
    np.testing.assert_allclose(model.fractions[height == 8, 0], 0.04, atol=1e-12)
    np.testing.assert_allclose(model.fractions[height == 6, 1], 1.0, atol=1e-12)
    np.testing.assert_allclose(model.fractions[height == 5, 1], 0.64, atol=1e-12)
    (muscle,) = model.muscles
    assert set(height[muscle.elements].tolist()) == {1, 2}
    np.testing.assert_allclose(muscle.weight, 1.0)
    assert model.fixed[np.abs(model.nodes[:, 2]) < 1e-9, 2].all()
    np.testing.assert_array_equal(model.fixed.sum(axis=0), [0, 0, 121 * 121])
    skin = model.surfaces["skin"]
    assert np.count_nonzero(skin.vertices[:, 2] > 4.49e-3) == 121 * 121
    mesh = trimesh.Trimesh(skin.vertices, skin.faces, process=False)
    assert mesh.is_watertight and mesh.volume == pytest.approx(60 * 60 * 4.5e-9)


def test_flat_block_of_one_material(tmp_path):
    path = flat_block.write(tmp_path, single_material=True, voxel=1.5, triangle=3)
    model = Scene.load(path).build()
    assert model.tissues == ["skin", "frontalis"]
    np.testing.assert_allclose(model.voxel, 1.5e-3)
    with pytest.raises(InputError, match="voxel: got 0"):
        flat_block.write(tmp_path, voxel=0)


def test_long_axis_of_tilted_muscles(tmp_path):
    skin = box([-30, -30, -30], [30, 30, 30])
    export(skin, tmp_path / "skin.stl")
    axes = np.array([[0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]])
    for number, axis in enumerate(axes):
        rod = trimesh.creation.cylinder(2.0, 20.0)
        rod.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], axis if number else -axis))
        rod.apply_translation([-15 + 30 * number, 0, 0])
        export(rod, tmp_path / f"rod{number}.stl")
    spec = tables(tmp_path)["muscles"][0] | {
        "surfaces": ["rod0.stl", "rod1.stl"],
        "fibre": "long-axis",
    }
    export(skin, tmp_path / "skin.stl")
    scene = tables(tmp_path, muscles=[spec], geometry={"voxel": 2.0})
    export(skin, tmp_path / "skin.stl")
    model = build_model(Scene.from_dict(scene, tmp_path))
    (muscle,) = model.muscles
    right = (model.centres[muscle.elements, 0] > 0).astype(int)
    np.testing.assert_allclose(muscle.fibre, axes[right], atol=1e-3)
    assert 0 < muscle.weight.min() <= muscle.weight.max() <= 1


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "off"])
def test_formats_give_the_same_volume(tmp_path, ending):
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=10.0)
    path = tmp_path / f"ball.{ending}"
    mesh.export(path)
    surface = read_surface(path, unit_scale=1e-3)
    assert surface.solid.volume == pytest.approx(mesh.volume * 1e-9, rel=1e-5)
    assert len(surface.vertices) == len(mesh.vertices)
    np.testing.assert_allclose(surface.bounds, mesh.bounds * 1e-3, rtol=1e-5)
    assert np.abs(long_axes([surface.solid])).max() <= 1.0


def refused(folder, pattern, **changes):
    with pytest.raises(InputError, match=pattern) as caught:
        build(folder, **changes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_unusable_files_are_one_clear_line(tmp_path):
    contents = {
        "empty.stl": b"",
        "noise.stl": b"not a surface at all",
        "noise.ply": b"ply\nformat ascii 1.0\nelement vertex nonsense\n",
        "points.obj": b"v 0 0 0\nv 1 0 0\n",
        "cloud.xyz": b"0 0 0\n",
    }
    for name, data in contents.items():
        (tmp_path / name).write_bytes(data)
        refused(tmp_path, re.escape(name), geometry={"skin": name})
    with pytest.raises(InputError, match=r"gone\.stl: no such surface file"):
        read_surface(tmp_path / "gone.stl")
    with pytest.raises(InputError, match="is not a file"):
        read_surface(tmp_path)


def test_nan_vertex_and_open_mesh_name_the_file(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    text = trimesh.exchange.obj.export_obj(ball)
    lines = text.splitlines()
    third = [number for number, line in enumerate(lines) if line.startswith("v ")][2]
    lines[third] = "v nan 0 0"
    (tmp_path / "nan.obj").write_text("\n".join(lines))
    refused(tmp_path, r"nan\.obj: vertex 2 is \(nan, 0, 0\) m", geometry={"skin": "nan.obj"})
    lower = ball.faces[ball.triangles_center[:, 2] < 2]
    half = trimesh.Trimesh(ball.vertices, lower, process=False)
    export(half, tmp_path / "half.ply")
    text = refused(tmp_path, r"half\.ply: the surface is open", geometry={"skin": "half.ply"})
    assert "open edges in 1 hole" in text and "mm around" in text


def test_muscle_outside_the_tissue_is_refused(tmp_path):
    scene = tables(tmp_path)
    export(box([20, 20, 20], [22, 22, 22]), tmp_path / "muscle.obj")
    with pytest.raises(InputError, match=r"muscle 'band': no voxel holds any of .*muscle\.obj"):
        build_model(Scene.from_dict(scene, tmp_path))


def test_fixed_box_without_nodes_warns(tmp_path):
    scene = tables(tmp_path, boundary={"fixed": [{"box": [[50, 50, 50], [51, 51, 51]]}]})
    with pytest.warns(BuildWarning, match=r"boundary\.fixed\[0\]: no node lies in the box"):
        model = build_model(Scene.from_dict(scene, tmp_path))
    assert len(model.report["warnings"]) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert build(tmp_path).report["warnings"] == []


def test_a_skin_of_which_no_face_moves_is_told_and_the_run_comes_to_its_end(tmp_path):
    scene = tables(
        tmp_path,
        geometry={"region": [[25, -1, -1], [35, 9, 7]]},
        solver={"gravity": [0, 0, 0]},
    )
    export(box([0, 0, 0], [60, 8, 6]), tmp_path / "skin.stl")
    export(box([26, 2, 1], [34, 6, 3]), tmp_path / "muscle.obj")
    scene["muscles"][0]["activation"] = 0.1
    loaded = Scene.from_dict(scene, tmp_path)
    message = (
        r"skin .*skin\.stl: none of its 12 faces has all its corners within 3 mm of the tissue"
    )
    with pytest.warns(BuildWarning, match=message) as told:
        result = run_scene(loaded, tmp_path / "out", device="native", quiet=True)
    assert len(told) == 1
    assert result.files["picture"].stat().st_size > 0
    assert result.folds is None
    with pytest.raises(InputError, match="no face of its skin moves with the tissue; divide"):
        run_pictures(tmp_path / "out", tmp_path / "pictures")


def test_forehead_from_anatomy(shared_data, tmp_path):
    anatomy = shared_data / "bodyparts3d"
    muscle = tables(tmp_path)["muscles"][0] | {
        "name": "frontalis",
        "surfaces": [str(anatomy / f"FMA{number}.obj") for number in (46759, 46760)],
        "fibre": "long-axis",
    }
    geometry = {
        "skin": str(anatomy / "derived_skin_closed.ply"),
        "bones": [str(anatomy / "FMA52734.obj")],
        "voxel": 1.0,
        "depth": 6.0,
        "region": [[-50, -200, 1535], [50, -135, 1610]],
    }
    thin = {"name": "corneum", "thickness": 0.02, "material": MATERIAL}
    layers = [thin, *tables(tmp_path)["layers"]]
    start = time.perf_counter()
    model = build(tmp_path, geometry=geometry, muscles=[muscle], layers=layers)
    assert time.perf_counter() - start < 60
    assert 40_000 < model.n_elements < 90_000
    (frontalis,) = model.muscles
    # The two muscles' volumes, bone side included, are 15 963 mm3.
    assert 12_000 < frontalis.weight.sum() < 17_000
    assert np.isfinite(model.section_ratio).all()
    depth_per_area = model.fractions[:, 0].sum() * 1e-9
    skin = model.surfaces["skin"]
    area = trimesh.Trimesh(skin.vertices, skin.bound_faces, process=False).area
    assert depth_per_area / area == pytest.approx(2e-5, rel=0.35)
