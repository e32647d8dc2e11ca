"""What is left out of a voxel model and what overlapping volumes get: choices and their report."""

import re

import numpy as np
import pytest
import trimesh

from tledface import _core
from tledface.errors import InputError
from tledface.geometry import Cleaning, Ranks, voxelise
from tledface.geometry.report import geometry_lines, surface_repairs


def solid(mesh, name="mesh", **options):
    return _core.prepare_surface(mesh.vertices, mesh.faces.astype(np.int32), name, **options)


def box(low, high):
    return trimesh.creation.box(bounds=[low, high])


def tissue_volumes(voxels):
    return (voxels.fractions * voxels.fill[:, None]).sum(axis=0) * np.prod(voxels.voxel)


def left_out(voxels, kind):
    return voxels.report["left_out"][kind]


# -- who has a place -------------------------------------------------------------------------------

SKIN = solid(box([0, 0, 0], [8, 8, 8]), "skin.stl")
BONE = solid(box([0, 0, 0], [8, 8, 2]), "a/bone.stl")
MUSCLE = solid(box([2, 2, 1], [6, 6, 4]), "a/one.stl")
OTHER = solid(box([2, 2, 3], [6, 6, 5]), "a/two.stl")
TOP = [((-1, -1, 7.9), (9, 9, 8.1))]


def overlapping(ranks, **options):
    return voxelise(
        SKIN, voxel=1.0, bones=[BONE], muscles=[MUSCLE, OTHER], ranks=ranks, outer=TOP, **options
    )


def test_an_order_between_muscles():
    first = tissue_volumes(overlapping(Ranks(0, [1, 2], [3])))
    np.testing.assert_allclose(first, [8 * 8 * 6 - 48, 32, 16])
    second = tissue_volumes(overlapping(Ranks(0, [2, 1], [3])))
    np.testing.assert_allclose(second, [8 * 8 * 6 - 48, 16, 32])


def test_muscle_before_bone():
    voxels = overlapping(Ranks(2, [0, 0], [3]))
    np.testing.assert_allclose(tissue_volumes(voxels), [8 * 8 * 6 - 48, 16 + 16 + 8, 24])
    assert voxels.cells[:, 2].min() == 1


def test_a_layer_before_muscle_and_bone():
    # Down to 3.5 the first layer goes before muscle; deeper muscle does; bone comes last of all.
    voxels = overlapping(Ranks(3, [1, 1], [0, 2]), boundaries=(3.5,))
    layer, rest, one, two = tissue_volumes(voxels)
    assert layer == pytest.approx(8 * 8 * 3.5)
    # Muscle two: 3 to 4.5, shared from 3 to 4; muscle one: 1 to 3 alone.
    assert (one, two) == (pytest.approx(16 * 2 + 8), pytest.approx(8 + 8))
    assert rest == pytest.approx(8 * 8 * 4.5 - one - two)
    moments = (voxels.first * voxels.fill[:, None]).sum(axis=1)
    np.testing.assert_allclose(moments[voxels.fill > 1 - 1e-9], 0.0, atol=1e-12)


def test_overlaps_are_reported_with_their_volume():
    beyond = solid(box([6, 6, 6], [10, 7, 7]), "b/one.stl")
    voxels = voxelise(SKIN, voxel=1.0, bones=[BONE], muscles=[MUSCLE, OTHER, beyond])
    report = voxels.report
    shown = [(*pair["names"], pytest.approx(pair["volume"])) for pair in report["overlaps"]]
    assert shown == [("bone.stl", "a/one.stl", 16), ("a/one.stl", "two.stl", 16)]
    # Within the skin's box: what lies beyond it is not sampled.
    assert report["volumes"]["b/one.stl"]["volume"] == pytest.approx(2)
    assert report["volumes"]["skin"]["volume"] == pytest.approx(512)


def test_what_lies_outside_the_skin_is_reported():
    skin = solid(trimesh.util.concatenate([box([0, 0, 0], [8, 8, 4]), box([0, 0, 5], [8, 8, 8])]))
    rod = solid(box([3, 3, 2], [5, 5, 7]), "rod.stl")
    volume = voxelise(skin, voxel=1.0, muscles=[rod]).report["volumes"]["rod.stl"]
    assert volume["volume"] == pytest.approx(20)
    assert volume["outside_skin"] == pytest.approx(4)


