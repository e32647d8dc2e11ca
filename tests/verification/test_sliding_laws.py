"""Surfaces that move, rub and let go."""

import h5py
import numpy as np
import pytest
import trimesh

import tledface as tf
from scenes import soft
from tledface import _core

H = 0.5e-3
FAR = np.array([0.1, -0.2, 1.6])  # where atlases lie
G = 9.81


def slab(cells=(10, 8, 4)):
    """A slab on z = 0 of FAR's frame; mask of its lower side."""
    block = tf.Model.block(cells, tuple(n * H for n in cells), soft(30e3, 0.45))
    low = FAR - np.array([cells[0] * H / 2, cells[1] * H / 2, 0.0])
    model = tf.Model.from_voxels(
        block.voxel, low, block.cells, block.tissues, block.tissue_materials, block.fractions
    )
    return model, block.node_ijk[:, 2] == 0


def ball(radius=20e-3):
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    sphere.apply_translation(FAR - np.array([0.0, 0.0, radius + 0.2e-3]))
    return sphere


def plane():
    mesh = trimesh.creation.box((60e-3, 60e-3, 2e-3)).apply_translation((0, 0, -1e-3))
    mesh.apply_translation(FAR)
    return mesh


def jaw(over):
    """A turn of 30 degrees about a hinge behind the ball, with a shift: as a jaw opens."""
    return tf.RigidMotion(
        about=tuple(FAR + np.array([0.0, 15e-3, -10e-3])),
        axis=(1.0, 0.2, 0.0),
        angle=np.radians(30.0),
        shift=(1e-3, -2e-3, 0.5e-3),
        share=tf.ramp(0.0, 1.0, over, shape="cosine"),
    )


@pytest.mark.parametrize("precision", ["single", "double"])
def test_distances_from_a_moving_surface_are_kept(executor, figure, precision):
    """The slab is carried along by friction and inertia; the distance holds at every step."""
    model, lower = slab()
    surface = ball()
    kept = model.slide(lower, surface, "jaw", friction=0.2)
    over = 8e-3
    model.move_surface("jaw", jaw(over))
    sim = tf.Simulator(model, damping=100.0, precision=precision, **executor.kwargs)
    worst = 0.0
    for part in (0.3, 0.6, 1.0):
        sim.run(until=part * over)
        pose = jaw(over)(sim.time)
        x = (model.nodes + sim.u)[lower]
        seen = (x - pose[:, 3]) @ pose[:, :3] - FAR
        squares, _ = _core.brute_force_nearest(surface.vertices - FAR, surface.faces, seen)
        worst = max(worst, abs(np.sqrt(squares) - abs(kept)).max() / H)
    assert abs(sim.u).max() > 5e-3
    figure(
        f"{precision}: error of the distance over the voxel",
        worst,
        at_most=1e-4 if precision == "single" else 1e-9,
    )


def test_held_components_leave_the_distance_to_a_moving_surface(figure):
    """The way back is along what is free of a slanted normal: x is held, the ball goes up."""
    model, lower = slab()
    surface = ball()
    kept = model.slide(lower, surface, "jaw", friction=0.1)
    model.fix(lower, "x")
    way = np.array([0.0, 1.5e-3, 1e-3])
    share = tf.ramp(0.0, 1.0, 4e-3, shape="cosine")
    model.move_surface("jaw", tf.RigidMotion(shift=tuple(way), share=share))
    sim = tf.Simulator(model, device="native", damping=100.0, precision="double")
    sim.run(until=5e-3)
    assert not sim.u[lower, 0].any() and sim.u[lower, 2].min() > 0.5e-3
    seen = (model.nodes + sim.u)[lower] - way - FAR
    squares, _ = _core.brute_force_nearest(surface.vertices - FAR, surface.faces, seen)
    figure("error of the distance over the voxel", abs(np.sqrt(squares) - abs(kept)).max() / H,
           at_most=1e-6)  # fmt: skip


