"""Properties of sampled volumes over many shapes and places, against slow and simple references."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tledface import _core
from tledface.geometry import voxelise

SETTINGS = settings(max_examples=25, deadline=None, derandomize=True)
SOLIDS = {
    "sphere": trimesh.creation.icosphere(subdivisions=2),
    "torus": trimesh.creation.torus(1.0, 0.4, major_sections=16, minor_sections=8),
    "capsule": trimesh.creation.capsule(height=1.0, radius=0.4, count=[10, 10]),
}
solids = st.sampled_from(sorted(SOLIDS))
seeds = st.integers(0, 2**32 - 1)


def prepare(vertices, faces, **options):
    return _core.prepare_surface(vertices, np.asarray(faces, np.int32), "mesh", **options)


def winding(vertices, faces, points):
    """Generalised winding numbers by summing every face's solid angle."""
    total = np.zeros(len(points))
    for face in faces:
        a, b, c = (vertices[v] - points for v in face)
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        top = np.einsum("ij,ij->i", a, np.cross(b, c))
        bottom = (
            la * lb * lc
            + np.einsum("ij,ij->i", a, b) * lc
            + np.einsum("ij,ij->i", b, c) * la
            + np.einsum("ij,ij->i", c, a) * lb
        )
        total += np.arctan2(top, bottom)
    return total / (2 * np.pi)


def lattice(voxels, cells, samples):
    step = (np.arange(samples) + 0.5) / samples
    offsets = np.stack(np.meshgrid(step, step, step, indexing="ij"), axis=-1).reshape(-1, 3)
    return voxels.origin + (cells[:, None] + offsets) * voxels.voxel


@SETTINGS
@given(solid=solids, seed=seeds)
def test_inside_is_that_of_the_solid_angle(solid, seed):
    rng = np.random.default_rng(seed)
    mesh = SOLIDS[solid]
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    vertices = mesh.vertices @ turn.T
    voxels = voxelise(prepare(vertices, mesh.faces), voxel=0.4, samples=2, fill=1e-9, clean=False)
    grid = np.stack(np.meshgrid(*[np.arange(n + 1) for n in voxels.cells.max(axis=0)]), -1)
    points = lattice(voxels, grid.reshape(-1, 3), 2).reshape(-1, 3)
    inside = np.abs(winding(vertices, mesh.faces, points)) > 0.5
    total = voxels.report["volumes"]["skin"]["volume"]
    assert total == pytest.approx(inside.sum() * 0.2**3, rel=1e-12)


@SETTINGS
@given(solid=solids, seed=seeds, height=st.floats(0.2, 0.9))
def test_large_holes_are_closed_as_the_winding_number_says(solid, seed, height):
    """The rim is ragged: a fan over it would not do."""
    rng = np.random.default_rng(seed)
    mesh = SOLIDS[solid]
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    vertices = mesh.vertices @ turn.T
    middles = vertices[mesh.faces].mean(axis=1)
    edge = height * middles[:, 2].max() + rng.uniform(-0.2, 0.2, len(middles))
    kept = trimesh.Trimesh(vertices, mesh.faces[middles[:, 2] < edge], process=False)
    islands = trimesh.graph.connected_components(
        kept.face_adjacency, nodes=np.arange(len(kept.faces)), min_len=1
    )
    faces = kept.faces[max(islands, key=len)]
    bone = prepare(vertices, faces, close_holes=True, hole_limit=0.0)
    frame = trimesh.creation.box((4.0, 4.0, 4.0))
    skin = prepare(frame.vertices, frame.faces)
    voxels = voxelise(skin, voxel=0.5, samples=2, bones=[bone], fill=1e-9, clean=False)
    grid = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = lattice(voxels, grid, 2).reshape(-1, 3)
    inside = np.abs(winding(vertices, faces, points)) > 0.5
    (name,) = (key for key in voxels.report["volumes"] if key != "skin")
    assert voxels.report["volumes"][name]["volume"] == pytest.approx(
        inside.sum() * 0.25**3, rel=1e-12
    )
    assert bone.report["holes_closed"] > 0


@SETTINGS
@given(solid=solids, seed=seeds)
def test_shuffled_faces_and_split_vertices_give_the_same_bits(solid, seed):
    rng = np.random.default_rng(seed)
    mesh = SOLIDS[solid]
    order = rng.permutation(len(mesh.faces))
    relabel = rng.permutation(len(mesh.vertices))
    moved = np.empty_like(mesh.vertices)
    moved[relabel] = mesh.vertices
    shuffled = prepare(moved, np.roll(relabel[mesh.faces[order]], rng.integers(3), axis=1))
    parted = prepare(
        mesh.vertices[mesh.faces[order]].reshape(-1, 3), np.arange(3 * len(order)).reshape(-1, 3)
    )
    options = dict(voxel=(0.3, 0.2, 0.25), boundaries=(0.01, 0.2), samples=3, fill=0.3)
    first = voxelise(prepare(mesh.vertices, mesh.faces), **options)
    for other in (shuffled, parted):
        second = voxelise(other, **options)
        for name in ("cells", "fill", "weight", "fractions", "first", "second", "normal"):
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)
        assert first.report == second.report


whole_box = st.tuples(*[st.integers(0, 5)] * 3, *[st.integers(1, 4)] * 3)


@SETTINGS
@given(boxes=st.lists(whole_box, min_size=1, max_size=4), samples=st.integers(1, 4))
def test_boxes_on_the_grid_are_exact_whatever_they_overlap(boxes, samples):
    cells = np.zeros((9, 9, 9), dtype=bool)
    parts = []
    for x, y, z, *size in boxes:
        low = np.array([x, y, z])
        high = low + size
        cells[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
        parts.append(trimesh.creation.box(bounds=[low * 0.5, high * 0.5]))
    joined = trimesh.util.concatenate(parts)
    voxels = voxelise(
        prepare(joined.vertices, joined.faces), voxel=0.5, samples=samples, clean=False
    )
    expected = np.argwhere(cells) * 0.5
    found = voxels.origin + voxels.cells * 0.5
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(voxels.fill, 1.0, atol=1e-9)
