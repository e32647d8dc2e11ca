"""Folds measured over a muscle of a block."""

import numpy as np
import pytest

from tledface.constitutive import material
from tledface.folds import measure_folds
from tledface.model import Model

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


def test_the_median_line_stands_for_all(model):
    u = waves(model, 2e-3, 0.012) * (model.nodes[:, 1:2] > 0.0045)
    folds = measure_folds(model, "surface", u, {"pull": 3e6}, TOP)
    assert folds.count == 5


def test_a_flat_surface_has_no_folds(model):
    folds = measure_folds(model, "surface", np.zeros_like(model.nodes), {"pull": 3e6}, TOP)
    assert folds.count == 0
    assert folds.to_dict()["wavelength_m"] is None
    assert folds.text() == "no wrinkles over pull"


def test_nothing_is_measured_without_an_active_muscle(model):
    assert measure_folds(model, "surface", np.zeros_like(model.nodes), {"pull": 0.0}) is None


def test_a_muscle_of_one_voxel_has_no_line_to_measure_along():
    block = Model.block(cells=(6, 4, 4), size=(0.006, 0.004, 0.004), material=SOFT)
    block.add_muscle("dot", np.arange(block.n_elements) == 50, (1, 0, 0), sigma_act=5e4)
    assert measure_folds(block, "surface", np.zeros_like(block.nodes), {"dot": 5e4}) is None