def test_a_jaw_carries_what_sticks_to_it_as_a_rigid_body(executor, figure):
    """High friction: relaxed on the turned surface, the slab has the surface's motion."""
    model, lower = slab()
    model.slide(lower, plane(), "jaw", friction=50.0)
    motion = jaw(20e-3)
    model.move_surface("jaw", motion)
    sim = tf.Simulator(model, damping=2000.0, precision="double", **executor.kwargs)
    sim.run(until=30e-3)
    pose = motion(1.0)
    rigid = model.nodes @ pose[:, :3].T + pose[:, 3] - model.nodes
    figure("off the rigid motion over its size", abs(sim.u - rigid).max() / abs(rigid).max(), 0.0,
           absolute=0.02)  # fmt: skip


def pushed_along_a_plane(friction, pull, until, release=True, **options):
    """A slab pressed on a plane by its weight, at rest, then pulled sideways ever more.

    Where it is free to leave, what presses, trembling or not, is the weight.
    """
    model, lower = slab()
    model.slide(lower, plane(), friction=friction, release=release)
    model.gravity = (0.0, 0.0, -G)
    rise = until / 4
    model.body_force(
        np.ones(model.n_elements, dtype=bool),
        lambda t: (1100.0 * pull * min(t / rise, 1.0), 0.0, 0.0),
    )
    sim = tf.Simulator(model, device="native", precision="double", **options)
    assert sim.relax(1e-6).converged
    sim.run(until=until)
    return sim


def test_friction_holds_below_the_angle_of_friction():
    """A pull of 0.36 g: it holds with a coefficient of 0.4 and goes with 0.3."""
    until, pull = 20e-3, 0.36 * G
    stays, goes = (pushed_along_a_plane(f, pull, until, damping=5.0) for f in (0.4, 0.3))
    free = 0.5 * pull * until**2
    assert abs(stays.u[:, 0].mean()) < 0.01 * free
    assert goes.u[:, 0].mean() > 0.05 * free


def test_a_sliding_block_is_braked_by_coulomb(figure):
    """In the end damping takes what friction leaves of the pull, and the speed stays."""
    friction, pull, damping = 0.3, 0.6 * G, 200.0
    sim = pushed_along_a_plane(friction, pull, 40e-3, damping=damping)
    speed = sim.velocity[:, 0].mean()
    figure("speed, mm/s", 1e3 * speed, 1e3 * (pull - friction * G) / damping, rel=0.02)


def test_what_friction_takes_is_in_the_ledger(figure):
    """Kept on the surface: a node that leaves loses what it has when it comes back."""
    sim = pushed_along_a_plane(0.3, 0.6 * G, 40e-3, release=False, damping=200.0, energy_every=10)
    energies = sim.energies
    print(energies)
    assert energies["friction"] > 0.3 * energies["external"]
    figure("balance error over external work", abs(energies["error"]) / energies["external"],
           at_most=0.02)  # fmt: skip


@pytest.mark.parametrize("pace", [1.0, 2.0])
def test_a_moving_surface_does_its_work(figure, pace):
    """A plane that lifts a slab against gravity: what it does is what the slab has.

    Also where its motion is played faster.
    """
    model, lower = slab()
    model.slide(lower, plane(), "table")
    model.fix(lambda x: abs(x[:, 0] - x[:, 0].min()) < 1e-9, "x")
    model.fix(lambda x: abs(x[:, 1] - x[:, 1].min()) < 1e-9, "y")
    model.gravity = (0.0, 0.0, -G)
    height = 4e-3
    share = tf.ramp(0.0, 1.0, 40e-3, shape="cosine")
    model.move_surface("table", tf.RigidMotion(shift=(0.0, 0.0, height), share=share))
    sim = tf.Simulator(model, device="native", precision="double", damping=400.0, energy_every=10,
                       time_scaling=pace)  # fmt: skip
    sim.run(until=20e-3 + 40e-3 / pace)
    figure("lift, mm", 1e3 * sim.u[:, 2].mean(), 1e3 * height, rel=0.01)
    energies = sim.energies
    lifted = 1100.0 * model.volumes.sum() * G * height
    figure("balance error over the work of lifting", abs(energies["error"]) / lifted, at_most=0.02)


