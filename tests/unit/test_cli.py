"""The command line: verbs, exit codes, one-line errors, JSON."""

import inspect
import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

import fake_run
from tledface import bench_workloads
from tledface.catalogue import Example, shipped
from tledface.cli import app
from tledface.errors import InputError, SimulationError
from tledface.io import _lock
from tledface.scene import Scene

VERBS = ("doctor", "demo", "examples", "new", "check", "build", "run", "resume", "bench", "schema")


@pytest.fixture
def call(monkeypatch, tmp_path):
    fake_run.install(monkeypatch)
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture
def demo_module(monkeypatch):
    """A shipped scene that costs nothing."""
    example = SimpleNamespace(__doc__="A block.\n\nMore.", write=lambda folder: _write(folder))
    monkeypatch.setattr("tledface.cli.demos.shipped", lambda: {"flat-block": example})


def _write(folder):
    folder.mkdir(parents=True, exist_ok=True)
    return fake_run.write_scene(folder)


def error_line(result, code=2):
    assert result.exit_code == code, result.output
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("tledface: error: ")
    assert result.stdout == ""
    return lines[0]


def test_help_names_every_verb_and_each_explains_itself(call):
    top = call("--help")
    assert top.exit_code == 0
    assert all(verb in top.stdout for verb in VERBS)
    for verb in VERBS:
        result = call(verb, "--help")
        assert result.exit_code == 0
        assert "--json" in result.stdout or verb == "schema"


def test_version(call):
    result = call("--version")
    assert result.exit_code == 0
    assert result.stdout.startswith("tledface 0.")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("fly", "'fly': no such verb; allowed: doctor, demo"),
        ("rnu x.toml", "'rnu': no such verb; nearest: run; allowed: doctor"),
        ("run", "missing argument 'SCENE|MODEL'; `tledface run --help`"),
        ("run x.toml", "missing option '-o'"),
        ("run x.toml -o", "option '-o' requires an argument"),
        ("check --fast", "no such option: --fast"),
        ("--fast check", "no such option: --fast"),
        ("examples more", "unexpected extra argument"),
    ],
)
def test_wrong_usage_is_one_line(call, words, message):
    assert message in error_line(call(*words.split()))


def test_no_words_show_the_help(call):
    assert "Usage: " in call().output
    assert "[OPTIONS] [NAME]" in call("demo", "--help").stdout


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("brow.h5", "model file brow.h5: not an HDF5 file, or cut short"),
        ("skin.STL", "skin.STL: is a surface; a scene file (.toml) names it"),
        ("folder", "folder: is a folder; give a scene file (.toml)"),
        ("a/none.toml", "a/none.toml: no such scene file; `tledface new a/none.toml` writes"),
        ("none.stl", "none.stl: no such scene file; give a scene file (.toml)"),
    ],
)
def test_what_is_no_scene_is_named(call, tmp_path, name, message):
    (tmp_path / "folder").mkdir()
    for file in ("brow.h5", "skin.STL"):
        (tmp_path / file).touch()
    assert message in error_line(call("check", name))


def test_missing_surfaces_are_all_named(call, tmp_path):
    scene = fake_run.write_scene(tmp_path)
    (tmp_path / "skin.stl").unlink()
    (tmp_path / "pull.stl").unlink()
    line = error_line(call("check", scene))
    assert "geometry.skin: file not found: " in line
    assert f'also not found: "{tmp_path / "pull.stl"}"; give paths' in line
    assert "more problem" not in line


def test_a_model_is_built_into_hdf5_only(call, tmp_path):
    assert "allowed: .h5, .hdf5" in error_line(
        call("build", fake_run.write_scene(tmp_path), "-o", "brow.txt")
    )
    assert not (tmp_path / "brow.txt").exists()


