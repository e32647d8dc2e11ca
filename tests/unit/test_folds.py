"""Folds measured over a muscle of a block."""

import numpy as np
import pytest

from tledface.constitutive import material
from tledface.folds import measure_folds
from tledface.metrics import MIN_PROMINENCE, line_profile, wrinkles
from tledface.model import Model
from tledface.surface import BoundSurface, boundary_surface

SOFT = material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)


@pytest.fixture(scope="module")
def model():
    block = Model.block(cells=(60, 12, 4), size=(0.06, 0.012, 0.004), material=SOFT)
    block.add_muscle("pull", lambda x: x[:, 2] < 0.002, (1, 0, 0), sigma_act=5e6)
    block.add_muscle("other", lambda x: x[:, 0] < 0.01, (0, 1, 0), sigma_act=5e6)
    return block


def waves(model, height, wavelength):
    """The top moves up in waves along x; the bottom stays."""
    u = np.zeros_like(model.nodes)
    wave = 0.5 * height * np.cos(2 * np.pi * (model.nodes[:, 0] - 0.03) / wavelength)
    u[:, 2] = wave * (model.nodes[:, 2] / 0.004)
    return u


TOP = [((0.0, 0.0, 0.0039), (0.06, 0.012, 0.005))]


def test_waves_along_the_strongest_muscle_are_measured(model):
    folds = measure_folds(model, "surface", waves(model, 2e-3, 0.012), {"pull": 3e6}, TOP)
    assert folds.muscle == "pull"
    assert folds.count == 5
    assert folds.wavelength == pytest.approx(0.012, rel=0.05)
    assert folds.amplitude == pytest.approx(2e-3, rel=0.25)
    assert "mm apart" in folds.text()
    # Pulled by all its voxels: one with more of them outdoes one of more stress.
    both = {"pull": 3e6, "other": 5e6}
    assert measure_folds(model, "surface", waves(model, 2e-3, 0.012), both, TOP).muscle == "pull"


def test_the_median_line_stands_for_all(model):
    """Of nine lines 2.4 to 9.6 mm across, with waves over most of them and over two."""
    for beyond, count in ((0.0045, 5), (0.0085, 0)):
        u = waves(model, 2e-3, 0.012) * (model.nodes[:, 1:2] > beyond)
        assert measure_folds(model, "surface", u, {"pull": 3e6}, TOP).count == count


def test_a_flat_surface_has_no_folds(model):
    folds = measure_folds(model, "surface", np.zeros_like(model.nodes), {"pull": 3e6}, TOP)
    assert folds.count == 0
    assert folds.line[0][1] == pytest.approx(0.006)  # the one in the middle
    assert folds.to_dict()["wavelength_m"] is None
    assert folds.text() == "no wrinkles over pull"


def slope(x):
    """The top of a block that rises along x, m."""
    return 0.004 + 0.1 * x


@pytest.fixture(scope="module")
def sloped():
    """Voxels of 1 mm under a sloped skin: steps of a voxel, 10 mm apart."""
    ijk = np.argwhere(np.ones((60, 12, 10), dtype=bool))
    cells = ijk[1e-3 * (ijk[:, 2] + 0.5) < slope(1e-3 * (ijk[:, 0] + 0.5))]
    block = Model.from_voxels(
        [1e-3] * 3, (0, 0, 0), cells, ["skin"], [SOFT], np.ones((len(cells), 1))
    )
    block.add_muscle("pull", lambda x: x[:, 2] < 0.002, (1, 0, 0), sigma_act=5e6)
    x, y = np.meshgrid(np.linspace(0, 0.06, 121), np.linspace(0, 0.012, 25), indexing="ij")
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    top = np.stack([x, y, slope(x)], -1).reshape(-1, 3)
    block.surfaces["skin"] = BoundSurface.on(block, top, faces)
    block.surfaces["voxels"] = boundary_surface(block)
    return block


def thickened(model):
    """Strained through the thickness by 0.4, in the outermost voxels by less: they are free."""
    u, z = np.zeros_like(model.nodes), model.nodes[:, 2]
    highest = np.full(62, -np.inf)
    column = np.round(1e3 * model.nodes[:, 0]).astype(int)
    np.maximum.at(highest, column, z)
    u[:, 2] = 0.4 * z - 0.15 * np.maximum(z - highest[column] + 1e-3, 0.0)
    return u


@pytest.mark.parametrize("surface", ["skin", "voxels"])
def test_steps_of_voxels_are_no_folds(sloped, surface):
    u = thickened(sloped)
    rest = sloped.surfaces[surface]
    ends = (np.array([0.005, 0.006, 0.0]), np.array([0.055, 0.006, 0.0]))
    line = line_profile(rest.displaced(u), rest.faces, *ends, 1e-4)[1]
    assert wrinkles(line, 1e-4).count > 2  # of which nothing else takes notice
    above = [((0.001, 0.001, 0.0035), (0.059, 0.011, 0.02))]
    folds = measure_folds(sloped, surface, u, {"pull": 3e6}, above)
    assert folds.count == 0
    step = 1e-3 * (4 / 3 if surface == "voxels" else 1 / 3)
    assert folds.min_prominence == pytest.approx(step, rel=0.15)
    assert folds.to_dict()["min_prominence_m"] == folds.min_prominence
    u += waves(sloped, 3e-3, 0.012)
    assert measure_folds(sloped, surface, u, {"pull": 3e6}, above).count == 5


def test_level_layers_of_voxels_have_no_steps(model):
    folds = measure_folds(model, "surface", waves(model, 2e-4, 0.012), {"pull": 3e6}, TOP)
    assert folds.count > 2
    assert folds.min_prominence == MIN_PROMINENCE


def test_nothing_is_measured_without_an_active_muscle(model):
    assert measure_folds(model, "surface", np.zeros_like(model.nodes), {"pull": 0.0}) is None


def test_a_muscle_of_one_voxel_has_no_line_to_measure_along():
    block = Model.block(cells=(6, 4, 4), size=(0.006, 0.004, 0.004), material=SOFT)
    block.add_muscle("dot", np.arange(block.n_elements) == 50, (1, 0, 0), sigma_act=5e4)
    assert measure_folds(block, "surface", np.zeros_like(block.nodes), {"dot": 5e4}) is None
