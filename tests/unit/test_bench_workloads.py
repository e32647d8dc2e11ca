"""Workloads beside the roofline: what they are made of, what is counted, what is reported."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import tledface as tf
from tledface import _core, bench, bench_workloads
from tledface._core_model import core_model
from tledface.cli import app

SMALL = {"flat-block": 1_500, "face": 3_000, "armadillo": 1_000, "slab": 4_000}
KEYS = (
    "device workload elements sliding_nodes ms_per_step melem_steps_per_s copy_gb_s "
    "effective_bytes roofline_fraction bitwise_repeatable driver load_average thread_ratio "
    "per_kernel launches_per_step fill energy float64_error peak_memory_mb"
)
SMALL |= {"dense-block": 4_000, "sparse-shell": 3_000}


def quick(workload, device="native", **options):
    given = {"elements": SMALL[workload], "rounds": 2, "seconds": 0.002, "array_mb": 4}
    options = {**given, **options}
    return bench_workloads.measure(workload, device, **options)


@pytest.mark.parametrize("workload", SMALL)
def test_each_workload_is_checked_and_reported(workload, executor):
    row = quick(workload, executor.device, kernels=executor.kernels)
    assert row["workload"] == workload and row["kernels"] == executor.kernels
    assert row["elements"] == pytest.approx(SMALL[workload], rel=0.35)
    assert row["bitwise_repeatable"] is True
    assert 0 < row["float64_error"] < 1e-3
    assert abs(row["energy"]["error"]) < row["energy"]["bound"] and row["energy"]["holds"]
    assert row["energy"]["elements"] == row["elements"]
    assert (row["muscle_elements"] > 0) == (workload != "armadillo")
    assert (row["sliding_nodes"] > 0) == (workload == "face")
    for key in ("roofline_fraction", "bytes_fraction", "arithmetic_fraction", "effective_bytes"):
        low, high = row[f"{key}_range"]
        assert 0 < low <= row[key] <= high
    # Of each round the nearer bound.
    assert row["roofline_fraction"] >= max(row["bytes_fraction"], row["arithmetic_fraction"])
    assert row["roofline_fraction_range"][1] == max(
        row[f"{bound}_fraction_range"][1] for bound in ("bytes", "arithmetic")
    )
    launches = {name: kernel["launches"] for name, kernel in row["per_kernel"].items()}
    assert sum(launches.values()) == row["launches_per_step"]
    rows, slides = executor.kernels == "rows", workload == "face"
    assert launches.get("slide_nodes", 0) == (slides and not rows)
    step = next(k for k in launches if k.endswith(("_physical", "_cubes")))
    assert launches[step] == 1 and ("sliding" in step) == (slides and rows)
    assert 0 < row["fill"] <= 1


def test_shares_of_the_roofline_follow_from_what_is_reported():
    """Of a single round, whose medians are its own figures; they are printed with six digits."""
    row = quick("flat-block", rounds=1, checks=False)
    n, seconds = row["elements"], 1e-3 * row["ms_per_step"]
    counted = row["instructions"]
    assert row["floor_instructions"] == pytest.approx(
        sum(counted.values()) - counted["shuffled"], rel=1e-4
    )
    # In float32 nine numbers of a node and 2 bytes of its mass; 2 of an element, 8 of its muscle.
    floor = (9 * 4 + 2) * row["nodes"] / n + 2 + 8 * row["muscle_elements"] / n
    assert row["floor_bytes"] == pytest.approx(floor, rel=1e-4)
    shares = {
        "bytes": floor * n / (1e9 * row["axpy_gb_s"]) / seconds,
        "arithmetic": row["floor_instructions"] * n / (1e9 * row["arithmetic_g_s"]) / seconds,
    }
    for bound, share in shares.items():
        assert row[f"{bound}_fraction"] == pytest.approx(share, rel=1e-4), bound
    assert row["roofline_fraction"] == pytest.approx(max(shares.values()), rel=1e-4)
    assert row["melem_steps_per_s"] == pytest.approx(1e-6 * n / seconds, rel=1e-4)
    assert row["effective_bytes"] == pytest.approx(1e9 * row["copy_gb_s"] * seconds / n, rel=1e-4)


def test_bodies_have_the_sizes_of_the_paper():
    """Table II: armadillo 15 107 elements, 19 698 nodes; forehead 503 530, 118 276 sliding."""
    figure = quick("armadillo", elements=None)
    assert figure["elements"] == pytest.approx(15_107, rel=0.01)
    assert figure["nodes"] == pytest.approx(19_698, rel=0.01)
    face = quick("face", elements=20_000, checks=False)
    assert face["nodes"] / face["elements"] == pytest.approx(629_178 / 503_530, rel=0.03)
    assert face["sliding_nodes"] / face["nodes"] == pytest.approx(118_276 / 629_178, rel=0.12)
    assert face["muscle_elements"] / face["elements"] == pytest.approx(0.3, abs=0.03)
    assert min(map(_core.workload_elements, bench_workloads.LARGE)) >= 16_000_000
    assert _core.workload_elements("face") == 503_452


def counts(model, *, physical=True):
    return _core.operations_per_element(core_model(model), physical=physical, axis_order=(0, 1, 2))


def block(cells, *, muscle=False, sides=(1e-3, 1e-3, 1e-3)):
    fat = tf.material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.45, density=1100.0)
    model = tf.Model.block(cells, tuple(h * n for h, n in zip(sides, cells, strict=True)), fat)
    if muscle:
        model.add_muscle("m", np.ones(model.n_elements, bool), fibre=(1, 0, 0), sigma_act=1e3)
    return model


def test_instructions_are_those_of_the_text():
    """By hand: the hourglass forms differ by what they are written with; a muscle has one root."""
    boxes = block((6, 6, 6), sides=(1e-3, 1.1e-3, 1.2e-3))
    plain, kappa = counts(boxes), counts(boxes, physical=False)
    assert plain["divided"] == kappa["divided"] == 1.0
    assert plain["roots"] == 0.0
    # kappa form: 12 products; physical: 9 for the rows of F^-1, 3 for their factors, 3 x 12 pulled
    # back, 9 moments with their 9 couplings, 9 in twists, 4 x 9 back and 4 x 9 at the centre.
    multiplying = {k: plain[k] - kappa[k] for k in ("fused", "multiplied")}
    sums = plain["added"] - kappa["added"]
    assert sum(multiplying.values()) == pytest.approx(129, abs=3)
    assert sums == pytest.approx(18, abs=3)
    # Cubes: no ratios in the three twists (2 each) nor in the three moments of two twists (2
    # each), of which one becomes a multiply-add more; scales all axes share are counted for each.
    cubes = counts(block((6, 6, 6)))
    fewer = sum(plain[k] - cubes[k] for k in ("fused", "multiplied"))
    assert fewer == pytest.approx(11, abs=1)
    muscle = counts(block((6, 6, 6), muscle=True))
    assert muscle["roots"] == 1.0
    assert 30 < sum(muscle.values()) - sum(cubes.values()) < 80


def test_instructions_come_with_elements_nodes_and_columns():
    """What is counted is linear in them: four blocks predict a fifth."""

    def parts(nx, ny, nz):
        return [nx * ny * nz, (nx + 1) * (ny + 1) * (nz + 1), (nx + 1) * (ny + 1), nx * ny]

    blocks = [(4, 4, 2), (4, 4, 6), (8, 3, 4), (2, 7, 3)]
    totals = [sum(counts(block(c)).values()) * np.prod(c) for c in blocks]
    per_part = np.linalg.solve(np.array([parts(*c) for c in blocks], float), totals)
    cells = (5, 6, 7)
    total = sum(counts(block(cells)).values()) * np.prod(cells)
    assert per_part @ parts(*cells) == pytest.approx(total, rel=0.01)


def test_roofline_does_the_mix_that_it_is_asked_for(executor):
    device = _core.open_device(executor.device)
    for wanted in ((1, 0, 0), (150, 100, 130), (70, 50, 115)):
        fused, multiplied, added = wanted
        roofline = _core.Roofline(
            device, is_double=False, nbytes=1 << 20, fused=fused, multiplied=multiplied, added=added
        )
        share = np.array(roofline.mix) / sum(roofline.mix)
        assert share == pytest.approx(np.array(wanted) / sum(wanted), abs=0.05)
        for rate in (roofline.axpy, roofline.copy, roofline.instructions):
            assert rate(0.001) > 0
    with pytest.raises(tf.InputError, match="some multiply-adds"):
        _core.Roofline(device, is_double=False, nbytes=1, fused=0, multiplied=1, added=1)


def test_flatness_is_of_the_sizes_that_no_cache_holds():
    rows = [
        {"ms_per_step": ms, "elements": n, "device_mb": mb, "arithmetic_fraction": share}
        for ms, n, mb, share in ((1, 1e6, 10, 0.9), (12, 1e7, 100, 0.5), (110, 1e8, 900, 0.4))
    ]
    found = bench_workloads.flatness(rows)
    assert found["ns_per_element"] == pytest.approx([1.0, 1.2, 1.1])
    assert found["relative_cost"] == pytest.approx([1 / 0.9, 1 / 0.5, 1 / 0.4])
    assert found["flatness"] == pytest.approx(1.2 / 1.1)
    assert found["relative_flatness"] == pytest.approx(0.5 / 0.4)
    assert bench_workloads.flatness(rows[:2])["flatness"] is None


def quicker(workload):
    return {"elements": SMALL[workload], "rounds": 1, "seconds": 1e-3, "array_bytes": 4 << 20}


@pytest.fixture
def small(monkeypatch):
    real = _core.bench_measure
    monkeypatch.setattr(
        _core,
        "bench_measure",
        lambda device, workload, **given: real(device, workload, **{**given, **quicker(workload)}),
    )


def test_files_hold_the_table_and_its_numbers(small, tmp_path):
    file = tmp_path / "here.json"
    words = ["bench", "--workload", "armadillo", "--sizes", "--device", "native", "-o", str(file)]
    shown = CliRunner().invoke(app, words)
    assert shown.exit_code == 0, shown.output
    result = json.loads(file.read_text())
    assert [row["hourglass"] for row in result["rows"]] == ["physical", "joldes"]
    assert len(result["sizes"]["ns_per_element"]) == len(bench_workloads.SIZES)
    text = file.with_suffix(".md").read_text()
    assert f"{result['rows'][0]['elements']:,} | 0 | physical" in text
    head, _, *shown_rows = (line.split("|")[1:-1] for line in text.splitlines()[2:6])
    for row, cells in zip(result["rows"], shown_rows, strict=True):
        cell = {name.strip(): value.strip() for name, value in zip(head, cells, strict=True)}
        assert cell["of roofline"].startswith(f"{row['roofline_fraction']:.2f} (")
        nearer = max(("bytes", "arithmetic"), key=lambda bound: row[f"{bound}_fraction"])
        assert cell["bound by"] == nearer
        assert cell["M elem-steps/s"] == f"{row['melem_steps_per_s']:.0f}"
    assert all(line in shown.stdout for line in text.splitlines())


def test_json_has_what_outside_readers_rely_on(small, monkeypatch):
    monkeypatch.setattr(bench, "measure", lambda *_, **__: {"ms_per_step": 1.0})
    monkeypatch.setattr(bench, "measure_laws", lambda *_, **__: {})
    monkeypatch.setattr(bench, "measure_sliding", lambda *_, **__: {})
    shown = CliRunner().invoke(app, ["bench", "--device", "native", "--json"])
    assert shown.exit_code == 0, shown.output
    result = json.loads(shown.stdout)
    assert result["voxels_save"] == pytest.approx(1.0 / result["ms_per_step"])
    keys = set(KEYS.split()) - ({"thread_ratio"} if _core.thread_count() == 1 else set())
    assert keys <= set(result)
    assert [r["workload"] for r in result["workloads"]] == ["face", "face"] + 2 * ["armadillo"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--workload brow", "workload: got 'brow', allowed are flat-block, "),
        ("--sizes -o x.txt", "ending '.txt' is not known; allowed: .json"),
        ("--workload face --model", "go one at a time"),
        ("--workload face --device opencl:77", "opencl:77"),
    ],
)
def test_wrong_usage_is_one_line(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["bench", *words.split()])
    assert result.exit_code == 2
    assert message in result.stderr and len(result.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
