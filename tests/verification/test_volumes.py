"""Volumes of voxel models against geometry: solids, layers, boxes on the grid, part-filled voxels.

Twenty voxels across, 8^3 samples; meshes so fine that their own error is a third of that allowed.
"""

import numpy as np
import pytest
import trimesh

from solids import box_with_hole
from tledface import _core
from tledface.geometry import voxelise

ACROSS, SAMPLES = 20, 8
VOLUME, LAYER = 2e-3, 1e-2
R, TUBE = 0.01, 0.0035  # m
INNER = 0.6 * R
TURN = trimesh.transformations.euler_matrix(0.3, 0.5, 0.7)
BOX = np.array([0.02, 0.02, 0.012])
DUCT = 0.01


def sphere(radius=R):
    return trimesh.creation.icosphere(subdivisions=5, radius=radius)


def torus():
    around, along = 240, 120
    u, v = np.meshgrid(
        np.arange(around) / around * 2 * np.pi, np.arange(along) / along * 2 * np.pi, indexing="ij"
    )
    ring = R + TUBE * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), TUBE * np.sin(v)], axis=-1)
    index = np.arange(around * along).reshape(around, along)
    a, b = index, np.roll(index, -1, axis=0)
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    faces = np.concatenate([np.stack(q, axis=-1).reshape(-1, 3) for q in ((a, b, c), (a, c, d))])
    return trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)


def shell():
    """Two nested spheres as one surface, the inner one wound inwards."""
    inner = sphere(INNER)
    inner.invert()
    return trimesh.util.concatenate([sphere(), inner])


def ball(radius):
    return 4 / 3 * np.pi * radius**3


def within_box_with_hole(depth):
    """Volume of the places in the box with a hole deeper than this."""
    x, y, z = BOX - 2 * depth
    return (x * y - (DUCT**2 + 4 * DUCT * depth + np.pi * depth**2)) * z


SHAPES = {
    "sphere": (sphere, lambda d: ball(R - d)),
    "torus": (torus, lambda d: 2 * np.pi**2 * R * (TUBE - d) ** 2),
    "box with a hole": (lambda: box_with_hole(BOX, DUCT), within_box_with_hole),
    "nested spheres": (shell, lambda d: ball(R - d) - ball(INNER + d)),
}
ENDS = (0.05e-3, 1.0e-3)
shapes = pytest.mark.parametrize("shape", SHAPES)


def solid(mesh, turned=True):
    if turned:
        mesh = mesh.copy()
        mesh.apply_transform(TURN)
    return _core.prepare_surface(mesh.vertices, mesh.faces.astype(np.int32), "mesh")


def sampled(surface, voxel, **options):
    given = {"samples": SAMPLES, "fill": 1e-9, "clean": False} | options
    return voxelise(surface, voxel=voxel, **given)


def volume(voxels):
    return voxels.fill.sum() * np.prod(voxels.voxel)


def tissue_volumes(voxels):
    return (voxels.fractions * voxels.fill[:, None]).sum(axis=0) * np.prod(voxels.voxel)


def edge(surface):
    return np.ptp(surface.vertices, axis=0).max() / ACROSS


@shapes
def test_total_volume(shape, figure):
    make, inside = SHAPES[shape]
    surface = solid(make())
    voxels = sampled(surface, edge(surface))
    error = volume(voxels) / inside(0.0) - 1
    figure("error of the volume", abs(error), at_most=VOLUME)


@shapes
def test_total_volume_of_flat_voxels(shape, figure):
    make, inside = SHAPES[shape]
    surface = solid(make())
    voxels = sampled(surface, edge(surface) * np.array([1.0, 1.0, 0.5]))
    error = volume(voxels) / inside(0.0) - 1
    figure("error of the volume", abs(error), at_most=VOLUME)


@shapes
def test_layer_volumes(shape, figure):
    """The first layer is a twentieth of a voxel thick, less than half a sample."""
    make, inside = SHAPES[shape]
    surface = solid(make())
    found = tissue_volumes(sampled(surface, edge(surface), boundaries=ENDS))
    expected = -np.diff([inside(depth) for depth in (0.0, *ENDS)])
    expected = np.array([*expected, inside(ENDS[-1])])
    for layer, error in enumerate(np.abs(found / expected - 1)):
        figure(f"error of layer {layer + 1}'s volume", error, at_most=LAYER)


def test_bone_within_skin(figure):
    voxels = sampled(solid(sphere()), 2 * R / ACROSS, bones=[solid(sphere(INNER))])
    error = volume(voxels) / (ball(R) - ball(INNER)) - 1
    figure("error of the volume", abs(error), at_most=VOLUME)
    overlap = voxels.report["overlaps"]
    assert overlap == []


@pytest.mark.parametrize("samples", [1, 3, 8])
def test_a_box_on_the_grid_is_exact(samples, figure):
    mesh = trimesh.creation.box(bounds=[[0.001, 0.002, 0.003], [0.011, 0.008, 0.006]])
    voxels = sampled(solid(mesh, turned=False), (0.5e-3, 1e-3, 0.25e-3), samples=samples)
    assert len(voxels.cells) == 20 * 6 * 12
    figure("error of the volume", abs(volume(voxels) / mesh.volume - 1), at_most=1e-12)
    figure("largest error of a fraction", np.abs(voxels.fill - 1).max(), at_most=1e-9)


def test_thickness_by_vertex(figure):
    """Thickness linear over a flat top: the layer's volume is that of its mean thickness."""
    side, height = 0.01, 0.005
    n = 11
    mesh = trimesh.creation.box(bounds=[[0, 0, 0], [side, side, height]]).subdivide().subdivide()
    surface = solid(mesh, turned=False)
    x, y = surface.vertices[:, 0] / side, surface.vertices[:, 1] / side
    thickness = 1e-5 * (1 + 2 * x + y)  # 0.01 to 0.04 mm
    top = [((-1, -1, height - 1e-6), (1, 1, height + 1e-6))]
    voxels = sampled(surface, side / (n - 1), boundaries=(thickness, thickness + 1e-3), outer=top)
    found = tissue_volumes(voxels)
    figure("error of the thin layer's volume", abs(found[0] / (2.5e-5 * side**2) - 1), at_most=1e-3)
    figure("error of the next layer's volume", abs(found[1] / (1e-3 * side**2) - 1), at_most=1e-3)
    where = voxels.cells[:, 2] == voxels.cells[:, 2].max()
    centre = voxels.origin + (voxels.cells[where] + 0.5) * voxels.voxel
    expected = 1e-5 * (1 + 2 * centre[:, 0] / side + centre[:, 1] / side) / voxels.voxel[2]
    error = np.abs(voxels.fractions[where, 0] - expected).max() / expected.max()
    figure("largest error of a voxel's share", error, at_most=1e-6)
