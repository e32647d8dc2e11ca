"""Which nodes a scene holds and lets slide: boxes, cuts, attachments, ligaments, symmetry, bone."""

import numpy as np
import pytest
import trimesh

import tledface as tf
from test_build import MATERIAL, box, export
from tledface import _core
from tledface.boundary import bone_names
from tledface.build import BuildWarning, build_model
from tledface.errors import InputError
from tledface.geometry.lines import near_lines, read_lines
from tledface.scene import Scene

INF = float("inf")
SOFT = tf.material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)
CENTRE = np.array([3.0, -2.0, 40.0])  # mm; nothing may depend on where the body is


def ball(radius, subdivisions=4, centre=CENTRE):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    mesh.apply_translation(centre)
    return mesh


def tables(folder, *, voxel=1.0, boundary=None, **geometry):
    """Skin and bone, two spheres of 12 and 8 mm about one centre, and a muscle between them."""
    export(ball(12.0), folder / "skin.stl")
    export(ball(8.0), folder / "skull.ply")
    x, y, z = CENTRE
    export(box([x - 5, y - 3, z + 7], [x + 5, y + 3, z + 10]), folder / "muscle.stl")
    return {
        "schema": 1,
        "units": "mm",
        "geometry": {"skin": "skin.stl", "bones": ["skull.ply"], "voxel": voxel} | geometry,
        "layers": [{"name": "fat", "material": MATERIAL}],
        "muscles": [
            {
                "name": "lid",
                "surfaces": ["muscle.stl"],
                "fibre": [1, 0, 0],
                "sigma_act": "1 MPa",
                "material": MATERIAL,
            }
        ],
        "boundary": boundary or {},
        "solver": {"duration": "1 ms"},
    }


def build(folder, **changes):
    return build_model(Scene.from_dict(tables(folder, **changes), folder))


def groups(model):
    return {(group.kind, group.name): group.nodes for group in model.groups}


def closest_by_force(points, mesh):
    """Distances to every triangle: face interior, edges, corners; the least of all."""
    best = np.full(len(points), INF)
    for a, b, c in mesh.triangles:
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        height = (points - a) @ normal
        inside = np.ones(len(points), dtype=bool)
        for p, q in ((a, b), (b, c), (c, a)):
            edge = q - p
            inside &= (points - p) @ np.cross(normal, edge) >= 0
            share = np.clip((points - p) @ edge / (edge @ edge), 0, 1)
            best = np.minimum(best, np.linalg.norm(points - p - share[:, None] * edge, axis=1))
        best[inside] = np.minimum(best[inside], np.abs(height[inside]))
    return best


# -- sliding -------------------------------------------------------------------------------------


def test_every_inner_node_of_a_shell_slides_at_its_exact_distance(tmp_path):
    model = build(tmp_path, boundary={"sliding": ["bones"]})
    sliding = model.sliding
    away = np.linalg.norm(model.nodes - 1e-3 * CENTRE, axis=1)
    faces, centres, normals = model.boundary()
    inwards = np.einsum("ij,ij->i", normals, centres - 1e-3 * CENTRE) < 0
    inner = np.unique(faces[inwards & (np.linalg.norm(centres - 1e-3 * CENTRE, axis=1) < 10e-3)])
    np.testing.assert_array_equal(sliding.nodes, inner)
    assert len(inner) > 700
    assert (sliding.surface == 0).all() and sliding.surfaces[0].name == "skull"
    chosen = np.random.default_rng(0).choice(len(inner), 60, replace=False)
    bone = trimesh.load(tmp_path / "skull.ply")
    bone.apply_scale(1e-3)
    exact = closest_by_force(model.nodes[inner[chosen]], bone)
    np.testing.assert_allclose(np.abs(sliding.distance[chosen]), exact, rtol=0, atol=1e-12 * 12e-3)
    # Behind the bone's surface the distance is negative.
    facets = 8e-3 * (1 - np.cos(np.radians(4.5)))
    sure = np.abs(away[inner] - 8e-3) > facets
    np.testing.assert_array_equal(
        np.sign(sliding.distance[sure]), np.sign(away[inner] - 8e-3)[sure]
    )
    assert model.report["boundary"]["sliding_nodes"] == len(inner)
    assert groups(model)["sliding", "skull"].tolist() == inner.tolist()


