"""A run from scene to files, with a simulator that makes waves without computing."""

import json
import shutil
import sys
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import trimesh

import fake_run
from conftest import file_limit
from tledface.check import check_scene
from tledface.constitutive import material
from tledface.errors import InputError, SimulationError
from tledface.frame_plan import reserved_frames
from tledface.io.vtkhdf import frame_bytes
from tledface.model import Model
from tledface.output import earlier_run
from tledface.run import _Frames, load_run, run_scene, save_built, shown_surface
from tledface.scene import Scene
from tledface.schedule import Ramp

FILES = ["frames.vtkhdf", "frames_surface.vtkhdf", "run.json", "surface.ply", "wrinkles.png"]


@pytest.fixture
def scene(tmp_path, monkeypatch):
    fake_run.install(monkeypatch)
    return Scene.load(fake_run.write_scene(tmp_path))


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_run_writes_its_files_and_measures_folds(scene, tmp_path):
    out = tmp_path / "out"
    result = run_scene(scene, out, quiet=True)
    assert names(out) == FILES
    assert (out / "wrinkles.png").read_bytes()[:4] == b"\x89PNG"
    with h5py.File(out / "frames.vtkhdf") as file:
        times = file["VTKHDF/Steps/Values"][:]
    np.testing.assert_allclose(times, np.arange(6) / 500, atol=1e-12)
    moved = trimesh.load(out / "surface.ply", process=False)
    assert moved.vertices[:, 2].max() == pytest.approx(0.005, rel=1e-4)
    assert result.frames == 6
    assert result.steps == 1000
    assert result.dt == pytest.approx(1e-5)
    assert result.folds is not None
    assert result.folds.count == 5
    assert result.max_displacement == pytest.approx(1e-3)
    about = earlier_run(out)
    assert about is not None
    assert about["state"] == "finished"
    assert about["result"]["wrinkles"]["count"] == 5
    assert set(about["files"]) == set(FILES) - {"run.json"}
    assert "5 folds" in result.text()
    assert "wrinkles.png" in result.text()
    json.dumps(result.to_dict(), allow_nan=False)


def test_the_scene_reaches_the_simulator(scene, tmp_path):
    run_scene(scene, tmp_path / "out", quiet=True)
    sim = fake_run.FakeSimulator.made[0]
    assert sim.options["damping"] == 200.0
    assert sim.options["mass_scaling"] == 10.0
    assert sim.options["dt"] == "auto"
    assert (sim.options["precision"], sim.options["hourglass"]) == ("single", "physical")
    assert "hourglass_kappa" not in sim.options
    assert sim.schedules == {"pull": Ramp(0.0, 0.75, 0.01)}


def test_selective_mass_scaling_reaches_the_simulator(tmp_path, monkeypatch):
    fake_run.install(monkeypatch)
    text = fake_run.SCENE.replace("mass_scaling = 10", 'mass_scaling = { dt = "3 us" }')
    run_scene(Scene.load(fake_run.write_scene(tmp_path, text)), tmp_path / "out", quiet=True)
    assert fake_run.FakeSimulator.made[0].options["mass_scaling"] == {"dt": pytest.approx(3e-6)}