@pytest.mark.parametrize(
    ("every", "end"),
    [("1 ms", "`tledface resume out` goes on"), ("off", "there is no checkpoint")],
)
def test_an_interrupted_run_says_how_it_goes_on(call, tmp_path, monkeypatch, every, end):
    monkeypatch.setattr(fake_run.FakeSimulator, "fail_at", 0.004)
    monkeypatch.setattr(fake_run, "SimulationError", KeyboardInterrupt)
    monkeypatch.setattr("tledface.checkpoint.save", lambda sim, path, **_: path.touch())
    text = fake_run.SCENE + f'checkpoint_every = "{every}"\n'
    result = call("run", fake_run.write_scene(tmp_path, text), "-o", "out", "-q")
    assert result.exit_code == 130
    assert result.stderr == f"tledface: interrupted at t = 0.004 s; frames are in out; {end}\n"


def test_interrupted_before_a_run(call, tmp_path, monkeypatch):
    def stop(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(Scene, "build", stop)
    result = call("check", fake_run.write_scene(tmp_path))
    assert (result.exit_code, result.stderr) == (130, "tledface: interrupted\n")


def test_new_then_check(call, tmp_path):
    result = call("new", "brow.toml")
    assert result.exit_code == 0
    assert "wrote brow.toml" in result.stdout
    assert "exists already" in error_line(call("new", "brow.toml"))
    assert "geometry.skin: file not found" in error_line(call("check", "brow.toml"))


def test_check_reports_and_writes_nothing(call, tmp_path, monkeypatch):
    monkeypatch.setattr("tledface.check._TIMING", 0.0)
    scene = fake_run.write_scene(tmp_path)
    before = sorted(tmp_path.iterdir())
    result = call("check", scene)
    assert result.exit_code == 0, result.output
    for words in ("2,880", "dermis", "set by pull", "1,000 steps", "6 loose ones", "fake CPU"):
        assert words in result.stdout
    for words in ("200 mm3: too deep", "3 mm3: bone.stl and skin are less", "2 faces turned"):
        assert words in result.stdout
    found = json.loads(call("check", scene, "--json").stdout)
    assert found["elements"] == 2880
    assert found["geometry"]["gaps"][0]["volume"] == 3e-9
    assert found["dt_tissue"] == "pull"
    assert found["muscles"] == {"pull": 1440}
    assert found["tissues"] == {"dermis": 2880}
    assert sorted(tmp_path.iterdir()) == before


def test_build_then_run_the_model(call, tmp_path):
    result = call("build", fake_run.write_scene(tmp_path), "-o", "brow.h5")
    assert result.exit_code == 0, result.output
    assert "2,880 voxels" in result.stdout and "2 faces turned" in result.stdout
    result = call("run", "brow.h5", "-o", "out", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["steps"] == 1000
    assert (tmp_path / "out" / "wrinkles.png").exists()


def test_run_prints_where_the_files_are(call, tmp_path):
    scene = fake_run.write_scene(tmp_path)
    result = call("run", scene, "-o", "out", "--device", "native")
    assert result.exit_code == 0, result.output
    assert "out/frames.vtkhdf" in result.stdout.replace("\\", "/")
    assert "--force" in error_line(call("run", scene, "-o", "out"))
    quiet = call("run", scene, "-o", "out", "--force", "--quiet")
    assert (quiet.exit_code, quiet.output) == (0, "")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("duration = ", "duraton = ", "solver.duraton: unknown key; nearest: duration"),
        ('"10 ms"\ndamp', "10\ndamp", "solver.duration: unit missing: got 10"),
        ('units = "mm"', 'units = "mm', "TOML syntax: "),
        ("skin.stl", "none.stl", "geometry.skin: file not found"),
    ],
)
def test_bad_scenes_are_one_line_and_exit_code_2(call, tmp_path, old, new, message):
    assert old in fake_run.SCENE
    scene = fake_run.write_scene(tmp_path, fake_run.SCENE.replace(old, new))
    line = error_line(call("run", scene, "-o", "out"))
    assert message in line
    assert "brow.toml" in line
    assert not (tmp_path / "out").exists()