def test_nodes_may_be_held_where_they_would_slide(tmp_path):
    sliding = build(tmp_path, boundary={"sliding": ["bones"]}).sliding.nodes
    model = build(tmp_path, boundary={"sliding": {"held": True}})
    assert len(model.sliding) == 0
    np.testing.assert_array_equal(np.flatnonzero(model.fixed.all(axis=1)), sliding)
    assert groups(model)["fixed", "skull"].tolist() == sliding.tolist()
    assert model.report["boundary"]["rigid_nodes"] == len(sliding)


@pytest.mark.parametrize("facing", [0.3, 0.6, 0.9])
def test_only_where_the_bone_faces_the_skin(tmp_path, facing):
    """The bone lies off the skin's centre, so its normal and the way to the skin part."""
    offset = np.array([2.0, 0.0, 0.0])
    scene = tables(tmp_path, boundary={"sliding": {"facing": facing, "reach": 3}}, depth=10)
    export(ball(4.0, centre=CENTRE + offset), tmp_path / "skull.ply")
    x, y, z = CENTRE
    export(box([x - 1, y - 1, z + 7], [x + 1, y + 1, z + 9]), tmp_path / "muscle.stl")
    model = build_model(Scene.from_dict(scene, tmp_path))
    nodes = model.nodes[model.sliding.nodes] * 1e3
    # On two spheres both directions are radial: known without any mesh.
    normal = nodes - CENTRE - offset
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    foot = CENTRE + offset + 4.0 * normal
    out = (foot - CENTRE) / np.linalg.norm(foot - CENTRE, axis=1)[:, None]
    cosine = np.einsum("ij,ij->i", normal, out)
    faceting = 0.05
    assert cosine.min() > facing - faceting
    # Those next to the limit are there: it is not stricter than asked for.
    possible = np.sqrt(1 - (2.0 / 4.0) ** 2)
    assert cosine.min() < max(facing, possible) + faceting


def test_the_far_side_and_the_edges_of_a_bone_do_not_slide(tmp_path):
    """A plate of bone in a block of tissue: only what lies on it slides."""
    scene = tables(tmp_path)
    export(box([0, 0, 0], [20, 10, 10]), tmp_path / "skin.stl")
    export(box([5, -1, 4], [15, 11, 6]), tmp_path / "skull.ply")
    export(box([6, 3, 7], [14, 7, 9]), tmp_path / "muscle.stl")
    scene["geometry"]["outer"] = [[[0, 0, 9.9], [20, 10, 10.1]]]
    found = {}
    for facing in (0.6, 0.8):
        scene["boundary"] = {"sliding": {"facing": facing}}
        model = build_model(Scene.from_dict(scene, tmp_path))
        found[facing] = {tuple(node) for node in model.node_ijk[model.sliding.nodes].tolist()}
    upper = {(x, y, 6) for x in range(5, 16) for y in range(11)}
    edges = {(x, y, 6) for x in (5, 15) for y in range(11)}
    # At an edge the normal is half way between its faces: cosine 0.707.
    assert found[0.6] == upper
    assert found[0.8] == upper - edges


def test_a_bone_behind_another_does_not_slide(tmp_path):
    """The floor of a cavity faces the skin, but there is bone between."""
    scene = tables(tmp_path, boundary={"sliding": ["floor"]})
    export(box([0, 0, 0], [20, 10, 12]), tmp_path / "skin.stl")
    export(box([3, -1, 2], [17, 11, 4]), tmp_path / "floor.stl")
    export(box([8.5, -1, 7], [11.5, 11, 8]), tmp_path / "roof.stl")
    export(box([6, 3, 9], [14, 7, 11]), tmp_path / "muscle.stl")
    scene["geometry"] |= {"outer": [[[0, 0, 11.9], [20, 10, 12.1]]]}
    along = {}
    for bones in (["floor.stl"], ["floor.stl", "roof.stl"]):
        scene["geometry"] |= {"bones": bones}
        model = build_model(Scene.from_dict(scene, tmp_path))
        ijk = model.node_ijk[model.sliding.nodes]
        assert (ijk[:, 2] == 4).all()
        along[len(bones)] = set(ijk[:, 0].tolist())
    assert along[1] == set(range(3, 18))
    assert along[2] == along[1] - {9, 10, 11}


