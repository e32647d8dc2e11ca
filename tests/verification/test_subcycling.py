"""Subcycling: each part its own step; momentum, energy, order, stability, conditions, restarts."""

import itertools
import warnings

import h5py
import numpy as np
import pytest
import trimesh

import tledface as tf
from conftest import EXECUTORS
from scenes import soft
from tledface import _core
from tledface.energy import EnergyWarning
from tledface.errors import InputError
from tledface.subcycling import SubcyclingWarning

ROWS = [e for e in EXECUTORS if e.kernels == "rows"]
H = 0.5e-3
CELLS = (12, 12, 12)  # as wide every way: blocks of lanes then lie in its layers
SIZE = tuple(n * H for n in CELLS)


@pytest.fixture(params=ROWS, ids=str)
def rows(request):
    return request.param.kwargs


def stiff_in_soft(sheets=(0, 1, 11)):
    """A soft block with stiff sheets at the bottom and the top, and a firmer one between."""
    model = tf.Model.block(CELLS, SIZE, soft(20e3, 0.45))
    layer = model.cells[:, 2]
    model.set_material(np.isin(layer, sheets), soft(10e6, 0.45), name="stiff")
    model.set_material(layer == 6, soft(300e3, 0.45), name="firm")
    return model


def stiff_corner():
    """A soft block, stiff in one corner: levels differ along each axis, and within blocks."""
    model = tf.Model.block(CELLS, SIZE, soft(20e3, 0.45))
    model.set_material((model.cells >= (8, 6, 8)).all(axis=1), soft(10e6, 0.45), name="stiff")
    return model


def swirl(model, speed=0.5):
    """A velocity with parts in every layer, m/s."""
    x, y, z = (2 * np.pi * model.nodes / (6e-3, 10e-3, 6e-3)).T
    return speed * np.stack([np.sin(z), np.cos(x / 2), np.sin(y)], axis=1)


def moving(substeps, make=stiff_in_soft, **options):
    sim = tf.Simulator(
        make(), **{"device": "native", "precision": "double", "subcycling": substeps, **options}
    )
    sim.set_state(np.zeros((sim.model.n_nodes, 3)), swirl(sim.model))
    return sim


def test_who_takes_which_step_is_by_the_bounds_of_nodes():
    """No element's step is above the bound of a node of its; what may take longer ones does."""
    model = stiff_in_soft()
    sim = tf.Simulator(model, device="native", subcycling=16)
    steps = np.asarray(sim._core.node_steps())
    parameters = model.element_parameters()
    mu = parameters["mu"]
    lame = parameters["bulk"] - 2 * mu / 3
    stiffness = (3 * lame + 2 * mu) / H**2
    square, mass = np.zeros(model.n_nodes), np.zeros(model.n_nodes)
    for corner in range(8):
        np.add.at(square, model.elements[:, corner], stiffness * model.volumes / 2)
        np.add.at(mass, model.elements[:, corner], parameters["density"] * model.volumes / 8)
    bound = 2 / np.sqrt(square / mass)
    shortest = sim.dt / sim.substeps
    # The stiffest nodes' step is by the limit of the body, which is above their bound.
    longer = steps > 1
    assert (steps[longer] * shortest <= bound[longer]).all()
    of_element = bound[model.elements].min(axis=1)
    may = np.full(model.n_nodes, np.inf)
    for corner in range(8):
        np.minimum.at(may, model.elements[:, corner], of_element)
    # Blocks of neighbours share a step: here layers are whole blocks.
    assert (2 * steps * shortest > 0.85 * may)[steps < 16].all()
    assert set(np.unique(steps)) == {1, 4, 16}
    assert sim._core.relative_cost() < 0.6