def test_a_failing_simulation_is_exit_code_1(call, tmp_path, monkeypatch):
    monkeypatch.setattr(fake_run.FakeSimulator, "fail_at", 0.005)
    scene = fake_run.write_scene(tmp_path)
    assert "not finite" in error_line(call("run", scene, "-o", "out"), code=1)


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (MemoryError(), 1, "out of memory"),
        (SimulationError("two\nlines"), 1, "two lines"),
        (PermissionError(13, "Permission denied", "x/y"), 2, "x/y: Permission denied"),
    ],
)
def test_no_error_of_the_world_is_a_traceback(call, tmp_path, monkeypatch, error, code, message):
    def fail(self):
        raise error

    monkeypatch.setattr(Scene, "build", fail)
    line = error_line(call("check", fake_run.write_scene(tmp_path)), code)
    assert message in line


def test_demo_runs_and_may_run_again(call, tmp_path, demo_module):
    result = call("demo")
    assert result.exit_code == 0, result.output
    folder = tmp_path / "tledface-flat-block"
    assert (folder / "wrinkles.png").exists()
    assert (folder / "scene" / "brow.toml").exists()
    assert call("demo", "flat-block", "-o", folder).exit_code == 0
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    assert "no tledface run" in error_line(call("demo", "-o", "mine"))


def test_demo_never_replaces_a_run_of_something_else(call, tmp_path, demo_module):
    scene = fake_run.write_scene(tmp_path)
    assert call("run", scene, "-o", "out", "-q").exit_code == 0
    assert "--force" in error_line(call("demo", "-o", "out"))


@pytest.fixture
def varied(monkeypatch):
    """A shipped scene with variants and settings; what it was called with."""
    calls = []

    def write(
        folder,
        *,
        voxel: float = 0.5,
        height: float | None = None,
        rows: int = 3,
        layers: bool = True,
        hair: str = "2 MPa",
        coarse: bool = False,
        data: str | Path | None = None,
        fine: tuple = (),
    ):
        if voxel <= 0:
            raise InputError(f"varied voxel: got {voxel}")
        calls.append({key: value for key, value in locals().items() if key != "calls"})
        return _write(folder / "deep")

    module = SimpleNamespace(
        __doc__="Varied.",
        write=write,
        VARIANTS={"reference": {}, "thin": {"height": 0.25}},
        ABOUT_VARIANTS={"thin": "finer"},
    )
    plain = SimpleNamespace(__doc__="Plain.", write=lambda folder, *, mesh: _write(folder))
    monkeypatch.setattr(
        "tledface.cli.demos.shipped", lambda: {"varied": module, "plain-one": plain}
    )
    return calls


