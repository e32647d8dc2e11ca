"""The time-step bound against the true limit 2/omega_max of the assembled operator."""

import numpy as np
import pytest
import tledface as tf
from scenes import soft
from tledface.errors import InputError


def true_limit(sim):
    """2 / sqrt of the largest eigenvalue of M^-1 K, K by central differences of the forces."""
    model = sim.model
    n = model.n_nodes
    free = ~model.fixed.ravel()
    base = sim.u
    stiffness = np.empty((3 * n, 3 * n))
    step = 1e-9
    for dof in range(3 * n):
        moved = np.zeros(3 * n)
        moved[dof] = step
        sim.set_state(base + moved.reshape(n, 3))
        force = sim.internal_force().ravel()
        sim.set_state(base - moved.reshape(n, 3))
        stiffness[:, dof] = (force - sim.internal_force().ravel()) / (2 * step)
    sim.set_state(base)
    root = np.sqrt(np.repeat(sim.mass, 3))
    operator = (stiffness / root[:, None] / root)[np.ix_(free, free)]
    return 2 / np.sqrt(np.linalg.eigvalsh((operator + operator.T) / 2).max())


def block(cells, size, material=None):
    return tf.Model.block(cells=cells, size=size, material=material or soft())


def film():
    model = block((5, 5, 3), (2.5e-3, 2.5e-3, 1.5e-3))
    model.set_material(lambda c: c[:, 2] > 1e-3, soft(2e6))
    return model


def muscle():
    model = block((4, 3, 3), (2e-3, 1.5e-3, 1.5e-3))
    model.add_muscle("m", np.ones(36, bool), fibre=(1, 0, 0), sigma_act=1e6, sigma_pas=1e6)
    return model


@pytest.mark.parametrize(
    ("make", "least"),
    [
        (lambda: block((1, 1, 1), (1e-3, 1e-3, 1e-3)), 0.97),
        (lambda: block((4, 4, 4), (2e-3, 2e-3, 2e-3)), 0.65),
        (lambda: block((4, 3, 2), (4e-3, 1.5e-3, 0.5e-3)), 0.7),
        (lambda: block((3, 3, 3), (3e-3, 3e-3, 3e-3), soft(poissons_ratio=0.3)), 0.7),
        (film, 0.65),
    ],
    ids=["one element", "cube", "flat boxes", "compressible", "film"],
)
def test_bound_is_below_the_true_limit(make, least):
    sim = tf.Simulator(make(), precision="double")
    limit = true_limit(sim)
    assert least * limit <= sim.dt_crit <= limit * 1.0001


@pytest.mark.parametrize("activation", [0.0, 0.3, 1.0])
def test_bound_allows_for_a_fully_active_muscle(activation):
    """The fibres' steepest slope is taken at all times: half the limit at full activation."""
    sim = tf.Simulator(muscle(), precision="double")
    sim.activate("m", activation)
    limit = true_limit(sim)
    assert sim.dt_crit <= limit * 1.0001
    assert sim.dt_crit >= {0.0: 0.3, 0.3: 0.4, 1.0: 0.55}[activation] * limit


@pytest.mark.parametrize("squeeze", [0.5, 0.75, 1.3])
def test_bound_follows_the_strain(squeeze):
    model = block((3, 3, 3), (1.5e-3, 1.5e-3, 1.5e-3))
    sim = tf.Simulator(model, precision="double")
    lateral = squeeze**-0.5
    F = np.diag([squeeze, lateral, lateral])
    sim.set_state(model.nodes @ (F - np.eye(3)))
    limit = true_limit(sim)
    assert 0.6 * limit <= sim.dt_crit <= limit * 1.0001


def test_runs_at_the_bound_and_not_beyond():
    """A free cube shaken a little: its swing stays at the bound, grows at 1.1 times the limit."""
    model = block((3, 3, 3), (3e-3, 3e-3, 3e-3))
    rng = np.random.default_rng(1)
    velocity = 1e-3 * rng.standard_normal((model.n_nodes, 3))
    probe = tf.Simulator(model, precision="double")
    limit = true_limit(probe)

    def swing(dt, steps):
        core = tf.Simulator(model, precision="double")._core
        core.dt = dt
        core.set_state(np.zeros_like(velocity), velocity, 0.0)
        core.step(steps, np.zeros((steps, 0)))
        # The velocities' momentum makes the cube drift and turn; its strain does not.
        F = core.element_state(np.zeros(0))["deformation_gradient"].reshape(-1, 3, 3)
        return abs(F.transpose(0, 2, 1) @ F - np.eye(3)).max()

    early = swing(probe.dt_crit, 100)
    assert early > 1e-6
    assert swing(probe.dt_crit, 20000) < 5 * early
    assert not swing(1.1 * limit, 1000) < 100 * early  # grown, or no longer a number


def test_a_step_above_the_bound_is_refused():
    with pytest.raises(InputError, match=r"dt: got .* above the stable bound .* tissue"):
        tf.Simulator(film(), dt=1e-4)


def test_mass_scaling_lengthens_the_step_by_its_root():
    plain = tf.Simulator(film(), precision="double")
    heavy = tf.Simulator(film(), precision="double", mass_scaling=4.0)
    assert heavy.dt == pytest.approx(2 * plain.dt, rel=1e-12)
    assert heavy.mass == pytest.approx(4 * plain.mass, rel=1e-12)