def test_a_step_is_kept_up_to_the_bound_of_its_nodes_and_not_beyond():
    """Longer ones are taken with room to spare, so that none changes to and fro; but above their
    bound nodes would be unstable.
    """
    model = stiff_in_soft()
    core = tf.Simulator(model, device="native", subcycling=16)._core
    bound = 2 / np.sqrt(np.asarray(core.node_squares()))
    # Of the soft layers in the middle between two sheets: all elements and nodes alike.
    node = np.argmin(np.linalg.norm(model.nodes - (3e-3, 3e-3, 4.5e-3), axis=1))
    assert core.node_steps()[node] == 16
    steps = []
    for share in (0.9, 0.99, 1.01, 0.99, 0.9):
        core.dt = share * bound[node] / 8
        core.choose_levels()
        steps.append(int(core.node_steps()[node]))
    assert steps == [8, 8, 4, 4, 8]


@pytest.mark.parametrize("make", [stiff_in_soft, stiff_corner])
def test_momentum_is_kept_to_rounding(rows, figure, make):
    sim = moving(16, make, device=rows["device"], kernels="rows")
    assert set(np.unique(sim._core.node_steps())) > {1}
    mass = np.asarray(sim.mass)[:, None]

    def momenta():
        x, p = sim.model.nodes + sim.u, mass * sim.velocity
        return p.sum(axis=0), np.cross(x, p).sum(axis=0)

    linear, angular = momenta()
    sim.step(100)
    scale = np.linalg.norm(mass * sim.velocity, axis=1).sum()
    assert abs(sim.u).max() > 0.3 * H
    now = momenta()
    figure("linear momentum over its parts", abs(now[0] - linear).max() / scale, at_most=1e-12)
    reach = np.linalg.norm(SIZE)
    figure("angular momentum over its parts", abs(now[1] - angular).max() / (scale * reach),
           at_most=1e-12)  # fmt: skip