def test_a_demo_s_settings_reach_its_scene_by_type(call, tmp_path, varied):
    (tmp_path / "mesh.ply").touch()
    words = "--set voxel=1 --set rows=7 --set layers=false --set hair=none --coarse"
    result = call("demo", "varied", "--variant", "thin", *words.split(), "--data", "mesh.ply")
    assert result.exit_code == 0, result.output
    got = varied[-1]
    given = {"voxel": 1.0, "rows": 7, "layers": False, "hair": "none", "coarse": True}
    assert {key: got[key] for key in given} == given
    assert type(got["voxel"]) is float
    assert (got["height"], got["data"]) == (0.25, tmp_path / "mesh.ply")
    folder = tmp_path / "tledface-varied-thin"
    about = json.loads((folder / "run.json").read_text())
    assert (about["demo"], about["variant"]) == ("varied", "thin")
    assert about["settings"] == {**given, "data": str(tmp_path / "mesh.ply")}
    assert Path(about["scene"]).samefile(folder / "scene" / "deep" / "brow.toml")
    assert sorted(path.name for path in folder.iterdir() if path.name.startswith(".")) == []
    # The variant's own settings give way to those of the command line.
    assert (
        call("demo", "varied", "--variant", "thin", "--set", "height=none", "-o", "b").exit_code
        == 0
    )
    assert varied[-1]["height"] is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("varied --variant thick", "'thick': no such variant; nearest: thin; allowed: reference,"),
        ("varied --set voxle=1", "--set voxle: no such setting; nearest: voxel; allowed: voxel, h"),
        ("varied --set voxel=1 --set voxel=2", "varied --set voxel: got it twice"),
        ("varied --set voxel", "--set 'voxel': no value; give it as KEY=VALUE"),
        ("varied --set voxel=thin", "--set voxel: got 'thin'; allowed is a number"),
        ("varied --set voxel=nan", "--set voxel: got 'nan'; allowed is a number"),
        ("varied --set voxel=none", "--set voxel: got 'none'; allowed is a number"),
        ("varied --set height=x", "--set height: got 'x'; allowed is a number or none"),
        ("varied --set rows=1.5", "--set rows: got '1.5'; allowed is a whole number"),
        ("varied --set layers=2", "--set layers: got '2'; allowed is true or false"),
        ("varied --set fine=1", "--set fine: no such setting; allowed: voxel"),
        ("varied --data none.ply", "none.ply: no such file or folder"),
        ("varied --set voxel=-1", "varied voxel: got -1.0"),
        ("flat-block --variant thin", "demo 'flat-block': no such scene"),
    ],
)  # fmt: skip
def test_a_wrong_setting_is_one_line_and_leaves_nothing(call, tmp_path, varied, words, message):
    assert message in error_line(call("demo", *words.split()))
    assert list(tmp_path.iterdir()) == []


def test_a_demo_without_settings_says_so(call, demo_module):
    for words in ("--coarse", "--data .", "--set voxel=1"):
        assert "no such setting; it has none" in error_line(call("demo", *words.split()))


def test_a_setting_that_is_needed(call, monkeypatch):
    def write(folder, *, data: Path):
        return _write(folder)

    monkeypatch.setattr(
        "tledface.cli.demos.shipped", lambda: {"own": SimpleNamespace(__doc__="", write=write)}
    )
    assert "own: data is missing; give --data PATH" in error_line(call("demo", "own"))


def test_other_settings_never_replace_a_run_unasked(call, tmp_path, varied, monkeypatch):
    """Nor does a scene that cannot be written or built, even when it is asked to."""
    assert call("demo", "varied", "-o", "out", "-q").exit_code == 0
    assert call("demo", "varied", "-o", "out", "-q").exit_code == 0
    for words in ("--set voxel=1", "--variant thin", "--coarse"):
        assert "--force" in error_line(call("demo", "varied", "-o", "out", *words.split()))
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")}
    error_line(call("demo", "varied", "-o", "out", "--force", "--set", "voxel=-1"))
    with monkeypatch.context() as patch:
        patch.setattr(Scene, "build", lambda self: (_ for _ in ()).throw(InputError("no tissue")))
        assert "no tissue" in error_line(call("demo", "varied", "-o", "out", "--force"))
    assert {path for path in (tmp_path / "out").rglob("*")} == set(before)
    assert all(path.stat().st_mtime_ns == t for path, t in before.items() if path.is_file())
    assert call("demo", "varied", "-o", "out", "--force", "--variant", "thin").exit_code == 0


