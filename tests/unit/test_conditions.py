"""Prescribed motion, body forces, pressures: on every executor, and their checks."""

import numpy as np
import pytest
import trimesh

import tledface as tf
from tledface._frame import core_pose
from tledface.conditions import Sampler
from tledface.errors import InputError
from tledface.motion import pose_at

SIZE = (4e-3, 3e-3, 2e-3)


def soft(**more):
    values = {"youngs_modulus": 34e3, "poissons_ratio": 0.45, "density": 1100.0, **more}
    return tf.material("neo_hookean", **values)


def block(cells=(8, 6, 4)):
    return tf.Model.block(cells=cells, size=SIZE, material=soft())


def bottom(X):
    return X[:, 2] < 1e-9


def top(X):
    return X[:, 2] > SIZE[2] - 1e-9


def motion(t, X):
    return 0.05 * X[:, 0] * np.sin(900 * t)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_prescribed_components_follow_their_schedules(executor, precision):
    model = block()
    model.fix(bottom)
    model.prescribe(top, {"x": lambda t: 3e-5 * np.sin(700 * t), "z": motion})
    model.prescribe(lambda X: X[:, 0] > SIZE[0] - 1e-9, {"y": np.full(35, 0.0)})
    sim = tf.Simulator(model, precision=precision, **executor.kwargs)
    nodes = top(model.nodes)
    for n in (1, 6, 300, 41):
        sim.step(n)
        assert sim.u[nodes, 0] == pytest.approx(3e-5 * np.sin(700 * sim.time), rel=1e-6)
        # Straight lines between keys 8 steps apart.
        slack = (8 * sim.dt) ** 2 / 8 * 0.05 * SIZE[0] * 900**2 + 1e-11
        assert abs(sim.u[nodes, 2] - motion(sim.time, model.nodes[nodes])).max() <= slack
        assert (sim.u[model.nodes[:, 0] > SIZE[0] - 1e-9, 1] == 0.0).all()
    inner = (model.nodes[:, 2] > 1e-9) & ~nodes
    assert (sim.u[inner, 1] != 0.0).any()


def test_executors_agree_under_all_conditions(executor):
    def run(**options):
        model = block()
        model.fix(bottom)
        model.prescribe(lambda X: top(X) & (X[:, 0] < 1e-3), {"x": lambda t: 0.02 * t, "z": motion})
        model.body_force(lambda c: c[:, 0] > 2e-3, (300.0, 0.0, -5e3))
        model.body_force(np.ones(192, bool), lambda t: (0.0, 2e3 * np.cos(500 * t), 0.0))
        model.pressure(lambda c, n: n[:, 2] > 0.5, lambda t: 4e4 * t)
        model.pressure(lambda c, n: n[:, 0] > 0.5, 50.0)
        model.gravity = (1.0, -2.0, 3.0)
        sim = tf.Simulator(model, precision="double", **options)
        sim.step(400)
        return sim.u

    expected = run(device="native")
    got = run(**executor.kwargs)
    assert abs(expected).max() > 1e-5
    assert abs(got - expected).max() <= 1e-10 * abs(expected).max()


def test_pieces_of_a_run_see_the_same_keys(executor):
    results = []
    for pieces in ([200], [3, 1, 60, 136]):
        model = block()
        model.fix(bottom)
        model.prescribe(top, {"z": motion})
        sim = tf.Simulator(model, **executor.kwargs)
        for n in pieces:
            sim.step(n)
        results.append(sim.u)
    assert np.array_equal(*results)


def test_the_start_is_at_the_prescribed_values():
    model = block()
    model.prescribe(top, {"x": 1e-4, "y": lambda t: 2e-4 + t, "z": lambda t, X: 0.1 * X[:, 1]})
    sim = tf.Simulator(model, precision="double")
    nodes = top(model.nodes)

    def check(time):
        assert (sim.u[nodes, 0] == 1e-4).all()
        assert sim.u[nodes, 1] == pytest.approx(2e-4 + time, rel=1e-12)
        assert np.allclose(sim.u[nodes, 2], 0.1 * model.nodes[nodes, 1], rtol=1e-12)

    check(0.0)
    assert (sim.u[~nodes] == 0.0).all()
    sim.set_state(np.full((model.n_nodes, 3), 5e-5), time=0.25)
    check(0.25)
    assert (sim.u[~nodes] == 5e-5).all()


