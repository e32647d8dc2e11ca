"""The block on a curved bone: constant skin, sliding, a forehead's muscles, folds that arch.

Short: the coarse half until its folds stand. The long version has the whole block at full size.
"""

import numpy as np
import pytest

from tledface.errors import InputError
from tledface.examples import curved_block
from tledface.folds import measure_folds
from tledface.geometry import read_surface
from tledface.run import run_scene, simulator_of
from tledface.scene import Scene

# s, of 50 ms: activation 0.3.
SHORT = 0.02
# mm, at that time. Rounding (float64) moves them by 3e-4 at most.
RISE, APART, HIGH = 7.52, 6.31, 1.19


class Contracted:
    """The coarse half at the time ``SHORT``."""

    def __init__(self, folder, **keywords):
        self.folder = folder
        scene = Scene.load(curved_block.write(folder, coarse=True, **keywords))
        self.model = scene.build()
        self.sim = simulator_of(scene, self.model, "native")
        self.sim.run(until=SHORT)
        self.u = self.sim.u
        pulls = {m.name: m.activation(SHORT) for m in scene.muscles}
        self.folds = measure_folds(self.model, "skin", self.u, pulls)

    def distances(self):
        """Of the sliding nodes from the bone, mm: now, and as they were bound."""
        bone = read_surface(self.folder / "bone.ply", unit_scale=1e-3).solid
        sliding = self.model.sliding
        squared, _, _, _ = bone.closest_points((self.model.nodes + self.u)[sliding.nodes])
        return 1e3 * np.sqrt(squared), 1e3 * abs(sliding.distance)

    def moved(self, muscle, low=-1.0, high=0.1):
        """Mean movement of a part of a muscle, mm; the part by height at rest, 0 to 1 upwards."""
        elements = next(m.elements for m in self.model.muscles if m.name == muscle)
        z = self.model.centres[elements, 2]
        share = (z - z.min()) / np.ptp(z)
        part = elements[(share >= low) & (share <= high)]
        return 1e3 * self.u[self.model.elements[part]].mean(axis=(0, 1))


@pytest.fixture(scope="module")
def raised(tmp_path_factory):
    return Contracted(tmp_path_factory.mktemp("raised"))


def test_the_skin_is_equally_thick_everywhere(tmp_path):
    curved_block.write(tmp_path, thickness=5.25)
    skin, bone = (
        read_surface(tmp_path / f"{name}.ply", unit_scale=1e-3).solid for name in ("skin", "bone")
    )
    squared, _, _, _ = bone.closest_points(skin.vertices)
    outside = squared < 7e-3**2  # the inner side is 8 mm from the bone's and 16 from its outer one
    block = (abs(skin.vertices[:, 0]) < 0.048) & (abs(skin.vertices[:, 2]) < 0.048) & outside
    assert np.count_nonzero(block) > 30_000
    assert 1e3 * np.sqrt(squared[block]) == pytest.approx(5.25, abs=0.01)


def test_the_brow_rises_and_the_skin_above_it_folds(raised, figure):
    assert raised.model.n_elements == pytest.approx(61_000, rel=0.02)
    assert np.linalg.det(raised.sim.deformation_gradient()).min() > 0.0
    figure("rise of the brow, mm", raised.moved("frontalis")[2], RISE, rel=0.01)
    figure("folds", raised.folds.count, 3, absolute=0)
    figure("distance of folds, mm", 1e3 * raised.folds.wavelength, APART, rel=0.01)
    figure("height of folds, mm", 1e3 * raised.folds.amplitude, HIGH, rel=0.02)


def test_the_skin_slides_on_the_bone(raised, figure):
    """Thousands of nodes have moved by millimetres, and none has left its distance."""
    slid = 1e3 * np.linalg.norm(raised.u[raised.model.sliding.nodes], axis=1)
    assert np.count_nonzero(slid > 3.0) > 1000
    now, bound = raised.distances()
    figure("distance from the bone, in voxels", abs(now - bound).max() / 0.75, at_most=1e-4)


def test_what_is_held_stays(raised):
    model, z = raised.model, raised.model.nodes[:, 2]
    held = model.fixed.all(axis=1)
    assert not raised.u[held].any()
    assert np.count_nonzero(held & (z == z.max())) > 400  # the upper rim, where the galea ends
    assert abs(raised.moved("frontalis", low=0.9, high=1.0)[2]) < RISE / 2


def test_one_material_does_not_fold(raised, tmp_path):
    plain = Contracted(tmp_path, single_material=True)
    assert plain.moved("frontalis")[2] > raised.moved("frontalis")[2] / 2
    assert plain.folds.count == 0


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"corneum": 2.0}, "curved block corneum: got 2.0, allowed is more than 0 mm, at most 1.8"),
        ({"voxel": 0.0}, "voxel: got 0.0, allowed is more than 0 mm, at most 2 mm"),
        ({"thickness": 9.0}, "thickness: got 9.0, allowed is more than 1.5 mm, at most 8 mm"),
        ({"galea_modulus": -1.0}, "galea_modulus: got -1.0, allowed is more than 0 MPa"),
    ],
)
def test_a_wrong_setting_is_one_line(keywords, message, tmp_path):
    with pytest.raises(InputError, match=message):
        curved_block.write(tmp_path / "scene", **keywords)
    assert not (tmp_path / "scene").exists()


@pytest.mark.slow
def test_whole_block(tmp_path, figure):
    scene = Scene.load(curved_block.write(tmp_path / "scene"))
    result = run_scene(scene, tmp_path / "out", quiet=True)
    figure("elements", result.n_elements, 414_868, rel=0.01)
    assert result.folds.count >= 4
    assert 4e-3 < result.folds.wavelength < 8e-3
    assert result.folds.amplitude > 1e-3