@pytest.mark.parametrize("substeps", [2, 4, 8, 16])
def test_energy_neither_grows_nor_falls(figure, substeps):
    """Undamped and far from linear, 8 000 shortest steps; the error is that of the longest step."""
    sim = moving(substeps, energy_every=64 // substeps)
    off = []
    for _ in range(125):
        sim.step(64 // substeps)
        held = sum(sim.energies[key] for key in ("kinetic", "strain", "hourglass"))
        off.append(sim.energies["error"] / held)
    figure("worst error over the energy", np.abs(off).max(), at_most=1e-5 * substeps**2)
    first, last = (np.mean(np.abs(part)) for part in np.array_split(off[5:], 2))
    assert last < 3 * first


def test_the_error_falls_with_the_square_of_the_step(figure):
    """Levels stay, all steps are halved; against one short step for all."""
    until, n_dofs = 0.8e-3, 0

    def run(substeps, n):
        core = moving(substeps)._core
        core.dt = until / n
        core.set_state(np.zeros((len(core.node_masses()), 3)), swirl(stiff_in_soft()), 0.0)
        core.step(n, np.empty((n, n_dofs)))
        return np.asarray(core.displacement())

    reference = run(1, 6400)
    errors = [abs(run(16, n) - reference).max() / abs(reference).max() for n in (448, 896, 1792)]
    orders = [np.log2(a / b) for a, b in itertools.pairwise(errors)]
    figure("error with 1792 shortest steps", errors[-1], at_most=1e-3)
    figure("order", orders[-1], 2.0, absolute=0.1)


@pytest.mark.parametrize("substeps", [4, 16])
def test_noise_at_the_limit_stays_bounded(substeps):
    """Every mode is excited, so a resonance of steps would show: 20 000 shortest steps."""
    sim = moving(substeps, dt=substeps * 0.97 * moving(1).dt_crit)
    noise = np.random.default_rng(3).normal(0.0, 0.05, (sim.model.n_nodes, 3))
    sim.set_state(np.zeros_like(noise), noise)
    mass = np.asarray(sim.mass)[:, None]
    most = []
    for _ in range(10):
        sim.step(2000 // substeps)
        most.append(float((mass * sim.velocity**2).sum()))
    assert max(most[5:]) < 1.3 * float((mass * noise**2).sum())


def test_a_free_fall_is_exact(rows):
    """Elements see no strain, so each node's parabola is that of its own step: all are the same."""
    model = stiff_in_soft()
    model.gravity = (0.3, -0.2, -9.81)
    sim = tf.Simulator(model, precision="double", subcycling=8, **rows)
    sim.step(300)
    np.testing.assert_allclose(sim.u, np.tile(0.5 * model.gravity * sim.time**2,
                               (model.n_nodes, 1)), rtol=1e-9, atol=1e-15)  # fmt: skip


def driven(substeps, device="native", **options):
    """All that acts on nodes: prescribed numbers and fields, pressure, a force, gravity, muscle."""
    model = stiff_in_soft()
    X = model.nodes
    model.prescribe(lambda x: x[:, 0] < 1e-9, {"x": lambda t: 2e-4 * (1 - np.cos(900 * t))})
    model.prescribe(
        lambda x: x[:, 0] > SIZE[0] - 1e-9,
        {"y": lambda t, x: 1e-4 * (1 - np.cos(700 * t)) * (1 + x[:, 2] / SIZE[2])},
    )
    model.fix(lambda x: x[:, 2] < 1e-9, "z")
    model.pressure(lambda c, n: n[:, 2] > 0.9, lambda t: 200.0 * min(t / 1e-3, 1.0))
    model.body_force(model.cells[:, 1] < 3, lambda t: (0.0, 3e4 * np.sin(500 * t), 0.0))
    model.gravity = (0.0, 0.0, -9.81)
    model.add_muscle("m", lambda c: abs(c[:, 2] - 2e-3) < 6e-4, fibre=(1, 0, 0), sigma_act=50e3)
    sim = tf.Simulator(model, device=device, kernels="rows", precision="double",
                       subcycling=substeps, **options)  # fmt: skip
    sim.activate("m", tf.ramp(0.0, 0.3, 2e-3))
    assert len(X) == model.n_nodes
    return sim


def test_conditions_act_at_each_nodes_own_time(rows, figure):
    sims = [
        driven(n, rows["device"], dt=n * 1.5e-6, damping=20.0, energy_every=16 // n) for n in (1, 8)
    ]
    for sim in sims:
        with warnings.catch_warnings():
            # Works are sums from entry to entry, poor while next to nothing has been done.
            warnings.simplefilter("ignore", EnergyWarning)
            sim.run(until=3e-3)
    alike, differing = (sim.u for sim in sims)
    assert set(np.unique(sims[1]._core.node_steps())) > {1}
    X = sims[1].model.nodes
    held = X[:, 0] < 1e-9
    np.testing.assert_allclose(
        differing[held, 0], 2e-4 * (1 - np.cos(900 * sims[1].time)), rtol=1e-12
    )
    held = X[:, 0] > SIZE[0] - 1e-9
    at = 1e-4 * (1 - np.cos(700 * sims[1].time)) * (1 + X[held, 2] / SIZE[2])
    np.testing.assert_allclose(differing[held, 1], at, rtol=1e-5)  # linear between keys
    figure("difference from one step for all", abs(differing - alike).max() / abs(alike).max(),
           at_most=2e-3)  # fmt: skip
    one, own = (sim.energies for sim in sims)
    for key in ("muscle_work", "damping", "strain", "kinetic"):
        assert own[key] == pytest.approx(one[key], rel=0.01), key
    # The works of supports differ with how often they are summed up.
    assert own["external"] == pytest.approx(one["external"], rel=0.03)
    works = abs(own["external"]) + abs(own["muscle_work"])
    figure("balance error over the works", abs(own["error"]) / works, at_most=0.01)


def test_a_muscle_that_stiffens_takes_shorter_steps():
    """The stiffest element is elsewhere, so dt stays; the muscle's blocks change their step."""
    model = stiff_in_soft()
    where = abs(model.centres[:, 2] - 4.6e-3) < 4e-4
    model.add_muscle("m", where, fibre=(1, 0, 0), sigma_act=1e6)
    sim = tf.Simulator(model, device="native", damping=200.0, subcycling=16)
    sim.activate("m", tf.ramp(0.0, 0.5, 4e-3))
    nodes = np.unique(model.elements[where])
    before = np.asarray(sim._core.node_steps())[nodes]
    dt = sim.dt
    sim.run(until=4e-3)
    after = np.asarray(sim._core.node_steps())[nodes]
    assert (after <= before).all() and (after < before).any()
    assert sim.dt > 0.9 * dt
    assert np.isfinite(sim.u).all()


def test_laws_beyond_the_base_take_the_shortest_step():
    """Their bound is not known element by element, and their past goes on step by step."""
    model = stiff_in_soft()
    viscous = tf.material(
        "neo_hookean", youngs_modulus=20e3, poissons_ratio=0.45, density=1100.0,
        prony=[(0.3, "1 ms")],
    )  # fmt: skip
    model.set_material(model.cells[:, 2] == 4, viscous, name="viscous")
    steps = []
    states = []
    for substeps in (1, 8):
        sim = tf.Simulator(model, device="native", precision="double", subcycling=substeps,
                           dt=substeps * 1.5e-6)  # fmt: skip
        sim.set_state(np.zeros((model.n_nodes, 3)), swirl(model))
        sim.run(until=0.6e-3)
        steps.append(np.asarray(sim._core.node_steps()))
        states.append(sim.u)
    of_viscous = np.unique(model.elements[model.cells[:, 2] == 4])
    assert (steps[1][of_viscous] == 1).all() and steps[1].max() == 8
    assert abs(states[1] - states[0]).max() < 5e-3 * abs(states[0]).max()


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_sliding_distances_are_kept_on_a_moving_surface(rows, figure, friction):
    model = stiff_in_soft(sheets=(8, 11))
    surface = trimesh.creation.icosphere(subdivisions=4, radius=20e-3)
    surface.apply_translation((SIZE[0] / 2, SIZE[1] / 2, -20.2e-3))
    lower = model.nodes[:, 2] < 1e-9
    kept = model.slide(lower, surface, "bone", friction=friction)
    motion = tf.RigidMotion(
        about=(3e-3, 15e-3, -10e-3),
        axis=(1.0, 0.2, 0.0),
        angle=np.radians(20.0),
        share=tf.ramp(0.0, 1.0, 6e-3, shape="cosine"),
    )
    model.move_surface("bone", motion)
    sim = tf.Simulator(model, damping=100.0, precision="double", subcycling=8, **rows)
    assert (np.asarray(sim._core.node_steps())[lower] == 8).all()
    for until in (2e-3, 4e-3, 6e-3):
        sim.run(until=until)
        pose = motion(sim.time)
        seen = ((model.nodes + sim.u)[lower] - pose[:, 3]) @ pose[:, :3]
        squares, _ = _core.brute_force_nearest(surface.vertices, surface.faces, seen)
        figure(f"error over the voxel at {1e3 * until:g} ms",
               abs(np.sqrt(squares) - abs(kept)).max() / H, at_most=1e-9)  # fmt: skip
    assert abs(sim.u).max() > 1e-3


def test_sliding_distances_are_kept_in_a_relaxation(rows, figure):
    """Pseudo-steps have one length: nodes of long steps are put back in each, and later."""
    model = stiff_in_soft(sheets=(8, 11))
    model.gravity = (981.0, 0.0, 0.0)
    model.fix(lambda x: x[:, 0] < 1e-9)
    surface = trimesh.creation.icosphere(subdivisions=4, radius=20e-3)
    surface.apply_translation((SIZE[0] / 2, SIZE[1] / 2, -20.2e-3))
    lower = (model.nodes[:, 2] < 1e-9) & ~model.fixed.any(axis=1)
    kept = model.slide(lower, surface, "bone")

    def error(sim):
        places = (model.nodes + sim.u)[lower]
        squares, _ = _core.brute_force_nearest(surface.vertices, surface.faces, places)
        return abs(np.sqrt(squares) - abs(kept)).max() / H

    sim = tf.Simulator(model, damping=100.0, precision="double", subcycling=8, **rows)
    assert (np.asarray(sim._core.node_steps())[lower] == 8).all()
    assert sim.relax(1e-6).converged
    assert abs(sim.u[lower]).max() > 0.1 * H
    figure("error over the voxel, relaxed", error(sim), at_most=1e-9)
    sim.step(5)
    figure("error over the voxel, steps after", error(sim), at_most=1e-9)
    whole = tf.Simulator(model, damping=100.0, precision="double", **rows)
    assert whole.relax(1e-6).converged
    sim.relax(1e-6)
    off = abs(sim.u - whole.u).max() / abs(whole.u).max()
    figure("difference from one step for all", off, at_most=1e-4)


def test_the_bits_do_not_depend_on_calls_or_bands(rows):
    one, parts = driven(8, rows["device"]), driven(8, rows["device"])
    one.step(57)
    for n in (10, 1, 40, 6):
        parts.step(n)
    np.testing.assert_array_equal(one.u, parts.u)
    np.testing.assert_array_equal(one.velocity, parts.velocity)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_executors_agree(precision, figure):
    if len(ROWS) < 2:
        pytest.skip("one executor with rows")
    found = []
    for executor in ROWS:
        sim = moving(8, precision=precision, device=executor.device, kernels="rows", dt=12e-6)
        sim.step(50)
        found.append(sim.u)
    off = abs(found[1] - found[0]).max() / abs(found[0]).max()
    figure(precision, off, at_most=1e-4 if precision == "single" else 1e-12)


def test_a_restart_goes_on_bit_for_bit(tmp_path):
    model = stiff_in_soft()
    model.fix(lambda x: x[:, 2] < 1e-9)
    model.gravity = (0.0, 0.0, -9.81)
    model.add_muscle("m", lambda c: abs(c[:, 2] - 2e-3) < 6e-4, fibre=(1, 0, 0), sigma_act=50e3)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=20e-3)
    ball.apply_translation((SIZE[0] / 2, SIZE[1] / 2, SIZE[2] + 20.2e-3))
    model.slide(model.nodes[:, 2] > SIZE[2] - 1e-9, ball)
    sim = tf.Simulator(model, device="native", subcycling=True, damping=50.0, energy_every=3)
    sim.activate("m", tf.ramp(0.0, 0.3, 2e-3))
    assert sim.substeps > 1
    sim.step(40)
    sim.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    assert again.substeps == sim.substeps
    np.testing.assert_array_equal(again._core.node_steps(), sim._core.node_steps())
    for each in (sim, again):
        each.step(60)
    np.testing.assert_array_equal(again.u, sim.u)
    np.testing.assert_array_equal(again.velocity, sim.velocity)
    assert again.energies == sim.energies


def test_a_restart_elsewhere_keeps_the_motion(tmp_path):
    """Other lanes make other blocks: their levels are chosen anew, the velocity stays."""
    others = [e.device for e in ROWS if e.device != "native"]
    if not others:
        pytest.skip("one executor with rows")
    sim = moving(8, precision="single")
    sim.step(40)
    sim.checkpoint(tmp_path / "c.h5")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        again = tf.Simulator.restore(tmp_path / "c.h5", device=others[0])
    speed = abs(sim.velocity).max()
    assert abs(again.velocity - sim.velocity).max() < 1e-3 * speed
    for each in (sim, again):
        each.step(40)
    assert again.time == sim.time
    assert abs(again.u - sim.u).max() < 0.01 * abs(sim.u).max()


def test_levels_are_chosen_at_once_after_a_restart_on_other_lanes(tmp_path):
    """Until then everything takes the shortest step: a file of a device of one lane is made up."""
    sim = moving(8)
    sim.step(40)
    sim.checkpoint(tmp_path / "c.h5")
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        layout, arrays = file["state/layout"], file["state/arrays"]
        lanes = int(layout.attrs["lanes"])
        layout.attrs["lanes"] = 1
        for name in ("u", "u_prev"):
            blocks = arrays[name][()].view(np.float64).reshape(-1, 3, lanes)
            arrays[name][...] = np.swapaxes(blocks, 1, 2).reshape(-1).view(np.uint8)
        levels = np.repeat(arrays["levels"][()], lanes)
        del arrays["levels"]
        arrays["levels"] = levels
    with pytest.warns(UserWarning, match="stand in other places"):
        again = tf.Simulator.restore(tmp_path / "c.h5")
    for each in (sim, again):
        each.step(1)
    cost = sim._core.relative_cost()
    assert cost < 0.8
    assert again._core.relative_cost() == pytest.approx(cost, abs=0.1)
    assert abs(again.u - sim.u).max() < 0.01 * abs(sim.u).max()


@pytest.mark.parametrize("substeps", [4, 16])
def test_a_body_at_rest_trembles_with_the_impulses_and_no_more(figure, substeps):
    """Forces that balance come at different times; relax() takes one step for all."""
    model = stiff_in_soft()
    model.gravity = (0.0, 0.0, -9.81 * 20)
    model.fix(lambda x: x[:, 2] < 1e-9)
    sim = tf.Simulator(model, device="native", precision="double", subcycling=substeps)
    for _ in range(2):
        assert sim.relax(1e-8).converged
        rest = sim.u
        sim.step(3200 // substeps)
        off = abs(sim.u - rest).max() / abs(rest).max()
        figure("tremor over the displacement", off, at_most=5e-5 * substeps**2)


# -- what is asked for ---------------------------------------------------------------------------


def test_dt_is_the_longest_step_and_substeps_the_fewest_that_do():
    model = stiff_in_soft()
    limit = tf.Simulator(model, device="native")
    auto = tf.Simulator(model, device="native", subcycling=True)
    assert auto.substeps in (4, 8, 16)
    assert auto.dt == pytest.approx(auto.substeps * limit.dt)
    four = tf.Simulator(model, device="native", subcycling=True, dt=3.9 * limit.dt)
    assert four.substeps == 4
    assert four.dt == pytest.approx(3.9 * limit.dt)
    one = tf.Simulator(model, device="native", subcycling=True, dt=limit.dt)
    assert one.substeps == 1
    four.step(10)
    assert four.n_steps == 10
    assert four.time == pytest.approx(39 * limit.dt)
    with pytest.raises(InputError, match=r"dt: got .*, above the stable bound .* set by stiff"):
        tf.Simulator(model, device="native", subcycling=True, dt=30 * limit.dt)


def test_a_body_of_one_material_is_left_alone():
    model = tf.Model.block(CELLS, SIZE, soft())
    assert tf.Simulator(model, device="native", subcycling=True).substeps == 1


@pytest.mark.parametrize("value", [3, 32, 0, "yes", 2.0, None, -4])
def test_other_numbers_are_refused(value):
    with pytest.raises(InputError, match=r"subcycling: got .*; allowed: true, false, or how many"):
        tf.Simulator(stiff_in_soft(), device="native", subcycling=value)


def test_kernels_that_cannot_say_so():
    gather = [e for e in EXECUTORS if e.kernels == "gather"]
    if not gather:
        pytest.skip("no executor with gather kernels")
    with pytest.warns(SubcyclingWarning, match="gather kernels take steps of one length"):
        sim = tf.Simulator(stiff_in_soft(), subcycling=True, **gather[0].kwargs)
    assert sim.substeps == 1
    sim.step(3)
