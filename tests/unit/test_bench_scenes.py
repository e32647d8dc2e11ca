"""The table of scenes beside the paper's: what is measured, what is left out, and its files."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

import tledface as tf
from conftest import REPOSITORY
from tledface import bench_scenes
from tledface.cli import app
from tledface.device import resolve
from tledface.examples import flat_block
from tledface.scene import Scene


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(bench_scenes, "_WARM_UP", 40)
    monkeypatch.setattr(bench_scenes, "_GO_ON", 5)
    monkeypatch.setattr(bench_scenes, "_BATCH", 4)
    monkeypatch.setattr(bench_scenes, "_TIMINGS", 2)


@pytest.fixture
def scene(tmp_path):
    return Scene.load(
        flat_block.write(tmp_path, width=6.0, voxel=1.5, voxel_height=1.5, triangle=3.0)
    )


def test_every_device_goes_on_from_one_contracted_state(quick, scene, executor, monkeypatch):
    """The state that is timed holds a contracted muscle, the same on each device."""
    model = scene.build()
    seen = []

    class Seen(tf.Simulator):
        def step(self, n=1):
            seen.append((self, n, self.u))
            super().step(n)

    monkeypatch.setattr("tledface.simulator.Simulator", Seen)
    devices = [resolve("native"), resolve(executor.device)]
    results = bench_scenes.measure(scene, model, devices, warm_up=40)
    first, second = (
        next(u for sim, n, u in seen if sim is which and n == 5)
        for which in (seen[0][0], seen[-1][0])
    )
    assert abs(first).max() > 1e-6
    assert second == pytest.approx(first, abs=1e-9)
    for result in results:
        assert result["ms_per_step"] > 0
        rate = model.n_elements / result["ms_per_step"] / 1e3
        assert result["melem_steps_per_s"] == pytest.approx(rate)
        assert 0 < result["dt_ms"] < 0.1
    assert [n for sim, n, _ in seen if sim is seen[0][0]][:2] == [40, 5]
    assert results[0]["kernels"] == "rows"


def test_rows_carry_the_paper_s_figures_and_files_hold_both(quick, tmp_path, monkeypatch):
    scenes = (("flat-block", "reference"), ("flat-block", "thin"), ("armadillo-of-mine", "x"))
    monkeypatch.setattr(bench_scenes, "SCENES", scenes)
    small = {"width": 6.0, "voxel": 1.5, "triangle": 3.0}

    def write(folder: Path, *, voxel_height: float = 1.5) -> Path:
        return flat_block.write(folder, voxel_height=voxel_height, **small)

    module = type("module", (), {"write": staticmethod(write), "VARIANTS": {"thin": {}}})
    monkeypatch.setattr(bench_scenes, "shipped", lambda: {"flat-block": module})
    file = tmp_path / "here.json"
    words = ["bench", "--scene", "all", "--device", "native", "-o", str(file)]
    shown = CliRunner().invoke(app, words)
    assert shown.exit_code == 0, shown.output
    result = json.loads(file.read_text())
    reference, thin = result["rows"]
    assert reference["paper"]["ms_per_step"] == 1.48 and thin["paper"] is None
    assert reference["elements"] == 480
    assert list(result["skipped"]) == ["armadillo-of-mine:x"]
    lines = file.with_suffix(".md").read_text().splitlines()
    assert lines[2] == (
        "| flat-block | [W], GTX 680 | 129,600 | 146,410 | not said | 0.005 | 1.48 |"
    )
    assert lines[3].startswith("| flat-block | native kernels")
    assert lines[4].startswith("| flat-block, thin | native kernels")
    assert "Left out: armadillo-of-mine:x" in lines[-1]
    assert lines == [line for line in shown.stdout.splitlines() if line in lines]


@pytest.mark.parametrize("stem", ["epyc-avx2-2-cores", "xeon-emerald-rapids-2-cores"])
def test_kept_results_are_those_of_their_tables(stem):
    """Tables and figures belong together, and name the paper that both stand beside."""
    kept = REPOSITORY / "bench" / "results" / f"{stem}-scenes.json"
    text = bench_scenes.table(json.loads(kept.read_text()))
    assert kept.with_suffix(".md").read_text() == f"{text}\n"
    assert "[W] is Warburton and Maddock (2014), Table II." in text.splitlines()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--scene film", "bench --scene film: no such scene; shipped: "),
        ("--scene flat-block:thick", "'thick': no such variant"),
        ("--scene flat-block -o x.txt", "ending '.txt' is not known; allowed: .json"),
        ("--scene flat-block --device opencl:77", "opencl:77"),
        ("-o x.json", "-o goes with --scene, --workload"),
        ("--data x.ply", "--data goes with --scene"),
        ("--scene film --sizes", "go one at a time"),
    ],
)
def test_wrong_usage_is_one_line(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["bench", *words.split()])
    assert result.exit_code == 2
    assert message in result.stderr and len(result.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
