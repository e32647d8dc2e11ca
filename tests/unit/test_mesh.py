"""Surfaces: welding, repairs, refusals, closest points, volumes."""

import numpy as np
import pytest
import trimesh

from tledface import _core
from tledface.errors import InputError


def prepare(vertices, faces, name="mesh"):
    return _core.prepare_surface(np.asarray(vertices, float), np.asarray(faces, np.int32), name)


def prepare_mesh(mesh):
    return prepare(mesh.vertices, mesh.faces)


def split(mesh):
    """Every face with its own three vertices."""
    return mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)


@pytest.fixture
def sphere():
    return trimesh.creation.icosphere(subdivisions=3, radius=0.05)


def test_volume_moments_of_a_box_far_from_the_origin():
    box = trimesh.creation.box((0.1, 0.2, 0.4))
    offset = np.array([1.6, -2.0, 3.0])
    solid = prepare(box.vertices + offset, box.faces)
    assert solid.volume == pytest.approx(0.008, rel=1e-12)
    assert solid.centroid == pytest.approx(offset, rel=1e-12)
    expected = 0.008 / 12 * np.array([0.01, 0.04, 0.16])
    assert solid.covariance[:3] == pytest.approx(expected, rel=1e-9)
    assert solid.covariance[3:] == pytest.approx(np.zeros(3), abs=1e-15)
    assert solid.area == pytest.approx(2 * (0.02 + 0.04 + 0.08), rel=1e-12)


def test_shuffled_and_split_faces_give_the_same_surface(sphere):
    rng = np.random.default_rng(1)
    whole = prepare_mesh(sphere)
    order = rng.permutation(len(sphere.faces))
    relabel = rng.permutation(len(sphere.vertices))
    shuffled_vertices = np.empty_like(sphere.vertices)
    shuffled_vertices[relabel] = sphere.vertices
    shuffled = prepare(shuffled_vertices, np.roll(relabel[sphere.faces[order]], 1, axis=1))
    parted = prepare(*split(sphere))
    for other in (shuffled, parted):
        np.testing.assert_array_equal(other.vertices, whole.vertices)
        np.testing.assert_array_equal(other.faces, whole.faces)
    assert parted.report["vertices_welded"] == 3 * len(sphere.faces) - len(sphere.vertices)


def test_seam_with_rounding_is_joined(sphere):
    vertices, faces = split(sphere)
    vertices = vertices + 1e-9 * np.random.default_rng(2).standard_normal(vertices.shape)
    solid = prepare(vertices, faces)
    assert solid.report["seams_joined"]
    assert len(solid.vertices) == len(sphere.vertices)
    assert solid.volume == pytest.approx(sphere.volume, rel=1e-5)


def test_repairs_are_made_and_reported():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    faces = sphere.faces.copy()
    faces[::7] = faces[::7, ::-1]
    damaged = np.concatenate([faces[1:], faces[5:9], faces[20:22, ::-1], [[3, 3, 4]]])
    solid = prepare(sphere.vertices, damaged)
    report = solid.report
    assert report["degenerate_faces"] == 1
    assert report["duplicate_faces"] == 4 + 2
    assert report["holes_filled"] >= 1
    assert report["flipped_faces"] > 0
    assert report["components"] == 1
    assert solid.volume == pytest.approx(sphere.volume, rel=0.01)


def test_inside_out_surface_is_turned(sphere):
    solid = prepare(sphere.vertices, sphere.faces[:, ::-1])
    assert solid.volume == pytest.approx(sphere.volume, rel=1e-12)
    assert solid.report["inverted_components"] == 1


@pytest.mark.parametrize("inverted", [False, True])
def test_cavity_is_kept(sphere, inverted):
    inner = 0.5 * sphere.vertices
    vertices = np.concatenate([sphere.vertices, inner])
    faces = np.concatenate([sphere.faces, sphere.faces[:, ::-1] + len(inner)])
    solid = prepare(vertices, faces[:, ::-1] if inverted else faces)
    assert solid.report["cavities"] == 1
    assert solid.volume == pytest.approx(sphere.volume * (1 - 0.125), rel=1e-12)


def test_separate_inverted_part_is_turned(sphere):
    beside = sphere.vertices + np.array([0.2, 0, 0])
    vertices = np.concatenate([sphere.vertices, beside])
    faces = np.concatenate([sphere.faces, sphere.faces[:, ::-1] + len(sphere.vertices)])
    solid = prepare(vertices, faces)
    assert solid.report["inverted_components"] == 1
    assert solid.volume == pytest.approx(2 * sphere.volume, rel=1e-12)


def test_large_hole_is_refused(sphere):
    with pytest.raises(
        InputError, match=r"^mesh: the surface is open: \d+ open edges in 1 hole, "
    ) as e:
        prepare(sphere.vertices, sphere.faces[sphere.triangles_center[:, 2] < 0.03])
    assert "mm around" in str(e.value) and "close" in str(e.value)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_non_finite_vertex_is_named(sphere, bad):
    vertices = np.array(sphere.vertices)
    vertices[17, 1] = bad
    with pytest.raises(InputError, match="mesh: vertex 17 is"):
        prepare(vertices, sphere.faces)


