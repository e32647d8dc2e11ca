"""What a look finds on the device, against formulas of its own in float64, on every executor."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tledface as tf
from tledface import _core
from tledface._core_model import core_model
from tledface.conditions import prescribed_mask
from tledface.muscle import CALCIUM_BETA, active_tension, passive_tension
from tledface.surface import HEX_CORNERS

sys.path.insert(0, str(Path(__file__).parents[1] / "verification"))
sys.path.insert(0, str(Path(__file__).parent))
from everything import body_of_everything

from scenes import contracting_block, soft, sparse_model

# Of a node's square: how far from the formulas, and how far above what is computed it is put.
ROUNDING = {"single": 1e-6, "double": 1e-12}
MARGIN = {"single": 512 * 2.0**-24, "double": 512 * 2.0**-53}
# What csrc/sim/step_limit.cpp scales its last iteration by.
POWER, TRUSTED = 2.5, 1.05


def three_muscles():
    """Fibres of each law, slanted, in part of two tissues; a held face, a face held along x."""
    model = tf.Model.block((19, 6, 5), (19e-3, 5e-3, 6e-3), soft(40e3, 0.45))
    model.set_material(lambda c: c[:, 2] > 3e-3, soft(400e3, 0.4, 1000.0))
    model.add_muscle(
        "hill", lambda c: c[:, 1] < 3e-3, (1, 0.4, -0.2), sigma_act=2e5, sigma_pas=1e5,
        lambda_opt=1.1,
    )  # fmt: skip
    model.add_muscle(
        "printed", lambda c: c[:, 0] > 8e-3, (0.1, 1, 0.3), sigma_act=1e5, sigma_pas=3e5,
        lambda_pas=1.1, law="tension_length_printed",
    )  # fmt: skip
    model.add_muscle("calcium", lambda c: c[:, 2] > 2e-3, (0, 0.2, 1), sigma_act=1e5, law="calcium")
    model.fix(lambda X: X[:, 0] < 1e-9)
    model.prescribe(lambda X: X[:, 0] > 19e-3 - 1e-9, {"x": 0.0})
    return model


def mesh():
    """The same with its inner nodes moved."""
    model = three_muscles().as_hexahedra()
    low, high = model.nodes.min(axis=0), model.nodes.max(axis=0)
    inner = ((model.nodes > low + 1e-9) & (model.nodes < high - 1e-9)).all(axis=1)
    moved = np.random.default_rng(1).uniform(-2e-4, 2e-4, model.nodes.shape) * inner[:, None]
    distorted = tf.Model.from_hexahedra(
        model.nodes + moved,
        model.elements,
        model.tissues,
        model.tissue_materials,
        model.fractions,
    )
    distorted.muscles = list(model.muscles)
    distorted.fix(lambda X: X[:, 0] < 1e-9)
    return distorted


MODELS = {
    "three muscles": three_muscles,
    "mesh": mesh,
    "holes": sparse_model,
    "everything": body_of_everything,
}


def mean_gradients(model):
    """dN_a/dX of each element, (n_elem, 8, 3), and its volume, by two Gauss points an axis."""
    signs = 2.0 * HEX_CORNERS - 1.0
    points = signs / np.sqrt(3.0)
    if model.is_conforming:
        corners = model.nodes[model.elements]
    else:  # positions far from the origin have lost digits
        corners = np.broadcast_to(HEX_CORNERS * model.voxel, (model.n_elements, 8, 3))
    gradient, volume = np.zeros(corners.shape), np.zeros(len(corners))
    for xi in points:
        factors = 1.0 + signs * xi
        local = signs * np.stack(
            [factors[:, 1] * factors[:, 2], factors[:, 0] * factors[:, 2],
             factors[:, 0] * factors[:, 1]], axis=1,
        ) / 8  # fmt: skip
        jacobian = np.einsum("eai,aj->eij", corners, local)
        weight = np.linalg.det(jacobian)
        gradient += weight[:, None, None] * (local @ np.linalg.inv(jacobian))
        volume += weight
    return gradient / volume[:, None, None], volume


def tension(muscle, activation, stretch):
    """Fibre stress over J and its slope over stretch, Pa."""
    if muscle.law == "calcium":
        rise = 1.0 + CALCIUM_BETA * (stretch - 1.0)
        stress = muscle.sigma_act * activation * np.maximum(rise, 0.0)
        slope = muscle.sigma_act * activation * np.where(rise > 0.0, CALCIUM_BETA, 0.0)
        return stress / stretch**2, (slope - 2.0 * stress / stretch) / stretch**2
    form = "printed" if muscle.law == "tension_length_printed" else "continuous"
    active = active_tension(stretch, muscle.lambda_opt)
    value = muscle.sigma_act * activation * active
    value = value + muscle.sigma_pas * passive_tension(stretch, muscle.lambda_pas, form=form)
    slope = np.where(
        active > 0.0, 12.5 / muscle.lambda_opt * (1.0 - stretch / muscle.lambda_opt), 0
    )
    passive = np.where(stretch > 1.0, 0.33 * np.exp(6.6 * (stretch - 1.0)), 0.0)
    passive = np.where(stretch > muscle.lambda_pas, 2.18, passive)
    return value, muscle.sigma_act * activation * slope + muscle.sigma_pas * passive


def squares_by_formula(sim, activations, low=1.0, high=1.0):
    """omega^2 of each node, and the stiffness of each element, Pa/m^2."""
    model = sim.model
    gradient, volume = mean_gradients(model)
    u = sim.u[model.elements]
    F = np.eye(3) + np.einsum("eai,eaj->eij", u - u[:, :1], gradient)
    J = np.linalg.det(F)
    cof = J[:, None, None] * np.linalg.inv(F).transpose(0, 2, 1)
    G = 2.0 * np.einsum("eai,eaj->eij", gradient, gradient)
    trace = np.einsum("eii->e", G)
    spread = np.einsum("eij,ejk,eik->e", cof, G, cof) / trace
    stiffness = _core.element_stiffness(core_model(model, muscles=False))
    stiffness = stiffness * np.maximum(spread * (0.5 + 0.5 / J**2), 1.0)
    for muscle, activation in zip(model.muscles, activations, strict=True):
        at, d = muscle.elements, muscle.fibre
        now = np.linalg.norm(np.einsum("eij,ej->ei", F[at], d), axis=1)
        along = np.einsum("ei,eij,ej->e", d, G[at], d)
        inverse_norm = np.linalg.norm(np.linalg.inv(F[at]), axis=(1, 2))
        most = np.zeros(len(at))
        for stretch in np.linspace(low, high, 7)[:, None] * now:
            value, slope = tension(muscle, activation, stretch)
            straight = np.maximum(value + np.maximum(stretch * slope, 0.0), 0.0) * along
            through = abs(value) * (stretch * inverse_norm + 1.0) / 2 * np.sqrt(along * trace[at])
            most = np.maximum(most, J[at] * (straight + through))
        stiffness[at] += muscle.weight * most
    stiffness = np.where(J > 0.0, stiffness, np.inf)
    sums = np.zeros(model.n_nodes)
    np.add.at(sums, model.elements, (stiffness * volume / 2)[:, None])
    held = (model.fixed | prescribed_mask(model)).all(axis=1)
    return np.where(held, 0.0, sums / sim._core.node_masses()), stiffness


def put(sim, u):
    """A displacement past the conditions, which would put prescribed nodes back."""
    sim._core.set_state(u, np.zeros(0), 0.0)


def deformed(model, precision, executor, amount=0.06, seed=2, **options):
    """A body hundreds of edges from where it was, stretched and turned, each node noisy."""
    sim = tf.Simulator(model, precision=precision, **executor.kwargs, **options)
    noise = np.random.default_rng(seed).uniform(-1, 1, (model.n_nodes, 3))
    bent = np.array([[-0.2, 0.15, 0.0], [-0.1, 0.12, 0.05], [0.0, -0.1, 0.15]])
    u = (model.nodes - model.nodes.mean(axis=0)) @ bent.T + (0.3, -0.2, 0.1)
    put(sim, u + amount * model.shortest_edge * noise)
    return sim


def levels_of(model):
    return np.linspace(0.3, 0.9, len(model.muscles))


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS.keys())
@pytest.mark.parametrize("precision", ["single", "double"])
def test_bounds_of_nodes_are_those_of_the_formulas(executor, precision, make):
    model = make()
    sim = deformed(model, precision, executor)
    levels = levels_of(model)
    core, margin = sim._core, MARGIN[precision]
    expected, stiffness = squares_by_formula(sim, levels, 0.8, 1.1)
    limit, node, element, bound = core.limit_now(levels, 0.0, 0.8, 1.1)
    got = core.node_squares()
    moves = expected > 0.0
    assert np.array_equal(got > 0.0, moves)
    assert moves.all() != bool(model.fixed.any())
    error = abs(got[moves] / (1.0 + margin) / expected[moves] - 1.0).max()
    assert error <= ROUNDING[precision]
    # Rounding never puts a bound above the truth.
    assert (got[moves] >= expected[moves]).all()
    assert bound == pytest.approx(2.0 / np.sqrt(got.max()), rel=1e-15)
    assert limit >= bound or model.law_rows()
    assert got[node] == got.max()
    around = np.flatnonzero((model.elements == node).any(axis=1))
    assert stiffness[element] == pytest.approx(stiffness[around].max(), rel=ROUNDING[precision])
    assert element in around
    if model.muscles:
        assert not np.allclose(expected, squares_by_formula(sim, levels)[0], rtol=1e-2)


@pytest.mark.parametrize("hourglass", ["physical", "joldes"])
@pytest.mark.parametrize("scaling", [3.0, {"dt": 4e-6}], ids=["factor", "selective"])
def test_bounds_know_mass_scaling(executor, scaling, hourglass):
    model = three_muscles()
    sim = deformed(model, "double", executor, mass_scaling=scaling, hourglass=hourglass)
    expected, _ = squares_by_formula(sim, levels_of(model))
    sim._core.limit_now(levels_of(model), 0.0)
    assert sim._core.node_squares() == pytest.approx(expected, rel=2e-12)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_limit_is_scaled_by_the_growth_of_the_nodes(executor, precision):
    """From the last iteration, by nodes above it; where they have grown by more, the bound."""
    model = three_muscles()
    sim = deformed(model, precision, executor, amount=0.0)
    core, rounding = sim._core, 5 * MARGIN[precision]
    then, u = np.full(3, 0.3), sim.u
    core.limit_now(then, np.inf, 0.9, 1.05)
    kept, square = core.raw_state()["limit_squares"], core.raw_state()["limit_square"]
    expected, _ = squares_by_formula(sim, then)
    free = expected > 0.0
    assert kept[free] == pytest.approx(expected[free], rel=ROUNDING[precision])
    assert (kept[~free] == 0.0).all()
    trusted = 0
    for factor, level in ((1.0, 0.3), (1.0, 0.31), (1.005, 0.31), (1.01, 0.3), (1.4, 0.9)):
        put(sim, factor * u)
        levels = np.full(3, level)
        limit, _, _, bound = core.limit_now(levels, 0.0, 0.8, 1.1)
        now, _ = squares_by_formula(sim, levels)
        reached, _ = squares_by_formula(sim, levels, 0.8, 1.1)
        since = max(1.0, (now / np.maximum(expected, 1.0))[now > square].max(initial=1.0))
        reach = max(1.0, (reached / np.maximum(now, 1.0))[reached > square].max(initial=1.0))
        scaled = 2.0 / np.sqrt(square * since**POWER * reach)
        if since <= TRUSTED:
            trusted += since > 1.001 and reach > 1.01 and scaled > 1.01 * bound
            assert limit == pytest.approx(max(bound, scaled), rel=rounding)
            assert limit <= max(bound, scaled) * (1.0 + 1e-7)
        else:
            assert limit == bound
    assert trusted > 0 and since > TRUSTED


@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_measurement_leaves_no_trace(executor, precision):
    model = three_muscles()
    sim = deformed(model, precision, executor)
    core, levels = sim._core, levels_of(model)
    core.limit_now(levels, np.inf, 0.8, 1.1)
    squares, raw = core.node_squares(), core.raw_state()
    put(sim, 1.1 * sim.u)
    other = core.measured_limit(0.5 * levels)[0]
    assert np.array_equal(core.node_squares(), squares)
    for name in ("limit_squares", "limit_square"):
        assert np.array_equal(core.raw_state()[name], raw[name]), name
    again = deformed(model, precision, executor)
    put(again, sim.u)
    assert again._core.measured_limit(0.5 * levels)[0] == other > 0.0


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("make", [three_muscles, mesh], ids=["voxels", "mesh"])
def test_a_restart_goes_on_from_the_last_iteration(executor, precision, make):
    model = make()
    sim = deformed(model, precision, executor, amount=0.0)
    levels = levels_of(model)
    sim._core.limit_now(levels, np.inf, 0.9, 1.05)
    put(sim, 1.003 * sim.u)
    again = tf.Simulator(model, precision=precision, **executor.kwargs)
    state = sim._core.raw_state()
    again._core.set_raw_state(**state)
    assert np.array_equal(again._core.raw_state()["limit_squares"], state["limit_squares"])
    found = sim._core.limit_now(levels, 0.0, 0.8, 1.1)
    assert again._core.limit_now(levels, 0.0, 0.8, 1.1) == found
    assert found[0] > 1.01 * found[3]


@pytest.mark.parametrize("make", [three_muscles, mesh], ids=["voxels", "mesh"])
def test_an_inverted_element_allows_no_step(executor, make):
    model = make()
    sim = deformed(model, "single", executor, amount=0.0)
    u = sim.u
    inverted = model.n_elements // 2
    corners = model.elements[inverted]
    centre = model.nodes[corners].mean(axis=0)
    u[corners] += -2.5 * (model.nodes[corners] - centre)
    put(sim, u)
    limit, node, element, bound = sim._core.limit_now(levels_of(model), np.inf, 0.8, 1.1)
    assert limit == bound == 0.0
    assert node in model.elements[element]
    _, stiffness = squares_by_formula(sim, levels_of(model))
    assert stiffness[element] == np.inf
    assert np.isinf(sim._core.node_squares()).any()


def test_every_node_held_allows_any_step(executor):
    model = tf.Model.block((9, 3, 3), (9e-3, 3e-3, 3e-3), soft())
    sim = tf.Simulator(model, **executor.kwargs)
    assert sim._core.limit_now(np.zeros(0), 0.0)[0] < 1.0
    model.fix(lambda X: X[:, 0] > -1.0)
    core = _core.Simulator(
        sim._device, core_model(model), precision="single", hourglass="physical", kappa=0.075,
        damping=0.0, kernels=executor.kernels,
    )  # fmt: skip
    assert core.limit_now(np.zeros(0), np.inf)[0] == np.inf


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("make", [sparse_model, mesh], ids=["voxels", "mesh"])
def test_what_is_not_finite_is_seen_wherever_it_is(executor, precision, make):
    model = make()
    sim = tf.Simulator(model, precision=precision, **executor.kwargs)
    core = sim._core
    largest = float(np.finfo(np.float32 if precision == "single" else np.float64).max)
    slots = np.asarray(core.node_slots())
    nodes = {0, model.n_nodes - 1, int(slots.argmin()), int(slots.argmax()), model.n_nodes // 3}
    for node in nodes:
        for axis, value in enumerate((np.nan, -np.inf, largest)):
            u = np.zeros((model.n_nodes, 3))
            u[node, axis] = value
            put(sim, u)
            assert core.first_non_finite_node() == (-1 if value == largest else node)
    u = np.zeros((model.n_nodes, 3))
    u[5:] = np.nan
    put(sim, u)
    assert core.first_non_finite_node() == 5


@pytest.mark.parametrize("precision", ["single", "double"])
def test_another_step_keeps_the_velocity(executor, precision):
    model = contracting_block()
    sim = tf.Simulator(model, precision=precision, **executor.kwargs)
    sim.activate("sheet", tf.ramp(0, 0.75, 0.001))
    sim.step(200)
    core, before, u = sim._core, sim.velocity, sim.u
    core.dt = 0.37 * core.dt
    digits = 2e-7 if precision == "single" else 4e-16
    assert np.array_equal(sim.u, u)
    assert abs(sim.velocity - before).max() <= digits * abs(u).max() / core.dt
    assert abs(before).max() > 1e3 * digits * abs(u).max() / core.dt


THREADS = """
import numpy as np
from everything import body_of_everything, contracted
sim = contracted(body_of_everything(), device="native")
sim.step(40)
levels = np.array([0.2, 0.3])
found = [sim._core.limit_now(levels, e, 0.8, 1.1) for e in (np.inf, 0.0)]
print(*map(repr, found), hash(sim._core.node_squares().tobytes()))
"""


HERE = str(Path(__file__).parent)


def test_threads_do_not_change_a_bit():
    said = {
        subprocess.run(
            [sys.executable, "-c", THREADS],
            env={**os.environ, "PYTHONPATH": os.pathsep.join([HERE, *sys.path]),
                 "PYTHONHASHSEED": "0", "TLEDFACE_NUM_THREADS": str(n)},
            capture_output=True, text=True, check=True, timeout=120,
        ).stdout
        for n in (1, 2, 5)
    }  # fmt: skip
    assert len(said) == 1