def test_the_last_of_fix_and_prescribe_holds():
    model = block()
    model.fix(bottom)
    model.prescribe(bottom, {"x": 1e-5})
    assert not model.fixed[bottom(model.nodes), 0].any()
    model.prescribe(lambda X: bottom(X) & (X[:, 0] < 1e-9), {"x": 2e-5})
    model.fix(lambda X: bottom(X) & (X[:, 1] < 1e-9), "x")
    u = tf.Simulator(model, precision="double").u[:, 0]
    X = model.nodes
    assert (u[bottom(X) & (X[:, 1] < 1e-9)] == 0.0).all()
    assert (u[bottom(X) & (X[:, 1] > 1e-9) & (X[:, 0] < 1e-9)] == 2e-5).all()
    assert (u[bottom(X) & (X[:, 1] > 1e-9) & (X[:, 0] > 1e-9)] == 1e-5).all()


def test_pressure_forces_are_area_vectors_of_the_deformed_faces():
    """A closed surface under one pressure: no net force, and the work is that on the volume."""
    model = block()
    model.pressure(lambda c, n: np.ones(len(c), bool), 100.0)
    sim = tf.Simulator(model, precision="double")
    A = np.array([[0.2, 0.1, 0.0], [0.0, -0.1, 0.3], [0.05, 0.0, 0.1]])
    sim.set_state(model.nodes @ A.T)
    force = sim.external_force()
    area = 2 * (SIZE[0] * SIZE[1] + SIZE[1] * SIZE[2] + SIZE[2] * SIZE[0])
    assert abs(force.sum(axis=0)).max() < 1e-12 * 100 * area
    volume = np.prod(SIZE) * np.linalg.det(np.eye(3) + A)
    # Growing all over by a share e adds 3 e V.
    assert (force * (model.nodes + sim.u)).sum() == pytest.approx(-100 * 3 * volume, rel=1e-12)


def test_free_body_accelerates_by_force_over_mass(executor):
    model = block()
    model.body_force(np.ones(192, bool), (1100.0 * 2.5, 0.0, 0.0))
    model.pressure(lambda c, n: abs(n[:, 1]) > 0.5, 30.0)  # balanced
    sim = tf.Simulator(model, precision="double", **executor.kwargs)
    sim.step(200)
    mass = sim.mass
    centre = (mass[:, None] * sim.u).sum(axis=0) / mass.sum()
    assert centre[0] == pytest.approx(2.5 * sim.time**2 / 2, rel=1e-9)
    assert abs(centre[1:]).max() < 1e-6 * centre[0]
    assert sim.u[:, 1].max() > 0 > sim.u[model.nodes[:, 1] > 2.9e-3, 1].min()


