"""A scene that subcycles: frames, what is said of the step, refused values."""

import json

import pytest

from tledface.errors import InputError
from tledface.examples import flat_block
from tledface.run import run_scene
from tledface.scene import Scene


def coarse(tmp_path, subcycling):
    """The flat block, coarse, for 4 ms."""
    path = flat_block.write(tmp_path, voxel=3.0, voxel_height=1.5, triangle=4.0)
    text = path.read_text().replace("[solver]", f"[solver]\nsubcycling = {subcycling}")
    text = text.replace('duration = "50 ms"', 'duration = "4 ms"').replace(
        "fps = 200", "fps = 1000"
    )
    path.write_text(text)
    return path


def test_a_run_has_the_frames_of_one_without(tmp_path):
    results = []
    for name, subcycling in (("without", "false"), ("with", "4")):
        (tmp_path / name).mkdir()
        scene = Scene.load(coarse(tmp_path / name, subcycling))
        results.append(run_scene(scene, tmp_path / name / "run", device="native", quiet=True))
    alike, own = results
    assert own.substeps == 4 and alike.substeps == 1
    assert own.frames == alike.frames == 5
    assert own.steps == pytest.approx(alike.steps / 4, abs=1.5)
    assert own.max_displacement == pytest.approx(alike.max_displacement, rel=0.02)
    facts = json.loads((tmp_path / "with" / "run" / "run.json").read_text())
    assert facts["result"]["substeps"] == 4
    assert "(4 short ones each; bound at rest" in own.text()
    assert "short ones" not in alike.text()


@pytest.mark.parametrize("value", ["3", '"yes"', "1.5", "-2"])
def test_other_values_are_refused(tmp_path, value):
    with pytest.raises(
        InputError, match=r"subcycling: got .*; allowed: true, false, 1, 2, 4, 8, 16"
    ):
        Scene.load(coarse(tmp_path, value))