def test_bad_input_leaves_nothing_behind(scene, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise InputError("dt: got 1 s, above the stable bound")

    monkeypatch.setattr("tledface.simulator.Simulator", refuse)
    with pytest.raises(InputError, match=r"brow\.toml: solver: dt: got 1 s"):
        run_scene(scene, tmp_path / "out", quiet=True)
    assert not (tmp_path / "out").exists()


def test_a_foreign_folder_is_refused_before_building(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(Scene, "build", lambda self: pytest.fail("built"))
    with pytest.raises(InputError, match="no tledface run"):
        run_scene(scene, tmp_path, quiet=True)


def test_a_failed_run_keeps_its_frames_and_says_so(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(fake_run.FakeSimulator, "fail_at", 0.005)
    out = tmp_path / "out"
    with pytest.raises(SimulationError, match=r"step 7: not finite; the frames until then are in"):
        run_scene(scene, out, quiet=True)
    assert names(out) == ["frames.vtkhdf", "frames_surface.vtkhdf", "run.json"]
    about = earlier_run(out)
    assert about is not None
    assert (about["state"], about["error"]) == ("failed", "step 7: not finite")
    monkeypatch.setattr(fake_run.FakeSimulator, "fail_at", np.inf)
    run_scene(scene, out, quiet=True, force=True)
    assert names(out) == FILES


def test_frames_passed_by_long_steps_are_not_made_up_for_in_short_ones():
    def frames(notes):
        made = _Frames(None, None, 30e3, 1.0, notes)
        made.put = lambda snapshot: None
        return made

    def taken(made, steps):
        found = []
        for dt, time in steps:
            sim = SimpleNamespace(time=time, dt=dt, snapshot=lambda: None)
            if made.due(sim):
                made.take(sim)
                found.append(time)
            assert not made.due(sim)
        return found

    long = [(1e-4, 1e-4 * step) for step in range(11)]
    short = [(1e-5, 1e-3 + 1e-5 * step) for step in range(1, 101)]
    with frames({"frames": 0, "last_time": -1.0}) as made:
        assert taken(made, long) == [time for _, time in long]
        # As after a checkpoint in between.
        notes = {"frames": made.count, "next_frame": made.next, "last_time": made.last_time}
        found = taken(made, short)
    assert len(found) == 29  # each 33 us up to 2 ms; one long step went beyond the first
    assert made.count == 40
    with frames(notes) as again:
        assert taken(again, short) == found


def test_folds_that_cannot_be_measured_fail_no_run(scene, tmp_path, monkeypatch):
    def refuse(*_):
        raise InputError("line profile: too short\nmore")

    monkeypatch.setattr("tledface.folds.measure_folds", refuse)
    with pytest.warns(UserWarning, match=r"^folds not measured \(line profile: too short\); "):
        result = run_scene(scene, tmp_path / "out", quiet=True)
    assert result.folds is None
    assert names(tmp_path / "out") == FILES
    assert earlier_run(tmp_path / "out")["state"] == "finished"


def test_more_frames_than_steps_give_one_a_step(tmp_path, monkeypatch):
    fake_run.install(monkeypatch)
    text = fake_run.SCENE.replace("fps = 500", "fps = 250000")
    text = text.replace('duration = "10 ms"', 'duration = "0.2 ms"')
    scene = Scene.load(fake_run.write_scene(tmp_path, text))
    result = run_scene(scene, tmp_path / "out", quiet=True)
    assert result.frames == 21
    for name in ("frames", "frames_surface"):
        with h5py.File(tmp_path / "out" / f"{name}.vtkhdf") as file:
            times = file["VTKHDF/Steps/Values"][:]
            assert file["VTKHDF/Steps"].attrs["NSteps"] == 21
        np.testing.assert_allclose(times, np.arange(21) * 1e-5, atol=1e-12)


@pytest.mark.parametrize(
    ("duration", "fps", "message"),
    [
        ("1e300 s", "500", r"duration: got 1e\+300 s, 1e\+305 steps of 1e-05 s; allowed: 1e\+12"),
        ("1000 s", "2000", r"fps, solver.duration: got 2,000,001 frames of .*allowed: 1,000,000"),
        ("1000 s", "1e308", r"fps, solver.duration: got 100,000,001 frames of "),
        ("10 s", "1e5", r"fps, solver.duration: got 1,000,001 frames of "),
    ],
)
def test_frames_that_no_disk_holds_are_refused_at_once(
    tmp_path, monkeypatch, duration, fps, message
):
    fake_run.install(monkeypatch)
    text = fake_run.SCENE.replace("fps = 500", f"fps = {fps}")
    text = text.replace('duration = "10 ms"', f'duration = "{duration}"')
    scene = Scene.load(fake_run.write_scene(tmp_path, text))
    with pytest.raises(InputError, match=message):
        check_scene(scene, device="native", quiet=True)
    with pytest.raises(InputError, match=message):
        run_scene(scene, tmp_path / "out", quiet=True)
    assert not (tmp_path / "out").exists()


def test_frames_that_this_disk_does_not_hold_are_refused(scene, tmp_path, monkeypatch):
    run_scene(scene, tmp_path / "out", quiet=True)
    written = (tmp_path / "out").glob("*.vtkhdf")
    taken = sum(path.stat().st_blocks * 512 for path in written)
    model = fake_run.make_model()
    frames = 6 * frame_bytes(model, shown_surface(model))
    free = shutil.disk_usage(tmp_path)._replace(free=frames - 1)
    monkeypatch.setattr("shutil.disk_usage", lambda path: free)
    message = r"got 6 frames of 0.\d+ MB, 0.\d+ GB; free for .*new: 0.\d+ GB; lower output.fps"
    with pytest.raises(InputError, match=message):
        run_scene(scene, tmp_path / "new", quiet=True)
    assert not (tmp_path / "new").exists()
    # The files that a run replaces are room for its own.
    free = free._replace(free=frames - taken)
    run_scene(scene, tmp_path / "out", quiet=True, force=True)
    free = free._replace(free=frames - 2 * taken - 2**20)
    before = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    with pytest.raises(InputError, match="lower output"):
        run_scene(scene, tmp_path / "out", quiet=True, force=True)
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the file size there")
@pytest.mark.parametrize("limit", [20_000, 400_000])
def test_a_file_longer_than_its_limit_is_refused_and_what_was_there_stays(scene, tmp_path, limit):
    run_scene(scene, tmp_path / "out", quiet=True)
    longest = max(path.stat().st_size for path in (tmp_path / "out").glob("*.vtkhdf"))
    assert longest > limit
    before = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    message = r"got 6 frames in a file of 0.\d+ MB; allowed by the limit of file sizes: 0.\d+ MB"
    with file_limit(limit), pytest.raises(InputError, match=message):
        run_scene(scene, tmp_path / "out", quiet=True, force=True)
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    with file_limit(int(1.2 * longest)):
        run_scene(scene, tmp_path / "out", quiet=True, force=True)


def test_frames_of_high_rates_reserve_no_more_than_steps(tmp_path, monkeypatch):
    fake_run.install(monkeypatch)
    text = fake_run.SCENE.replace("fps = 500", "fps = 1e9")
    scene = Scene.load(fake_run.write_scene(tmp_path, text))
    assert reserved_frames(scene, fake_run.FakeSimulator(None)) == 2001


def test_a_built_model_runs_without_its_surfaces(scene, tmp_path):
    path = tmp_path / "model.h5"
    save_built(scene, scene.build(), path)
    (tmp_path / "skin.stl").unlink()
    loaded, model = load_run(path)
    assert loaded.solver == scene.solver
    assert loaded.muscles[0].activation == scene.muscles[0].activation
    assert model.n_elements == 2880
    run_scene(loaded, tmp_path / "out", model=model, quiet=True)
    assert names(tmp_path / "out") == FILES
    assert not list(tmp_path.glob("*.part*"))


def test_a_scene_with_python_objects_comes_back_from_its_model_file(scene, tmp_path):
    tables = fake_run.scene_tables()
    tables["muscles"][0]["activation"] = Ramp(np.float64(0.0), 0.7, 3e-5, 1e-3, "cosine")
    tables["layers"][0]["material"] = material(
        "mooney_rivlin", c10=1e3, bulk_modulus=1e5, density=1e3, prony=[(0.2, 0.01)]
    )
    made = Scene.from_dict(tables, tmp_path)
    save_built(made, made.build(), tmp_path / "model.h5")
    loaded, _ = load_run(tmp_path / "model.h5")
    assert loaded.layers == made.layers
    assert loaded.muscles[0].activation == tables["muscles"][0]["activation"]


def test_a_model_without_scene_is_named(tmp_path):
    path = tmp_path / "model.h5"
    fake_run.make_model().save(path)
    assert Model.load(path).n_elements == 2880
    with pytest.raises(InputError, match=r"model\.h5: holds no scene"):
        load_run(path)
