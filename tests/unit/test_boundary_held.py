"""Which nodes a scene holds: boxes, attachments, cuts, ligaments, planes of symmetry."""

import numpy as np
import pytest

from shell_scene import CENTRE, INF, build, groups
from tledface.errors import InputError
from tledface.geometry.lines import near_lines, read_lines


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
