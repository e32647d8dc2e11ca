"""The energy ledger: a free vibration keeps its energy, work balances what the body holds."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import tledface as tf
from scenes import soft
from tledface.energy import EnergyWarning
from tledface.errors import InputError

LENGTH = 0.012


def bar(**more):
    model = tf.Model.block(
        cells=(6, 3, 3),
        size=(LENGTH, 0.006, 0.006),
        material=soft(poissons_ratio=0.45, **more),
    )
    model.fix(lambda X: X[:, 0] < 1e-9)
    return model


def swinging(**options):
    model = bar()
    sim = tf.Simulator(model, **options)
    velocity = np.zeros((model.n_nodes, 3))
    velocity[:, 2] = 3.0 * model.nodes[:, 0]
    sim.set_state(np.zeros_like(velocity), velocity)
    return sim


@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_free_vibration_keeps_its_energy_over_100_000_steps(precision):
    sim = swinging(precision=precision, energy_every=500, device="native")
    mass = sim.mass[:, None]
    start = 0.5 * float((mass * sim.velocity**2).sum())
    assert sim.energies["kinetic"] == pytest.approx(start, rel=0.01)
    kinetic = []
    for _ in range(200):
        sim.step(500)
        energies = sim.energies
        total = energies["kinetic"] + energies["strain"] + energies["hourglass"]
        assert total == pytest.approx(start, rel=0.01)
        assert abs(energies["error"]) < 0.01 * start
        kinetic.append(energies["kinetic"])
    assert min(kinetic) < 0.3 * start < 0.7 * start < max(kinetic)  # it does vibrate


def test_energy_is_kept_on_every_executor(executor):
    sim = swinging(energy_every=50, **executor.kwargs)
    sim.step(1000)
    energies = sim.energies
    total = energies["kinetic"] + energies["strain"] + energies["hourglass"]
    assert abs(energies["error"]) < 1e-4 * total


def driven(executor, every):
    """Everything that does work at once: muscle, loads, pressure, moved support, damping."""
    model = bar()
    model.gravity = (0.0, 0.0, -9.81)
    model.pressure(lambda c, n: n[:, 2] > 0.5, lambda t: 300 * np.sin(300 * t))
    model.body_force(np.ones(54, bool), (0.0, 2000.0, 0.0))
    model.prescribe(
        lambda X: X[:, 0] > LENGTH - 1e-9,
        {
            "x": lambda t: -1e-3 * np.sin(100 * t) ** 2,
            "y": lambda t, X: 0.05 * X[:, 2] * (1 - np.cos(150 * t)),
        },
    )
    model.add_muscle("m", lambda c: c[:, 2] < 0.003, fibre=(1, 0, 0), sigma_act=3e4)
    sim = tf.Simulator(model, damping=100.0, energy_every=every, dt=5e-5, **executor.kwargs)
    sim.activate("m", tf.ramp(0, 0.7, 0.02))
    sim.run(until=0.04)
    return sim.energies


def test_work_balances_what_the_body_holds(executor):
    """Within 0.5 % of what passes through with an entry each 4 steps, second order in it."""
    energies = driven(executor, 4)
    for key in ("strain", "muscle_work", "damping", "external"):
        assert abs(energies[key]) > 1e-6, key
    passed = abs(energies["muscle_work"]) + abs(energies["external"])
    assert abs(energies["error"]) < 0.005 * passed
    held = energies["kinetic"] + energies["strain"] + energies["hourglass"]
    done = energies["muscle_work"] + energies["external"] - energies["damping"]
    assert held - done == pytest.approx(energies["error"], abs=1e-5 * passed)


def test_balance_error_falls_with_the_interval(executor):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EnergyWarning)
        errors = [abs(driven(executor, every)["error"]) for every in (2, 8, 32)]
    assert errors[0] < errors[1] < errors[2]


def test_a_balance_that_is_off_warns():
    """Entries too far apart to see the vibration."""
    native = SimpleNamespace(kwargs={"device": "native"})
    with pytest.warns(EnergyWarning, match=r"t = .* s: the energy balance is off by \d+%") as seen:
        driven(native, 64)
    assert len(seen) == 1


def test_hourglass_share_warns_and_names_elements():
    """A pattern of pure hourglass modes."""
    model = bar()
    sim = tf.Simulator(model, energy_every=10)
    ijk = model.node_ijk
    u = np.zeros((model.n_nodes, 3))
    u[:, 0] = 2e-5 * np.where((ijk[:, 1] + ijk[:, 2]) % 2, 1, -1) * (ijk[:, 0] > 0)
    sim.set_state(u)
    with pytest.warns(EnergyWarning, match=r"hourglass energy is \d+% .* elements \d+ \(tissue\)"):
        sim.step(1)


def test_the_ledger_is_asked_for():
    sim = tf.Simulator(bar())
    with pytest.raises(InputError, match="no ledger is kept"):
        _ = sim.energies
    with pytest.raises(InputError, match="energy_every: got 0"):
        tf.Simulator(bar(), energy_every=0)