def test_a_surface_over_itself_and_inside_out_is_reported():
    parts = [box([0, 0, 0], [4, 4, 4]), box([3, 0, 0], [8, 4, 4])]
    surface = solid(trimesh.util.concatenate(parts))
    assert voxelise(surface, voxel=1.0).report["volumes"]["skin"]["covered_twice"] == 16
    hollow = box([1, 1, 1], [2, 3, 3])
    hollow.invert()
    through = box([3, 1, 1], [7, 3, 3])  # a quarter in, the rest out of the first, wound inwards
    through.invert()
    surface = solid(trimesh.util.concatenate([parts[0], hollow, through]))
    report = voxelise(surface, voxel=1.0).report["volumes"]["skin"]
    assert surface.report["cavities"] == 1
    assert report["covered_twice"] + report["inside_out"] == pytest.approx(4)


def test_gaps_between_volumes_are_reported():
    bone = solid(box([0, 0, 0], [8, 8, 2]), "bone.stl")
    sheet = solid(box([1, 1, 2.4], [7, 7, 3.4]), "sheet.stl")
    high = solid(box([1, 1, 5.0], [7, 7, 7.6]), "high.stl")
    skin = solid(box([-2, -2, -2], [10, 10, 8]), "skin.stl")
    gaps = voxelise(skin, voxel=1.0, bones=[bone], muscles=[sheet, high]).report["gaps"]
    shown = {tuple(gap["names"]): gap["volume"] for gap in gaps}
    # 6 x 6 x 0.4 each, sampled at halves of a voxel; nothing across 1.6.
    assert set(shown) == {("bone.stl", "sheet.stl"), ("high.stl", "skin")}
    assert shown["bone.stl", "sheet.stl"] == pytest.approx(6 * 6 * 0.5)
    assert shown["high.stl", "skin"] == pytest.approx(6 * 6 * 0.5)


# -- how deep, how full ----------------------------------------------------------------------------


def test_depth_by_region():
    surface = solid(box([0, 0, 0], [10, 10, 10]))
    top = [((-1, -1, 9), (11, 11, 11))]
    left, corner = ((-1, -1, -1), (5, 11, 11)), ((-1, -1, -1), (2, 2, 11))
    voxels = voxelise(
        surface, voxel=1.0, outer=top, depth=5.0, depth_in=[(left, 2.5), (corner, 8.0)], fill=0.2
    )
    total = 50 * 5 + (50 - 4) * 2.5 + 4 * 8
    assert tissue_volumes(voxels).sum() == pytest.approx(total)
    assert left_out(voxels, "too_deep")["volume"] == pytest.approx(1000 - total)
    # A box through the middle of voxels: samples decide.
    voxels = voxelise(
        surface, voxel=1.0, outer=top, depth_in=[(((-1, -1, -1), (4.5, 11, 11)), 2.0)], fill=0.2
    )
    assert tissue_volumes(voxels).sum() == pytest.approx(45 * 2 + 55 * 10)


def test_weights_of_partly_filled_voxels():
    """Half of the lowest voxels is bone, a quarter of the highest is outside."""
    skin = solid(box([0, 0, 0], [4, 4, 3.75]))
    bone = solid(box([-1, -1, -1], [5, 5, 0.5]))
    options = dict(voxel=1.0, bones=[bone], fill=0.3)
    for partial, low, high in (("full", 1, 1), ("scaled", 0.5, 0.75), ("bone-full", 1, 0.75)):
        voxels = voxelise(skin, partial=partial, **options)
        level = voxels.cells[:, 2]
        np.testing.assert_allclose(voxels.weight[level == 0], low)
        np.testing.assert_allclose(voxels.weight[level == 3], high)
        np.testing.assert_allclose(voxels.weight[level == 1], 1)
        np.testing.assert_allclose(voxels.fill[level == 0], 0.5)
    with pytest.raises(InputError, match="partial: got 'half', allowed: full, scaled, bone-full"):
        voxelise(skin, partial="half", **options)
    capped = voxelise(skin, voxel=1.0, partial="bone-full", depth=1.25, fill=0.2)
    assert capped.weight.min() == pytest.approx(0.75)


# -- cleaning --------------------------------------------------------------------------------------


def test_loose_and_unconnected_voxels_are_kept_by_choice():
    big, far = box([0, 0, 0], [4, 4, 4]), box([6, 0, 0], [8, 2, 2])
    tip = box([1, 1, 4], [2, 2, 6])
    surface = solid(trimesh.util.concatenate([big, far, tip]))
    for largest_only, least, kept in ((True, 0, 66), (False, 3, 72), (False, 0, 74)):
        cleaning = Cleaning(largest_only=largest_only, min_neighbours=least)
        voxels = voxelise(surface, voxel=1.0, clean=cleaning)
        assert len(voxels.cells) == kept
        loose, parts = left_out(voxels, "loose"), left_out(voxels, "unconnected")
        assert (loose["voxels"], loose["removed"]) == (2, least > 0)
        assert (parts["voxels"], parts["removed"]) == (8, largest_only)
        assert (loose["volume"], parts["volume"]) == (2, 8)


