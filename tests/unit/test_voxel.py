"""Voxels of surfaces: volumes, layers, moments, priorities, cleaning, limits."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh

from solids import box_with_hole
from tledface import _core
from tledface.errors import InputError
from tledface.geometry import memory, section_ratio, voxelise
from tledface.geometry.memory import available_memory


def solid(mesh, name="mesh"):
    return _core.prepare_surface(mesh.vertices, mesh.faces.astype(np.int32), name)


def box(low, high):
    return trimesh.creation.box(bounds=[low, high])


def volume(voxels):
    return voxels.fill.sum() * np.prod(voxels.voxel)


def tissue_volumes(voxels):
    return (voxels.fractions * voxels.fill[:, None]).sum(axis=0) * np.prod(voxels.voxel)


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.icosphere(subdivisions=3),
        trimesh.creation.torus(1.0, 0.35, major_sections=48, minor_sections=24),
        box_with_hole(),
    ],
    ids=["sphere", "torus", "box with a hole"],
)
def test_volume_of_tilted_shapes(mesh):
    turned = mesh.copy()
    turned.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.5, 0.7))
    surface = solid(turned)
    size = np.ptp(surface.vertices, axis=0).max()
    voxels = voxelise(surface, voxel=size / 20, samples=8, fill=1e-9, clean=False)
    assert volume(voxels) == pytest.approx(surface.volume, rel=2e-3)


def test_grid_aligned_box_is_exact():
    surface = solid(box([0.1, -0.2, 1.6], [0.15, -0.17, 1.602]))
    voxels = voxelise(surface, voxel=(5e-4, 1e-3, 2.5e-4), samples=3)
    assert len(voxels.cells) == 100 * 30 * 8
    np.testing.assert_allclose(voxels.fill, 1.0, atol=1e-9)
    assert volume(voxels) == pytest.approx(surface.volume, rel=1e-12)
    keys = [tuple(cell) for cell in voxels.cells.tolist()]
    assert keys == sorted(keys)


def test_two_muscles_share_a_part_of_a_voxel_equally():
    """Both fill the lower half of the voxels: a quarter of each, whatever else is in them."""
    skin = solid(box([0, 0, 0], [2, 2, 1]), "skin")
    muscles = [solid(box([-1, -1, -1], [3, 3, 0.5]), name) for name in "ab"]
    voxels = voxelise(skin, voxel=1.0, muscles=muscles)
    np.testing.assert_allclose(voxels.fractions, np.tile([0.5, 0.25, 0.25], (4, 1)), atol=1e-12)
    assert voxels.fill == pytest.approx(1.0)


@pytest.mark.parametrize(("fill", "layers"), [(0.5, 4), (0.4, 5)])
def test_a_voxel_is_kept_when_filled_to_its_share(fill, layers):
    """The topmost of five layers of voxels is filled to 7/16."""
    surface = solid(box([0, 0, 0], [3, 3, 4 + 7 / 16]))
    voxels = voxelise(surface, voxel=1.0, samples=16, fill=fill)
    assert len(voxels.cells) == 9 * layers and voxels.cells[:, 2].max() == layers - 1


def test_overlapping_and_self_intersecting_parts_are_joined():
    parts = [box([0, 0, 0], [0.6, 1, 1]), box([0.4, 0, 0], [1, 1, 1])]
    voxels = voxelise(solid(trimesh.util.concatenate(parts)), voxel=0.1)
    assert len(voxels.cells) == 1000
    assert volume(voxels) == pytest.approx(1.0, rel=1e-9)


def test_samples_on_vertices_and_upright_faces_leave_no_streaks():
    # With one sample a voxel, columns run through vertices and edges of this octahedron.
    vertices = np.array([[2, 0, 0], [-2, 0, 0], [0, 2, 0], [0, -2, 0], [0, 0, 2], [0, 0, -2.0]])
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    surface = _core.prepare_surface(vertices + 0.0, np.array(faces, np.int32), "octahedron")
    voxels = voxelise(surface, voxel=0.5, samples=1, fill=1e-9, clean=False)
    centres = voxels.origin + (voxels.cells + 0.5) * voxels.voxel
    assert (np.abs(centres).sum(axis=1) <= 2.5).all()
    grid = np.arange(-1.75, 2, 0.5)
    inner = np.abs(np.stack(np.meshgrid(grid, grid, grid))).sum(axis=0) < 2
    assert len(voxels.cells) >= np.count_nonzero(inner)


def test_split_vertices_and_shuffled_faces_give_identical_voxels():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.01)
    order = np.random.default_rng(0).permutation(len(mesh.faces))
    parted = trimesh.Trimesh(
        mesh.vertices[mesh.faces[order]].reshape(-1, 3),
        np.arange(3 * len(order)).reshape(-1, 3),
        process=False,
    )
    options = dict(voxel=1e-3, boundaries=(2e-5, 1.8e-3), fill=0.3)
    first, second = voxelise(solid(mesh), **options), voxelise(solid(parted), **options)
    for name in ("cells", "fill", "fractions", "first", "second", "normal"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


TOP = [((-1, -1, 4.4e-3), (1, 1, 4.6e-3))]


def test_thin_layers_of_a_flat_block_are_exact():
    surface = solid(box([0, 0, 0], [5e-3, 5e-3, 4.5e-3]))
    voxels = voxelise(surface, voxel=5e-4, boundaries=(2e-5, 1.82e-3), outer=TOP)
    by_height = [voxels.fractions[voxels.cells[:, 2] == k] for k in range(9)]
    expected = {8: (0.04, 0.96, 0), 6: (0, 1, 0), 5: (0, 0.64, 0.36), 4: (0, 0, 1), 0: (0, 0, 1)}
    for k, fractions in expected.items():
        np.testing.assert_allclose(by_height[k], np.tile(fractions, (100, 1)), atol=1e-12)
    np.testing.assert_allclose(voxels.normal, np.tile((0, 0, -1.0), (900, 1)), atol=1e-12)


@pytest.mark.parametrize("height", [4.45e-3, 4.7e-3, 4.9e-3])
def test_thin_layer_survives_where_its_voxel_is_left_out(height):
    surface = solid(box([0, 0, 0], [5e-3, 5e-3, height]))
    top = [((-1, -1, height - 1e-6), (1, 1, height + 1e-6))]
    voxels = voxelise(surface, voxel=5e-4, boundaries=(2e-5,), outer=top)
    thickness = voxels.fractions[:, 0].sum() * 5e-4**3 / 25e-6
    filled = height / 5e-4 - voxels.cells[:, 2].max()
    assert thickness == pytest.approx(2e-5 / filled, rel=1e-6)
    tied = section_ratio(voxels, [1.0, 1.0])
    np.testing.assert_allclose(tied, 1.0, rtol=1e-9)


def test_thin_layer_keeps_its_mean_thickness_on_a_slope():
    mesh = box([-8e-3, -8e-3, -3e-3], [8e-3, 8e-3, 3e-3])
    mesh.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.5, 0.7))
    voxels = voxelise(solid(mesh), voxel=5e-4, boundaries=(2e-5,))
    thickness = voxels.fractions[:, 0].sum() * 5e-4**3 / mesh.area
    assert thickness == pytest.approx(2e-5, rel=0.15)


def test_section_ratio_of_two_layers_is_analytic():
    surface = solid(box([0, 0, 0], [5e-3, 5e-3, 4.5e-3]))
    voxels = voxelise(surface, voxel=5e-4, boundaries=(2e-5, 1.82e-3), outer=TOP)
    moduli = np.array([48e6, 81.4e3, 34e3])
    ratio = section_ratio(voxels, moduli)
    h, t = 5e-4, 2e-5
    z = np.array([-h / 2, -h / 2 + t, h / 2])
    stretch, first, second = (moduli[:2] @ np.diff(z**power) / power / h for power in (1, 2, 3))
    expected = 12 * (second - first**2 / stretch) / h**2 / stretch
    np.testing.assert_allclose(ratio[voxels.cells[:, 2] == 8], expected, rtol=1e-9)
    np.testing.assert_array_equal(ratio[voxels.cells[:, 2] == 4], 1.0)


def test_layer_volumes_of_a_sphere():
    radius, thickness = 0.01, (5e-5, 2e-3)
    surface = solid(trimesh.creation.icosphere(subdivisions=5, radius=radius))
    depth = np.cumsum(thickness)
    voxels = voxelise(
        surface, voxel=1e-3, boundaries=depth.tolist(), samples=8, fill=1e-9, clean=False
    )
    radii = np.array([radius, *(radius - depth), 0.0])
    shells = -np.diff(4 / 3 * np.pi * radii**3)
    np.testing.assert_allclose(tissue_volumes(voxels), shells, rtol=0.01)
    centres = voxels.origin + (voxels.cells + 0.5) * voxels.voxel
    layered = np.linalg.norm(centres, axis=1) > 7e-3
    inward = -centres / np.linalg.norm(centres, axis=1)[:, None]
    assert ((voxels.normal * inward).sum(axis=1)[layered] > 0.98).all()


def test_depth_cap_and_region():
    surface = solid(box([0, 0, 0], [10e-3, 10e-3, 10e-3]))
    top = [((-1, -1, 9e-3), (1, 1, 11e-3))]
    capped = voxelise(surface, voxel=1e-3, outer=top, depth=3.25e-3, fill=0.2)
    assert sorted(set(capped.cells[:, 2].tolist())) == [6, 7, 8, 9]
    np.testing.assert_allclose(capped.fill[capped.cells[:, 2] == 6], 0.25, atol=1e-9)
    low, high = (2e-3, -1, -1), (5e-3, 1, 1)
    part = voxelise(surface, voxel=1e-3, region=(low, high))
    assert part.origin[0] == pytest.approx(2e-3)
    assert len(part.cells) == 3 * 100
    with pytest.raises(InputError, match=r"region: .* does not meet the skin"):
        voxelise(surface, voxel=1e-3, region=((1, 1, 1), (2, 2, 2)))


def test_bone_before_muscle_before_skin():
    skin = solid(box([0, 0, 0], [8, 8, 8]))
    bone = solid(box([0, 0, 0], [8, 8, 2]))
    muscle = solid(box([2, 2, 1], [6, 6, 4]))
    other = solid(box([2, 2, 3], [6, 6, 5]))
    voxels = voxelise(skin, voxel=1.0, bones=[bone], muscles=[muscle, other])
    assert voxels.cells[:, 2].min() == 2
    layers, first, second = tissue_volumes(voxels)
    assert (first, second) == (pytest.approx(24.0), pytest.approx(24.0))
    assert layers == pytest.approx(8 * 8 * 6 - 48)


def test_only_the_largest_part_is_kept_and_loose_voxels_go():
    big, far = box([0, 0, 0], [4, 4, 4]), box([6, 0, 0], [8, 2, 2])
    tip = box([1, 1, 4], [2, 2, 6])
    surface = solid(trimesh.util.concatenate([big, far, tip]))
    voxels = voxelise(surface, voxel=1.0)
    assert len(voxels.cells) == 64
    left_out = voxels.report["left_out"]
    assert (left_out["loose"]["voxels"], left_out["unconnected"]["parts"]) == (2, [8])
    assert left_out["loose"]["volume"] == pytest.approx(2.0)
    assert left_out["unconnected"]["volume"] == pytest.approx(8.0)
    sheet = voxelise(solid(box([0, 0, 0], [4, 4, 1])), voxel=1.0)
    assert len(sheet.cells) == 16


def test_refusals():
    surface = solid(box([0, 0, 0], [1, 1, 1]))
    with pytest.raises(InputError, match="outer: none of the 12 faces"):
        voxelise(surface, voxel=0.1, outer=[((5, 5, 5), (6, 6, 6))])
    with pytest.raises(InputError, match="no voxel of"):
        voxelise(surface, voxel=10.0)
    with pytest.raises(InputError, match="samples: got 99"):
        voxelise(surface, voxel=0.1, samples=99)
    with pytest.raises(InputError, match="boundaries must rise"):
        voxelise(surface, voxel=0.1, boundaries=[0.2, 0.1])


def test_too_small_a_voxel_says_how_much_memory_and_what_would_fit(monkeypatch):
    surface = solid(box([0, 0, 0], [0.1, 0.1, 0.1]))
    monkeypatch.setattr(memory, "available_memory", lambda: int(1e9))
    with pytest.raises(InputError) as caught:
        voxelise(surface, voxel=1e-5)
    text = str(caught.value)
    assert "0.01 mm gives about 1e+12 voxels" in text
    assert "GB of memory, 0.9 GB are usable" in text
    fits = float(text.partition("a voxel of ")[2].partition(" mm")[0])
    memory.check_memory((0.1 / (1e-3 * fits)) ** 3, 1, np.full(3, 1e-3 * fits))
    with pytest.raises(InputError, match="would fit"):
        memory.check_memory((0.1 / (0.8e-3 * fits)) ** 3, 1, np.full(3, 0.8e-3 * fits))


ROD = """
import resource, sys
import numpy as np, trimesh
from tledface import _core
from tledface.geometry import voxelise
rod = trimesh.creation.box((1.2, 2e-3, 2e-3))
rod.apply_transform(trimesh.geometry.align_vectors([1, 0, 0], [1, 1, 1]))
solid = _core.prepare_surface(rod.vertices, rod.faces.astype(np.int32), "rod")
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
voxels = voxelise(solid, voxel=5e-4, samples=2)
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
box = np.prod(np.ptp(voxels.cells, axis=0) + 1.0)
print(len(voxels.cells), box, (after - before) * 1024)
"""


def test_memory_goes_with_the_voxels_not_with_their_box():
    out = subprocess.run([sys.executable, "-c", ROD], capture_output=True, text=True, check=True)
    voxels, box, grown = map(float, out.stdout.split())
    assert 3e4 < voxels < 6e4
    assert box > 2e9
    # A byte for each cell of the box would be 2.6 GB.
    assert grown < 2000 * voxels


def test_available_memory_is_known():
    assert 1e7 < available_memory() < 1e15
