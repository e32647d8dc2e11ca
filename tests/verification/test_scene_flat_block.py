"""The flat block of Warburton & Maddock and its variants: which skin folds, and how finely.

Short: strips of the block, 12 mm wide, while their folds form. The whole blocks to the end of the
contraction are the long version, but for the reference, which is the main job of it all.

Rounding (float64, another executor, a start that is off by 1e-10 m) moves the figures of a strip by
1e-4 of them, and the height of the thin strip's folds by 7 %: tolerances are some times that.
"""

import json

import pytest

from tledface.examples import flat_block
from tledface.folds import measure_folds
from tledface.run import run_scene, simulator_of
from tledface.scene import Scene

# s, of 50 ms: activation 0.225.
FORMING = 0.015


@pytest.fixture(scope="module")
def forming(tmp_path_factory):
    """Folds of the strip of each variant at the time ``FORMING``, and its greatest movement, m."""
    found = {}
    for variant, keywords in flat_block.VARIANTS.items():
        folder = tmp_path_factory.mktemp(variant)
        scene = Scene.load(flat_block.write(folder, width=12.0, **keywords))
        model = scene.build()
        sim = simulator_of(scene, model, "native")
        sim.run(until=FORMING)
        u = sim.u
        folds = measure_folds(model, "skin", u, {"frontalis": 1.0}, scene.geometry.outer)
        found[variant] = folds, abs(u).max()
    return found


@pytest.fixture(scope="module")
def folded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flat-block")
    scene = Scene.load(flat_block.write(folder / "scene"))
    return run_scene(scene, folder / "out", quiet=True)


def test_strip_folds(forming, figure):
    folds, _ = forming["reference"]
    figure("folds while they form", folds.count, 4, absolute=0)
    figure("distance of folds, mm", 1e3 * folds.wavelength, 5.92, rel=0.01)
    figure("height of folds, mm", 1e3 * folds.amplitude, 1.31, rel=0.02)


def test_strip_of_one_material_does_not_fold(forming, figure):
    folds, moved = forming["single-material"]
    assert moved > 3e-3  # the muscle does contract
    figure("folds of one skin material", folds.count, at_most=0)


def test_strip_of_thin_voxels_folds_more_finely(forming, figure):
    """Fig. 12 of the paper: the stiff layer is half as thick, so that folds may be half as far."""
    thin, reference = forming["thin"][0], forming["reference"][0]
    figure(
        "thin: folds over those of the reference", thin.count / reference.count, 1.75, absolute=0
    )
    ratio = thin.wavelength / reference.wavelength
    figure("thin: distance over that of the reference", ratio, 0.538, absolute=0.01)
    figure("thin: height of folds, mm", 1e3 * thin.amplitude, 0.85, rel=0.12)


def test_strip_of_young_skin_folds_more_finely(forming):
    """Half the stiffness of the corneum: a little more and a little lower folds."""
    young, reference = forming["young"][0], forming["reference"][0]
    assert young.count > reference.count
    assert 0.7 < young.wavelength / reference.wavelength < 0.95
    assert young.amplitude < reference.amplitude


def test_flat_block_folds(folded):
    """Warburton & Maddock's block: at least three folds, 5 to 8 mm apart, a millimetre high."""
    assert (folded.n_elements, folded.n_nodes) == (129_600, 146_410)
    assert folded.folds.count >= 3
    assert 5e-3 <= folded.folds.wavelength <= 8e-3
    assert folded.folds.amplitude > 1e-3
    assert json.loads((folded.directory / "run.json").read_text())["state"] == "finished"
    for path in folded.files.values():
        assert path.stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("variant", [name for name in flat_block.VARIANTS if name != "reference"])
def test_whole_variants(folded, tmp_path, variant):
    scene = Scene.load(flat_block.write(tmp_path / "scene", **flat_block.VARIANTS[variant]))
    result = run_scene(scene, tmp_path / "out", quiet=True)
    assert result.max_displacement > 5e-3
    folds, reference = result.folds, folded.folds
    if variant == "single-material":
        assert folds.amplitude < reference.amplitude / 5
    elif variant == "thin":
        assert result.n_elements == 259_200
        assert folds.count > reference.count
        assert folds.wavelength < 0.9 * reference.wavelength
    else:
        assert folds.wavelength < reference.wavelength