def test_segments_meet_surfaces_as_by_force():
    """The tree's answer is that of every triangle, for segments long, short, along axes."""
    rng = np.random.default_rng(0)
    parts = [ball(1.0, 3, [0, 0, 0]), ball(0.4, 2, [1.5, 0.2, 0])]
    starts, ends = rng.uniform(-2, 2, (2, 300, 3))
    ends[:100] = starts[:100] + 0.3 * (ends[:100] - starts[:100])
    ends[100:150, 1:] = starts[100:150, 1:]
    meshes = [(part.vertices, part.faces) for part in parts]
    got = _core.segments_meet(meshes, starts, ends)
    expected = crossed(starts, ends, parts[0].triangles) | crossed(starts, ends, parts[1].triangles)
    np.testing.assert_array_equal(got, expected)
    assert 60 < expected.sum() < 240


def test_reach_boxes_and_excluded_boxes(tmp_path):
    everywhere = build(tmp_path, boundary={"sliding": ["skull"]}).sliding
    z = CENTRE[2]
    upper = [[[-INF, -INF, z], [INF, INF, INF]]]
    model = build(tmp_path, boundary={"sliding": {"on": ["skull"], "boxes": upper}})
    above = model.nodes[:, 2] >= 1e-3 * z - 1e-9
    np.testing.assert_array_equal(model.sliding.nodes, everywhere.nodes[above[everywhere.nodes]])
    without = build(tmp_path, boundary={"sliding": {"on": ["skull"], "excluded": upper}}).sliding
    np.testing.assert_array_equal(
        np.sort(np.concatenate([model.sliding.nodes, without.nodes])), everywhere.nodes
    )
    near = build(tmp_path, boundary={"sliding": {"reach": 0.25}}).sliding
    expected = everywhere.nodes[np.abs(everywhere.distance) <= 0.25e-3]
    np.testing.assert_array_equal(near.nodes, expected)
    assert 0 < len(near) < len(everywhere)


def test_nodes_at_a_cut_across_the_tissue_do_not_slide(tmp_path):
    """Only the lowest row of a cut face lies on the bone's side."""
    x, y, z = CENTRE
    region = [[x - 20, y - 20, z], [x + 20, y + 20, z + 20]]
    model = build(tmp_path, boundary={"sliding": {"reach": 4}}, region=region)
    cut = np.abs(model.nodes[:, 2] - 1e-3 * z) < 1e-9
    away = np.linalg.norm(model.nodes - 1e-3 * CENTRE, axis=1)
    on_cut = model.sliding.nodes[cut[model.sliding.nodes]]
    assert len(on_cut) > 30
    assert away[on_cut].max() < 9.2e-3 < away[cut].max()


def test_two_bones_equally_near_take_the_first_and_are_counted(tmp_path):
    export(box([0, 0, 0], [20, 10, 6]), tmp_path / "skin.stl")
    for name, low, high in (("left", -1, 10), ("right", 10, 21)):
        export(box([low, -1, -3], [high, 11, 2]), tmp_path / f"{name}.stl")
    scene = tables(tmp_path, boundary={"sliding": ["bones"]})
    export(box([0, 0, 0], [20, 10, 6]), tmp_path / "skin.stl")
    export(box([5, 3, 3], [15, 7, 5]), tmp_path / "muscle.stl")
    outer = [[[0, 0, 5.9], [20, 10, 6.1]]]
    scene["geometry"] |= {"bones": ["right.stl", "left.stl"], "outer": outer}
    model = build_model(Scene.from_dict(scene, tmp_path))
    (tied,) = [e for e in model.report["boundary"]["bound_twice"] if e["first"] == "one bone"]
    assert tied["nodes"] == 11  # the line between the bones
    names = [surface.name for surface in model.sliding.surfaces]
    on = np.array(names)[model.sliding.surface]
    x = model.nodes[model.sliding.nodes, 0] * 1e3
    assert (on[x > 9.999] == "right").all() and (on[x < 9.999] == "left").all()
    assert len(model.sliding) == 21 * 11
    np.testing.assert_allclose(model.sliding.distance, 0.0, atol=1e-15)


