"""The same steps on every executor: agreement with float64, between executors, and bit for bit."""

import sys
import time
from pathlib import Path

import numpy as np
import pytest

import tledface as tf
from tledface import _core
from tledface._core_model import core_model
from tledface.device import resolve

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
sys.path.insert(0, str(Path(__file__).parent))
from everything import body_of_everything, contracted

from scenes import contracting_block, soft, sparse_model

# Below the bound throughout, so that every run takes the same steps.
DT = 1.8e-6


def run(model, steps, *, dt=DT, **options):
    sim = tf.Simulator(model, dt=dt, **options)
    for muscle in model.muscles:
        sim.activate(muscle.name, tf.ramp(0, 0.75, 0.005))
    sim.step(steps)
    return sim.u


@pytest.fixture(scope="module")
def reference_1000():
    return run(contracting_block(), 1000, precision="double", device="native")


@pytest.mark.parametrize("hourglass", ["physical", "joldes"])
def test_executors_agree_in_float64(executor, hourglass):
    options = {"precision": "double", "hourglass": hourglass}
    model = contracting_block()
    expected = run(model, 100, device="native", **options)
    got = run(model, 100, **options, **executor.kwargs)
    assert abs(expected).max() > 1e-4
    assert abs(got - expected).max() <= 1e-10 * abs(expected).max()


def test_float32_against_float64_after_1000_steps(executor, reference_1000):
    got = run(contracting_block(), 1000, precision="single", **executor.kwargs)
    assert abs(reference_1000).max() > 1e-3
    assert abs(got - reference_1000).max() <= 3e-4 * abs(reference_1000).max()


@pytest.mark.parametrize("precision", ["single", "double"])
def test_two_runs_agree_bit_for_bit(executor, precision):
    options = {"precision": precision, **executor.kwargs}
    first = run(contracting_block(), 300, **options)
    assert np.array_equal(first, run(contracting_block(), 300, **options))


@pytest.mark.parametrize("laws", [True, False], ids=["laws", "no laws"])
@pytest.mark.parametrize("hourglass", ["physical", "joldes"])
def test_executors_agree_on_a_body_of_everything(executor, hourglass, laws):
    """Holes, mixed voxels, laws with a past, muscles, loads, prescribed and sliding nodes."""
    model = body_of_everything(laws=laws)
    options = {"precision": "double", "hourglass": hourglass, "dt": 2e-6}
    expected = contracted(model, device="native", **options)
    got = contracted(model, **options, **executor.kwargs)
    for sim in (expected, got):
        sim.step(300)
    assert abs(expected.u).max() > 2e-4
    assert abs(got.u - expected.u).max() <= 1e-10 * abs(expected.u).max()
    force = expected.internal_force()
    assert abs(got.internal_force() - force).max() <= 1e-10 * abs(force).max()
    past = expected.stress()
    assert abs(got.stress() - past).max() <= 1e-9 * abs(past).max()


def core_of(model, device, **options):
    """A core simulator with the options that the package leaves to it."""
    core = _core.Simulator(
        resolve(device),
        core_model(model),
        hourglass="physical",
        kappa=0.075,
        damping=0.0,
        **options,
    )
    core.dt = 0.9 * core.bound_at_rest()[0]
    return core


def test_number_of_bands_does_not_change_a_bit():
    """Threads and bands deal the same columns out differently; the sums stay in one order."""
    model = sparse_model()
    model.gravity = (3.0, -9.81, 5.0)
    results = []
    for n_bands in (1, 2, 3, 5, 9):
        core = core_of(model, "native", precision="single", n_bands=n_bands)
        core.step(60, np.zeros((60, 0)))
        results.append(core.displacement())
    assert abs(results[0]).max() > 0
    for result in results[1:]:
        assert np.array_equal(result, results[0])


@pytest.mark.parametrize("precision", ["single", "double"])
def test_shape_of_tiles_does_not_change_a_bit(opencl, precision):
    """Tiles deal the same elements out differently, and compute some of them more than once."""
    model = body_of_everything()
    levels = np.full((60, len(model.muscles)), 0.4)
    results = []
    for tile in ((2, 3, 1), (5, 3, 2), (16, 8, 0), (16, 12, 3), (32, 4, 64), (3, 40, 5)):
        core = core_of(model, opencl, precision=precision, kernels="tile", tile=tile)
        core.dt = 2e-6
        core.step(60, levels)
        results.append(core.raw_state())
    assert np.any(results[0]["u"] != results[0]["u_prev"])
    for result in results[1:]:
        for name in ("u", "u_prev", "history"):
            assert np.array_equal(result[name], results[0][name]), name


def test_tiles_too_large_for_the_device_are_refused(opencl):
    for tile, words in (
        ((4096, 4096, 0), "needs work-groups of 16777216"),
        ((1, 8, 0), "got 1 x 8 elements and 0 planes; allowed are 2 x 3"),
        ((16, 8, -1), "got 16 x 8 elements and -1 planes"),
    ):
        with pytest.raises(tf.InputError, match=words):
            core_of(sparse_model(), opencl, precision="single", kernels="tile", tile=tile)


