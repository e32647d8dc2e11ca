"""The benchmark of model creation: it measures what it says and prints it."""

import json

import pytest
from typer.testing import CliRunner

from tledface import bench_model


def test_a_row_counts_samples_of_voxels_with_tissue():
    row = bench_model.measure(3, 3, voxel=5e-3, repeats=1)
    assert row["triangles"] == 3 * 1280
    assert row["msamples_per_s"] * 1e6 * row["voxelise_s"] == pytest.approx(row["voxels"] * 27)
    # Tissue between balls of 50 and 40 mm, and the voxels that it touches.
    assert 2044 < row["voxels"] < 4000
    assert row["volume_error"] < 0.02


def test_the_verb_prints_a_row_for_each_case(monkeypatch):
    from tledface.cli import app

    monkeypatch.setattr(bench_model, "_SUBDIVISIONS", (4,))
    monkeypatch.setattr(bench_model, "_SAMPLES", (2, 4))
    monkeypatch.setattr(bench_model, "_REPEATS", 1)
    result = CliRunner().invoke(app, ["bench", "--model", "--json"])
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert [row["samples"] for row in printed["rows"]] == [4, 2]
    table = CliRunner().invoke(app, ["bench", "--model"]).stdout.splitlines()
    assert len(table) == 2 + 2 and table[1].split()[-1] == "samples/s"