def test_a_bad_value_on_the_way_is_named():
    model = block()
    model.prescribe(top, {"x": lambda t: "far" if t > 1e-5 else 0.0})
    sim = tf.Simulator(model)
    with pytest.raises(InputError, match=r"component x: got 'far', at t = "):
        sim.step(100)
    model = block()
    model.prescribe(top, {"x": lambda t, X: np.zeros(3)})
    with pytest.raises(InputError, match=r"gave shape \(3,\), at t = 0 s; allowed: .* \(63,\)"):
        tf.Simulator(model)
    model = block()
    with pytest.raises(InputError, match=r"body_force: got inf at \[2\], which is not finite"):
        model.body_force(np.ones(192, bool), (0.0, 0.0, np.inf))
    model.body_force(np.ones(192, bool), lambda t: 3.0)
    with pytest.raises(InputError, match=r"body_force: got 3.0, .* three finite numbers"):
        tf.Simulator(model)
    with pytest.raises(
        InputError, match=r"got shape \(2,\); allowed: finite N/m3, \(3,\) for all of"
    ):
        model.body_force(np.ones(192, bool), (0.0, 1.0))
    for given in ("far", [[1.0], [2.0, 3.0]]):
        model = block()
        model.prescribe(top, {"x": lambda t, X, given=given: given})
        with pytest.raises(InputError, match=r"allowed: a finite number or \(63,\)"):
            tf.Simulator(model)
        model = block()
        model.body_force(np.ones(192, bool), lambda t, given=given: given)
        with pytest.raises(InputError, match="three finite numbers"):
            tf.Simulator(model)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_what_is_fixed_stays_whatever_acts_and_velocity_is_given(executor, precision):
    model = block()
    model.fix(lambda X: X[:, 0] < 1e-9)
    model.fix(top, "x")
    model.gravity = (2.0, -3.0, -9.81)
    model.body_force(np.ones(192, bool), (500.0, 200.0, -300.0))
    model.pressure(lambda c, n: abs(n[:, 0]) > 0.5, 30.0)
    sim = tf.Simulator(model, precision=precision, **executor.kwargs)
    sim.set_state(np.zeros_like(model.nodes), np.ones_like(model.nodes))
    sim.step(20)
    assert not sim.u[model.fixed].any() and sim.u[~model.fixed].any()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.prescribe(top, {"w": 1.0}), "some of the keys 'x', 'y', 'z'"),
        (lambda m: m.prescribe(top, {}), "some of the keys"),
        (lambda m: m.prescribe(top, {"x": np.nan}), "component x: got nan"),
        (lambda m: m.prescribe(top, {"x": [1.0, 2.0]}), r"or \(63,\) of them"),
        (lambda m: m.prescribe(lambda X: X[:, 0] > 1, {"x": 0.0}), "selects none"),
        (lambda m: m.body_force(np.ones(192, bool), (1.0, 2.0)), r"got shape \(2,\)"),
        (lambda m: m.pressure(lambda c, n: n[:, 0] > 2, 1.0), "none of the 208 boundary faces"),
        (lambda m: m.pressure(np.ones(3, bool), 1.0), r"must be \(208,\) bool"),
        (lambda m: m.pressure(lambda c, n: n[:, 0] > 0, "big"), "pressure: got 'big'"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call(block())


def test_conditions_are_saved_where_they_are_numbers(tmp_path):
    model = block()
    model.fix(bottom)
    model.prescribe(top, {"x": 1e-5, "z": 1e-2 * model.nodes[top(model.nodes), 0]})
    model.body_force(lambda c: c[:, 0] > 2e-3, (0.0, 1e3, 0.0))
    model.pressure(lambda c, n: n[:, 0] > 0.5, 50.0)
    model.save(tmp_path / "m.h5")
    results = []
    for each in (model, tf.Model.load(tmp_path / "m.h5")):
        sim = tf.Simulator(each)
        sim.step(100)
        results.append(sim.u)
    assert np.array_equal(*results)
    model.pressure(lambda c, n: n[:, 0] < -0.5, lambda t: t)
    with pytest.raises(InputError, match=r"given to Model.pressure cannot be saved; save the"):
        model.save(tmp_path / "n.h5")
    assert not (tmp_path / "n.h5").exists()


@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
def test_channels_of_many_steps_are_those_of_each(moving):
    """Bit for bit, whatever stands still and whatever changes; functions see each step's time."""
    calls = []

    def push(t):
        calls.append(t)
        return 4e4 * t

    model = block()
    model.body_force(lambda c: c[:, 0] > 2e-3, (300.0, 0.0, -5e3))
    model.pressure(lambda c, n: n[:, 0] > 0.5, 50.0)
    model.prescribe(lambda X: top(X) & (X[:, 0] < 1e-3), {"x": 1e-5})
    if moving:
        model.body_force(np.ones(192, bool), lambda t: (1e2 * t, 2e3 * np.cos(500 * t), 0.0))
        model.pressure(lambda c, n: n[:, 2] > 0.5, push)
        model.prescribe(lambda X: top(X) & (X[:, 0] > 3e-3), {"y": lambda t: np.sin(700 * t)})
        for shift in (1e-3, 2e-3):
            bone = trimesh.creation.box((0.01, 0.01, 0.002))
            bone.apply_translation((0.0, 0.0, -1e-3 - shift))
            name = f"bone {shift}"
            model.slide(
                lambda X, s=shift: bottom(X) & ((X[:, 0] < 1.9e-3) == (s < 1.5e-3)), bone, name
            )
            motion = tf.RigidMotion(axis=(1, 2, 3), angle=0.1, share=tf.ramp(0, 1, 1e-3))
            model.move_surface(name, motion)
    sampler = Sampler(model, time_scaling=1.7)
    times = 3e-4 + 1.7e-6 * np.arange(6)
    table = sampler.channels_of_steps(times)
    assert calls == [1.7 * t for t in times[:-1].tolist()] * moving
    for row, begin, end in zip(table, times, times[1:], strict=False):
        expected = [sampler.loads(begin), sampler.scalars(end)]
        for _, motion in sampler._motions:
            expected += [
                core_pose(model, pose_at(motion, 1.7 * t, "motion")).ravel() for t in (begin, end)
            ]
        assert np.array_equal(row, np.concatenate(expected))
    assert np.array_equal(sampler.channels(times[2], times[3]), table[2])
    assert table.shape == (5, len(sampler.channels_of_rest()))


def test_a_rigid_motion_takes_numbers_of_every_kind_and_refuses_text():
    turn = tf.RigidMotion(axis=np.array([0, 1, 0]), angle=np.float32(0.5), share=tf.ramp(0, 1, 1.0))
    assert turn(1.0)[0, 0] == pytest.approx(np.cos(0.5))
    for key, value in {"axis": "x", "about": None, "shift": (0, "a", 0), "angle": "5"}.items():
        with pytest.raises(InputError, match=f"motion {key}: got .*; allowed: "):
            tf.RigidMotion(**{key: value})


WRONG = [
    (None, "None"),
    ("3.0", "'3.0'"),
    (np.nan, "nan"),
    ({"x": 1.0}, r"\{'x': 1.0\}"),
    (np.zeros((2, 2)), r"shape \(2, 2\)"),
    ([[1.0], [2.0, 3.0]], r"\[\[1.0\], \[2.0, 3.0\]\]"),
    ("long " * 99, r"'long long .*\.\.\."),
]


@pytest.mark.parametrize(("value", "told"), WRONG)
@pytest.mark.parametrize("kind", ["scalar", "field", "force", "pressure", "pose"])
def test_what_a_callable_gave_is_told_with_its_time(kind, value, told):
    """At the first moment that it gives it: before 10 us nothing is wrong."""
    model = block()
    good = {"field": np.zeros(63), "force": np.zeros(3), "pose": np.eye(4)}.get(kind, 0.0)
    given = value
    if kind == "field" and value is np.nan:
        given, told = np.where(np.arange(63) == 5, np.nan, 0.0), r"nan at \[5\], .* not finite"

    def later(t):
        return good if t < 1e-5 else given

    if kind == "scalar":
        model.prescribe(top, {"x": later})
    elif kind == "field":
        model.prescribe(top, {"x": lambda t, X: later(t)})
    elif kind == "force":
        model.body_force(np.ones(192, bool), later)
    elif kind == "pressure":
        model.pressure(lambda c, n: n[:, 2] > 0.5, later)
    else:
        model.slide(bottom, trimesh.creation.box((1.0, 1.0, 1.0)), "bone")
        model.move_surface("bone", later)
    sim = tf.Simulator(model, device="native")
    line = rf"(got|gave) {told}, at t = [\d.e-]+ s; allowed: "
    with pytest.raises(InputError, match=line) as caught:
        sim.step(1000)
    assert len(str(caught.value)) < 250
    assert "\n" not in str(caught.value)
