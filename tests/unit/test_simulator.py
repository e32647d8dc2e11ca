"""The Simulator's own duties: checking, sampling, frames, sharing arrays, stopping on NaN."""

import numpy as np
import pytest
import trimesh

import tledface as tf
from conftest import required, unless_required
from tledface.errors import InputError, SimulationError


def soft(**more):
    values = {"youngs_modulus": 34e3, "poissons_ratio": 0.49, "density": 1100.0, **more}
    return tf.material("neo_hookean", **values)


def small_model(muscle=True):
    model = tf.Model.block(cells=(8, 6, 4), size=(4e-3, 3e-3, 2e-3), material=soft())
    if muscle:
        model.add_muscle("m", lambda c: c[:, 2] < 1e-3, fibre=(1, 0, 0), sigma_act=1e5)
    model.fix(lambda X: X[:, 0] < 1e-9)
    return model


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"damping": -1.0}, "damping: got -1.0"),
        ({"damping": 1e300}, r"damping: got 1e\+300; allowed: a number from 0 to 1e\+15"),
        ({"mass_scaling": 1e300}, r"mass_scaling: got 1e\+300; allowed: a factor of 1 to 1e\+15"),
        ({"hourglass": "joldes", "hourglass_kappa": 1e300}, r"hourglass_kappa: got 1e\+300"),
        ({"mass_scaling": 0.5}, "mass_scaling: got 0.5"),
        ({"hourglass": "none"}, "hourglass: got 'none', allowed are 'physical', 'joldes'"),
        ({"hourglass_kappa": 0.5}, 'hourglass_kappa: got 0.5 with hourglass = "physical"'),
        ({"hourglass": "joldes", "hourglass_kappa": "a"}, "hourglass_kappa: got 'a'"),
        ({"precision": "half"}, "precision: got 'half'"),
        ({"precision": 32}, "precision: got '32', allowed are 'single', 'double'"),
        ({"kernels": None}, "kernels: got 'None', allowed are 'auto', 'rows', 'gather', 'tile'"),
        ({"hourglass": 1}, "hourglass: got '1', allowed are 'physical', 'joldes'"),
        ({"kernels": "fast"}, "kernels: got 'fast'"),
        ({"dt": "big"}, "dt: got 'big'"),
        ({"dt": 0.0}, "dt: got 0.0"),
        ({"dt": 1.0}, "above the stable bound"),
        ({"device": "opencl:99"}, "opencl:99"),
        ({"device": "native", "kernels": "gather"}, "row kernels"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(InputError, match=message):
        tf.Simulator(small_model(), **options)


def test_what_is_no_model_is_refused():
    with pytest.raises(InputError, match="got None as model; allowed: a tledface"):
        tf.Simulator(None)


def test_dt_message_suggests_a_mass_scaling_that_works():
    model = small_model()
    dt = 3 * tf.Simulator(model, mass_scaling=4.0).dt
    with pytest.raises(InputError) as caught:
        tf.Simulator(model, mass_scaling=4.0, dt=dt)
    wanted = float(str(caught.value).rsplit("=", 1)[1])
    assert tf.Simulator(model, mass_scaling=1.05 * wanted, dt=dt).dt == dt


def test_unknown_muscle_and_bad_activation():
    sim = tf.Simulator(small_model())
    with pytest.raises(InputError, match="this model has: m"):
        sim.activate("frontalis", 0.5)
    with pytest.raises(InputError):
        sim.activate("m", 1.5)
    with pytest.raises(InputError, match="whole number"):
        sim.step(-1)


def test_run_reaches_its_time_and_calls_frames():
    sim = tf.Simulator(small_model())
    sim.activate("m", tf.ramp(0, 0.5, 1e-3))
    seen = []
    sim.run(until=2e-3, on_frame=lambda s: seen.append(s.time), fps=5000)
    assert sim.time == pytest.approx(2e-3, abs=sim.dt)
    assert np.allclose(seen, 2e-4 * np.arange(1, 11), atol=sim.dt)
    with pytest.raises(InputError, match="fps"):
        sim.run(until=3e-3, on_frame=print)


@pytest.mark.parametrize("fps", [3e5, 1e9])
def test_a_step_gives_one_frame_however_many_are_asked_for(fps):
    sim = tf.Simulator(small_model(), device="native")
    seen = []
    sim.run(until=10 * sim.dt, on_frame=lambda s: seen.append(s.n_steps), fps=fps)
    assert sim.n_steps == 10
    assert len(seen) >= 10 and len(seen) == len(set(seen))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda sim: sim.run("a"), "run: got until = 'a'; allowed: a finite time"),
        (lambda sim: sim.run(None), "run: got until = None"),
        (lambda sim: sim.run(-1), r"run: got until = -1 s; allowed: .* which is now, or later"),
        (lambda sim: sim.run(sim.time - sim.dt), "which is now, or later"),
        (lambda sim: sim.run(1e-3, on_frame=3, fps=1000), "run: got on_frame = 3; allowed: a func"),
        (lambda sim: sim.run(1e-3, on_frame=print, fps="a"), "run: got fps = 'a'"),
        (lambda sim: sim.set_state("a"), "u: got 'a'; allowed: finite values of shape"),
        (
            lambda sim: sim.set_state(np.where(np.arange(315 * 3).reshape(315, 3) == 4, np.nan, 0)),
            r"u: got nan at \[1, 1\], which is not finite; allowed",
        ),
        (lambda sim: sim.set_state([1, [2]]), "u: got .*; allowed: finite values of shape"),
        (lambda sim: sim.set_state(sim.u, time=np.nan), "set_state: got time = nan"),
        (lambda sim: sim.set_state(sim.u, time="a"), "set_state: got time = 'a'"),
    ],
)
def test_bad_arguments_of_run_and_set_state_change_nothing(call, message):
    sim = tf.Simulator(small_model(), device="native")
    sim.step(5)
    time = sim.time
    with pytest.raises(InputError, match=message):
        call(sim)
    assert (sim.time, sim.n_steps) == (time, 5)


