"""bench/gpu.sh: what it says of a machine with and without a driver."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tledface as tf

SCRIPT = Path(__file__).parents[2] / "bench" / "gpu.sh"


@pytest.fixture(autouse=True)
def bash():
    if shutil.which("bash") is None:
        pytest.skip("there is no bash")


def gpu(*options, **environment):
    return subprocess.run(
        ["bash", SCRIPT, *options],
        env={**os.environ, "TLEDFACE_PYTHON": sys.executable, **environment},
        capture_output=True,
        text=True,
        timeout=600,
    )


def test_without_a_driver_it_says_what_it_looked_for(tmp_path):
    done = gpu("--output", str(tmp_path), OCL_ICD_VENDORS="/no/such/folder")
    assert done.returncode == 1
    for words in (
        "/dev/nvidiaN",
        "/proc/driver/nvidia/version",
        "libnvidia-opencl.so.1 in the linker's cache and /usr/lib/x86_64-linux-gnu",
        "OpenCL library: ",
        "registered drivers: /no/such/folder (/no/such/folder, from OCL_ICD_VENDORS)",
        "OpenCL devices: none",
    ):
        assert words in done.stdout
    assert "no working GPU among the OpenCL devices: nothing was measured" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_device_that_is_not_there(opencl, tmp_path):
    done = gpu("--device", "no such card", "--output", str(tmp_path))
    assert done.returncode == 1
    assert "no no such card among the OpenCL devices" in done.stderr
    assert f"gpu.sh: {opencl}: " in done.stdout  # what there is instead
    assert not list(tmp_path.iterdir())


def test_a_device_is_found_by_id_and_by_name(opencl):
    name = next(d.name for d in tf.devices() if d.id == opencl)
    for which in (opencl, name[2:-2].upper()):
        done = gpu("--find", "--device", which)
        assert done.returncode == 0, done.stderr
        assert done.stdout.endswith(f"gpu.sh: taken: {opencl}, {name}\n")


def test_options_that_do_not_exist():
    for options in (["--fast"], ["--device"], ["device"]):
        done = gpu(*options)
        assert done.returncode == 2
        assert len(done.stderr.splitlines()) == 1 and options[0] in done.stderr


def test_figures_are_kept_in_one_file(opencl, tmp_path):
    """From end to end, with a stand-in for the workloads, which take minutes."""
    package = tmp_path / "python"
    package.write_text(
        "#!/bin/sh\n"
        # The program itself must be there; only its minutes of work are left out.
        'if [ "$3" = bench ]; then\n'
        f'  {sys.executable} -c "$2" bench --device native --help > /dev/null || exit 1\n'
        '  shift 3; echo "{\\"given\\": \\"$*\\", $ROWS}"; exit; fi\n'
        f'exec {sys.executable} "$@"\n'
    )
    package.chmod(0o755)
    output = tmp_path / "results"
    options = ["--device", opencl, "--no-tests", "--output", str(output)]
    rows = '"rows": [{"command_buffers": false}, {"command_buffers": true}]'
    done = gpu(*options, "--", "--workload", "face", TLEDFACE_PYTHON=str(package), ROWS=rows)
    assert done.returncode == 0, done.stderr
    (file,) = output.iterdir()
    kept = json.loads(file.read_text())
    assert kept["bench"]["given"] == f"--workload face --device {opencl} --json"
    works = next(d.command_buffers for d in tf.devices() if d.id == opencl)
    assert kept["command_buffers"] == {"work": works, "replayed": True}
    assert f"command buffers work: {'yes' if works else 'no'}, replayed: yes" in done.stdout
    assert kept["device"]["id"] == opencl and kept["device"]["works"]
    assert kept["tledface"] == tf.__version__
    assert any(line.startswith("registered drivers: ") for line in kept["found"])
    assert file.name.startswith(kept["device"]["name"].split()[0].lower()[:6])
