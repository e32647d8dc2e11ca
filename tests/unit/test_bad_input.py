"""Bad input through the real command line: one clear line, exit code 2, nothing written."""

import tomllib

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from tledface.examples import flat_block


@pytest.fixture
def scene(tmp_path):
    """A small valid scene: a block of 10 x 8 x 6 mm with a muscle in it."""
    trimesh.creation.box(bounds=[[0, 0, 0], [10, 8, 6]]).export(tmp_path / "skin.stl")
    trimesh.creation.box(bounds=[[2, 2, 1], [8, 6, 3]]).export(tmp_path / "muscle.stl")
    text = flat_block.write(tmp_path / "template").read_text()
    text = text.replace("frontalis.stl", "muscle.stl").replace(
        "voxel = [0.5, 0.5, 0.5]", "voxel = 1"
    )
    start = text.index("outer =")
    text = text[:start] + text[text.index("\n", start) + 1 :]
    path = tmp_path / "scene.toml"
    path.write_text(text.replace('duration = "50 ms"', 'duration = "0.5 ms"'))
    tomllib.loads(path.read_text())
    return path


def refuse(scene, *arguments, verb="run"):
    from tledface.cli import app

    out = scene.parent / "out"
    output = ["-o", str(out)] if verb == "run" else []
    result = CliRunner().invoke(app, [verb, str(scene), *output, "--quiet", *arguments])
    lines = result.stderr.strip().splitlines()
    assert result.exit_code == 2, result.output
    assert len(lines) == 1, lines
    assert lines[0].startswith("tledface: error: ")
    assert not out.exists()
    return lines[0]


def edit(scene, old, new):
    text = scene.read_text()
    assert old in text
    scene.write_text(text.replace(old, new, 1))


def test_the_scene_itself_runs(scene):
    from tledface.cli import app

    out = scene.parent / "out"
    result = CliRunner().invoke(app, ["run", str(scene), "-o", str(out), "--quiet"])
    assert result.exit_code == 0, result.output
    assert (out / "frames.vtkhdf").exists()


def test_check_says_how_large_the_body_is(scene):
    from tledface.cli import app

    result = CliRunner().invoke(app, ["check", str(scene), "--device", "native"])
    assert result.exit_code == 0, result.output
    assert "size       10 x 8 x 6 mm, in voxels of 1 x 1 x 1 mm" in result.stdout.splitlines()


def test_missing_mesh(scene):
    edit(scene, "muscle.stl", "frontal.stl")
    assert "frontal.stl" in refuse(scene)


def test_a_mesh_that_is_a_folder(scene):
    (scene.parent / "skin.stl").unlink()
    (scene.parent / "skin.stl").mkdir()
    line = refuse(scene, verb="check")
    assert "geometry.skin: got " in line
    assert 'skin.stl", which is a folder; allowed: a surface file' in line
    assert "nearest" not in line


def test_a_skin_in_other_units(scene):
    trimesh.creation.box(bounds=[[0, 0, 0], [0.01, 0.008, 0.006]]).export(scene.parent / "skin.stl")
    line = refuse(scene, verb="check")
    assert "the skin measures 0.01 x 0.008 x 0.006 mm: check units" in line


def test_a_model_of_another_format(scene):
    np.savez(scene.parent / "m.npz", a=np.zeros(3))
    line = refuse(scene.parent / "m.npz")
    assert "cannot be read as text; allowed: a scene file (.toml), or a model file (.h5)" in line


def test_a_face_of_a_vertex_that_is_not_there(scene):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 9\n"
    (scene.parent / "muscle.obj").write_text(text)
    edit(scene, "muscle.stl", "muscle.obj")
    line = refuse(scene, verb="check")
    assert "(line 6: a face names vertex 9; allowed: 1 to 4)" in line


