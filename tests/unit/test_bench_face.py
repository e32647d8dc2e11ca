"""The benchmark's face: what it is made of, that it slides, what is reported."""

import numpy as np
import pytest

from tledface import _core, bench, bench_face, device

ELEMENTS = 10_600  # 48 x 48 columns
VOXEL = 0.5e-3


def test_it_has_the_proportions_of_the_paper():
    """Table II: 503 530 elements, 629 178 nodes, 118 276 of them sliding."""
    body = _core.Workload("face", 103_700)
    assert len(body.sliding_nodes) / body.n_nodes == pytest.approx(118_276 / 629_178, rel=0.1)
    assert body.n_nodes / body.n_elements == pytest.approx(629_178 / 503_530, rel=0.02)
    assert body.n_muscle_elements / body.n_elements == pytest.approx(0.3, abs=0.03)
    assert len(body.sliding_distances) == len(body.sliding_nodes)
    assert abs(body.sliding_distances).max() < 2 * VOXEL


def test_its_nodes_change_triangles_at_the_pace_of_a_brow():
    body = _core.Workload("face", ELEMENTS)
    assert body.speed == 1.2e-6  # 12 mm in 10 000 steps
    sim = bench_face.started(body, device.resolve("native"))
    assert np.linalg.norm(sim.velocity()[body.sliding_nodes], axis=1).mean() * sim.dt == (
        pytest.approx(body.speed, rel=1e-3)
    )
    bench_face.advance(sim, 300)
    moved = np.linalg.norm(sim.displacement()[body.sliding_nodes], axis=1).mean()
    assert moved == pytest.approx(300 * body.speed, rel=0.5)


def test_without_its_bone_its_nodes_leave_it():
    """What the share is a share of: the same body, of which nothing slides."""
    body = _core.Workload("face", ELEMENTS)
    on, off = (
        bench_face.started(body, device.resolve("native"), sliding=sliding)
        for sliding in (True, False)
    )
    assert len(on.sliding_normals()) == len(body.sliding_nodes)
    assert len(off.sliding_normals()) == 0
    for sim in (on, off):
        bench_face.advance(sim, 300)
    u, free = (sim.displacement()[body.sliding_nodes] for sim in (on, off))
    assert np.linalg.norm(free - u, axis=1).max() > 0.1 * 300 * body.speed


def test_measure_sliding_reports_the_share():
    result = bench_face.measure_sliding("native", ELEMENTS)
    assert result["elements"] == pytest.approx(ELEMENTS, rel=0.05)
    assert result["sliding_nodes"] > 0.1 * result["nodes"]
    # The medians of the two times, or of shares turn by turn: the same but for what turns differ.
    by_medians = 1.0 - result["without"] / result["ms_per_step"]
    assert result["sliding_share"] == pytest.approx(by_medians, abs=result["spread"] + 1e-9)
    assert result["ms_per_step"] > 0.0 and result["without"] > 0.0
    assert f"{result['sliding_share']:.0%}" in bench._face_table(result)
    assert 0.0 < result["ms_per_look"] < 1e3
    assert f"{result['ms_per_look']:.2f} ms a look" in bench._face_table(result)
