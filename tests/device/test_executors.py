"""The same steps on every executor: agreement with float64, between executors, and bit for bit."""

import sys
from pathlib import Path

import numpy as np
import pytest

import tledface as tf

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
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


def test_number_of_bands_does_not_change_a_bit():
    """Threads and bands deal the same rows out differently; the sums stay in one order."""
    model = sparse_model()
    model.gravity = (3.0, -9.81, 5.0)
    results = []
    for n_bands in (1, 2, 3, 7, 11):
        core = tf.simulator._core.Simulator(
            tf.device.resolve("native"),
            tf.simulator.core_model(model),
            precision="single",
            hourglass="physical",
            kappa=0.075,
            damping=0.0,
            n_bands=n_bands,
        )
        core.dt = 0.9 * core.bound_at_rest()[0]
        core.step(60, np.zeros((60, 0)))
        results.append(core.displacement())
    assert abs(results[0]).max() > 0
    for result in results[1:]:
        assert np.array_equal(result, results[0])


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