@pytest.mark.parametrize("friction", [0.0, 0.3, 5.0])
def test_a_moving_surface_that_rubs_does_its_work(figure, friction):
    """A belt under a block that one end holds: it slips, or sticks and strains the block."""
    model, lower = slab(cells=(8, 6, 6))
    model.slide(lower, plane(), "belt", friction=friction)
    model.fix(lambda x: x[:, 0] < x[:, 0].min() + 1e-9, "x")
    model.gravity = (0.0, 0.0, -3 * G)
    share = tf.ramp(0.0, 1.0, 8e-3, shape="cosine")
    model.move_surface("belt", tf.RigidMotion(shift=(1e-3, 0.0, 0.0), share=share))
    sim = tf.Simulator(model, device="native", precision="double", damping=30.0, energy_every=1)
    sim.run(until=9e-3)
    energies = sim.energies
    print(energies)
    held = energies["kinetic"] + energies["strain"] + energies["hourglass"] + energies["damping"]
    assert (energies["friction"] > held) == (friction == 0.3)
    figure(f"friction {friction:g}: balance error over external work",
           abs(energies["error"]) / energies["external"], at_most=0.02)  # fmt: skip


@pytest.mark.parametrize("release", [False, True])
def test_a_node_that_may_leave_does(executor, release):
    """Pulled off its surface, and pressed on it."""
    model, lower = slab()
    model.slide(lower, ball(), release=release)
    top = model.nodes[:, 2] > model.nodes[:, 2].max() - 1e-9
    model.fix(top, "xy")
    model.prescribe(top, {"z": lambda t: 0.3e-3 * np.sin(2 * np.pi * t / 16e-3)})
    sim = tf.Simulator(model, damping=500.0, precision="double", **executor.kwargs)
    centre = FAR - np.array([0.0, 0.0, 20.2e-3])
    first = np.linalg.norm(model.nodes[lower] - centre, axis=1)
    sim.run(until=4e-3)
    up = np.linalg.norm((model.nodes + sim.u)[lower] - centre, axis=1) - first
    sim.run(until=12e-3)
    down = np.linalg.norm((model.nodes + sim.u)[lower] - centre, axis=1) - first
    assert (up.mean() > 0.1e-3) if release else (abs(up).max() < 0.01e-3)
    assert down.min() > -0.01e-3


def thrown(up, mesh):
    """A slab thrown off a surface; what of its energy is kinetic, and is missing."""
    model, lower = slab(cells=(4, 4, 3))
    model.slide(lower, mesh, friction=0.3, release=True)
    velocity = np.zeros((model.n_nodes, 3))
    velocity[:, 2] = up
    sim = tf.Simulator(model, device="native", precision="double", energy_every=1)
    sim.set_state(np.zeros_like(velocity), velocity)
    sim.step(50)
    start = 0.5 * sim.mass.sum() * up**2
    return sim.energies["kinetic"] / start, sim.energies["error"] / start


def below(distance, *, inverted=False):
    mesh = plane().apply_translation((0.0, 0.0, -distance))
    if inverted:  # the slab lies behind it
        mesh.invert()
    return mesh


@pytest.mark.parametrize("inverted", [False, True])
def test_the_ledger_knows_who_left(inverted):
    """Nothing holds a slab that flies, on either side of its surface."""
    kinetic, error = thrown(1.0, below(0.2e-3, inverted=inverted))
    assert kinetic == pytest.approx(1.0, rel=1e-12)
    assert abs(error) < 1e-12


def test_rounding_does_not_put_a_node_behind_the_surface_that_it_is_on():
    """Turned over, the plane has nodes 2e-16 m behind it, which may leave it downwards too."""
    kinetic, _ = thrown(-1.0, below(0.0, inverted=True))
    assert kinetic == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("inverted", [False, True])
