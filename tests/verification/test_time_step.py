"""The time-step bound against the true limit 2/omega_max of the assembled operator."""

import contextlib

import numpy as np
import pytest

import tledface as tf
from scenes import soft
from tledface import time_step
from tledface.errors import InputError, SimulationError


def true_limit(sim, mass=None):
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
    root = np.sqrt(np.repeat(sim.mass if mass is None else mass, 3))
    operator = (stiffness / root[:, None] / root)[np.ix_(free, free)]
    return 2 / np.sqrt(np.linalg.eigvalsh((operator + operator.T) / 2).max())


def block(cells, size, material=None):
    return tf.Model.block(cells=cells, size=size, material=material or soft())


def film():
    model = block((5, 5, 3), (2.5e-3, 2.5e-3, 1.5e-3))
    model.set_material(lambda c: c[:, 2] > 1e-3, soft(2e6))
    return model


def held_film():
    model = film()
    model.fix(lambda X: X[:, 2] < 1e-9)
    return model


def muscle():
    model = block((4, 3, 3), (2e-3, 1.5e-3, 1.5e-3))
    model.add_muscle("m", np.ones(36, bool), fibre=(1, 0, 0), sigma_act=1e6, sigma_pas=1e6)
    return model


MODELS = {
    "one element": lambda: block((1, 1, 1), (1e-3, 1e-3, 1e-3)),
    "cube": lambda: block((4, 4, 4), (2e-3, 2e-3, 2e-3)),
    "flat boxes": lambda: block((4, 3, 2), (4e-3, 1.5e-3, 0.5e-3)),
    "compressible": lambda: block((3, 3, 3), (3e-3, 3e-3, 3e-3), soft(poissons_ratio=0.3)),
    "film": film,
    "held film": held_film,
}
# Of the true limit: what the estimate must reach, and what it must not pass.
LEAST, MOST = 0.9, 1.0 + 1e-9


def check(sim):
    limit = true_limit(sim)
    assert LEAST * limit <= sim.dt_crit <= MOST * limit
    # What the watch takes for granted between its iterations.
    assert sim._core.limit_now(sim._activations_now(), enough=0.0)[0] <= MOST * limit


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS.keys())
@pytest.mark.parametrize("hourglass", ["physical", "joldes"])
def test_estimate_is_just_below_the_true_limit(make, hourglass):
    check(tf.Simulator(make(), precision="double", hourglass=hourglass))


@pytest.mark.parametrize("name", MODELS)
def test_pseudo_masses_put_the_limit_at_a_step_of_one_or_above(name):
    """They are those of the nodes' bound, which of a single element is the limit itself."""
    sim = tf.Simulator(MODELS[name](), device="native", precision="double")
    limit = true_limit(sim, np.asarray(sim._core.relaxation_masses()))
    assert 1.0 - 1e-6 <= limit <= (1.0 + 1e-6 if name == "one element" else 1.6)


def test_a_pseudo_step_moves_nodes_by_force_over_their_pseudo_mass(executor):
    model = block((4, 3, 3), (4e-3, 3e-3, 3e-3))
    model.fix(lambda X: X[:, 2] < 1e-9)
    model.gravity = (1.0, -2.0, 9.81)
    sim = tf.Simulator(model, precision="double", **executor.kwargs)
    core, nothing = sim._core, np.zeros((1, 0))
    mass = np.linspace(1.0, 2.0, model.n_nodes)
    core.begin_relaxation(mass)
    core.relax(np.array([[0.0, 1.0, 1.0]]), nothing, nothing, np.empty(0))
    core.end_relaxation()
    moved = np.where(model.fixed, 0.0, sim.mass[:, None] * model.gravity / mass[:, None])
    np.testing.assert_allclose(sim.u, moved, rtol=1e-12)