def test_run_to_a_time_that_is_reached_does_nothing():
    sim = tf.Simulator(small_model(), device="native")
    until = 4.6 * sim.dt
    sim.run(until)
    sim.run(until)  # the nearest step lies behind it
    sim.run(sim.time)
    assert sim.n_steps == 5


def test_steps_in_pieces_equal_steps_at_once():
    results = []
    for pieces in ([300], [1] * 20 + [280], [37, 263]):
        sim = tf.Simulator(small_model())
        sim.activate("m", tf.ramp(0, 0.5, 1e-3))
        for n in pieces:
            sim.step(n)
        results.append(sim.u)
    assert abs(results[0]).max() > 1e-6
    for result in results[1:]:
        assert np.array_equal(result, results[0])


def test_free_fall_is_exact_from_the_first_step():
    """u = g t^2/2 at every step: the start from rest is second order."""
    model = tf.Model.block(cells=(3, 3, 3), size=(3e-3, 3e-3, 3e-3), material=soft())
    model.gravity = (0.0, 2.0, -9.81)
    sim = tf.Simulator(model, precision="double")
    for n in (1, 2, 7):
        sim.step(n)
        assert np.allclose(sim.u, np.multiply(model.gravity, sim.time**2 / 2), rtol=1e-9, atol=0)


def test_initial_velocity_and_velocity_out():
    model = tf.Model.block(cells=(3, 3, 3), size=(3e-3, 3e-3, 3e-3), material=soft())
    sim = tf.Simulator(model, precision="double")
    sim.set_state(np.zeros((64, 3)), np.tile([0.3, -0.1, 0.2], (64, 1)), time=1.5)
    assert sim.time == 1.5
    sim.step(10)
    assert np.allclose(sim.u, np.multiply([0.3, -0.1, 0.2], 10 * sim.dt))
    assert np.allclose(sim.velocity, [0.3, -0.1, 0.2])


def test_damping_slows_a_free_body_as_its_equation_says():
    model = tf.Model.block(cells=(2, 2, 2), size=(2e-3, 2e-3, 2e-3), material=soft())
    sim = tf.Simulator(model, precision="double", damping=500.0)
    sim.set_state(np.zeros((27, 3)), np.tile([1.0, 0.0, 0.0], (27, 1)))
    sim.step(200)
    expected = np.exp(-500 * (sim.time - sim.dt / 2))
    assert expected < 0.2
    assert sim.velocity[:, 0] == pytest.approx(expected, rel=1e-4)


def test_fixed_components_stay():
    model = small_model()
    model.fix(lambda X: X[:, 2] < 1e-9, "z")
    model.gravity = (1.0, 2.0, -9.81)
    sim = tf.Simulator(model)
    sim.activate("m", 0.3)
    sim.step(200)
    assert (sim.u[model.fixed] == 0).all()
    assert (sim.u[~model.fixed] != 0).all()


def test_array_is_the_displacement_of_the_device(executor):
    if executor.device != "native":
        required("pyopencl")
    sim = tf.Simulator(small_model(), **executor.kwargs)
    sim.activate("m", 0.4)
    sim.step(25)
    shared = sim.array("u")
    values = shared if executor.device == "native" else shared.get()
    block, lane = sim.node_slots
    in_nodes = values[block, :, lane]
    restored = np.empty_like(in_nodes)
    restored[:, list(sim.axis_order)] = in_nodes
    assert np.array_equal(restored.astype(float), sim.u)
    with pytest.raises(InputError, match="'u'"):
        sim.array("v")


