"""Where nodes stand in memory: the shape of a block, and which axes blocks lie in."""

from itertools import permutations

import numpy as np
import pytest

import tledface as tf
from conftest import EXECUTORS, Executor

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


def test_forces_of_a_comb(executor):
    """Gaps of a block and more, teeth thinner than one: all executors have the same forces."""
    if executor == EXECUTORS[0]:
        pytest.skip("the one that others are compared with")
    i, j, k = np.indices((37, 14, 6)).reshape(3, -1)
    # A comb: teeth of two, three and five voxels, gaps of a chunk and more, one spine.
    tooth = (i < 2) | ((i >= 9) & (i < 12)) | ((i >= 21) & (i < 26)) | (i >= 35)
    cells = np.column_stack([i, j, k])[tooth | (j < 3)]
    model = tf.Model.from_voxels(
        (1e-3,) * 3, (0.0, 0.0, 0.0), cells, ["skin"], [SKIN], np.ones((len(cells), 1))
    )
    x = model.nodes / 5e-3
    bent = 2e-4 * np.column_stack([np.sin(x[:, 1]), np.cos(x[:, 2]), np.sin(x[:, 0] + x[:, 1])])
    forces = []
    for each in (EXECUTORS[0], executor):
        sim = tf.Simulator(model, dt=1e-6, precision="double", **each.kwargs)
        sim.step(3)
        sim.set_state(bent, np.zeros_like(bent))
        sim.step(2)
        forces.append(sim.internal_force())
    assert abs(forces[1] - forces[0]).max() <= 1e-10 * abs(forces[0]).max()