# -- rigid nodes ---------------------------------------------------------------------------------


def test_half_spaces_are_boxes_without_end(tmp_path):
    x = CENTRE[0]
    held = [{"box": [[x + 6, -INF, -INF], [INF, INF, INF]]}]
    model = build(tmp_path, boundary={"fixed": held})
    expected = model.nodes[:, 0] >= 1e-3 * (x + 6) - 1e-9
    np.testing.assert_array_equal(model.fixed.all(axis=1), expected)
    assert expected.any()


def test_attachments_are_the_muscle_s_nodes_near_the_bone(tmp_path):
    spec = {"muscle": "lid", "bone": "skull", "reach": 1.0}
    model = build(tmp_path, boundary={"attachments": [spec]})
    (muscle,) = model.muscles
    own = np.zeros(model.n_nodes, dtype=bool)
    own[model.elements[muscle.elements]] = True
    away = np.linalg.norm(model.nodes - 1e-3 * CENTRE, axis=1) - 8e-3
    held = model.fixed.all(axis=1)
    assert held.any() and not held[~own].any()
    assert away[held].max() <= 1.05e-3
    assert away[own & ~held].min() > 0.95e-3
    assert groups(model)["attachment", "lid on skull"].tolist() == np.flatnonzero(held).tolist()
    half = build(
        tmp_path,
        boundary={"attachments": [spec | {"boxes": [[[CENTRE[0], -INF, -INF], [INF, INF, INF]]]}]},
    )
    right = half.nodes[:, 0] >= 1e-3 * CENTRE[0] - 1e-9
    np.testing.assert_array_equal(half.fixed.all(axis=1), held & right)


def test_cut_faces_of_the_region_are_held(tmp_path):
    x, y, z = CENTRE
    region = [[x - 20, y - 20, z + 0.3], [x + 20, y + 20, z + 9.9]]
    cuts = [{"side": "z-"}, {"side": "z+", "components": "z"}]
    model = build(tmp_path, boundary={"cuts": cuts}, region=region)
    faces, _, normals = model.boundary()
    low, high = model.nodes[:, 2].min(), model.nodes[:, 2].max()
    bottom = np.unique(faces[(normals[:, 2] < -0.5) & (model.nodes[faces[:, 0], 2] == low)])
    top = np.unique(faces[(normals[:, 2] > 0.5) & (model.nodes[faces[:, 0], 2] == high)])
    np.testing.assert_array_equal(np.flatnonzero(model.fixed.all(axis=1)), bottom)
    held_up = model.fixed[:, 2] & ~model.fixed[:, 0]
    np.testing.assert_array_equal(np.flatnonzero(held_up), np.setdiff1d(top, bottom))
    assert abs(high - 1e-3 * (z + 9.9)) <= 0.5e-3 and len(top) > 50
    one = [{"side": "z-", "boxes": [[[x, -INF, -INF], [INF, INF, INF]]]}]
    half = build(tmp_path, boundary={"cuts": one}, region=region)
    right = half.nodes[bottom, 0] >= 1e-3 * x - 1e-9
    np.testing.assert_array_equal(np.flatnonzero(half.fixed.all(axis=1)), bottom[right])


