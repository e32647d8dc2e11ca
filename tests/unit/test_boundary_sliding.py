"""Which nodes a scene lets slide: what faces the skin, reach, boxes, cuts, between two bones."""

import numpy as np
import pytest
import trimesh

from shell_scene import CENTRE, INF, ball, build, crossed, groups, tables
from test_build import box, export
from tledface import _core
from tledface.build import build_model
from tledface.scene import Scene


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


def test_of_surfaces_as_near_but_for_rounding_the_first_is_taken():
    first, second = (trimesh.creation.box((2, 2, 2)), trimesh.creation.box((2, 2, 2 + 2e-9)))
    meshes = [(mesh.vertices, mesh.faces.astype(np.int32)) for mesh in (first, second)]
    point = np.array([[0.1, 0.2, 1.5]])
    for order in (meshes, meshes[::-1]):
        found = _core.nearest_surfaces(order, point, 1e-6)
        assert found["surface"].tolist() == [0] and found["tied"].tolist() == [True]
    found = _core.nearest_surfaces(meshes, point, 1e-12)
    assert found["surface"].tolist() == [1] and found["tied"].tolist() == [False]


def test_nodes_may_be_held_where_they_would_slide(tmp_path):
    sliding = build(tmp_path, boundary={"sliding": ["bones"]}).sliding.nodes
    model = build(tmp_path, boundary={"sliding": {"held": True}})
    assert len(model.sliding) == 0
    np.testing.assert_array_equal(np.flatnonzero(model.fixed.all(axis=1)), sliding)
    assert groups(model)["fixed", "skull"].tolist() == sliding.tolist()
    assert model.report["boundary"]["rigid_nodes"] == len(sliding)


def test_without_a_reach_nodes_up_to_two_voxels_away_slide(tmp_path):
    """Tissue that ends 2 mm above the bone, some of its voxels before and some behind that."""
    near, far = (
        build(tmp_path, boundary={"sliding": sliding}, depth=2.0).sliding.distance
        for sliding in ({}, {"reach": 4})
    )
    assert 1.8e-3 < near.max() <= 2e-3 < far.max()
    assert len(near) == np.count_nonzero(abs(far) <= 2e-3)


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
