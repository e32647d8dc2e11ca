"""Runs that stop midway: what they leave, and how they go on. Kills are in test_kill.py."""

import errno
import json
import os
import sys

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from conftest import file_limit
from tledface import checkpoint
from tledface.cli import app
from tledface.errors import InputError, SimulationError, in_shell
from tledface.examples import flat_block
from tledface.io import _lock
from tledface.io.vtkhdf import VTKHDFWriter
from tledface.run import resume_run, run_scene
from tledface.run_checkpoints import RunCheckpoints
from tledface.scene import Scene

FINISHED = ["frames.vtkhdf", "frames_surface.vtkhdf", "run.json", "skin.ply", "wrinkles.png"]
LEFT = ["checkpoint-before.h5", "checkpoint-model.h5", "checkpoint.h5"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = flat_block.write(
        tmp_path_factory.mktemp("scene"), voxel=3.0, voxel_height=1.5, triangle=4.0
    )
    text = path.read_text().replace('"50 ms"', '"6 ms"')
    path.write_text(text.replace("fps = 200\n", 'fps = 1000\ncheckpoint_every = "1 ms"\n'))
    return Scene.load(path)


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "out"
    return run_scene(scene, folder, device="native", quiet=True)


@pytest.fixture
def stopped(scene, tmp_path, monkeypatch):
    """A run stopped by the keyboard while its fourth checkpoint was due."""
    stop_at(monkeypatch, 4)
    with pytest.raises(KeyboardInterrupt):
        run_scene(scene, tmp_path / "out", device="native", quiet=True)
    monkeypatch.undo()
    return tmp_path / "out"


def stop_at(monkeypatch, count):
    take, taken = RunCheckpoints.take, []

    def counted(self, *arguments):
        taken.append(self)
        if len(taken) == count:
            raise KeyboardInterrupt
        take(self, *arguments)

    monkeypatch.setattr(RunCheckpoints, "take", counted)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def facts(folder):
    return json.loads((folder / "run.json").read_text())


def assert_same(result, whole):
    assert (result.steps, result.dt, result.frames) == (whole.steps, whole.dt, whole.frames)
    assert result.dt_crit == whole.dt_crit
    for role in ("surface", "picture"):
        assert result.files[role].read_bytes() == whole.files[role].read_bytes(), role
    assert names(result.directory) == FINISHED


def test_a_stopped_run_goes_on(stopped, whole):
    assert names(stopped) == sorted([*LEFT, *FINISHED[:3]])
    assert facts(stopped)["state"] == "interrupted"
    result = resume_run(stopped, quiet=True)
    assert_same(result, whole)
    assert facts(stopped)["state"] == "finished"
    assert facts(stopped)["scene"] == facts(whole.directory)["scene"]
    assert result.wall > 0.0


def test_a_scene_that_has_changed_is_told(stopped, whole, scene):
    text = scene.path.read_text()
    try:
        scene.path.write_text(text.replace('"6 ms"', '"7 ms"'))
        with pytest.warns(
            UserWarning, match=r"\.toml is not, or no longer, the scene that this run"
        ):
            assert_same(resume_run(stopped, quiet=True), whole)
    finally:
        scene.path.write_text(text)


def test_one_that_has_not_is_not_told(stopped, whole, scene, recwarn):
    scene.path.write_text("# a remark\n" + scene.path.read_text())
    assert_same(resume_run(stopped, quiet=True), whole)
    assert not [str(w.message) for w in recwarn if "no longer" in str(w.message)]


def test_an_unfinished_run_is_no_earlier_one(stopped, scene):
    message = rf"holds an unfinished run; `tledface resume {stopped}` goes on, --force starts again"
    with pytest.raises(InputError, match=message):
        run_scene(scene, stopped, device="native", quiet=True)
    for name in LEFT:
        (stopped / name).unlink()
    with pytest.raises(InputError, match="holds an earlier run; --force replaces it"):
        run_scene(scene, stopped, device="native", quiet=True)


@pytest.mark.parametrize(
    ("path", "word"),
    [
        ("out/a-b_2", "out/a-b_2"),
        ("Ergebnisse/für/Ä", "Ergebnisse/für/Ä"),
        ("my run", "'my run'"),
        ("für alle", "'für alle'"),
        ("a;b", "'a;b'"),
    ],
)
def test_paths_in_commands_are_one_word(path, word):
    assert in_shell(path) == word


def test_checkpoints_cost_no_bits(scene, whole, tmp_path):
    output = scene.output.model_copy(update={"checkpoint_every": "off"})
    assert_same(
        run_scene(
            scene.model_copy(update={"output": output}),
            tmp_path / "out",
            device="native",
            quiet=True,
        ),
        whole,
    )


def test_a_resumption_may_be_stopped_too(stopped, whole, monkeypatch):
    stop_at(monkeypatch, 2)
    with pytest.raises(KeyboardInterrupt):
        resume_run(stopped, quiet=True)
    monkeypatch.undo()
    assert names(stopped) == sorted([*LEFT, *FINISHED[:3]])
    assert_same(resume_run(stopped, quiet=True), whole)


def test_a_damaged_checkpoint_is_passed_over(stopped, whole):
    path = stopped / "checkpoint.h5"
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.warns(UserWarning, match=r"checkpoint\.h5: .*cut short.*taking the one before it"):
        result = resume_run(stopped, quiet=True)
    assert_same(result, whole)


def test_a_kill_between_two_renames_loses_nothing(stopped, whole):
    os.replace(stopped / "checkpoint-before.h5", stopped / "checkpoint-old.h5")
    os.replace(stopped / "checkpoint.h5", stopped / "checkpoint-new.h5")
    os.replace(stopped / "checkpoint-old.h5", stopped / "checkpoint-before.h5")
    assert_same(resume_run(stopped, quiet=True), whole)


@pytest.mark.filterwarnings("ignore:checkpoint")
def test_what_cannot_go_on_is_named(stopped, whole, tmp_path):
    with pytest.raises(InputError, match="no run; give the folder of"):
        resume_run(tmp_path)
    with pytest.raises(InputError, match="the run is finished; there is nothing to resume"):
        resume_run(whole.directory)
    with pytest.raises(InputError, match="opencl:99"):
        resume_run(stopped, device="opencl:99", quiet=True)
    for name in ("checkpoint.h5", "checkpoint-before.h5"):
        (stopped / name).write_bytes(b"no HDF5")
    with pytest.raises(InputError, match="no checkpoint is whole"):
        resume_run(stopped, quiet=True)
    for name in ("checkpoint.h5", "checkpoint-before.h5"):
        (stopped / name).unlink()
    with pytest.raises(InputError, match=r"before its first checkpoint; run it again with --force"):
        resume_run(stopped, quiet=True)
    assert facts(stopped)["state"] == "interrupted"


def test_a_study_is_computed_anew(tmp_path):
    (tmp_path / "run.json").write_text('{"tledface": "0.1.0", "demo": "film", "state": "failed"}')
    with pytest.raises(InputError, match="no checkpoints; run `tledface demo film --force -o "):
        resume_run(tmp_path)


def test_a_device_that_fails_costs_no_checkpoint(stopped, whole, monkeypatch):
    """No advice to begin anew: the same checkpoint goes on where the device works."""

    def fails(*_arguments, **_options):
        raise SimulationError("opencl:0: kernels do not compile")

    with monkeypatch.context() as patch:
        patch.setattr("tledface.Simulator.__init__", fails)
        with pytest.raises(SimulationError, match=r"^opencl:0: kernels do not compile$"):
            resume_run(stopped, quiet=True)
    assert_same(resume_run(stopped, quiet=True), whole)


def test_a_lost_model_is_damage(stopped):
    (stopped / "checkpoint-model.h5").unlink()
    with (
        pytest.warns(UserWarning, match="taking the one before it"),
        pytest.raises(InputError, match="no checkpoint is whole"),
    ):
        resume_run(stopped, quiet=True)


def test_another_device_is_a_warning(stopped, executor):
    if executor.device == "native":
        pytest.skip("the run was on the native device")
    with pytest.warns(UserWarning, match="the device was .*not bit for bit"):
        result = resume_run(stopped, device=executor.device, quiet=True)
    assert names(result.directory) == FINISHED


def test_force_replaces_a_stopped_run_with_all_it_left(scene, stopped, whole):
    os.replace(stopped / "frames.vtkhdf", stopped / "frames.part.vtkhdf")
    (stopped / "run.json").write_text(
        json.dumps({**facts(stopped), "state": "running", "files": ["frames.part.vtkhdf"]})
    )
    with pytest.raises(InputError, match="--force"):
        run_scene(scene, stopped, device="native", quiet=True)
    assert_same(run_scene(scene, stopped, device="native", quiet=True, force=True), whole)


def test_a_run_with_more_frames_than_steps_goes_on(scene, tmp_path, monkeypatch):
    text = scene.path.read_text().replace('"6 ms"', '"1 ms"').replace("fps = 1000", "fps = 60000")
    path = scene.path.with_name("many.toml")
    path.write_text(text.replace('every = "1 ms"', 'every = "0.2 ms"'))
    many = Scene.load(path)
    whole = run_scene(many, tmp_path / "whole", device="native", quiet=True)
    assert whole.frames == whole.steps + 1
    stop_at(monkeypatch, 4)
    with pytest.raises(KeyboardInterrupt):
        run_scene(many, tmp_path / "out", device="native", quiet=True)
    monkeypatch.undo()
    assert_same(resume_run(tmp_path / "out", quiet=True), whole)
    times = []
    for folder in ("whole", "out"):
        with h5py.File(tmp_path / folder / "frames.vtkhdf") as file:
            times.append(file["VTKHDF/Steps/Values"][: whole.frames])
    np.testing.assert_array_equal(*times)


def test_others_are_refused_while_a_run_goes_on(scene, whole, tmp_path, monkeypatch):
    out, take, refused = tmp_path / "out", RunCheckpoints.take, []

    def files():  # not when they were read
        stats = {path: path.stat() for path in out.iterdir()}
        return {path: (s.st_ino, s.st_size, s.st_mtime_ns) for path, s in stats.items()}

    def others_come(self, sim, *arguments):
        take(self, sim, *arguments)
        monkeypatch.setattr(RunCheckpoints, "take", take)  # others that got in would come here too
        before = files()
        for words in (["resume", out], ["run", scene.path, "-o", out, "--force"]):
            done = CliRunner().invoke(app, [*map(str, words), "-q"])
            refused.append((done.exit_code, done.stderr))
        assert files() == before

    monkeypatch.setattr(RunCheckpoints, "take", others_come)
    assert_same(run_scene(scene, out, device="native", quiet=True), whole)
    line = f"tledface: error: output {out}: another process is running into it; wait for its end"
    assert refused
    assert all(code == 2 and text.startswith(line) for code, text in refused)
    assert all(text.count("\n") == 1 for _, text in refused)


def test_a_run_that_ends_while_a_resumption_comes_is_not_run_again(stopped, monkeypatch):
    acquire = _lock.acquire

    def ends_first(path):
        (stopped / "run.json").write_text(json.dumps({**facts(stopped), "state": "finished"}))
        return acquire(path)

    monkeypatch.setattr(_lock, "acquire", ends_first)
    with pytest.raises(InputError, match="the run is finished; there is nothing to resume"):
        resume_run(stopped, quiet=True)
    assert "run.lock" not in names(stopped)


def test_a_disk_too_full_for_checkpoints_is_a_warning(scene, whole, tmp_path, monkeypatch):
    save = checkpoint.save

    def full(sim, path, **more):
        if sim.time > 2.5e-3:
            raise OSError(errno.ENOSPC, "No space left on device")
        save(sim, path, **more)

    monkeypatch.setattr(checkpoint, "save", full)
    with pytest.warns(UserWarning, match=r"no checkpoint at t = .*No space left.*earlier one stay"):
        result = run_scene(scene, tmp_path / "out", device="native", quiet=True)
    assert_same(result, whole)


def test_a_disk_too_full_for_frames_ends_the_run_and_it_goes_on_later(
    scene, whole, tmp_path, monkeypatch
):
    append = VTKHDFWriter.append

    def full(self, time, u, **fields):
        if time > 3.5e-3:
            raise OSError(errno.ENOSPC, "No space left on device")
        append(self, time, u, **fields)

    monkeypatch.setattr(VTKHDFWriter, "append", full)
    with pytest.raises(OSError, match="No space left"):
        run_scene(scene, tmp_path / "out", device="native", quiet=True)
    assert facts(tmp_path / "out")["state"] == "failed"
    monkeypatch.undo()
    assert_same(resume_run(tmp_path / "out", quiet=True), whole)


def test_a_disk_too_full_for_the_first_frame_says_what_to_do(scene, tmp_path, monkeypatch):
    def full(self, time, u, **fields):
        raise OSError(errno.ENOSPC, "No space left on device", "frames.part.vtkhdf")

    monkeypatch.setattr(VTKHDFWriter, "append", full)
    with pytest.raises(OSError, match=r"make room, then run it again with --force.*frames\.part"):
        run_scene(scene, tmp_path / "out", device="native", quiet=True)


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the file size there")
def test_a_limit_of_file_sizes_ends_a_resumption_and_it_goes_on_later(stopped, whole):
    size = (stopped / "frames.vtkhdf").stat().st_size
    for limit in (size // 4, size // 2, size - 8):
        with file_limit(limit):
            done = CliRunner().invoke(app, ["resume", str(stopped), "-q"])
        if limit == size // 4:
            limited = done
    assert limited.exit_code == 2, limited.output
    line = limited.stderr.splitlines()[-1]
    assert line.startswith(f"tledface: error: {stopped}")
    assert line.endswith(
        "File too large; raise the limit of file sizes (ulimit -f), then "
        f"`tledface resume {stopped}` goes on"
    )
    assert facts(stopped)["state"] == "failed"
    assert_same(resume_run(stopped, quiet=True), whole)


def test_the_verb(stopped, whole):
    done = CliRunner().invoke(app, ["resume", str(stopped), "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["frames"] == whole.frames
    assert np.isclose(found["simulated_s"], whole.simulated, rtol=0, atol=0)
    done = CliRunner().invoke(app, ["resume", str(stopped)])
    assert done.exit_code == 2
    assert done.stderr.startswith("tledface: error: resume ")
    assert done.stderr.count("\n") == 1
