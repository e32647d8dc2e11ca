"""The run's folder: never mixed, never half-written."""

import json
import os
import subprocess
import sys

import pytest

from tledface.errors import InputError
from tledface.io._atomic import check_new_folder
from tledface.output import RUN_FILE, OutputFolder, earlier_run


def test_checking_writes_nothing_and_begin_makes_the_folder(tmp_path):
    path = tmp_path / "a" / "b"
    folder = OutputFolder(path)
    assert not path.parent.exists()
    folder.begin({"scene": "x"})
    about = json.loads((path / RUN_FILE).read_text())
    assert about["state"] == "running" and about["scene"] == "x" and about["tledface"]
    assert [entry.name for entry in path.iterdir()] == [RUN_FILE]


def test_an_empty_folder_is_used(tmp_path):
    OutputFolder(tmp_path).begin({})
    assert earlier_run(tmp_path)["state"] == "running"


@pytest.mark.parametrize("force", [False, True])
def test_foreign_files_are_never_mixed_with(tmp_path, force):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="holds files that are no tledface run"):
        OutputFolder(tmp_path, force=force)
    (tmp_path / RUN_FILE).write_text("[1]")
    with pytest.raises(InputError, match="no tledface run"):
        OutputFolder(tmp_path, force=force)


def test_an_earlier_run_is_replaced_only_with_force(tmp_path):
    first = OutputFolder(tmp_path / "run")
    first.begin({})
    (first.path / "skin.ply").write_text("old")
    (first.path / "notes.txt").write_text("mine")
    (tmp_path / "outside").write_text("mine")
    first.write({"state": "finished", "files": ["skin.ply", "../outside"]})
    with pytest.raises(InputError, match="holds an earlier run; --force"):
        OutputFolder(first.path)
    OutputFolder(first.path, force=True).begin({})
    assert sorted(entry.name for entry in first.path.iterdir()) == ["notes.txt", RUN_FILE]
    assert (tmp_path / "outside").exists()


def test_one_at_a_time_holds_a_folder(tmp_path):
    path = tmp_path / "run"
    first, second = OutputFolder(path), OutputFolder(path, force=True)
    with first.held():
        first.begin({})
        with pytest.raises(InputError, match="another process is running into it"):
            OutputFolder(path, force=True)
        with pytest.raises(InputError, match="another process is running into it"), second.held():
            pytest.fail("held twice")
    assert [entry.name for entry in path.iterdir()] == [RUN_FILE]
    with second.held():
        second.begin({})


def test_a_folder_that_was_filled_meanwhile_is_refused(tmp_path):
    path = tmp_path / "run"
    first, second = OutputFolder(path), OutputFolder(path)
    with first.held():
        first.begin({})
    with pytest.raises(InputError, match="holds an earlier run; --force"), second.held():
        pytest.fail("held")
    assert [entry.name for entry in path.iterdir()] == [RUN_FILE]


def test_a_killed_process_holds_nothing(tmp_path):
    code = (
        "import sys, time; from tledface.output import OutputFolder\n"
        "with OutputFolder(sys.argv[1]).held(): print('held', flush=True); time.sleep(600)"
    )
    words = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "held\n"
            with pytest.raises(InputError, match="another process is running into it"):
                OutputFolder(tmp_path)
        finally:
            process.kill()
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.lock"]
    folder = OutputFolder(tmp_path)
    with folder.held():
        folder.begin({})
    assert [entry.name for entry in tmp_path.iterdir()] == [RUN_FILE]


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is a file"):
        OutputFolder(tmp_path / "file")
    with pytest.raises(InputError, match="file is a file, which holds no folder; give another"):
        OutputFolder(tmp_path / "file" / "run")


def test_pictures_go_into_no_file(tmp_path):
    (tmp_path / "file").touch()
    check_new_folder(tmp_path / "new", "pictures")
    check_new_folder(tmp_path, "pictures")
    with pytest.raises(InputError, match=r"pictures .*file: is a file; give a folder"):
        check_new_folder(tmp_path / "file", "pictures")


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_place_is_named(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="is not writable"):
        OutputFolder(tmp_path / "run")
