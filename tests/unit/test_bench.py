"""The workload that shows what uniform blocks are worth: what stands where, what is reported."""

import numpy as np
import pytest

import tledface as tf
from tledface import bench

CELLS = (32, 16, 2)


@pytest.mark.parametrize("laws", [2, 4])
def test_blocks_hold_one_law_or_all(executor, laws):
    """Counted in the solver's own blocks; the same elements of each law in both arrangements."""
    for interleaved in (False, True):
        for fast_axis in (0, 1):
            model = bench.law_block(laws, interleaved=interleaved, fast_axis=fast_axis, cells=CELLS)
            assert (model.fractions.sum(axis=0) == model.n_elements / laws).all()
            if fast_axis != 0:
                continue
            sim = tf.Simulator(model, **executor.kwargs)
            assert sim.axis_order[0] == 0
            block = np.asarray(sim._core.node_slots())[model.elements[:, 0]] // sim._core.lanes
            law = model.fractions.argmax(axis=1)
            held = [len(set(law[block == b])) for b in np.unique(block)]
            assert set(held) == ({min(laws, sim._core.lanes)} if interleaved else {1})


def test_laws_are_equally_stiff_at_rest():
    p = bench.law_block(4, interleaved=True, cells=CELLS).element_parameters()
    for name in ("mu", "bulk"):
        assert p[name] == pytest.approx(p[name][0], rel=1e-9)


def test_both_arrangements_compute_the_same_block(executor):
    """Swapping which element has which law swaps cost only: each element's force is its law's."""
    models = [bench.law_block(4, interleaved=i, cells=CELLS) for i in (False, True)]
    F = np.array([[1.05, 0.1, 0.0], [0.0, 0.96, 0.02], [0.0, 0.0, 1.03]])
    by_law = []
    for model in models:
        sim = tf.Simulator(model, precision="double", **executor.kwargs)
        sim.set_state(model.nodes @ (F - np.eye(3)).T)
        stress, law = sim.stress(), model.fractions.argmax(axis=1)
        by_law.append(np.array([stress[law == k][0] for k in range(4)]))
    assert by_law[0] == pytest.approx(by_law[1], rel=1e-12, abs=1e-9)
    assert len({round(s[0], 3) for s in by_law[0]}) == 4


def test_rates_of_a_measurement_follow_from_its_time():
    result = bench.measure(bench.flat_block((20, 10, 9)), "native")
    n, seconds = 20 * 10 * 9, 1e-3 * result["ms_per_step"]
    assert result["elements"] == n and result["bitwise_repeatable"]
    assert result["melem_steps_per_s"] == pytest.approx(1e-6 * n / seconds)
    assert result["effective_bytes"] == pytest.approx(1e9 * result["copy_gb_s"] * seconds / n)


def test_measure_laws_reports_rates_and_their_ratio():
    result = bench.measure_laws(4, "native", cells=CELLS)
    assert result["laws"] == [
        "mooney_rivlin", "ogden", "holzapfel_gasser_ogden", "neo_hookean_coupled",
    ]  # fmt: skip
    rates = [result[name]["melem_steps_per_s"] for name in ("uniform", "interleaved")]
    assert result["gain"] == pytest.approx(rates[0] / rates[1])
    assert result["elements"] == np.prod(CELLS)
    assert f"{result['gain']:.2f}" in bench._law_table([result])
