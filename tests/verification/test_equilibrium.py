"""Equilibrium by relaxation, reactions, loads: against closed forms and a long damped run."""

import numpy as np
import pytest

import tledface as tf
from scenes import soft, uniaxial
from tledface.errors import InputError

EDGE = 0.01


def low(X):
    return X[:, 2] < 1e-9


def high(X):
    return X[:, 2] > EDGE - 1e-9


def cube(n=6, nu=0.45):
    return tf.Model.block(cells=(n,) * 3, size=(EDGE,) * 3, material=soft(poissons_ratio=nu))


@pytest.mark.parametrize("stretch", [0.6, 0.8, 1.5, 2.0])
def test_bar_pulled_with_free_sides(executor, stretch):
    """Uniform stress: one layer of elements is exact."""
    model = cube()
    model.fix(low, "z")
    model.fix(lambda X: abs(X).max(axis=1) < 1e-9)
    model.fix(lambda X: low(X) & (X[:, 1] < 1e-9), "y")
    model.prescribe(high, {"z": (stretch - 1) * EDGE})
    sim = tf.Simulator(model, precision="double", **executor.kwargs)
    info = sim.relax(1e-6)
    assert info.converged
    assert info.residual <= 1e-6
    assert info.steps < 5000
    p = model.element_parameters()
    lateral, sigma = uniaxial(stretch, p["mu"][0], p["bulk"][0])
    force = sigma * (lateral * EDGE) ** 2
    assert sim.reaction(high)[2] == pytest.approx(force, rel=1e-5)
    assert sim.reaction(low)[2] == pytest.approx(-force, rel=1e-5)
    far, near = (np.argmin(abs(model.nodes - [x, 0, 0]).sum(axis=1)) for x in (EDGE, 0.0))
    assert sim.u[far, 0] - sim.u[near, 0] == pytest.approx((lateral - 1) * EDGE, rel=1e-4)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_relaxed_state_is_at_rest_and_the_clock_stands(executor, precision):
    model = cube()
    model.fix(low)
    model.prescribe(high, {"x": 0.0, "y": 0.0, "z": -0.2 * EDGE})
    sim = tf.Simulator(model, precision=precision, **executor.kwargs)
    info = sim.relax(1e-4)
    assert info.converged
    assert sim.time == 0.0
    assert sim.n_steps == 0
    assert abs(sim.velocity).max() == 0.0
    before = sim.u
    assert before[high(model.nodes), 2] == pytest.approx(-0.2 * EDGE, rel=1e-6)
    sim.step(500)
    assert abs(sim.u - before).max() < 2e-4 * abs(before).max()
    again = sim.relax(1e-4)
    assert again.converged
    assert again.steps < info.steps


def test_relaxation_finds_what_a_long_damped_run_finds(executor):
    def make():
        model = cube(nu=0.49)
        model.fix(low)
        model.add_muscle(
            "m", lambda c: abs(c[:, 1] - EDGE / 2) < EDGE / 4, fibre=(0.6, 0, 0.8), sigma_act=4e4
        )
        model.gravity = (0.0, 3.0, -9.81)
        model.pressure(lambda c, n: n[:, 2] > 0.5, 200.0)
        model.body_force(np.ones(216, bool), (0.0, 5e3, 0.0))
        return model

    slow = tf.Simulator(make(), precision="double", device="native", damping=150.0)
    slow.activate("m", tf.ramp(0, 0.6, 0.02))
    slow.run(until=0.25)
    sim = tf.Simulator(make(), precision="double", **executor.kwargs)
    sim.activate("m", 0.6)
    assert sim.relax(1e-6).converged
    assert abs(sim.u).max() > 0.05 * EDGE
    assert abs(sim.u - slow.u).max() < 1e-4 * abs(sim.u).max()


def test_reactions_balance_weight_and_loads():
    model = cube()
    model.fix(low)
    model.gravity = (0.0, 0.0, -9.81)
    model.body_force(lambda c: c[:, 0] < EDGE / 2, (0.0, 800.0, 0.0))
    sim = tf.Simulator(model, precision="double")
    assert sim.relax(1e-6).converged
    weight = 1100.0 * EDGE**3 * 9.81
    assert sim.reaction(low) == pytest.approx([0.0, -800 * EDGE**3 / 2, weight], abs=1e-5 * weight)
    with pytest.raises(InputError, match="none of the selected nodes is fixed"):
        sim.reaction(high)


def test_cantilever_under_a_little_gravity():
    """Timoshenko, weight 0.01 g: within 1 % with four elements through the thickness."""
    length, side, young, nu = 0.1, 0.01, 1e5, 0.0
    model = tf.Model.block(
        cells=(40, 4, 4),
        size=(length, side, side),
        material=soft(youngs_modulus=young, poissons_ratio=nu),
    )
    model.fix(lambda X: X[:, 0] < 1e-9)
    model.gravity = (0.0, 0.0, -0.0981)
    sim = tf.Simulator(model, precision="double")
    assert sim.relax(1e-5).converged
    load = 1100 * 0.0981 * side**2
    second = side**4 / 12
    tip = load * length**4 / (8 * young * second)
    tip += load * length**2 / (2 * 5 / 6 * young / (2 * (1 + nu)) * side**2)
    assert -sim.u[:, 2].min() == pytest.approx(tip, rel=0.01)