def test_the_ledger_balances_where_nodes_may_leave_and_rub(figure, inverted):
    """Pressed on by its weight and pulled along, on either side of the surface."""
    model, lower = slab(cells=(6, 5, 3))
    model.slide(lower, below(0.2e-3, inverted=inverted), release=True, friction=0.3)
    model.gravity = (0.0, 0.0, -G)
    model.body_force(
        np.ones(model.n_elements, dtype=bool),
        lambda t: (1100.0 * 0.6 * G * min(t / 5e-3, 1.0), 0.0, 0.0),
    )
    sim = tf.Simulator(model, device="native", precision="double", damping=200.0, energy_every=2)
    assert sim.relax(1e-6).converged
    sim.run(until=15e-3)
    energies = sim.energies
    assert energies["friction"] > 0.4 * energies["external"]
    # Where the ledger takes the other side for the one that is pressed, 0.0056.
    figure("balance error over external work", abs(energies["error"]) / energies["external"],
           at_most=2e-4)  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*energy balance")
def test_they_go_into_files_and_on_from_there(tmp_path):
    """Saved between two entries of the ledger, when something has rubbed since the last."""
    model, lower = slab()
    model.slide(lower, ball(), "jaw", friction=0.3, release=True)
    model.move_surface("jaw", jaw(4e-3))
    model.gravity = (0.0, 0.0, -100 * G)
    sim = tf.Simulator(model, device="native", damping=100.0, energy_every=50)
    sim.step(230)
    sim.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    # As on another device: what is known of the surfaces, and what rubbed off, is not taken over.
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        del file["state/arrays/sliding"]
    elsewhere = tf.Simulator.restore(tmp_path / "c.h5")
    saved = sim.energies
    for each in (sim, again, elsewhere):
        each.step(200)
    assert sim.energies["friction"] > 1.1 * saved["friction"] > 0.0
    assert np.array_equal(sim.u, again.u)
    assert again.energies == sim.energies
    # As files were before the ledger kept marks of friction and forces of surfaces.
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        sums = file["ledger/sums"][:8]
        del file["ledger/sums"], file["ledger/contact"]
        file["ledger/sums"] = sums
    assert tf.Simulator.restore(tmp_path / "c.h5").energies == saved
    assert elsewhere.energies["friction"] == pytest.approx(sim.energies["friction"], rel=1e-4)


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda m, s: m.slide(s, plane(), friction=-1.0), "friction: got -1.0"),
        (lambda m, s: m.slide(s, plane(), release=2), "release: got 2"),
        (lambda m, s: m.move_surface("chin", jaw(1.0)), "move_surface: got 'chin'"),
        (lambda m, s: m.move_surface("jaw", 3.0), "got 3.0"),
        (lambda m, s: m.move_surface("jaw", lambda t: np.eye(3)), "shape \\(3, 3\\)"),
        (lambda m, s: m.move_surface("jaw", lambda t: 2 * np.eye(4)), "not rigid"),
        (
            lambda m, s: m.move_surface("jaw", lambda t: np.full((3, 4), np.nan)),
            r"got nan at \[0, 0\] \(12 such of 12\), which is not finite, at t = 0 s",
        ),
        (lambda m, s: m.move_surface("jaw", lambda t: np.eye(4)[[1, 2, 0, 3]]), "not the identity"),
        (lambda m, s: tf.RigidMotion(axis=(0, 0, 0)), "axis: got"),
        (lambda m, s: tf.RigidMotion(shift=(0, 0)), "shift: got"),
    ],
)
def test_bad_input_is_one_line(call, line):
    model, lower = slab()
    model.slide(lower, plane(), "jaw")
    with pytest.raises(tf.InputError, match=line):
        call(model, lower)


def test_a_motion_that_no_file_can_hold(tmp_path):
    model, lower = slab()
    model.slide(lower, plane(), "jaw")
    model.move_surface("jaw", lambda t: np.eye(4))
    with pytest.raises(tf.InputError, match="move_surface"):
        model.save(tmp_path / "m.h5")