def test_a_demo_that_finds_no_room_keeps_its_earlier_results(call, tmp_path, varied, monkeypatch):
    assert call("demo", "varied", "-o", "out", "-q").exit_code == 0
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "out").rglob("*") if p.is_file()}
    full = shutil.disk_usage(tmp_path)._replace(free=-(10**9))
    with monkeypatch.context() as patch:
        patch.setattr("shutil.disk_usage", lambda path: full)
        line = error_line(call("demo", "varied", "-o", "out"))
    assert line.startswith("tledface: error: out/scene/deep/brow.toml: output.fps")
    after = {p: p.stat().st_mtime_ns for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert after == before


def test_a_demo_holds_its_folder_from_the_scene_to_the_last_result(
    call, tmp_path, varied, monkeypatch
):
    release, states = _lock.release, []

    def released(path, handle):
        states.append(json.loads((tmp_path / "out" / "run.json").read_text())["state"])
        release(path, handle)

    monkeypatch.setattr(_lock, "release", released)
    assert call("demo", "varied", "-o", "out", "-q").exit_code == 0
    assert states == ["finished"]


def test_an_unfinished_demo_is_resumed_rather_than_begun_again(call, tmp_path, varied):
    assert call("demo", "varied", "-o", "out", "-q").exit_code == 0
    about = json.loads((tmp_path / "out" / "run.json").read_text())
    (tmp_path / "out" / "run.json").write_text(json.dumps({**about, "state": "running"}))
    (tmp_path / "out" / "checkpoint.h5").touch()
    assert "`tledface resume out` goes on" in error_line(call("demo", "varied", "-o", "out"))
    assert call("demo", "varied", "-o", "out", "--force").exit_code == 0


def test_examples_show_variants_and_settings(call, varied):
    assert "thin" not in call("examples").stdout
    lines = [line.strip() for line in call("examples", "--list").stdout.splitlines()]
    assert "--variant thin       finer" in lines
    assert "--coarse" in lines and "--data PATH" in lines
    assert "--set voxel=0.5 height=none rows=3 layers=true hair='2 MPa'" in lines
    found = json.loads(call("examples", "--json").stdout)
    assert found["variants"]["varied"] == {"reference": "", "thin": "finer"}
    assert found["settings"]["varied"]["voxel"]["default"] == 0.5
    assert found["settings"]["plain-one"] == {}


def test_every_shipped_example_fits_the_command_line():
    """Each variant's keywords are parameters; each has a line; the first is the reference."""
    for name, module in shipped().items():
        example = Example.of(name, module)
        variants = getattr(module, "VARIANTS", {"reference": {}})
        assert next(iter(variants.items())) == ("reference", {}), name
        assert set(getattr(module, "ABOUT_VARIANTS", variants)) == set(variants), name
        assert example.about, name
        parameters = inspect.signature(example.call).parameters
        for variant, keywords in variants.items():
            assert set(keywords) <= set(parameters), (name, variant)
        for key in ("coarse", "data"):
            assert (key in parameters) == (key in example.settings), (name, key)


def test_unknown_demo_names_the_nearest(call, demo_module):
    assert "nearest: flat-block" in error_line(call("demo", "flat-blok"))
    assert "nearest" not in error_line(call("demo", "xyz"))


def test_a_demo_without_its_device_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("flat-block", "film"):
        result = CliRunner().invoke(app, ["demo", name, "--device", "opencl:77"])
        assert "opencl:77" in error_line(result)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("ratio=-1", "film ratio: got -1.0; allowed, with an exact answer: 10, 24.57, 100"),
        ("waves=0", "film waves: got 0.0; allowed: 1 to 1000"),
        ("resolution=0", "film resolution: got 0; allowed: 5 to 10000"),
    ],
)
def test_a_study_s_wrong_setting_leaves_the_folder_as_it_was(call, tmp_path, setting, message):
    assert message in error_line(call("demo", "film", "--set", setting))
    assert list(tmp_path.iterdir()) == []
    out = tmp_path / "out"
    out.mkdir()
    (out / "run.json").write_text('{"tledface": "0", "files": ["film.png"]}')
    (out / "film.png").touch()
    before = {path: path.read_bytes() for path in out.iterdir()}
    error_line(call("demo", "film", "-o", "out", "--force", "--set", setting))
    assert {path: path.read_bytes() for path in out.iterdir()} == before


def test_examples(call):
    result = call("examples", "--list")
    assert result.exit_code == 0
    assert "flat-block" in result.stdout
    assert "flat-block" in json.loads(call("examples", "--json").stdout)["examples"]