def test_voxels_below_the_fill_are_reported():
    skin = solid(box([0, 0, 0], [4, 4, 3.25]))
    voxels = voxelise(skin, voxel=1.0)
    assert left_out(voxels, "below_fill") == {
        "voxels": 16,
        "volume": pytest.approx(4),
        "removed": True,
    }
    assert voxels.report["tissue_volume"] == pytest.approx(48)


def orbit():
    """A slab of tissue over a bone plate with an edge; tissue runs down behind the edge."""
    skin = box([0, 0, 0], [20, 6, 12])
    bone = box([-1, -1, 4], [10, 7, 8])
    return solid(skin, "skin.stl"), solid(bone, "plate.stl")


def test_tissue_behind_a_bone_edge():
    skin, bone = orbit()
    options = dict(voxel=1.0, bones=[bone], outer=[((-1, -1, 11.9), (21, 7, 12.1))])
    kept = voxelise(skin, **options)
    found = left_out(kept, "behind_bone")
    assert (found["removed"], found["cosine"]) == (False, 0.35)
    cut = voxelise(skin, clean=Cleaning(behind_bone=0.35), **options)
    assert left_out(cut, "behind_bone")["removed"]
    assert len(kept.cells) - len(cut.cells) >= found["voxels"]
    centres = cut.origin + (cut.cells + 0.5) * cut.voxel
    # Over the plate all stays; behind and below its edge nothing does, down to the angle's cosine.
    over = centres[:, 0] < 10
    assert (centres[over, 2] > 8).all() and over.sum() == 10 * 6 * 4
    beside = centres[~over] - [10, 0, 8]
    assert (beside[:, 2] >= 0.35 * np.hypot(beside[:, 0], beside[:, 2]) - 1e-9).all()
    part = Cleaning(behind_bone=0.35, behind_bone_in=[((12, -1, -1), (30, 7, 13))])
    some = voxelise(skin, clean=part, **options)
    assert len(cut.cells) < len(some.cells) < len(kept.cells)


def test_large_holes_by_choice():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    bowl = trimesh.Trimesh(
        ball.vertices, ball.faces[ball.triangles_center[:, 2] < 6], process=False
    )
    with pytest.raises(InputError, match='take holes = "close"'):
        solid(bowl, "bowl.ply")
    surface = solid(bowl, "bowl.ply", close_holes=True)
    assert surface.report["holes_closed"] == 1
    (repair,) = surface_repairs(surface)
    assert re.match(r"bowl\.ply: a large hole closed, [\d.e+]+ mm around; half balls", repair)
    voxels = voxelise(surface, voxel=0.5, boundaries=(0.1,), fill=1e-9, clean=False)
    height = 16.0
    true = np.pi * height**2 * (30 - height) / 3
    assert tissue_volumes(voxels).sum() == pytest.approx(true, rel=0.01)
    # The cut has no layer: that of the bowl is as large as its own outside.
    area = 2 * np.pi * 10 * height
    assert tissue_volumes(voxels)[0] == pytest.approx(0.1 * area, rel=0.02)
    lid = voxels.origin + (voxels.cells + 0.5) * voxels.voxel
    middle = (np.hypot(lid[:, 0], lid[:, 1]) < 5) & (lid[:, 2] > 0)
    assert voxels.fractions[middle, 0].max() == 0.0


def test_a_surface_that_is_mostly_hole_is_refused_all_the_same():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    few = np.random.default_rng(0).permutation(len(ball.faces))[:200]
    with pytest.raises(InputError, match=r"^mesh: the surface is open: its \d+ holes are as large"):
        solid(trimesh.Trimesh(ball.vertices, ball.faces[few], process=False), close_holes=True)


def test_the_report_as_lines():
    bone = solid(box([0, 0, 0], [8, 8, 2.2]), "bone.stl")
    voxels = voxelise(SKIN, voxel=1.0, bones=[bone], muscles=[MUSCLE], depth=3.0, fill=0.9)
    report = {"elements": len(voxels.cells), "repairs": ["a.stl: 2 faces turned"]}
    lines = geometry_lines(voxels.report | report)
    text = "\n".join(f"{label}: {what}" for label, what in lines)
    assert "left out: " in text and " mm3: too deep" in text
    assert "overlap: 20,000,000,000 mm3: bone.stl and one.stl" in text
    assert "repair: a.stl: 2 faces turned" in text