@pytest.mark.parametrize(("kept", "expected"), [(200, 684), (50, 84)])
def test_an_stl_file_cut_short(scene, kept, expected):
    path = scene.parent / "skin.stl"
    path.write_bytes(path.read_bytes()[:kept])
    line = refuse(scene, verb="check")
    assert f"skin.stl: cut short: {kept} bytes, {expected} expected (binary STL of " in line


def test_open_mesh_with_a_big_hole(scene):
    mesh = trimesh.load(scene.parent / "skin.stl")
    mesh.update_faces(np.arange(len(mesh.faces)) >= 2)
    mesh.export(scene.parent / "skin.stl")
    line = refuse(scene)
    assert "skin.stl" in line and "hole" in line and "open edges" in line


def test_nan_vertex(scene):
    (scene.parent / "skin.obj").write_text(
        "v 0 0 0\nv 10 0 0\nv 0 8 nan\nv 0 0 6\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    )
    edit(scene, "skin.stl", "skin.obj")
    line = refuse(scene)
    assert "skin.obj" in line and "vertex" in line and "2" in line


def test_negative_thickness(scene):
    edit(scene, "thickness = 1.8", "thickness = -1.8")
    line = refuse(scene)
    assert "layers[1].thickness" in line and "-1.8" in line


def test_unknown_key_names_the_nearest(scene):
    edit(scene, "damping =", "dampign =")
    line = refuse(scene)
    assert "dampign" in line and "damping" in line.replace("dampign", "")


def test_a_stiffness_that_no_number_holds(scene):
    text = scene.read_text()
    start = text.index("youngs_modulus = ")
    end = text.index(",", start)
    scene.write_text(text[:start] + 'youngs_modulus = "1e300 GPa"' + text[end:])
    line = refuse(scene)
    assert "layers[0].material.youngs_modulus: got '1e300 GPa'; allowed: up to 1e+15 Pa" in line


def test_unit_missing(scene):
    edit(scene, '"0.5 ms"', "0.5")
    line = refuse(scene)
    assert "duration" in line and "unit" in line


def test_voxels_too_small_for_the_memory(scene):
    edit(scene, "voxel = 1", "voxel = 0.002")
    line = refuse(scene)
    assert "voxel" in line and ("GB" in line or "GiB" in line)


def test_dt_above_the_bound(scene):
    edit(scene, 'dt = "auto"', 'dt = "1 ms"')
    line = refuse(scene)
    assert "dt" in line and "bound" in line


def test_duration_shorter_than_a_step(scene):
    edit(scene, '"0.5 ms"', '"0.1 us"')
    line = refuse(scene)
    assert "solver.duration: got 1e-07 s, shorter than one step of" in line
    assert "shorter than one step" in refuse(scene, verb="check")


def test_a_bone_that_is_not_there(scene):
    edit(scene, "[boundary]", '[boundary]\nsliding = ["skull"]')
    line = refuse(scene)
    assert "boundary.sliding.on: got 'skull'; allowed: none, [geometry] has no bones" in line


def test_tissue_on_both_sides_of_a_plane_of_symmetry(scene):
    edit(scene, "[boundary]", '[boundary]\nsymmetry = [{ axis = "x", at = 5 }]')
    assert "tissue on both sides of x = 5 mm; keep one side with region" in refuse(scene)


def test_a_render_surface_that_is_damaged(scene):
    (scene.parent / "face.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/1 9/1\n")
    edit(scene, "[boundary]", '[[surfaces]]\nname = "face"\nfile = "face.obj"\n\n[boundary]')
    line = refuse(scene)
    assert "face.obj" in line and "names" in line


def test_a_file_of_ligaments_that_is_none(scene):
    (scene.parent / "lines.txt").write_text("1 2 3\n4 five 6\n")
    entry = 'ligaments = [{ name = "a", file = "lines.txt", radius = 1 }]'
    edit(scene, "[boundary]", f"[boundary]\n{entry}")
    line = refuse(scene)
    assert "lines.txt: cannot be read as lines" in line


def test_no_such_device(scene):
    assert "opencl:77" in refuse(scene, "--device", "opencl:77")