def slender(precision, executor, cells=(20, 1, 1), law=None, **options):
    """A cantilever of a chain of cubes of 1 mm, under a tenth of gravity."""
    material = law or soft(poissons_ratio=0.45)
    model = tf.Model.block(cells=cells, size=tuple(1e-3 * n for n in cells), material=material)
    model.fix(lambda X: X[:, 0] < 1e-9)
    model.gravity = (0.0, 0.0, -0.981)
    return tf.Simulator(model, precision=precision, **executor.kwargs, **options)


@pytest.mark.parametrize(("length", "rounding"), [(10, 1.4e-2), (20, 3.3e-2)])
def test_slender_bodies_reach_the_tolerance_in_single_precision(executor, length, rounding, figure):
    """Rounding alone is more than the tolerance; the answer is that of double precision."""
    exact = slender("double", executor, (length, 1, 1))
    assert exact.relax(1e-6).precision == "double"
    size = np.linalg.norm(exact.u)
    for tolerance in (1e-3, 1e-4):
        sim = slender("single", executor, (length, 1, 1))
        info = sim.relax(tolerance)
        assert (info.converged, info.precision) == (True, "double")
        assert max(info.residual, info.displacement_error) <= tolerance
        error = np.linalg.norm(sim.u - exact.u) / size
        figure(f"{length}:1, tolerance {tolerance:g}", error, at_most=2 * tolerance)

        def imbalance(sim=sim, info=info):
            free = ~sim.model.fixed
            forces = (sim.external_force() - sim.internal_force())[free]
            return np.linalg.norm(forces) / info.reference

        # What is left is said, and is what float32 makes of the exact state too.
        assert info.kept_residual == pytest.approx(imbalance(), rel=1e-6)
        # Chance has a say in how a state's digits fall: 0.5 to 2.1 times over 48 states.
        assert rounding / 2.5 < info.kept_residual < 2.5 * rounding
        sim.set_state(exact.u)
        assert imbalance() == pytest.approx(rounding, rel=0.5)


def test_single_precision_stays_where_it_will_do(executor):
    model = cube()
    model.fix(low)
    model.prescribe(high, {"x": 0.0, "y": 0.0, "z": -0.2 * EDGE})
    info = tf.Simulator(model, precision="single", **executor.kwargs).relax(1e-3)
    assert (info.converged, info.precision) == (True, "single")
    assert info.kept_residual == info.residual


def test_loads_and_muscles_go_along_into_double_precision(executor):
    """Every condition still acts there: the equilibrium is that of a double simulator."""
    found = []
    for precision in ("single", "double"):
        sim = slender(precision, executor, (12, 2, 1))
        model = sim.model
        model.add_muscle("m", lambda c: c[:, 1] < 1e-3, fibre=(1, 0, 0), sigma_act=300.0)
        model.body_force(lambda c: c[:, 0] > 6e-3, (0.0, 300.0, 0.0))
        model.pressure(lambda c, n: n[:, 2] > 0.5, 0.5)
        model.prescribe(lambda X: X[:, 0] > 11.999e-3, {"y": 3e-4})
        sim = tf.Simulator(model, precision=precision, mass_scaling=3.0, **executor.kwargs)
        sim.activate("m", 0.5)
        info = sim.relax(1e-5)
        assert (info.converged, info.precision) == (True, "double")
        found.append(sim.u)
    assert abs(found[0] - found[1]).max() < 1e-4 * abs(found[1]).max()


def test_the_past_goes_along_into_double_precision_and_back(executor):
    """Plastic tissue that has flowed: the same forces in either precision and layout."""
    law = tf.material("j2_plastic", mu=1e4, bulk_modulus=4e4, yield_stress=1e3, density=1100.0)
    sim = slender("single", executor, (3, 9, 2), law, damping=500.0)
    sim.set_state(sim.model.nodes * (0.1, 0.0, -0.05))
    sim.run(until=4e-3)
    core = sim._core
    assert np.count_nonzero(core.raw_state()["history"]) > 0
    before, force = sim.u, sim.internal_force()
    exact = core.in_double()
    assert exact.displacement() == pytest.approx(before, abs=1e-12)
    assert abs(np.asarray(exact.internal_force([])) - force).max() < 1e-4 * abs(force).max()
    core.set_state(before, np.empty(0), 0.0)  # forgets
    assert abs(sim.internal_force() - force).max() > 1e-2 * abs(force).max()
    core.take_state(exact)
    assert np.array_equal(sim.u, before)
    assert abs(sim.internal_force() - force).max() < 1e-4 * abs(force).max()


def test_giving_up_is_said():
    model = cube()
    model.fix(low)
    model.gravity = (0.0, 0.0, -9.81)
    sim = tf.Simulator(model, precision="double")
    info = sim.relax(1e-9, max_steps=40)
    assert not info.converged
    assert info.steps == 40
    assert info.residual > 1e-9
    with pytest.raises(InputError, match="tolerance: got 0"):
        sim.relax(0)
    with pytest.raises(InputError, match="max_steps: got 0"):
        sim.relax(max_steps=0)
