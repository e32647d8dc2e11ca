"""The benchmark's face: what it is made of, that it slides, what is reported."""

import numpy as np
import pytest

from tledface import bench, bench_face, device

COLUMNS = 48


def test_it_has_the_proportions_of_the_paper():
    """Table II: 503 530 elements, 629 178 nodes, 118 276 of them sliding."""
    model = bench_face.face_shell(150)
    assert len(model.sliding) / model.n_nodes == pytest.approx(118_276 / 629_178, rel=0.1)
    assert model.n_nodes / model.n_elements == pytest.approx(629_178 / 503_530, rel=0.02)
    assert len(model.muscles[0].elements) / model.n_elements == pytest.approx(0.3, abs=0.03)
    assert abs(model.sliding.distance).max() < 2 * bench_face._H


def test_its_nodes_change_triangles_at_the_pace_of_a_brow():
    model = bench_face.face_shell(COLUMNS)
    sim = bench_face.started(model, device.resolve("native"))
    assert np.linalg.norm(sim.velocity[model.sliding.nodes], axis=1).mean() * sim.dt == (
        pytest.approx(bench_face.SPEED, rel=1e-3)
    )
    sim.step(300)
    moved = np.linalg.norm(sim.u[model.sliding.nodes], axis=1).mean()
    assert moved == pytest.approx(300 * bench_face.SPEED, rel=0.5)


def test_measure_sliding_reports_the_share():
    result = bench_face.measure_sliding("native", COLUMNS)
    assert result["sliding_nodes"] > 0.1 * result["nodes"]
    assert result["sliding_share"] < 1.0
    assert result["ms_per_step"] > 0.0 and result["without"] > 0.0
    assert f"{result['sliding_share']:.0%}" in bench._face_table(result)