def test_useless_surfaces_are_refused(sphere):
    with pytest.raises(InputError, match="no triangles"):
        prepare(np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(InputError, match="face 0 names vertex 9"):
        prepare(np.eye(3), [[0, 1, 9]])
    with pytest.raises(InputError, match="degenerate or cancel"):
        prepare(np.eye(3), [[0, 1, 2], [0, 2, 1]])
    with pytest.raises(InputError, match="is open"):
        prepare(np.eye(3), [[0, 1, 2]])
    flat = sphere.vertices * [1, 1, 0]
    with pytest.raises(InputError, match=r"no volume|degenerate"):
        prepare(flat, sphere.faces)


def test_moebius_strip_cannot_be_oriented():
    n = 24
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    width = np.array([-0.3, 0.3])
    radius = 1 + width * np.cos(angle / 2)[:, None]
    vertices = np.stack(
        [
            radius * np.cos(angle)[:, None],
            radius * np.sin(angle)[:, None],
            width * np.sin(angle / 2)[:, None],
        ],
        axis=-1,
    ).reshape(-1, 3)
    faces = []
    for i in range(n):
        a, b = 2 * i, 2 * i + 1
        c, d = (2 * i + 2, 2 * i + 3) if i < n - 1 else (1, 0)
        faces += [[a, c, b], [b, c, d]]
    with pytest.raises(InputError, match="cannot be oriented"):
        prepare(vertices, faces)


def brute_force_distance(points, triangles):
    best = np.full(len(points), np.inf)
    for triangle in triangles:
        near = trimesh.triangles.closest_point(np.repeat(triangle[None], len(points), 0), points)
        best = np.minimum(best, np.linalg.norm(points - near, axis=1))
    return best


def test_closest_point_against_brute_force():
    mesh = trimesh.creation.torus(1.0, 0.4, major_sections=12, minor_sections=7)
    solid = prepare_mesh(mesh)
    points = np.random.default_rng(3).uniform(-2, 2, (300, 3))
    points[:20] = solid.vertices[:20]
    distance2, face, closest, side = solid.closest_points(points)
    triangles = solid.vertices[solid.faces]
    np.testing.assert_allclose(
        np.sqrt(distance2), brute_force_distance(points, triangles), atol=1e-12
    )
    np.testing.assert_allclose(
        np.linalg.norm(points - closest, axis=1), np.sqrt(distance2), atol=1e-12
    )
    on_face = trimesh.triangles.closest_point(triangles[face], closest)
    np.testing.assert_allclose(on_face, closest, atol=1e-12)
    assert (side[:20] == 0).all()
    ring = np.hypot(np.hypot(points[20:, 0], points[20:, 1]) - 1.0, points[20:, 2])
    clear = np.abs(ring - 0.4) > 0.1
    np.testing.assert_array_equal(side[20:][clear], np.where(ring < 0.4, -1, 1)[clear])


def test_side_at_sharp_edges_and_corners():
    solid = prepare_mesh(trimesh.creation.box((1, 1, 1)))
    points = np.random.default_rng(4).uniform(-1, 1, (2000, 3))
    inside = (np.abs(points) < 0.5).all(axis=1)
    side = solid.closest_points(points)[3]
    np.testing.assert_array_equal(side, np.where(inside, -1, 1))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_closest_point_of_no_place_is_refused(value):
    solid = prepare_mesh(trimesh.creation.icosphere(1))
    with pytest.raises(InputError, match="points: point 1 is not finite"):
        solid.closest_points([[0.0, 0.0, 0.0], [0.0, value, 0.0]])


def test_sliver_and_zero_area_triangles_have_a_closest_point():
    box = trimesh.creation.box((1, 1, 1))
    # A vertex in the middle of an edge of one face only: a T-junction closed by a flat face.
    vertices = np.concatenate([box.vertices, [0.5 * (box.vertices[0] + box.vertices[1])]])
    flat = [[0, 8, 1], [1, 8, 0]]
    solid = prepare(vertices, np.concatenate([box.faces, flat]))
    assert np.isfinite(solid.closest_points(np.zeros((1, 3)))[0]).all()
    assert solid.volume == pytest.approx(1.0)


def boxes(*bounds):
    return trimesh.util.concatenate([trimesh.creation.box(bounds=b) for b in bounds])


def test_parts_that_touch_or_coincide_stay_closed():
    below = trimesh.creation.box(bounds=[[0, 0, 0], [1, 1, 1]])
    above = trimesh.Trimesh([0, 0, 2] + [1, 1, -1] * below.vertices, below.faces[:, ::-1])
    touching = prepare_mesh(trimesh.util.concatenate([below, above]))
    assert touching.volume == pytest.approx(2.0)
    assert touching.report["duplicate_faces"] == 4
    # Both stand on one square: its faces are there twice, wound alike, and both stay.
    standing = prepare_mesh(boxes([[0, 0, 0], [1, 1, 1]], [[0, 0, 0], [1, 1, 2]]))
    assert standing.volume == pytest.approx(3.0)
    assert standing.report["duplicate_faces"] == standing.report["open_edges"] == 0


@pytest.mark.parametrize("copies", [[1], [-1], [1, 1], [-1, 1]])
def test_a_repeated_face_stays_whichever_way_its_copies_wind(sphere, copies):
    patch = sphere.faces[40:44]
    repeated = [patch[:, ::copy] for copy in copies]
    solid = prepare(sphere.vertices, np.concatenate([sphere.faces, *repeated]))
    assert solid.report["duplicate_faces"] == 4 * len(copies)
    assert solid.report["open_edges"] == 0
    assert solid.volume == pytest.approx(sphere.volume, rel=1e-12)
