"""Render surfaces: read vertex for vertex, bound, moved, written and stored with all they hold."""

import time

import numpy as np
import pytest
import trimesh

import tledface as tf
from test_build import box, build, export
from tledface.errors import InputError
from tledface.geometry import read_polygons
from tledface.io.surfaces import write_surface
from tledface.polygons import Polygons
from tledface.surface import BoundSurface, bind

SOFT = tf.material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)

# A cube's net: six quads, each with texture coordinates of its own, so that every vertex is on a
# seam; two groups, two materials, one hard edge; one vertex that no face uses.
CUBE = """# a cube
mtllib cube.mtl
o crate
v 1 1 1
v 9 1 1
v 9 7 1
v 1 7 1
v 1 1 5
v 9 1 5
v 9 7 5
v 1 7 5
v 4 4 3
vt 0 0
vt .25 0
vt .25 .25
vt 0 .25
vt .5 .5
vt .75 .5
vt .75 .75
vt .5 .75
vn 0 0 -1
vn 0 0 1
vn 0.7 0.7 0
g ends
usemtl wood
f 4/1/1 3/2/1 2/3/1 1/4/1
f -5/5/2 -4/6/2 -3/7/2 -2/8/2
g sides front
usemtl steel
f 1/1/3 2/2/3 6/3/3 5/4/3
f 2/5/3 3/6/3 7/7/3 6/8/3
f 3/1/3 4/2/3 8/3/3
f 3/1/3 8/3/3 7/4/3
f 4//3 1//3 5//3 8//3
"""


@pytest.fixture
def crate(tmp_path):
    (tmp_path / "crate.obj").write_text(CUBE)
    return tmp_path / "crate.obj"


def same_polygons(one, other):
    for name in ("sizes", "vertex", "uv", "uv_of", "normal_of"):
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            np.testing.assert_array_equal(a, b, err_msg=name)
    assert (one.n_normals, one.library) == (other.n_normals, other.library)
    assert set(one.labels) == set(other.labels)
    for kind, labels in one.labels.items():
        assert labels.names == other.labels[kind].names
        np.testing.assert_array_equal(labels.of, other.labels[kind].of)


def test_an_obj_file_is_read_as_it_is(crate):
    vertices, polygons = read_polygons(crate, unit_scale=1e-3)
    assert vertices.shape == (9, 3)
    np.testing.assert_allclose(vertices[6], [9e-3, 7e-3, 5e-3], rtol=1e-15)
    assert polygons.sizes.tolist() == [4, 4, 4, 4, 3, 3, 4]
    assert polygons.vertex[:8].tolist() == [3, 2, 1, 0, 4, 5, 6, 7]
    assert polygons.uv.shape == (8, 2) and polygons.uv[1].tolist() == [0.25, 0.0]
    assert polygons.uv_of[:8].tolist() == list(range(8))
    assert polygons.uv_of[-4:].tolist() == [-1] * 4
    assert polygons.normal_of[[0, 4, 8]].tolist() == [0, 1, 2] and polygons.n_normals == 3
    assert polygons.library == "cube.mtl"
    labels = polygons.labels
    assert labels["object"].names == ["crate"] and (labels["object"].of == 0).all()
    assert labels["group"].names == ["ends", "sides front"]
    assert labels["group"].of.tolist() == [0, 0, 1, 1, 1, 1, 1]
    assert labels["material"].names == ["wood", "steel"]
    triangles = polygons.triangles()
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    assert mesh.is_watertight and mesh.volume == pytest.approx(8 * 6 * 4e-9)
    normals = polygons.corner_normals(vertices)
    np.testing.assert_allclose(normals[:2], [[0, 0, -1], [0, 0, 1]], atol=1e-15)