def test_pyopencl_device_is_taken():
    pyopencl = required("pyopencl")
    platforms = [d for p in pyopencl.get_platforms() for d in p.get_devices()]
    if not platforms:
        unless_required("pyopencl lists no device")
    sim = tf.Simulator(small_model(), device=platforms[0])
    sim.activate("m", 0.4)
    sim.step(25)
    native = tf.Simulator(small_model(), device="native")
    native.activate("m", 0.4)
    native.step(25)
    assert abs(sim.u - native.u).max() <= 1e-4 * abs(native.u).max()


def test_a_state_that_is_not_finite_stops_the_run():
    model = small_model()
    sim = tf.Simulator(model)
    u = np.zeros((model.n_nodes, 3))
    u[model.nodes[:, 0] > 3.9e-3] = 0.5
    sim.set_state(u, 1e6 * np.ones_like(u))
    with pytest.raises(
        SimulationError, match=r"step \d+, t = .* near element \d+ \((m|tissue)\), dt = .* dt_crit"
    ):
        sim.step(5000)


def test_sudden_full_contraction_stays_finite_with_auto_dt():
    model = small_model()
    model.add_muscle("strong", lambda c: c[:, 2] > 1e-3, fibre=(1, 0, 0), sigma_act=1e5)
    sim = tf.Simulator(model, damping=200.0)
    before = sim.dt
    sim.activate("strong", 1.0)
    sim.step(4000)
    assert np.isfinite(sim.u).all()
    assert sim.dt < before


def test_surface_follows_the_voxels():
    model = small_model()
    sim = tf.Simulator(model)
    u = model.nodes @ np.array([[0.1, 0, 0], [0, -0.05, 0.02], [0, 0, 0.03]])
    sim.set_state(u)
    mesh = sim.surface("surface")
    rest = model.surfaces["surface"].vertices
    assert np.allclose(
        mesh.vertices,
        rest + rest @ np.array([[0.1, 0, 0], [0, -0.05, 0.02], [0, 0, 0.03]]),
        atol=1e-8,
    )
    with pytest.raises(InputError, match="this model has"):
        sim.surface("skin")


def _step_in_child(queue):
    sim = tf.Simulator(small_model(), device="native")
    sim.activate("m", 0.4)
    sim.step(50)
    queue.put(sim.u)


def test_a_forked_process_simulates_too():
    """A child process has none of its parent's threads; it must not wait for them."""
    import multiprocessing

    sim = tf.Simulator(small_model(), device="native")
    sim.activate("m", 0.4)
    sim.step(50)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_step_in_child, args=(queue,))
    child.start()
    try:
        assert np.array_equal(queue.get(timeout=60), sim.u)
    finally:
        child.kill()


def test_reading_from_another_thread_does_not_disturb_the_steps(executor):
    import threading

    def run(read):
        sim = tf.Simulator(small_model(), **executor.kwargs)
        sim.activate("m", 0.4)
        done = threading.Event()

        def reader():
            while not done.is_set():
                sim.internal_force()
                _ = sim.u

        thread = threading.Thread(target=reader)
        if read:
            thread.start()
        try:
            for _ in range(20):
                sim.step(20)
        finally:
            done.set()
            if read:
                thread.join()
        return sim.u

    assert np.array_equal(run(True), run(False))


def changed_later(change):
    """Simulators of one model: of the second, ``change`` follows."""
    sims = []
    for _ in range(2):
        model = small_model()
        sims.append(tf.Simulator(model, device="native", precision="double", damping=50.0))
    change(sims[1].model)
    return sims


def more_fixed(model):
    model.fix(lambda X: X[:, 0] > X[:, 0].max() - 1e-9)


def more_prescribed(model):
    model.prescribe(lambda X: X[:, 0] > X[:, 0].max() - 1e-9, {"z": 1e-4})


def more_sliding(model):
    far = model.nodes[:, 0].max()
    wall = trimesh.creation.box((0.01, 0.1, 0.1)).apply_translation((far + 0.006, 0.0, 0.0))
    model.slide(lambda X: X[:, 0] > far - 1e-9, wall)


def more_muscles(model):
    model.add_muscle("late", np.ones(model.n_elements, bool), (1, 0, 0), sigma_act=1e3)


@pytest.mark.parametrize("change", [more_fixed, more_prescribed, more_sliding, more_muscles])
def test_later_changes_to_the_model_are_not_seen(change):
    def everything(sim):
        sim.activate("m", 0.3)
        sim.step(5)
        held = sim.reaction(np.ones(sim.model.n_nodes, bool))
        assert sim.relax(1e-3).converged
        return held, sim.u, sim.reaction(np.ones(sim.model.n_nodes, bool))

    first, second = changed_later(change)
    for one, other in zip(everything(first), everything(second), strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(InputError, match="got muscle 'late'; this model has: m"):
        second.activate("late", 0.1)