def test_ligaments_are_points_and_lines_with_a_radius(tmp_path):
    x, y, z = CENTRE
    line = [[x - 6, y, z + 10], [x, y, z + 10], [x, y + 5, z + 10]]
    specs = [
        {"name": "line", "points": line, "radius": 1.5},
        {"name": "point", "points": [[x, y, z - 10]], "radius": 2.0},
    ]
    model = build(tmp_path, boundary={"ligaments": specs})
    nodes = model.nodes * 1e3
    away = np.full(len(nodes), INF)
    for p, q in zip(np.array(line), np.array(line)[1:], strict=False):
        for share in np.linspace(0, 1, 2001):
            away = np.minimum(away, np.linalg.norm(nodes - p - share * (q - p), axis=1))
    on_line = away <= 1.5 + 1e-5
    on_point = np.linalg.norm(nodes - [x, y, z - 10], axis=1) <= 2.0 + 1e-9
    found = groups(model)
    np.testing.assert_array_equal(found["ligament", "line"], np.flatnonzero(on_line))
    np.testing.assert_array_equal(found["ligament", "point"], np.flatnonzero(on_point))
    np.testing.assert_array_equal(model.fixed.all(axis=1), on_line | on_point)
    (tmp_path / "line.txt").write_text("\n".join(f"{a}, {b} {c}" for a, b, c in line))
    filed = build(tmp_path, boundary={"ligaments": [
        {"name": "line", "file": "line.txt", "radius": 1.5}]})  # fmt: skip
    np.testing.assert_array_equal(filed.fixed.all(axis=1), on_line)


def test_files_of_lines(tmp_path):
    path = tmp_path / "lines.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 2 0\nv 5 5 5\nl 1 2 -2\np 4\n")
    line, point = read_lines(path, unit_scale=0.5)
    np.testing.assert_allclose(line, [[0, 0, 0], [0.5, 0, 0], [0.5, 1, 0]])
    np.testing.assert_allclose(point, [[2.5, 2.5, 2.5]])
    path = tmp_path / "lines.txt"
    path.write_text("# two lines\n0 0 0\n1 0 0  # end\n\n\n2 2 2\n")
    assert [len(line) for line in read_lines(path)] == [2, 1]
    for text, word in (("1 2\n", "line 1 has 2 numbers"), ("", "no points"), ("0 0 nan", "finite")):
        path.write_text(text)
        with pytest.raises(InputError, match=word):
            read_lines(path)
    # A line doubled back on itself and one of no length are no trouble.
    points = np.array([[0.5, 0.1, 0], [3.0, 0, 0]])
    lines = [np.array([[0, 0, 0], [1, 0, 0], [0, 0, 0]]), np.array([[3.0, 0, 0], [3.0, 0, 0]])]
    assert near_lines(points, lines, 0.1).tolist() == [True, True]
    assert near_lines(points, lines, 0.0999).tolist() == [False, True]


# -- symmetry, and nodes bound twice ---------------------------------------------------------------


@pytest.mark.parametrize("side", ["below", "above"])
def test_nodes_lie_exactly_on_a_plane_of_symmetry(tmp_path, side):
    x, y, z = CENTRE
    low, high = [x - 20, y - 20, z - 20], [x + 20, y + 20, z + 20]
    (high if side == "below" else low)[0] = 0.0
    plane = [{"axis": "x", "at": 0}]
    model = build(
        tmp_path, boundary={"symmetry": plane, "sliding": ["bones"]}, region=[low, high], voxel=0.8
    )
    held = np.flatnonzero(model.fixed[:, 0])
    assert (model.nodes[held, 0] == 0.0).all() and len(held) > 100
    assert (model.nodes[:, 0] <= 0.0).all() if side == "below" else (model.nodes[:, 0] >= 0).all()
    on_plane = model.nodes[:, 0] == 0.0
    np.testing.assert_array_equal(np.flatnonzero(on_plane), held)
    assert not model.fixed[:, 1:].any()
    # Where the plane meets the bone, nodes slide within the plane.
    both = np.intersect1d(held, model.sliding.nodes)
    assert len(both) > 20
    (entry,) = [e for e in model.report["boundary"]["bound_twice"] if e["second"] == "sliding"]
    assert entry == {
        "first": "symmetry x = 0 mm", "second": "sliding", "nodes": len(both), "kept": "both hold"
    }  # fmt: skip


def test_tissue_on_both_sides_of_a_plane_of_symmetry_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"tissue on both sides of x = 3 mm; keep one side"):
        build(tmp_path, boundary={"symmetry": [{"axis": "x", "at": 3}]})