def test_obj_files_of_every_corner_pattern(tmp_path):
    path = tmp_path / "t.obj"
    head = "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n"
    for face, uv, normal in (
        ("1 2 3", None, None),
        ("1/1 2/2 3/3", [0, 1, 2], None),
        ("1//1 2//1 3//1", None, [0, 0, 0]),
        ("1/3/1 2/2/1 3/1/1", [2, 1, 0], [0, 0, 0]),
        ("-3/-1 -2/-2 -1/-3", [2, 1, 0], None),
        ("1/1 2 3/3/1", [0, -1, 2], [-1, -1, 0]),
        ("1/1/ 2/2/ \\\n 3/3/", [0, 1, 2], None),
    ):
        path.write_text(f"{head}f {face}\n")
        vertices, polygons = read_polygons(path)
        assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
        assert polygons.vertex.tolist() == [0, 1, 2]
        assert (polygons.uv_of if uv is None else polygons.uv_of.tolist()) == uv, face
        assert (polygons.normal_of if normal is None else polygons.normal_of.tolist()) == normal


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "names vertex 4 of 3"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "face 0 has 2 corners"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "vertex 0; OBJ counts from 1"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9\n", "names what is not there"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4294967299\n", "names what is not there"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/-2 3/1\n", "names what is not there"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/2 3/1\n", "texture coordinate 2 of 1"),
        ("v 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "needs 3 numbers"),
        ("v 0 0 x\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "cannot be read as OBJ"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "vertex 0 is not finite"),
        ("v 0 0 0\n", "no faces"),
        ("", "empty"),
        ("f 1/2/3/4 1 1\nv 0 0 0\n", "cannot be read as OBJ"),
    ],
)
def test_bad_files_are_one_clear_line(tmp_path, text, pattern):
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(InputError, match=pattern) as caught:
        read_polygons(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("ending", ["obj", "off"])
def test_damaged_text_is_refused_or_read(tmp_path, crate, ending):
    """Bytes changed, lines dropped, doubled or cut: an InputError of one line, or a surface."""
    text = CUBE
    if ending == "off":
        write_surface(tmp_path / "c.off", *read_polygons(crate))
        text = (tmp_path / "c.off").read_text()
    rng = np.random.default_rng(0)
    path, read = tmp_path / f"d.{ending}", 0
    for _ in range(400):
        lines = text.splitlines()
        for _ in range(rng.integers(1, 4)):
            where = int(rng.integers(len(lines)))
            line, kind = lines[where], rng.integers(5)
            spot = int(rng.integers(len(line) + 1))
            if kind == 0:
                lines[where] = line[:spot] + chr(rng.integers(32, 127)) + line[spot + 1 :]
            elif kind == 1:
                lines[where] = line[:spot]
            elif kind == 2:
                lines.insert(where, line)
            elif kind == 3 and len(lines) > 1:
                del lines[where]
            else:
                lines[where] = line + " -7/99/ 1e999"
        path.write_text("\n".join(lines))
        try:
            vertices, polygons = read_polygons(path)
        except InputError as error:
            assert "\n" not in str(error) and str(path) in str(error)
            continue
        read += 1
        assert np.isfinite(vertices).all()
        assert polygons.triangles().max() < len(vertices) and polygons.triangles().min() >= 0
    assert 20 < read < 390


def test_other_formats_keep_vertex_order_and_polygons(tmp_path, crate):
    points, polygons = read_polygons(crate)
    for ending in ("off", "ply"):
        path = tmp_path / f"crate.{ending}"
        if ending == "off":
            rows = [f"{a} {b} {c}" for a, b, c in points]
            starts = polygons.starts
            rows += [
                f"{n} {' '.join(map(str, polygons.vertex[starts[f] : starts[f] + n]))} 255 0 0"
                for f, n in enumerate(polygons.sizes)
            ]
            path.write_text(
                f"OFF\n# crate\n{len(points)} {len(polygons.sizes)} 0\n" + "\n".join(rows)
            )
        else:
            write_surface(path, points, polygons)
        again, read = read_polygons(path)
        np.testing.assert_array_equal(again, points)
        assert read.sizes.tolist() == polygons.sizes.tolist()
        np.testing.assert_array_equal(read.vertex, polygons.vertex)
    mesh = trimesh.creation.icosphere(2)
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    shuffled = trimesh.Trimesh(
        mesh.vertices[order], np.argsort(order)[mesh.faces], process=False,
        visual=trimesh.visual.TextureVisuals(uv=mesh.vertices[order, :2]),
    )  # fmt: skip
    for ending in ("ply", "glb", "off"):
        path = tmp_path / f"ball.{ending}"
        shuffled.export(path)
        points, polygons = read_polygons(path)
        np.testing.assert_allclose(points, shuffled.vertices, atol=1e-6)
        np.testing.assert_array_equal(polygons.vertex.reshape(-1, 3), shuffled.faces)
        if ending == "glb":
            np.testing.assert_allclose(polygons.uv, shuffled.vertices[:, :2], atol=1e-6)
    quads = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    quads += "property float z\nproperty float s\nproperty float t\nelement face 1\n"
    quads += "property list uchar int vertex_indices\nend_header\n"
    (tmp_path / "q.ply").write_text(
        quads + "0 0 0 .1 0\n1 0 0 .2 0\n1 1 0 .3 0\n0 1 0 .4 .5\n4 3 0 1 2\n"
    )
    points, polygons = read_polygons(tmp_path / "q.ply")
    assert polygons.sizes.tolist() == [4] and polygons.vertex.tolist() == [3, 0, 1, 2]
    np.testing.assert_allclose(polygons.uv[:, 0], [0.1, 0.2, 0.3, 0.4], rtol=1e-6)


def crate_model(tmp_path):
    """The block of test_build with the crate beside its skin."""
    surfaces = [{"name": "crate", "file": "crate.obj"}]
    return build(tmp_path, surfaces=surfaces)


def test_a_surface_of_the_scene_moves_and_keeps_all_it_holds(tmp_path, crate):
    model = crate_model(tmp_path)
    bound = model.surfaces["crate"]
    vertices, polygons = read_polygons(crate, unit_scale=1e-3)
    np.testing.assert_array_equal(bound.displaced(np.zeros_like(model.nodes)), vertices)
    same_polygons(bound.polygons, polygons)
    shear = np.array([[0.0, 0.2, 0.0], [0.0, 0.0, 0.1], [0.3, 0.0, 0.0]])
    moved = bound.displaced(model.nodes @ shear.T)
    np.testing.assert_allclose(moved, vertices + vertices @ shear.T, atol=1e-15)
    out = tmp_path / "moved.obj"
    write_surface(out, moved, bound.polygons)
    back, same = read_polygons(out)
    np.testing.assert_allclose(back, moved, rtol=1e-8, atol=1e-12)
    same_polygons(same, polygons)
    # Normals are those of the moved shape, shared as before.
    lines = [line.split()[1:] for line in out.read_text().splitlines() if line.startswith("vn")]
    cross = np.cross(moved[1] - moved[0], moved[3] - moved[0])
    np.testing.assert_allclose(np.array(lines[0], float), -cross / np.linalg.norm(cross), atol=2e-6)
    # A second tool reads it too.
    other = trimesh.load(out, process=False)
    parts = other.geometry.values() if isinstance(other, trimesh.Scene) else [other]
    assert sum(len(part.faces) for part in parts) == 12


def test_surfaces_survive_the_model_file(tmp_path, crate):
    model = crate_model(tmp_path)
    model.save(tmp_path / "m.h5")
    again = tf.Model.load(tmp_path / "m.h5")
    assert list(again.surfaces) == ["skin", "crate"]
    for name, bound in model.surfaces.items():
        other = again.surfaces[name]
        same_polygons(other.polygons, bound.polygons)
        for key in ("vertices", "faces", "element", "local", "corner_nodes"):
            np.testing.assert_array_equal(getattr(other, key), getattr(bound, key), strict=True)
        assert (other.follow is None) == (bound.follow is None)


def test_a_file_s_own_unit(tmp_path, crate):
    scaled = [
        " ".join(["v", *(f"{0.1 * float(x):.6g}" for x in line.split()[1:])])
        if line.startswith("v ")
        else line
        for line in CUBE.splitlines()
    ]
    crate.write_text("\n".join(scaled))
    model = build(tmp_path, surfaces=[{"name": "c", "file": "crate.obj", "units": "cm"}])
    np.testing.assert_allclose(model.surfaces["c"].vertices[6], [9e-3, 7e-3, 5e-3])


def test_vertices_far_from_the_tissue_stay_in_order_and_at_rest(tmp_path):
    """A skin of which only one end is tissue."""
    skin = box([0, 0, 0], [40, 8, 6]).subdivide().subdivide().subdivide()
    scene_region = [[0, -1, -1], [10, 9, 7]]
    build(tmp_path)
    export(skin, tmp_path / "long.ply")
    export(box([2, 2, 1], [8, 6, 3]), tmp_path / "muscle.obj")
    model = build(
        tmp_path,
        geometry={"skin": "long.ply", "region": scene_region},
        surfaces=[
            {"name": "hard", "file": "long.ply", "reach": 2},
            {"name": "soft", "file": "long.ply", "reach": 2, "fade": 10},
        ],
    )
    away = np.maximum(skin.vertices[:, 0] - 10.0, 0.0)
    u = np.tile([0.0, 0.0, 1e-3], (model.n_nodes, 1))
    for name, reach in (("skin", 3.0), ("hard", 2.0)):
        bound = model.surfaces[name]
        np.testing.assert_allclose(bound.vertices, 1e-3 * skin.vertices, atol=1e-9)
        np.testing.assert_array_equal(bound.bound, away <= reach + 1e-9)
        moved = bound.displaced(u)[:, 2] - bound.vertices[:, 2]
        np.testing.assert_allclose(moved, 1e-3 * (away <= reach + 1e-9), atol=1e-15)
        assert len(bound.faces) == len(skin.faces)
        inside = bound.bound[bound.faces].all(axis=1)
        np.testing.assert_array_equal(bound.bound_faces, bound.faces[inside])
    soft = model.surfaces["soft"].displaced(u)[:, 2] - model.surfaces["soft"].vertices[:, 2]
    t = np.clip((away - 2.0) / 10.0, 0.0, 1.0)
    np.testing.assert_allclose(soft, 1e-3 * (1 - 3 * t**2 + 2 * t**3), atol=1e-12)
    assert 0 < np.count_nonzero((t > 0) & (t < 1)) < len(t)
    # Numbers that count, in the report and after a trip through a file.
    bound, total = model.report["bound_vertices"]["hard"]
    assert (bound, total) == (np.count_nonzero(away <= 2.0 + 1e-9), len(skin.vertices))
    model.save(tmp_path / "m.h5")
    again = tf.Model.load(tmp_path / "m.h5").surfaces["soft"]
    np.testing.assert_array_equal(again.follow, model.surfaces["soft"].follow)
    export(box([90, 90, 90], [99, 99, 99]), tmp_path / "far.ply")
    with pytest.raises(InputError, match=r"surface 'hard': no vertex of .* lies near the tissue"):
        build(tmp_path, surfaces=[{"name": "hard", "file": "far.ply"}])


@pytest.mark.parametrize(
    ("surface", "pattern"),
    [
        ({"name": "skin", "file": "skin.stl"}, "name 'skin' is used twice"),
        ({"name": "a/b", "file": "skin.stl"}, "got 'a/b'; allowed: letters"),
        ({"name": "a", "file": "gone.obj"}, "file not found"),
        ({"name": "a", "file": "skin.stl", "units": "inch"}, "got 'inch'; allowed: one of"),
        ({"name": "a", "file": "skin.stl", "fade": -1}, "fade: got -1"),
    ],
)
def test_bad_surfaces_of_a_scene(tmp_path, surface, pattern):
    with pytest.raises(InputError, match=pattern):
        build(tmp_path, surfaces=[surface])


def test_a_million_vertices_bind_in_seconds():
    model = tf.Model.block((80, 80, 20), (0.08, 0.08, 0.02), SOFT)
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.01, -0.01, -0.01], [0.09, 0.09, 0.03], (1_000_000, 3))
    start = time.process_time()
    bound = BoundSurface.on(model, points, np.zeros((0, 3), int))
    assert time.process_time() - start < 12
    gradient = 0.25 * rng.normal(size=(3, 3))
    moved = bound.displaced(model.nodes @ gradient.T)
    near = bind(points, model)[2] < 0.9e-3
    assert near.sum() > 300_000
    np.testing.assert_allclose(moved[near], (points + points @ gradient.T)[near], atol=1e-14)


