"""Checkpoints: bit for bit on every executor, clear refusals, whole whatever happens."""

import errno
import subprocess
import sys
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest

import tledface as tf
from tledface import checkpoint
from tledface.energy import EnergyWarning
from tledface.errors import InputError, SimulationError
from tledface.schedule import Keyframes
from tledface.time_step import StepWarning


def make_model():
    soft = tf.material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)
    model = tf.Model.block(cells=(17, 9, 5), size=(0.017, 0.009, 0.005), material=soft)
    model.add_muscle("low", lambda c: c[:, 2] < 0.003, (1, 0.3, 0.2), sigma_act=5e6)
    model.add_muscle("high", lambda c: c[:, 2] > 0.003, (0.1, 1, 0), sigma_act=1e6)
    model.fix(lambda X: X[:, 0] == 0.0)
    model.gravity = (0, 0, -9.81)
    return model


def make_sim(model=None, **options):
    sim = tf.Simulator(model or make_model(), damping=200.0, **options)
    sim.activate("low", tf.ramp(0, 0.75, 0.005, shape="cosine"))
    sim.activate("high", Keyframes((0.0, 0.002, 0.004), (0.0, 0.3, 0.1)))
    return sim


def assert_same(one, other):
    for name in ("u", "velocity"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert (one.time, one.dt, one.n_steps) == (other.time, other.dt, other.n_steps)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("steps", [0, 333, 700])
def test_a_restart_goes_on_bit_for_bit(executor, precision, steps, tmp_path):
    sim = make_sim(precision=precision, **executor.kwargs)
    sim.step(steps)
    sim.checkpoint(tmp_path / "c.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["c.h5"]
    again = tf.Simulator.restore(tmp_path / "c.h5")
    assert_same(sim, again)
    # Past several looks at the state, with another time step after some of them.
    sim.step(900)
    for n in (1, 399, 500):
        again.step(n)
    assert_same(sim, again)
    assert abs(sim.u).max() > (1e-3 if steps else 0.0)
    again.checkpoint(tmp_path / "d.h5")
    assert_same(sim, tf.Simulator.restore(tmp_path / "d.h5", device=executor.device))


def test_dt_and_options_come_back(tmp_path):
    sim = make_sim(
        device="native", dt=5e-6, mass_scaling=2.0, hourglass="joldes", hourglass_kappa=0.1
    )
    sim.step(40)
    sim.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    assert again._options == sim._options
    sim.step(100)
    again.step(100)
    assert_same(sim, again)


def test_the_physical_form_comes_back_though_a_kappa_is_stored(tmp_path):
    make_sim(device="native").checkpoint(tmp_path / "c.h5")
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        assert file["options"].attrs["hourglass_kappa"] == 0.075
        file["options"].attrs["hourglass_kappa"] = 0.5  # once taken in silence
    assert tf.Simulator.restore(tmp_path / "c.h5")._options["hourglass"] == "physical"


def test_histories_of_materials_come_back(executor, tmp_path):
    moduli = {"youngs_modulus": 34e3, "poissons_ratio": 0.49, "density": 1100.0}
    slow = tf.material("neo_hookean", **moduli, prony=[(0.4, 0.001), (0.2, 0.01)])
    model = make_model()
    model.set_material(lambda c: c[:, 1] < 0.005, slow)
    sim = make_sim(model, **executor.kwargs)
    sim.step(300)
    sim.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    sim.step(300)
    again.step(300)
    assert_same(sim, again)


def test_prescribed_motion_and_a_relaxation_go_on_bit_for_bit(tmp_path):
    model = make_model()
    model.prescribe(lambda X: X[:, 0] > 0.0169, {"x": -1e-5})
    sim = make_sim(model, device="native")
    sim.step(300)
    sim.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    for one in (sim, again):  # at first from the loads of the last step before the file
        one.relax(tolerance=1e-2)
        one.step(100)
        one.relax(tolerance=1e-2)
        one.step(100)
    assert_same(sim, again)


def test_a_given_state_is_looked_at_before_its_first_step_on_both_sides_of_a_file(tmp_path):
    model = make_model()
    sim = make_sim(model, device="native")
    at_rest = sim.dt
    sim.set_state(model.nodes * (-0.25, 0.0, 0.0))
    sim.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    for one in (sim, again):
        one.step(1)
    assert again.dt < 0.95 * at_rest
    assert_same(sim, again)


def test_a_warning_of_the_step_is_not_given_again_after_a_restart(tmp_path):
    model = make_model()
    dt = 0.99 * make_sim(model, device="native").dt_crit
    sim = make_sim(model, device="native", dt=dt)
    squeezed = model.nodes * (-0.25, 0.0, 0.0)
    sim.set_state(squeezed)
    with pytest.warns(StepWarning, match="may be above the stable limit of now"):
        sim.step(1)
    sim.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    with warnings.catch_warnings():
        warnings.simplefilter("error", StepWarning)
        again.step(8)


@pytest.mark.parametrize("weigh", ["largest", "turnover"])
def test_the_ledger_weighs_its_error_by_all_that_passed_before_a_restart(weigh, tmp_path):
    """The warning of a balance that is off says the same as without a restart.

    Of a swing that damping takes away the largest energy is what the error is weighed by, of one
    under gravity that nothing takes away it is what went to and fro.
    """
    soft = tf.material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.45, density=1100.0)
    model = tf.Model.block(cells=(6, 3, 3), size=(0.012, 0.006, 0.006), material=soft)
    model.fix(lambda X: X[:, 0] == 0.0)
    damping = 200.0 if weigh == "largest" else 0.0
    if weigh == "turnover":
        model.gravity = (0, 0, -9.81)
    sim = tf.Simulator(
        model, device="native", precision="double", damping=damping, energy_every=2, dt=1.2e-4
    )
    if weigh == "largest":
        sim.set_state(np.zeros_like(model.nodes), model.nodes[:, [1, 1, 0]] * (0, 0, 3.0))
    sim.step(14 if weigh == "largest" else 170)
    sim.checkpoint(tmp_path / "c.h5")
    told = []
    for one in (sim, tf.Simulator.restore(tmp_path / "c.h5")):
        one.step(12)  # the first entries of a ledger warn of nothing
        one._core.set_state(one.u, 0 * one.velocity, one.time)  # behind the ledger's back
        with pytest.warns(EnergyWarning, match="the energy balance is off by") as seen:
            one.step(2)
        told += [str(warning.message) for warning in seen]
    assert told[0] == told[1] and len(told) == 2


def test_the_model_comes_back(tmp_path):
    model = make_model()
    make_sim(model, device="native").checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5").model
    for key, values in model.element_parameters().items():
        assert np.array_equal(values, again.element_parameters()[key]), key
    for one, other in zip(model.muscles, again.muscles, strict=True):
        assert np.array_equal(one.fibre, other.fibre)


def test_a_callable_is_asked_for_again(tmp_path):
    sim = make_sim(device="native")
    sim.activate("low", lambda t: 100.0 * t)
    sim.step(50)
    sim.checkpoint(tmp_path / "c.h5")
    with pytest.raises(InputError, match=r"the activation of 'low' was a callable.*activations=\{"):
        tf.Simulator.restore(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5", activations={"low": lambda t: 100.0 * t})
    sim.step(50)
    again.step(50)
    assert_same(sim, again)
    with pytest.raises(InputError, match="got muscle 'middle'"):
        tf.Simulator.restore(tmp_path / "c.h5", activations={"low": 0.1, "middle": 0.5})


@pytest.mark.parametrize("steps", [0, 333])
def test_another_device_goes_on_with_a_warning(executor, steps, tmp_path):
    if executor.device == "native":
        pytest.skip("the native device is the one to start on")
    sim = make_sim(device="native", precision="double")
    sim.step(steps)
    sim.checkpoint(tmp_path / "c.h5")
    with pytest.warns(UserWarning, match="not bit for bit"):
        again = tf.Simulator.restore(tmp_path / "c.h5", device=executor.device)
    assert np.array_equal(sim.u, again.u)
    assert np.array_equal(sim.velocity, again.velocity)
    sim.step(300)
    again.step(300)
    assert again.u == pytest.approx(sim.u, abs=1e-9 * abs(sim.u).max())


@pytest.mark.parametrize(("more_lanes", "turn"), [(3, 1), (0, 1), (0, 0)])
def test_the_arrangement_of_another_device_is_translated(executor, more_lanes, turn, tmp_path):
    """Of another device, or another version: a file of other lanes, axes, places is made up."""
    sim = make_sim(precision="double", **executor.kwargs)
    sim.step(100)
    sim.checkpoint(tmp_path / "c.h5")
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        layout, arrays = file["state/layout"], file["state/arrays"]
        lanes, order = int(layout.attrs["lanes"]), layout.attrs["axis_order"]
        slots = layout["node_slots"][()]
        turned, wider = np.roll(order, turn), lanes + more_lanes
        scattered = np.random.default_rng(1).permutation(7 * len(slots))[: len(slots)]
        for name in ("u", "u_prev"):
            old = arrays[name][()].view(np.float64).reshape(-1, 3, lanes)
            new = np.full((7 * len(slots) // wider + 1, 3, wider), np.nan)
            for axis in range(3):
                source = old[:, list(order).index(axis)][slots // lanes, slots % lanes]
                target = new[:, list(turned).index(axis)]
                target[scattered // wider, scattered % wider] = source
            del arrays[name]
            arrays[name] = new.reshape(-1).view(np.uint8)
        layout.attrs["lanes"], layout.attrs["axis_order"] = wider, turned
        layout["node_slots"][...] = scattered
    with pytest.warns(UserWarning, match="stand in other places than now; not bit for bit"):
        again = tf.Simulator.restore(tmp_path / "c.h5")
    assert_same(sim, again)
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        file["state/arrays/more"] = np.zeros(24, dtype=np.uint8)
    with pytest.raises(InputError, match="histories of materials"):
        tf.Simulator.restore(tmp_path / "c.h5")


def test_no_warning_on_the_same_device(tmp_path):
    make_sim(device="native").checkpoint(tmp_path / "c.h5")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tf.Simulator.restore(tmp_path / "c.h5")
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        file.attrs["tledface"] = "0.0.1"
    with pytest.warns(UserWarning, match=r"made by tledface 0\.0\.1; not bit for bit"):
        tf.Simulator.restore(tmp_path / "c.h5")
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        file["device"].attrs["platform"] = "AVX-9"
    with pytest.warns(UserWarning, match=r"the device's platform was AVX-9, now it is"):
        tf.Simulator.restore(tmp_path / "c.h5")
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        file["device"].attrs.update({"id": "opencl:7", "name": "a card that was taken out"})
    with pytest.warns(UserWarning, match="the device was a card that was taken out, now it is"):
        tf.Simulator.restore(tmp_path / "c.h5")


def test_a_model_changed_after_the_simulator_was_made_is_noticed(tmp_path):
    model = make_model()
    sim = make_sim(model, device="native")
    stiff = tf.material("neo_hookean", youngs_modulus=1e6, poissons_ratio=0.49, density=1100.0)
    model.set_material(lambda c: c[:, 0] > 0.01, stiff)
    sim.checkpoint(tmp_path / "c.h5")
    with pytest.raises(InputError, match="model is not the one that was simulated"):
        tf.Simulator.restore(tmp_path / "c.h5")


def damage_cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def damage_byte(path):
    with h5py.File(path) as file:
        place = file["state/arrays/u"].id.get_chunk_info(0).byte_offset
    data = bytearray(path.read_bytes())
    data[place + 100] ^= 1
    path.write_bytes(data)


def damage_key(path):
    with h5py.File(path, "r+") as file:
        del file["watch"]


def damage_kind(path):
    with h5py.File(path, "r+") as file:
        file.attrs["format"] = "tledface model"


def damage_version(path):
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 99


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (damage_cut, "not an HDF5 file, or cut short"),
        (damage_byte, "damaged"),
        (damage_key, "damaged"),
        (damage_kind, "not a tledface checkpoint"),
        (damage_version, "version 99, this tledface reads version 1"),
        (Path.unlink, "no such file"),
    ],
)
def test_damage_is_one_line(damage, message, tmp_path):
    path = tmp_path / "c.h5"
    make_sim(device="native").checkpoint(path)
    damage(path)
    with pytest.raises(checkpoint.DamagedCheckpoint, match=message) as raised:
        tf.Simulator.restore(path)
    assert "\n" not in str(raised.value)
    assert str(path) in str(raised.value)


def test_a_device_that_fails_is_no_damage(tmp_path, monkeypatch):
    """The file may be whole: it says what the device said."""
    path = tmp_path / "c.h5"
    make_sim(device="native").checkpoint(path)

    def fails(*_arguments, **_options):
        raise SimulationError("opencl:0: kernels do not compile")

    monkeypatch.setattr(tf.Simulator, "__init__", fails)
    with pytest.raises(SimulationError, match=r"^opencl:0: kernels do not compile$"):
        tf.Simulator.restore(path)


@pytest.mark.parametrize("options", [{"mass_scaling": {"dt": 5e-6}}, {"time_scaling": 2.0}])
def test_the_page_names_all_that_is_in_the_file(options, tmp_path):
    page = Path(__file__).parents[2] / "docs" / "reference" / "checkpoint-file.md"
    text = page.read_text(encoding="utf-8")
    path = tmp_path / "c.h5"
    sim = make_sim(device="native", energy_every=5, subcycling=2, **options)
    sim.step(7)
    sim.checkpoint(path)
    with h5py.File(path) as file:
        named = list(file.attrs) + list(file)
        for group in ("options", "device", "watch", "ledger", "state", "state/layout"):
            named += [*file[group].attrs, *file[group]]
        named += list(file["state/arrays"])
    unnamed = [name for name in named if f"`{name}`" not in text and f"/{name}`" not in text]
    assert [name for name in unnamed if name != "schedules"] == []  # they have numbers there


def test_no_such_folder(tmp_path):
    with pytest.raises(InputError, match="there is no folder"):
        make_sim(device="native").checkpoint(tmp_path / "none" / "c.h5")


def test_what_is_no_file_is_refused(tmp_path):
    sim = make_sim(device="native")
    with pytest.raises(InputError, match=r"checkpoint .*: is a folder"):
        sim.checkpoint(tmp_path)
    for call in (sim.checkpoint, tf.Simulator.restore):
        with pytest.raises(InputError, match="checkpoint: got None"):
            call(None)


def test_a_full_disk_leaves_the_earlier_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "c.h5"
    sim = make_sim(device="native")
    sim.step(10)
    sim.checkpoint(path)
    before = path.read_bytes()
    sim.step(10)
    write = Path.write_bytes

    def full(self, data):
        write(self, bytes(data)[:1000])
        raise OSError(errno.ENOSPC, "No space left on device", str(self))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        sim.checkpoint(path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["c.h5"]


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the file size there")
def test_a_limit_of_the_file_size_leaves_the_earlier_checkpoint(tmp_path):
    program = """
import resource, sys
sys.path.insert(0, sys.argv[1])
from test_checkpoint import make_sim
sim = make_sim(device="native")
sim.step(10)
sim.checkpoint("c.h5")
sim.step(10)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    sim.checkpoint("c.h5")
except OSError as error:
    sys.exit(f"OSError: {error.strerror}")
"""
    done = subprocess.run(
        [sys.executable, "-c", program, str(Path(__file__).parent)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (1, "OSError: File too large\n")
    assert [entry.name for entry in tmp_path.iterdir()] == ["c.h5"]
    assert tf.Simulator.restore(tmp_path / "c.h5").n_steps == 10