@pytest.mark.parametrize("activation", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(
    "F",
    [
        np.eye(3),
        np.diag([0.65, 1.2, 1.25]),
        np.diag([0.5, 1.4, 1.45]),
        np.diag([1.3, 0.88, 0.87]),
        np.array([[0.8, 0.3, 0.0], [0.0, 1.1, 0.1], [0.0, 0.0, 1.1]]),
    ],
    ids=["rest", "contracted", "squeezed", "stretched", "sheared"],
)
def test_estimate_with_the_activation_and_stretch_of_now(activation, F):
    model = muscle()
    sim = tf.Simulator(model, precision="double")
    sim.activate("m", activation)
    sim.set_state(model.nodes @ (F - np.eye(3)).T)
    check(sim)


def test_estimate_for_a_muscle_that_has_contracted():
    model = muscle()
    model.fix(lambda X: X[:, 0] < 1e-9)
    sim = tf.Simulator(model, precision="double")
    sim.activate("m", 0.5)
    assert sim.relax(1e-4).converged
    assert sim.u[:, 0].min() < -0.2 * 2e-3
    check(sim)


@pytest.mark.parametrize("squeeze", [0.5, 0.75, 1.3])
def test_bound_follows_the_strain(squeeze):
    model = block((3, 3, 3), (1.5e-3, 1.5e-3, 1.5e-3))
    sim = tf.Simulator(model, precision="double")
    lateral = squeeze**-0.5
    F = np.diag([squeeze, lateral, lateral])
    sim.set_state(model.nodes @ (F - np.eye(3)))
    check(sim)


def contracted():
    """A muscle at half its activation, found by relaxation; its state and activation."""
    model = muscle()
    model.fix(lambda X: X[:, 0] < 1e-9)
    sim = tf.Simulator(model, precision="double")
    sim.activate("m", 0.5)
    assert sim.relax(1e-6).converged
    return model, sim.u, 0.5


def at_rest(make):
    model = make()
    return model, np.zeros((model.n_nodes, 3)), None


@pytest.mark.parametrize(
    "start",
    [lambda: at_rest(MODELS["cube"]), lambda: at_rest(film), contracted],
    ids=["cube", "film", "contracted muscle"],
)
def test_stable_just_below_the_estimate_and_not_beyond_the_limit(start):
    """Shaken a little: the swing stays at 0.95 of the estimate, grows at 1.1 times the limit."""
    model, u, activation = start()
    rng = np.random.default_rng(1)
    velocity = 1e-4 * rng.standard_normal((model.n_nodes, 3)) * ~model.fixed
    probe = tf.Simulator(model, precision="double")
    activations = np.zeros(0) if activation is None else np.full(1, activation)
    if activation is not None:
        probe.activate("m", activation)
    probe.set_state(u)
    limit, estimate = true_limit(probe), probe.dt_crit

    def strain(core):
        F = core.element_state(activations)["deformation_gradient"].reshape(-1, 3, 3)
        return F.transpose(0, 2, 1) @ F

    def swing(dt, steps):
        core = tf.Simulator(model, precision="double")._core
        core.dt = dt
        core.set_state(u, velocity, 0.0)
        before = strain(core)
        core.step(steps, np.tile(activations, (steps, 1)))
        # The velocities' momentum makes a free body drift and turn; its strain does not.
        return abs(strain(core) - before).max()

    early = swing(0.95 * estimate, 100)
    assert early > 1e-7
    assert swing(0.95 * estimate, 20000) < 10 * early
    assert not swing(1.1 * limit, 1000) < 100 * early  # grown, or no longer a number


def test_an_automatic_step_is_eight_tenths_of_the_limit_at_rest():
    sim = tf.Simulator(muscle())
    assert sim.dt == pytest.approx(0.8 * sim.dt_crit, rel=1e-6)


def test_a_step_above_the_bound_is_refused():
    limit = tf.Simulator(film()).dt_crit
    for dt in (1.01 * limit, 1e-4):
        with pytest.raises(InputError, match=r"dt: got .* above the stable bound .* tissue"):
            tf.Simulator(film(), dt=dt)
    assert tf.Simulator(film(), dt=0.99 * limit).dt == 0.99 * limit


def test_mass_scaling_lengthens_the_step_by_its_root():
    plain = tf.Simulator(film(), precision="double")
    heavy = tf.Simulator(film(), precision="double", mass_scaling=4.0)
    assert heavy.dt == pytest.approx(2 * plain.dt, rel=1e-12)
    assert heavy.mass == pytest.approx(4 * plain.mass, rel=1e-12)


def test_selective_mass_scaling_adds_only_where_it_is_needed():
    model = held_film()
    plain = tf.Simulator(model, precision="double")
    assert plain.added_mass == tf.time_step.AddedMass(0.0, 0.0, 0)
    wanted = 2 * plain.dt
    sim = tf.Simulator(model, precision="double", mass_scaling={"dt": wanted})
    assert sim.dt >= wanted
    added = sim.added_mass
    hard = model.centres[:, 2] > 1e-3
    assert added.elements == hard.sum()
    gained = sim.mass - plain.mass
    assert added.kg == pytest.approx(gained.sum(), rel=1e-9)
    assert added.share == pytest.approx(gained.sum() / plain.mass.sum(), rel=1e-9)
    assert (gained[model.nodes[:, 2] < 0.9e-3] == 0.0).all()
    assert sim.dt_crit <= true_limit(sim)
    # A uniform factor for the same step is heavier.
    uniform = tf.Simulator(model, precision="double", mass_scaling=(wanted / plain.dt) ** 2)
    assert uniform.added_mass.kg > 1.5 * added.kg


@pytest.mark.parametrize("scaling", [5.0, {"dt": 3e-6}])
def test_mass_scaling_leaves_the_weight_as_it_is(scaling):
    """The same sag in equilibrium, and the weight on the supports."""
    model = held_film()
    model.gravity = (0.0, 1.0, -9.81)
    sims = [tf.Simulator(model, precision="double", mass_scaling=s) for s in (None, scaling)]
    assert sims[1].added_mass.kg > 0
    for sim in sims:
        assert sim.relax(1e-6).converged
        weight = 1100 * np.prod([2.5e-3, 2.5e-3, 1.5e-3])
        assert sim.reaction(lambda X: X[:, 2] < 1e-9) == pytest.approx(
            [0, -weight, 9.81 * weight], rel=1e-4, abs=1e-5 * weight
        )
    assert abs(sims[0].u - sims[1].u).max() < 1e-5 * abs(sims[0].u).max()


@pytest.mark.parametrize("scaling", [0.5, -1.0, {"dt": 0.0}, {"step": 1e-6}, {}, True, "big"])
def test_bad_mass_scaling_is_named(scaling):
    with pytest.raises(InputError, match="mass_scaling: got"):
        tf.Simulator(film(), mass_scaling=scaling)


@pytest.mark.parametrize("over", [1e-3, 4e-3])
def test_auto_dt_follows_a_rising_activation(over):
    """Fast ramps stay finite, and dt comes down before the limit does."""
    model = muscle()
    model.fix(lambda X: X[:, 0] < 1e-9)
    sim = tf.Simulator(model)
    sim.activate("m", tf.ramp(0, 1, over))
    first = sim.dt
    while sim.time < 6e-3:
        sim.step(40)
        assert sim.dt <= sim.dt_crit
    assert sim.dt < 0.8 * first


def test_an_activation_that_nobody_saw_coming_is_looked_at_before_its_first_step():
    model = muscle()
    model.fix(lambda X: X[:, 0] < 1e-9)
    sim = tf.Simulator(model, damping=500.0, device="native")
    sim.step(300)  # looks are some hundred steps apart by now
    relaxed = sim.dt
    sim.activate("m", 1.0)
    sim.step(1)
    assert sim.dt < 0.9 * relaxed
    assert sim.dt <= sim.dt_crit


def test_auto_dt_comes_back_when_the_body_does():
    """Squeezed by 40 % and let go: down in time, and up again to the step of rest, no further."""
    model = tf.Model.block((8, 4, 4), (4e-3, 2e-3, 2e-3), soft(50e3, 0.45))
    model.fix(lambda X: X[:, 0] < 1e-9)
    over = 150e-3
    model.prescribe(
        lambda X: X[:, 0] > 4e-3 - 1e-9,
        {"x": lambda t: -1.6e-3 * np.sin(np.pi * min(t / over, 1.0)) ** 2},
    )
    sim = tf.Simulator(model, damping=500.0, device="native")
    first, lowest = sim.dt, sim.dt
    while sim.time < 1.5 * over:
        sim.step(100)
        assert sim.dt <= sim.dt_crit
        lowest = min(lowest, sim.dt)
    assert lowest < 0.7 * first
    assert 0.8 * first < sim.dt <= first
    assert abs(sim.u).max() < 1e-6


def test_iterations_wait_where_steps_are_cheap(monkeypatch, tmp_path):
    """As on a GPU: between two of them the nodes' bound lowers dt, in time, by what it is worse."""

    def run(pause, until=0.03):
        monkeypatch.setitem(time_step._PAUSE, "native", pause)
        model = muscle()
        model.fix(lambda X: X[:, 0] < 1e-9)
        sim = tf.Simulator(model, damping=500.0, device="native")
        sim.activate("m", tf.ramp(0, 0.6, 0.02))
        rest = sim._core.limit_iterations
        sim.run(until=until)
        return sim, sim._core.limit_iterations - rest

    often, n_often = run(0)
    never, n_never = run(1 << 20)
    some, n_some = run(400)
    assert n_never == 0 and 0 < n_some < n_often
    assert n_some <= some.n_steps // 400
    for sim in (often, never, some):
        assert sim.dt <= sim._core.measured_limit([0.6])[0]
    assert often.dt > never.dt > 0.6 * often.dt
    assert abs(never.u - often.u).max() < 1e-3 * abs(often.u).max()
    half, _ = run(400, until=0.008)
    half.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    own = ("_core", "_name_of")
    seen, restored = (
        {key: value for key, value in vars(sim._watch).items() if key not in own}
        for sim in (half, again)
    )
    np.testing.assert_equal(restored, seen)
    assert seen["pace"] > 0
    again.run(until=0.03)
    assert again.n_steps == some.n_steps and np.array_equal(again.u, some.u)


def test_a_given_dt_above_the_limit_of_now_warns_once():
    model = muscle()
    model.fix(lambda X: X[:, 0] < 1e-9)
    dt = 0.99 * tf.Simulator(model).dt_crit
    sim = tf.Simulator(model, dt=dt, damping=500.0)
    sim.activate("m", tf.ramp(0, 0.2, 0.02))
    match = r"near element \d+ \(m\), at t = "
    with (
        pytest.warns(tf.time_step.StepWarning, match=match) as seen,
        contextlib.suppress(SimulationError),
    ):
        sim.run(until=0.02)
    assert len(seen) == 1