def test_steps_are_enqueued_without_waiting(opencl):
    """The host fills the tables of batches to come while the device computes."""
    none = np.zeros((3 * 256, 0))

    def enqueued_and_whole(*cells):
        size = [1e-3 * n for n in cells]
        model = tf.Model.block(cells=cells, size=size, material=soft())
        core = core_of(model, opencl, precision="single", kernels="tile")
        core.step(8, none[:8])
        core.finish()
        begin = time.perf_counter()
        core.step(len(none), none)
        enqueued = time.perf_counter() - begin
        core.finish()
        return enqueued, time.perf_counter() - begin

    enqueued, whole = enqueued_and_whole(32, 32, 16)
    if enqueued > 0.5 * whole:  # a GPU takes a step of so small a body in less time than a launch
        enqueued, whole = enqueued_and_whole(192, 192, 48)
    assert enqueued < 0.5 * whole, f"{enqueued:.3f} s of {whole:.3f} s"


def test_empty_voxels_stay_out(executor):
    """A model with holes gives finite states and the forces of a dense solver written in NumPy."""
    model = sparse_model()
    rng = np.random.default_rng(5)
    u = 2e-5 * rng.standard_normal((model.n_nodes, 3))
    sim = tf.Simulator(model, precision="double", **executor.kwargs)
    sim.set_state(u)
    assert (
        abs(sim.internal_force() - naive_force(model, u)).max()
        <= 1e-10 * abs(naive_force(model, u)).max()
    )


def test_wild_motion_beside_empty_voxels_makes_no_nan(executor):
    """Two bodies that fly through each other leave wild F in the voxels between them."""
    keep = np.array(
        [[i, j, k] for i in (*range(5), *range(7, 12)) for j in range(3) for k in range(3)],
        np.int32,
    )
    model = tf.Model.from_voxels(
        voxel=np.full(3, 1e-3),
        origin=np.zeros(3),
        cells=keep,
        tissues=["t"],
        tissue_materials=[soft()],
        fractions=np.ones((len(keep), 1)),
    )
    u = np.zeros((model.n_nodes, 3))
    u[model.nodes[:, 0] > 6e-3] = (-8e-3, 2e-3, 50.0)
    sim = tf.Simulator(model, **executor.kwargs)
    sim.set_state(u)
    force = sim.internal_force()
    assert np.isfinite(force).all()
    assert abs(force).max() <= 1e-3
    sim.step(50)
    assert np.isfinite(sim.u).all()


def naive_force(model, u):
    """Forces element by element from stored gradients: no blocks, no transforms, no rows."""
    signs = np.array(
        [[-1, 1, 1, -1, -1, 1, 1, -1], [-1, -1, 1, 1, -1, -1, 1, 1], [-1, -1, -1, -1, 1, 1, 1, 1]],
        float,
    )
    h = model.voxel
    dNdX = signs / (4 * h[:, None])
    V = np.prod(h)
    p = model.element_parameters()
    modes = [signs[0] * signs[1], signs[1] * signs[2], signs[2] * signs[0], signs.prod(axis=0)]
    force = np.zeros_like(u)
    for e, nodes in enumerate(model.elements):
        mu, bulk, nu, young = (p[k][e] for k in ("mu", "bulk", "poissons_ratio", "youngs_modulus"))
        F = np.eye(3) + u[nodes].T @ dNdX.T
        J = np.linalg.det(F)
        inverse = np.linalg.inv(F)
        P = mu * J ** (-2 / 3) * (F - (F**2).sum() / 3 * inverse.T)
        P += bulk / 2 * (J**2 - 1) * inverse.T
        xy, yz, zx, xyz = (inverse @ (u[nodes].T @ m) / h for m in modes)  # q_i / h_i
        bend = V * young / (1 - nu**2) / 48
        g = np.zeros((4, 3))
        for (i, a), (j, b) in (((0, 2), (1, 1)), ((0, 0), (2, 1)), ((1, 0), (2, 2))):
            q = (xy, yz, zx)
            g[a, i] += bend * (q[a][i] + nu * q[b][j])
            g[b, j] += bend * (q[b][j] + nu * q[a][i])
        for (i, a), (j, b) in (((0, 1), (1, 2)), ((1, 2), (2, 0)), ((0, 1), (2, 0))):
            q = (xy, yz, zx)
            both = q[a][i] * h[i] / h[j] + q[b][j] * h[j] / h[i]
            g[a, i] += V * mu / 48 * both * h[i] / h[j]
            g[b, j] += V * mu / 48 * both * h[j] / h[i]
        g[3] = V * young / 144 * xyz
        f = (inverse.T @ (g / h).T).T  # mode forces
        for mode, q in zip(f, (xy, yz, zx, xyz), strict=True):
            P -= np.outer(mode, q * h) / V
        corner = V * P @ dNdX + sum(np.outer(mode, m) for mode, m in zip(f, modes, strict=True))
        np.add.at(force, nodes, corner.T)
    return force
