"""The physical hourglass form has the bending and twisting stiffness of linear elasticity."""

import numpy as np
import pytest

import tledface as tf
from scenes import rotation, soft

E, NU = 50e3, 0.3


def one_layer(h=(0.5e-3, 0.7e-3, 0.3e-3)):
    return tf.Model.block(cells=(6, 5, 1), size=(6 * h[0], 5 * h[1], h[2]), material=soft(E, NU))


def energy(model, u, **options):
    sim = tf.Simulator(model, precision="double", **options)
    sim.set_state(u)
    return sim, (sim.hourglass_energy() * np.prod(model.voxel)).sum()


def test_bending_energy_of_a_plate_one_element_thick():
    """u = curvature (x z, 0, -x^2/2): the energy of a plate strip, E/(1 - nu^2) h^3/12 per area."""
    model = one_layer()
    X = model.nodes - model.nodes.mean(axis=0)
    curvature = 1e-3
    u = curvature * np.stack([X[:, 0] * X[:, 2], 0 * X[:, 0], -(X[:, 0] ** 2) / 2], axis=1)
    _, got = energy(model, u)
    h = model.voxel
    expected = 0.5 * E / (1 - NU**2) * curvature**2 * h[2] ** 3 / 12 * 30 * h[0] * h[1]
    assert got / expected == pytest.approx(1.0, rel=1e-4)  # of 1e-18 J: approx allows 1e-12


def test_bending_both_ways_couples_by_poissons_ratio():
    model = one_layer()
    X = model.nodes - model.nodes.mean(axis=0)
    k = 1e-3
    u = k * np.stack(
        [X[:, 0] * X[:, 2], X[:, 1] * X[:, 2], -(X[:, 0] ** 2 + X[:, 1] ** 2) / 2], axis=1
    )
    _, got = energy(model, u)
    h = model.voxel
    expected = 0.5 * E / (1 - NU**2) * (2 + 2 * NU) * k**2 * h[2] ** 3 / 12 * 30 * h[0] * h[1]
    assert got / expected == pytest.approx(1.0, rel=1e-4)  # of 1e-18 J: approx allows 1e-12


def test_twisting_energy_of_a_plate_one_element_thick():
    """u = twist (y z, x z, -x y): 2 mu twist^2 h^3/12 per area (Kirchhoff plate)."""
    model = one_layer()
    X = model.nodes - model.nodes.mean(axis=0)
    twist = 1e-3
    u = twist * np.stack([X[:, 1] * X[:, 2], X[:, 0] * X[:, 2], -X[:, 0] * X[:, 1]], axis=1)
    _, got = energy(model, u)
    h = model.voxel
    mu = E / (2 * (1 + NU))
    expected = 0.5 * mu * (2 * twist) ** 2 * h[2] ** 3 / 12 * 30 * h[0] * h[1]
    assert got / expected == pytest.approx(1.0, rel=1e-4)  # of 1e-18 J: approx allows 1e-12


@pytest.mark.parametrize("component", range(3))
def test_energy_of_the_xyz_mode_is_the_chosen_one(component):
    """V E/288 (s/h)^2 of the displacement's sum s: a choice, for there is no plate to go by."""
    h = np.array([0.5e-3, 0.7e-3, 0.3e-3])
    model = tf.Model.block(cells=(1, 1, 1), size=tuple(h), material=soft(E, NU))
    u = np.zeros((8, 3))
    u[:, component] = 1e-7 * np.sign(model.nodes - model.nodes.mean(axis=0)).prod(axis=1)
    _, got = energy(model, u)
    expected = np.prod(h) * E / 288 * (8e-7 / h[component]) ** 2
    assert got / expected == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("shape", [(1e-3, 1e-3, 1e-3), (2e-3, 1e-3, 1e-3), (1e-3, 2e-3, 4e-3)])
def test_forces_turn_with_the_body(executor, shape):
    """Randomly deformed boxes: forces after a rotation are the rotated forces, to round-off."""
    rng = np.random.default_rng(7)
    cells = (3, 2, 2)
    model = tf.Model.block(
        cells=cells, size=tuple(np.multiply(cells, shape)), material=soft(E, 0.45)
    )
    u = 0.15e-3 * rng.standard_normal((model.n_nodes, 3))
    Q = rotation((1.0, -2.0, 0.7), 1.9)
    sim = tf.Simulator(model, precision="double", **executor.kwargs)
    sim.set_state(u)
    before = sim.internal_force()
    sim.set_state((model.nodes + u) @ Q.T - model.nodes)
    after = sim.internal_force()
    assert abs(after - before @ Q.T).max() <= 1e-12 * abs(before).max() * 10
    # No net force and, with the centre term, no net torque either.
    torque = np.cross(model.nodes + u, before).sum(axis=0)
    reach = abs(model.nodes).max() * abs(before).max()
    assert abs(before.sum(axis=0)).max() <= 1e-12 * abs(before).max()
    assert abs(torque).max() <= 1e-12 * reach * 10


@pytest.mark.parametrize("hourglass", ["physical", "joldes"])
def test_forces_are_the_gradient_of_the_energy(executor, hourglass):
    """Central differences of strain + hourglass energy, float64."""
    rng = np.random.default_rng(11)
    model = tf.Model.block(cells=(2, 2, 1), size=(2e-3, 1e-3, 1.5e-3), material=soft(E, 0.4))
    u = 0.1e-3 * rng.standard_normal((model.n_nodes, 3))
    sim = tf.Simulator(model, precision="double", hourglass=hourglass, **executor.kwargs)

    def total(u):
        sim.set_state(u)
        return (sim.strain_energy() + sim.hourglass_energy()).sum() * np.prod(model.voxel)

    sim.set_state(u)
    force = sim.internal_force()
    step = 1e-8
    for node, component in [(0, 0), (4, 1), (7, 2), (13, 0), (17, 2)]:
        moved = np.zeros_like(u)
        moved[node, component] = step
        slope = (total(u + moved) - total(u - moved)) / (2 * step)
        assert slope == pytest.approx(force[node, component], rel=1e-5, abs=1e-6 * abs(force).max())