def test_nodes_bound_twice_are_counted_and_rigid_comes_first(tmp_path):
    x, y, z = CENTRE
    boundary = {
        "fixed": [{"box": [[x, -INF, -INF], [INF, INF, INF]]}],
        "attachments": [{"muscle": "lid", "reach": 1.0}],
        "ligaments": [
            {"name": "a", "points": [[x - 4, y, z + 9]], "radius": 3},
            {"name": "b", "points": [[x - 5, y, z + 9]], "radius": 3},
        ],
        "sliding": ["bones"],
    }
    model = build(tmp_path, boundary=boundary)
    named, free = groups(model), build(tmp_path, boundary={"sliding": ["bones"]}).sliding.nodes
    counted = {
        (entry["first"], entry["second"]): (entry["nodes"], entry["kept"])
        for entry in model.report["boundary"]["bound_twice"]
    }
    claims = {
        "fixed[0]": named["fixed", "fixed[0]"],
        "attachment lid on bones": named["attachment", "lid on bones"],
        "ligament a": named["ligament", "a"],
        "ligament b": named["ligament", "b"],
    }
    names = list(claims)
    for first, name in enumerate(names):
        for other in names[first + 1 :]:
            shared = len(np.intersect1d(claims[name], claims[other]))
            assert counted.get((name, other), (0, "held once")) == (shared, "held once")
        shared = len(np.intersect1d(claims[name], free))
        assert counted[name, "sliding"] == (shared, "rigid") and shared > 0
    rigid = np.unique(np.concatenate(list(claims.values())))
    np.testing.assert_array_equal(np.flatnonzero(model.fixed.all(axis=1)), rigid)
    np.testing.assert_array_equal(model.sliding.nodes, np.setdiff1d(free, rigid))
    assert counted["ligament a", "ligament b"][0] > 10


def test_entries_without_nodes_warn(tmp_path):
    z = CENTRE[2]
    entries = {
        r"fixed\[0\]: no node lies in the box": {"fixed": [{"box": [[90, 90, 90], [91, 91, 91]]}]},
        r"cuts\[0\] z\+: no cut face": {"cuts": [{"side": "z+", "at": z + 40}]},
        r"ligament far: no node": {
            "ligaments": [{"name": "far", "points": [[90, 90, 90]], "radius": 1}]
        },
        r"attachment lid on bones: no node": {"attachments": [{
            "muscle": "lid", "reach": 0, "boxes": [[[90, 90, 90], [91, 91, 91]]]}]},
        r"sliding: no node slides": {"sliding": {"boxes": [[[90, 90, 90], [91, 91, 91]]]}},
    }  # fmt: skip
    for pattern, boundary in entries.items():
        with pytest.warns(BuildWarning, match=pattern):
            model = build(tmp_path, boundary=boundary)
        assert len(model.report["warnings"]) == 1


@pytest.mark.parametrize(
    ("boundary", "pattern"),
    [
        ({"sliding": ["jaw"]}, r"boundary\.sliding\.on: got 'jaw'; allowed: bones, skull"),
        ({"attachments": [{"muscle": "lid", "bone": "jaw", "reach": 1}]},
         r"boundary\.attachments\[0\]\.bone: got 'jaw'"),
        ({"attachments": [{"muscle": "lids", "reach": 1}]},
         r"boundary\.attachments\[0\]\.muscle: got 'lids'; allowed: lid"),
        ({"cuts": [{"side": "z+"}]}, r"boundary\.cuts\[0\]\.at: key missing"),
        ({"cuts": [{"side": "up"}]}, r"side: got 'up'; allowed: one of x-, x\+"),
        ({"sliding": "bones"}, r"sliding: got 'bones'; allowed: a list of bones"),
        ({"sliding": {"facing": 1.0}}, r"facing: got 1.0; allowed"),
        ({"symmetry": [{"axis": "x"}, {"axis": "x", "at": 1}]}, r"axis 'x' is used twice"),
        ({"ligaments": [{"name": "a", "radius": 1}]}, r"points, file: got neither"),
        ({"ligaments": [{"name": "a", "points": [[0, 0]], "radius": 1}]}, "three lengths"),
        ({"fixed": [{"box": [[0, 0, 0], [INF, -INF, 0]]}]}, "a low corner not above the high"),
        ({"fixed": [{"box": [[0, 0, 0], [float("nan"), 1, 1]]}]}, "finite number"),
    ],
)  # fmt: skip
def test_bad_entries_are_one_clear_line(tmp_path, boundary, pattern):
    with pytest.raises(InputError, match=pattern) as caught:
        build(tmp_path, boundary=boundary)
    assert "\n" not in str(caught.value)


