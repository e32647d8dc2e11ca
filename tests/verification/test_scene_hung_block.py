"""The block of Hung et al. (2009): what is written, how folds are measured, the paper's trends."""

import numpy as np
import pytest
import trimesh

import hung_scenarios
import tledface as tf
from tledface.examples import hung_block
from tledface.examples._box import box_surface
from tledface.run import run_scene
from tledface.scene import Scene

KPA, MM = 1e3, 1e-3


@pytest.fixture(scope="module")
def blended(tmp_path_factory):
    """All scenarios at 0.5 mm and calcium 0.6, with the base's way to equilibrium."""
    return {
        scenario: hung_scenarios.run(
            tmp_path_factory.mktemp(scenario),
            scenario=scenario,
            calcium=0.6,
            relax=scenario == "base",
        )
        for scenario in hung_block.SCENARIOS
    }


def judge(figure, runs, *, closer):
    """Assert the paper's trends, the fourth only where asked for."""
    assert runs["base"].folds >= 2
    assert runs["base"].depth > 0.2 * MM  # or ratios to it would say little
    assert min(found.smallest_J for found in runs.values()) > 0.9
    even, soft, fat, spacing = (got for _, got, _, _ in hung_scenarios.trends(runs))
    figure("homogeneous skin: depth over the base's", even, at_most=hung_scenarios.HOMOGENEOUS)
    figure("base's depth over that of half the stiffness", 1 / soft, at_most=0.75)
    figure("twice the subcutis: depth over the base's", fat, at_most=0.9)
    if closer:
        figure("half the skin: distance of crests over the base's", spacing, at_most=0.8)


def test_the_papers_trends_hold(blended, figure):
    judge(figure, blended, closer=True)


def test_the_run_ends_near_equilibrium(blended, figure):
    moved = blended["base"].moved / MM
    figure("way from the end of the base's run to equilibrium, mm", moved, at_most=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("voxel", "bending"), [(0.5, "section"), (0.25, "blended"), (0.25, "section")]
)
def test_the_first_three_trends_hold_in_every_form(voxel, bending, tmp_path, figure):
    runs = {
        scenario: hung_scenarios.run(
            tmp_path, scenario=scenario, calcium=0.6, voxel=voxel, bending=bending
        )
        for scenario in hung_block.SCENARIOS
    }
    judge(figure, runs, closer=False)


@pytest.mark.slow
def test_the_answer_does_not_move_when_the_bulk_modulus_doubles(blended, tmp_path, figure):
    base = blended["base"]
    stiffer = hung_scenarios.run(tmp_path, calcium=0.6, bulk_modulus=2000.0)
    figure("distance of crests over that before", stiffer.spacing / base.spacing, 1.0, rel=0.02)
    figure("first crest over that before", stiffer.first_crest / base.first_crest, 1.0, rel=0.02)
    figure("depth over that before", stiffer.depth / base.depth, 1.0, rel=0.08)


def test_the_block_is_that_of_table_1(tmp_path):
    scene = Scene.load(hung_block.write(tmp_path))
    model = scene.build()
    assert model.n_elements == 60 * 22 * 15
    high = model.fractions.sum(axis=0) * model.voxel.prod() / (30 * 11 * MM**2) / MM
    expected = {"stratum corneum": 0.02, "skin": 3.96, "subcutis": 0.96, "frontalis": 2.56}
    assert dict(zip(model.tissues, high, strict=True)) == pytest.approx(expected, abs=4e-3)
    table = {
        "stratum corneum": {"c10": 9400, "c11": 82000, "bulk_modulus": 1e6},
        "skin": {"c10": 9.4, "c11": 82, "bulk_modulus": 1e3},
        "subcutis": {"c10": 3, "bulk_modulus": 1e3},
        "frontalis": {"c10": 10, "c20": 10, "c30": 6.67, "bulk_modulus": 1e3},
    }
    zero = dict.fromkeys(("c01", "c11", "c20", "c30"), 0.0)
    for tissue, material in zip(model.tissues, model.tissue_materials, strict=True):
        constants = {k: v * KPA for k, v in {**zero, **table[tissue]}.items()}
        assert {k: material.parameters[k] for k in constants} == pytest.approx(constants)
    (muscle,) = model.muscles
    assert (muscle.law, muscle.sigma_act) == ("calcium", 100e3)
    assert scene.muscles[0].activation(scene.solver.duration) == 0.9
    wall, bottom = model.node_ijk[:, 0] == 0, model.node_ijk[:, 2] == 0
    assert np.array_equal(model.fixed, np.stack([wall, wall, wall | bottom], axis=1))
    assert model.section_ratio is None


@pytest.mark.parametrize("variant", hung_block.VARIANTS)
def test_every_variant_is_a_scene(variant, tmp_path):
    settings = hung_block.VARIANTS[variant]
    assert variant in hung_block.ABOUT_VARIANTS
    scene = Scene.load(hung_block.write(tmp_path, **settings))
    size = np.array([30, 11, hung_block.thickness(settings.get("scenario", "base"))]) * MM
    cells = size / scene.geometry.voxel
    assert cells == pytest.approx(np.rint(cells))
    assert scene.geometry.voxel == pytest.approx([settings.get("voxel", 0.5) * MM] * 3, rel=0.01)