def test_schema_is_json(call):
    assert json.loads(call("schema").stdout)["title"] == "tledface scene"


def test_doctor_and_bench_call_their_modules(call, monkeypatch):
    fake = SimpleNamespace(text=lambda: "all well", report=lambda: {"well": True})
    monkeypatch.setitem(sys.modules, "tledface.doctor", fake)
    monkeypatch.setattr("tledface.doctor", fake, raising=False)
    assert call("doctor").stdout == "all well\n"
    assert json.loads(call("doctor", "--json").stdout) == {"well": True}
    asked = {}
    monkeypatch.setitem(sys.modules, "tledface.bench", SimpleNamespace(main=asked.update))
    assert call("bench", "--device", "native", "--json").exit_code == 0
    assert asked == {"device": "native", "json": True, "quiet": False}


def test_the_device_that_is_asked_for_is_the_one_that_works(call, tmp_path, monkeypatch):
    """A verb that took no notice of --device would run too, on another."""
    asked = {}
    done = SimpleNamespace(text=str, to_dict=dict)
    for verb, does in (
        ("check", "tledface.check.check_scene"),
        ("run", "tledface.run.run_scene"),
        ("resume", "tledface.run.resume_run"),
    ):
        monkeypatch.setattr(
            does, lambda *_, verb=verb, **given: asked.update({verb: given}) or done
        )
    scene = fake_run.write_scene(tmp_path)
    for words in (("check", scene), ("run", scene, "-o", "out"), ("resume", "out")):
        assert call(*words, "--device", "opencl:3").exit_code == 0
    assert {verb: given["device"] for verb, given in asked.items()} == dict.fromkeys(
        ("check", "run", "resume"), "opencl:3"
    )
    assert call("resume", "out").exit_code == 0 and asked["resume"]["device"] is None


@pytest.mark.parametrize(
    ("words", "workloads", "with_sizes"),
    [
        ("--all", (*bench_workloads.QUICK, *bench_workloads.LARGE), False),
        ("--workload face --workload armadillo", ("face", "armadillo"), False),
        ("--sizes", (), True),
        ("--all --sizes", (*bench_workloads.QUICK, *bench_workloads.LARGE), True),
    ],
)
def test_bench_measures_what_it_was_asked_for(call, monkeypatch, words, workloads, with_sizes):
    asked = {}
    monkeypatch.setattr(bench_workloads, "main", lambda **given: asked.update(given))
    result = call("bench", *words.split(), "--device", "opencl:3", "-o", "b.json", "--quiet")
    assert result.exit_code == 0, result.output
    assert asked == {
        "device": "opencl:3",
        "workloads": workloads,
        "with_sizes": with_sizes,
        "output": Path("b.json"),
        "json": False,
        "quiet": True,
    }


def test_console_script_error_has_no_traceback(tmp_path):
    code = (
        "import sys; sys.argv[1:] = ['check', 'none.toml']; from tledface.cli import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith("tledface: error: none.toml: no such scene file")
    assert done.stderr.count("\n") == 1


INTERRUPTED = """
import os, signal, sys, time
import tledface.cli
import tledface.scene

class Interrupting:
    def find_spec(self, name, path, target=None):
        if name == {module!r}:
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.1)
            except BaseException:
                pass  # as some modules do

def load(path):
    import {module}
    time.sleep(3)

tledface.scene.Scene.load = load
sys.meta_path.insert(0, Interrupting())
sys.argv[1:] = ["check", "x.toml"]
try:
    tledface.cli.main()
finally:
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
"""


@pytest.mark.parametrize("module", ["tledface.cli.demos", "tledface.check", "trimesh"])
def test_an_interrupt_while_modules_are_loaded_is_not_lost(tmp_path, module):
    """Before a verb begins, as it begins, and within it."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED.format(module=module)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (130, "tledface: interrupted\n")