def test_names_of_bones(tmp_path):
    paths = [tmp_path / name for name in ("a/jaw.stl", "b/jaw.obj", "bones.ply")]
    assert bone_names(paths) == ["jaw", "jaw 2", "bones 2"]


# -- the model and Python ------------------------------------------------------------------------


def floor(z=0.0):
    vertices = [[-1, -1, z], [2, -1, z], [2, 2, z], [-1, 2, z]]
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False)


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


# -- anatomy -------------------------------------------------------------------------------------


def test_forehead_slides_on_the_outside_of_the_skull_only(shared_data, tmp_path):
    anatomy = shared_data / "bodyparts3d"
    numbers = (52734, 53647, 53648, 52892, 52893, 52788, 52789, 52736, 53649, 53650)
    scene = tables(tmp_path, boundary={"sliding": ["bones"]})
    scene["geometry"] = {
        "skin": str(anatomy / "derived_skin_closed.ply"),
        "bones": [str(anatomy / f"FMA{number}.obj") for number in numbers],
        "voxel": 1.0,
        "region": [[-44, -200, 1535], [44, -120, 1605]],
        # Not the planes that close it below and behind.
        "outer": [[[-200, -300, 1511], [200, -73, 1700]]],
    }
    scene["muscles"][0]["surfaces"] = [str(anatomy / f"FMA{n}.obj") for n in (46759, 46760)]
    model = build_model(Scene.from_dict(scene, tmp_path))
    nodes = model.nodes[model.sliding.nodes] * 1e3
    assert 7_000 < len(nodes) < 16_000
    # Nothing but tissue lies between a sliding node and the skin: none is inside the skull or in
    # the orbit, where bone would.
    chosen = nodes[np.random.default_rng(0).choice(len(nodes), 150, replace=False)]
    skin = trimesh.load(anatomy / "derived_skin_closed.ply", process=False).vertices
    nearest = skin[[int(((skin - node) ** 2).sum(axis=1).argmin()) for node in chosen]]
    way = nearest - chosen
    # A node may lie within the bone by a voxel's diagonal.
    starts = chosen + 1.75 * way / np.linalg.norm(way, axis=1)[:, None]
    for number in numbers:
        bone = trimesh.load(anatomy / f"FMA{number}.obj", process=False)
        assert not crossed(starts, nearest, bone.triangles).any(), number
    # And the check sees bone where there is some: from behind the frontal bone.
    behind = chosen + np.array([0, 12.0, 0])
    triangles = trimesh.load(anatomy / "FMA52734.obj", process=False).triangles
    assert crossed(behind, nearest, triangles).mean() > 0.8


def crossed(starts, ends, triangles):
    """Which segments cross any triangle (Moeller and Trumbore)."""
    a, ab, ac = (
        triangles[:, 0],
        triangles[:, 1] - triangles[:, 0],
        triangles[:, 2] - triangles[:, 0],
    )
    found = []
    for start, end in zip(starts, ends, strict=True):
        run = end - start
        across = np.cross(run, ac)
        det = np.einsum("ij,ij->i", ab, across)
        det[det == 0.0] = np.nan  # parallel: no comparison holds
        u = np.einsum("ij,ij->i", start - a, across) / det
        turned = np.cross(start - a, ab)
        v = turned @ run / det
        t = np.einsum("ij,ij->i", ac, turned) / det
        found.append(((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)).any())
    return np.array(found)