def test_polygons_refuse_what_is_not_there():
    with pytest.raises(InputError, match="names vertex 4 of 3"):
        Polygons.of_triangles([[0, 1, 3]]).check(3, "here")
    model = tf.Model.block((1, 1, 1), (1, 1, 1), SOFT)
    with pytest.raises(InputError, match="surface faces: a face names vertex"):
        BoundSurface.on(model, np.zeros((2, 3)), Polygons.of_triangles([[0, 1, 2]]))


def test_armadillo_of_15_000_voxels_keeps_its_file_s_vertices(shared_data, tmp_path):
    """The count of Warburton and Maddock's Figure 11 within 2 %, at 2.5 mm."""
    path = shared_data / "stanford" / "armadillo.off"
    raw, polygons = read_polygons(path)
    assert raw.shape == (26_002, 3) and len(polygons.sizes) == 52_000
    scale = 1.004  # of the scan's own units as millimetres
    mesh = trimesh.Trimesh(scale * raw, polygons.triangles(), process=False)
    mesh.export(tmp_path / "armadillo.off", digits=12)
    scene = {
        "schema": 1,
        "units": "mm",
        "geometry": {"skin": "armadillo.off", "voxel": 2.5},
        "layers": [{"name": "body", "material": {
            "model": "neo_hookean", "youngs_modulus": "50 kPa", "poissons_ratio": 0.4,
            "density": 1000}}],
        "solver": {"duration": "1 ms"},
    }  # fmt: skip
    model = tf.Scene.from_dict(scene, tmp_path).build()
    assert abs(model.n_elements - 15_107) <= 0.02 * 15_107
    skin = model.surfaces["skin"]
    size = np.ptp(skin.vertices, axis=0).max()
    rest = skin.displaced(np.zeros_like(model.nodes))
    assert np.abs(rest - 1e-3 * scale * raw).max() <= 1e-9 * size
    np.testing.assert_array_equal(skin.polygons.vertex, polygons.vertex)
    # Fingers too thin for these voxels go with the hand.
    assert skin.bound.all() and bind(skin.vertices, model)[2].max() > 3 * 2.5e-3
    # And it follows: a stretch of the body is one of the skin, where the skin lies near voxels.
    moved = skin.displaced(0.1 * model.nodes)
    near = bind(skin.vertices, model)[2] < 0.9 * model.voxel.min()
    assert near.mean() > 0.9
    np.testing.assert_allclose(moved[near], 1.1 * skin.vertices[near], atol=1e-9 * size)