def test_scenarios_change_what_they_say(tmp_path):
    def layers(scenario):
        scene = Scene.load(hung_block.write(tmp_path, scenario=scenario, calcium=0.6))
        return {x.name: (x.thickness, x.material.parameters) for x in scene.layers}

    base = layers("base")
    even, soft = layers("homogeneous-skin"), layers("soft-skin")
    fat, thin = layers("thick-subcutis"), layers("thin-skin")
    assert even["stratum corneum"] == (0.02 * MM, base["skin"][1])
    assert soft["stratum corneum"] == base["stratum corneum"]
    for term in ("c10", "c11"):
        assert soft["skin"][1][term] == pytest.approx(base["skin"][1][term] / 2)
    assert hung_block.thickness("thick-subcutis") == pytest.approx(7.5 + 0.96)
    assert fat["skin"] == base["skin"]
    assert thin["skin"] == (pytest.approx(1.98 * MM), base["skin"][1])


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"scenario": "old"}, "scenario: got 'old', allowed is one of base, homogeneous-skin"),
        ({"bending": "thin"}, "bending: got 'thin', allowed is one of blended, section"),
        ({"calcium": 1.5}, "calcium: got 1.5, allowed is a level from 0 to 1"),
        ({"calcium": float("nan")}, "calcium: got nan"),
        ({"voxel": 0.0}, "voxel: got 0.0, allowed is above 0 up to 1 mm"),
        ({"bulk_modulus": 10.0}, "bulk_modulus: got 10.0, allowed is 200 kPa or more"),
    ],
)
def test_bad_settings_are_refused(settings, said, tmp_path):
    with pytest.raises(tf.InputError, match=said):
        hung_block.write(tmp_path / "new", **settings)
    assert not (tmp_path / "new").exists()


def test_a_coarse_block_runs_from_start_to_end(tmp_path):
    scene = Scene.load(hung_block.write(tmp_path / "scene", voxel=1.0))
    result = run_scene(scene, tmp_path / "out", device="native", quiet=True)
    surface = trimesh.load(result.files["surface"], process=False)
    found = hung_block.measure(surface.vertices, surface.faces)
    assert 27 * MM < found.end < 29 * MM  # the muscle does pull
    assert found.first_crest > 0.5 * MM


def waves(height):
    """The block's surface with its top moved to a height over x, m."""
    vertices, faces = box_surface((0, 0, 0), (30, 11, 7.5), 0.25)
    top = vertices[:, 2] > 7.4
    vertices[top, 2] += height(vertices[top, 0])
    return vertices * MM, faces


def test_crests_and_troughs_of_known_waves():
    """0.4 (1 - cos) over 6 mm on a slope: crests a little up it, 0.8 mm above the troughs."""
    found = hung_block.measure(*waves(lambda x: 0.4 * (1 - np.cos(2 * np.pi * x / 6)) + 0.02 * x))
    assert len(found.crests) == 5
    assert found.crests[:, 0] / MM == pytest.approx(3 + 6 * np.arange(5), abs=0.26)
    assert found.spacing == pytest.approx(6 * MM, rel=0.02)
    assert found.depth == pytest.approx(0.8 * MM, rel=0.01)
    assert found.first_crest == pytest.approx(0.86 * MM, rel=0.01)
    assert len(found.troughs) == 4
    assert found.end == pytest.approx(30 * MM, rel=1e-3)


def test_a_bulge_is_one_crest_and_ripples_are_none():
    bulge = hung_block.measure(*waves(lambda x: np.sin(np.pi * x / 30)))
    assert (len(bulge.crests), bulge.depth) == (1, 0.0)
    assert np.isnan(bulge.spacing)
    assert bulge.first_crest == pytest.approx(1 * MM, rel=1e-3)
    ripples = hung_block.measure(*waves(lambda x: 0.01 * np.sin(2 * np.pi * x / 3)))
    assert (len(ripples.crests), len(ripples.troughs)) == (0, 0)
    assert np.isnan(ripples.first_crest)


def test_a_dip_at_the_wall_is_no_trough():
    dip = hung_block.measure(*waves(lambda x: -np.sin(2 * np.pi * x / 15)))
    assert dip.crests[:, 0] / MM == pytest.approx([11.25, 26.25], abs=0.26)
    assert dip.troughs[:, 0] / MM == pytest.approx([18.75], abs=0.26)
    assert dip.depth == pytest.approx(2 * MM, rel=0.01)


def test_box_surfaces_are_closed_and_look_outwards():
    for edge in (None, 1.5):
        mesh = trimesh.Trimesh(*box_surface((1, 2, 3), (4, 8, 4), edge), process=False)
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(18.0)
    assert len(mesh.faces) == 2 * 2 * (2 * 4 + 2 * 1 + 4 * 1)
