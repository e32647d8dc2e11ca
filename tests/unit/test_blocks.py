"""Where nodes stand in memory: the shape of a block, and which axes blocks lie in."""

from itertools import permutations

import numpy as np
import pytest

import tledface as tf
from conftest import Executor

SKIN = tf.material("neo_hookean", youngs_modulus=50e3, poissons_ratio=0.45, density=1000.0)


def simulator(shape, executor, precision):
    model = tf.Model.block(shape, tuple(1e-3 * n for n in shape), SKIN)
    return tf.Simulator(model, dt=1e-6, precision=precision, **executor.kwargs), model


@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_block_is_a_patch_of_one_plane(executor, precision):
    """Four along x by the rest along y for vector rows; work-items of one lane stand along x."""
    sim, model = simulator((19, 21, 5), executor, precision)
    core = sim._core
    blocks, lanes = sim.node_slots
    width = min(4, core.lanes) if executor.kernels == "rows" else core.lanes
    ijk = np.rint(model.nodes / 1e-3).astype(int)[:, list(core.axis_order)]
    assert np.array_equal(lanes, ijk[:, 0] % width + ijk[:, 1] % (core.lanes // width) * width)
    places = np.column_stack([ijk[:, 0] // width, ijk[:, 1] // (core.lanes // width), ijk[:, 2]])
    assert len(np.unique(blocks)) == len(np.unique(places, axis=0))
    for block in np.unique(blocks):
        assert len(np.unique(places[blocks == block], axis=0)) == 1


@pytest.mark.parametrize(("thin", "longest"), list(permutations(range(3), 2)))
def test_columns_stand_across_a_sheet(thin, longest):
    """However it lies; bands are cut along its longer side."""
    shape = [24, 24, 24]
    shape[thin], shape[longest] = 3, 48
    sim, _ = simulator(tuple(shape), Executor("native", "rows"), "single")
    order = list(sim._core.axis_order)
    assert (order[0], order[2]) == (longest, thin)
