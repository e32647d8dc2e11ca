"""One-point elements against closed forms: patch test, rotation, uniaxial stretch, muscle."""

import numpy as np
import pytest

import tledface as tf
from scenes import neo_hookean_cauchy, rotation, soft, sparse_model, uniaxial

# Of the force that the strain's largest component makes against the bulk modulus: a displacement's
# last digit is worth that much volume change, whatever the stress then is.
TOLERANCE = {"single": 1e-5, "double": 1e-12}


def affine(model, F):
    return model.nodes @ (np.asarray(F) - np.eye(3)).T


def interior_nodes(model):
    counts = np.bincount(model.elements.ravel(), minlength=model.n_nodes)
    return counts == 8


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("hourglass", ["physical", "joldes"])
def test_patch(executor, precision, hourglass):
    """Any affine displacement gives uniform F and no force inside (Irons' patch test)."""
    model = tf.Model.block(cells=(19, 7, 5), size=(0.019, 0.0035, 0.005), material=soft())
    F = np.array([[1.1, 0.2, -0.1], [0.05, 0.9, 0.15], [-0.12, 0.08, 1.05]])
    sim = tf.Simulator(model, precision=precision, hourglass=hourglass, **executor.kwargs)
    sim.set_state(affine(model, F))
    force = sim.internal_force()
    inside = interior_nodes(model)
    assert inside.sum() > 100
    parameters = model.element_parameters()
    scale = parameters["bulk"][0] * abs(F - np.eye(3)).max() * 0.7e-6
    assert abs(force[~inside]).max() > 1e-2 * scale
    assert abs(force[inside]).max() <= TOLERANCE[precision] * scale
    assert abs(sim.deformation_gradient() - F).max() <= TOLERANCE[precision]
    sigma = neo_hookean_cauchy(F, parameters["mu"][0], parameters["bulk"][0])
    expected = sigma[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    assert abs(sim.stress() - expected).max() <= TOLERANCE[precision] * parameters["bulk"][0]


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("hourglass", ["physical", "joldes"])
def test_rigid_rotation_gives_no_force(executor, precision, hourglass):
    """A model with holes turned by 90 degrees, against the force of a 1 % stretch."""
    model = sparse_model()
    X = model.node_ijk * model.voxel  # model.nodes lies metres away and has lost digits to that
    sim = tf.Simulator(model, precision=precision, hourglass=hourglass, **executor.kwargs)
    sim.set_state(0.01 * X)
    stretched = abs(sim.internal_force()).max()
    sim.set_state(X @ (rotation((1, 2, 3), np.pi / 2) - np.eye(3)).T)
    turned = abs(sim.internal_force()).max()
    assert stretched > 0
    assert turned <= {"single": 2e-3, "double": 1e-11}[precision] * stretched


@pytest.mark.parametrize("stretch", [0.7, 0.85, 1.0, 1.2, 1.5])
@pytest.mark.parametrize("volumetric", ["log", "quadratic"])
def test_uniaxial_stretch(executor, stretch, volumetric, figure):
    """Axial force of a bar with free sides: closed form within 0.1 %."""
    material = soft(volumetric=volumetric)
    model = tf.Model.block(cells=(4, 3, 3), size=(0.004, 0.003, 0.003), material=material)
    lateral, sigma = uniaxial(stretch, material.mu, material.bulk, volumetric)
    sim = tf.Simulator(model, **executor.kwargs)
    sim.set_state(affine(model, np.diag([stretch, lateral, lateral])))
    end = model.nodes[:, 0] > 0.004 - 1e-9
    force = sim.internal_force()
    expected = sigma * lateral**2 * 9e-6
    scale = max(abs(expected), 1e-3 * material.mu * 9e-6)
    figure("axial force, N", force[end, 0].sum(), expected, absolute=1e-3 * scale)
    # The sides are free of load: nothing pulls them in or out.
    assert abs(force[:, 1:]).max() <= 1e-3 * scale


def test_uniaxial_equilibrium_is_found_by_the_solver():
    """The same closed form reached by stepping: a bar pulled by its own weight's acceleration."""
    material = soft(density=1000.0)
    model = tf.Model.block(cells=(20, 2, 2), size=(0.02, 0.002, 0.002), material=material)
    model.fix(lambda X: X[:, 0] < 1e-9, "x")
    model.fix(lambda X: (X[:, 0] < 1e-9) & (X[:, 1] < 1e-9), "y")
    model.fix(lambda X: (X[:, 0] < 1e-9) & (X[:, 2] < 1e-9), "z")
    g = 40.0
    model.gravity = (g, 0.0, 0.0)
    sim = tf.Simulator(model, damping=120.0, precision="double")
    sim.run(until=0.12)
    assert abs(sim.velocity).max() < 1e-4
    # Nominal stress at X is the weight hanging below it; the tip moves by the integral of
    # stretch - 1. Elements carry the mean of their ends' loads.
    load = 1000.0 * g * (0.02 - (np.arange(20) + 0.5) * 0.001)
    stretches = [_stretch_under(p, material) for p in load]
    tip = sim.u[model.nodes[:, 0] > 0.02 - 1e-9, 0].mean()
    assert tip == pytest.approx(sum(np.asarray(stretches) - 1) * 0.001, rel=1e-3)


def _stretch_under(nominal, material):
    low, high = 1.0, 2.0
    for _ in range(60):
        middle = (low + high) / 2
        lateral, sigma = uniaxial(middle, material.mu, material.bulk)
        low, high = (middle, high) if sigma * lateral**2 < nominal else (low, middle)
    return middle


@pytest.mark.parametrize("activation", [0.0, 0.4, 0.75])
def test_isometric_muscle(executor, activation, figure):
    """At stretch 1 the fibre stress is activation times sigma_act (eq. 8-12): 3.75 MPa at 0.75."""
    fibre = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
    model = tf.Model.block(cells=(5, 4, 3), size=(0.005, 0.004, 0.003), material=soft())
    model.add_muscle("m", np.ones(60, bool), fibre=fibre, sigma_act=5e6, sigma_pas=5e6)
    sim = tf.Simulator(model, **executor.kwargs)
    sim.activate("m", activation)
    sigma = sim.stress()
    expected = activation * 5e6 * np.outer(fibre, fibre)
    figure(
        "fibre stress, MPa",
        1e-6
        * (
            sigma[0]
            @ (
                np.array([1, 1, 1, 2, 2, 2])
                * (fibre[[0, 1, 2, 0, 1, 0]] * fibre[[0, 1, 2, 1, 2, 2]])
            )
        ),
        5 * activation,
        absolute=1e-6,
    )
    assert abs(sigma - expected[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]).max() <= 1.0
    # The device's own forces carry it: traction on the x = max face.
    end = model.nodes[:, 0] > 0.005 - 1e-9
    assert sim.internal_force()[end].sum(axis=0) == pytest.approx(
        expected[0] * 12e-6, rel=1e-4, abs=1e-9
    )


@pytest.mark.parametrize("stretch", [0.55, 0.7, 0.95, 1.05, 1.19, 1.21, 1.35, 1.5])
@pytest.mark.parametrize("volume", [1.0, 0.9, 1.15])
def test_muscle_over_stretch(executor, stretch, volume):
    """Active and passive tension of two muscles in one element against the NumPy reference.

    Cauchy stress along a fibre is tension times stretch squared whatever the volume does.
    """
    from tledface.muscle import active_tension, passive_tension

    model = tf.Model.block(cells=(3, 3, 3), size=(0.003, 0.003, 0.003), material=soft())
    model.add_muscle("x", np.ones(27, bool), fibre=(1, 0, 0), sigma_act=3e6, sigma_pas=2e6)
    model.add_muscle(
        "y",
        np.ones(27, bool),
        fibre=(0, 1, 0),
        sigma_act=1e6,
        sigma_pas=4e6,
        lambda_opt=1.1,
        weight=0.5,
    )
    lateral = np.sqrt(volume / stretch)
    sim = tf.Simulator(model, **executor.kwargs)
    sim.activate("x", 0.6)
    sim.activate("y", 0.3)
    sim.set_state(affine(model, np.diag([stretch, lateral, lateral])))
    fx = 0.6 * 3e6 * active_tension(stretch) + 2e6 * passive_tension(stretch)
    fy = 0.5 * (0.3 * 1e6 * active_tension(lateral, 1.1) + 4e6 * passive_tension(lateral))
    sigma = neo_hookean_cauchy(np.diag([stretch, lateral, lateral]), soft().mu, soft().bulk)
    force = sim.internal_force()
    for axis, tension, reach in ((0, fx * stretch**2, stretch), (1, fy * lateral**2, lateral)):
        end = model.nodes[:, axis] > 0.003 - 1e-9
        area = 9e-6 * volume / reach  # of the deformed face
        expected = (sigma[axis, axis] + tension) * area
        assert force[end, axis].sum() == pytest.approx(expected, rel=5e-4, abs=5e-4 * 34e3 * 9e-6)


def test_calcium_activation_gives_hungs_stresses(executor, figure):
    """85.4 kPa at Ca 0.9 and 63.3 kPa at 0.6 for stretch 1, and the slope over stretch."""
    from tledface.muscle import calcium_stress

    figure("fibre stress at Ca 0.9, Pa", calcium_stress(0.9), 85.4e3, rel=1e-3)
    figure("fibre stress at Ca 0.6, Pa", calcium_stress(0.6), 63.3e3, rel=1e-3)
    model = tf.Model.block(cells=(3, 3, 3), size=(0.003, 0.003, 0.003), material=soft())
    model.add_muscle("m", np.ones(27, bool), fibre=(1, 0, 0), sigma_act=100e3, law="calcium")
    sim = tf.Simulator(model, **executor.kwargs)
    for level in (0.9, 0.6):
        sim.activate("m", level)
        for stretch in (0.7, 1.0, 1.3):
            lateral = stretch**-0.5
            F = np.diag([stretch, lateral, lateral])
            sim.set_state(affine(model, F))
            passive = neo_hookean_cauchy(F, soft().mu, soft().bulk)[0, 0]
            expected = passive + calcium_stress(level, stretch)
            assert sim.stress()[:, 0] == pytest.approx(np.full(27, expected), rel=1e-5)
            end = model.nodes[:, 0] > 0.003 - 1e-9
            pull = sim.internal_force()[end, 0].sum()
            assert pull == pytest.approx(expected * 9e-6 / stretch, rel=1e-3)


def test_printed_passive_law_jumps_and_the_default_does_not(executor):
    from tledface.muscle import passive_tension

    for law, form in (("tension_length_printed", "printed"), ("tension_length", "continuous")):
        model = tf.Model.block(cells=(3, 3, 3), size=(0.003, 0.003, 0.003), material=soft())
        model.add_muscle("m", np.ones(27, bool), fibre=(1, 0, 0), sigma_act=1e6, law=law)
        sim = tf.Simulator(model, precision="double", **executor.kwargs)
        for stretch in (1.1, 1.1999, 1.2001, 1.4):
            F = np.diag([stretch, stretch**-0.5, stretch**-0.5])
            sim.set_state(affine(model, F))
            fibre = sim.stress()[0, 0] - neo_hookean_cauchy(F, soft().mu, soft().bulk)[0, 0]
            expected = 1e6 * stretch**2 * passive_tension(stretch, form=form)
            assert fibre == pytest.approx(expected, rel=1e-9)
