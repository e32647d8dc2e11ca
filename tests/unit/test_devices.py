"""Devices: listing, opening, buffers, building kernels, sharing with pyopencl.

TLEDFACE_REQUIRE_OPENCL=1 turns a missing OpenCL device into a failure.
"""

import dataclasses
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from conftest import required
from tledface import _core, doctor
from tledface.device import Device, devices, pyopencl_queue, resolve
from tledface.errors import InputError, SimulationError

WORKING = [device.id for device in devices() if device.works]

# One work-item squares a value through the included file; the last argument is the count.
PROGRAM = """\
#include "square.cl"
#include "square.cl"

__kernel void square_all(__global real *values, const int n) {
  int i = get_global_id(0);
  if (i < n) values[i] = square(values[i]);
}
__kernel void options(__global int *result) {
  result[0] = TLED_OPENCL;
  result[1] = TLED_LANES;
  result[2] = TLED_VECTOR_ROWS;
  result[3] = TLED_DOUBLE;
}
__kernel void mix_all(__global real *values, const int n) {
  int i = get_global_id(0);
  if (i >= n) return;
  real x = values[i];
  for (int k = 0; k < 50; ++k) x = mad(x, sin(x), exp(-x * x));
  values[i] = x;
}
"""
SQUARE = """\
#pragma once
#if TLED_DOUBLE
typedef double real;
#else
typedef float real;
#endif
real square(real x) { return x * x; }
"""


@pytest.fixture(params=WORKING)
def any_device(request):
    return resolve(request.param)


@pytest.fixture
def opencl_device():
    found = [device for device in devices() if device.kind != "native"]
    working = [device for device in found if device.works]
    if not working:
        why = "; ".join(f"{d.id}: {d.reason}" for d in found) or _core.opencl_loader_report()
        if os.environ.get("TLEDFACE_REQUIRE_OPENCL") == "1":
            pytest.fail(f"TLEDFACE_REQUIRE_OPENCL=1, but no OpenCL device works: {why}")
        pytest.skip(f"no OpenCL device works: {why}")
    return resolve("opencl")


@pytest.fixture
def kernel_folder(tmp_path, monkeypatch):
    (tmp_path / "program.cl").write_text(PROGRAM)
    (tmp_path / "square.cl").write_text(SQUARE)
    monkeypatch.setenv("TLEDFACE_KERNELS", str(tmp_path))
    return tmp_path


def run_python(code: str, **environment: str) -> str:
    """Run code in a fresh process: the search for OpenCL happens once in each."""
    result = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def message_of(function, *args, error=InputError, **kwargs) -> str:
    with pytest.raises(error) as caught:
        function(*args, **kwargs)
    message = str(caught.value)
    assert "\n" not in message
    return message


# Listing


def test_native_comes_first_and_works():
    native = devices()[0]
    assert (native.id, native.kind, native.works, native.reason) == ("native", "native", True, "")


def test_a_device_is_a_frozen_record():
    device = devices()[0]
    assert isinstance(device, Device)
    with pytest.raises(dataclasses.FrozenInstanceError):
        device.works = False


def test_opencl_device_is_listed_with_its_driver(opencl_device):
    info = opencl_device.info
    listed = {device.id: device for device in devices()}[info.id]
    assert listed.works and listed.kind in {"cpu", "gpu", "accelerator"}
    assert listed.name and listed.platform and listed.driver
    assert listed.compute_units >= 1 and listed.memory_bytes > 2**20


def test_ids_are_unique():
    ids = [device.id for device in devices()]
    assert len(set(ids)) == len(ids)


def test_broken_library_path_is_reported_and_not_fatal():
    out = run_python(
        "from tledface import _core; from tledface.device import devices, resolve\n"
        "print(_core.opencl_loader_report()); print([d.id for d in devices()])\n"
        "print(resolve('auto').info.id)",
        TLEDFACE_OPENCL_LIBRARY="/nowhere/libOpenCL.so",
    )
    report, ids, auto = out.splitlines()
    assert report.startswith("none:") and "TLEDFACE_OPENCL_LIBRARY=/nowhere/libOpenCL.so" in report
    assert ids == "['native']" and auto == "native"


def test_library_that_is_not_opencl_is_reported():
    # The module itself is a shared library on every machine that runs this.
    out = run_python(
        "from tledface import _core; print(_core.opencl_loader_report())",
        TLEDFACE_OPENCL_LIBRARY=_core.__file__,
    )
    assert "has no clGetPlatformIDs" in out


@pytest.mark.parametrize(
    ("probe", "reason"),
    [
        ("__kernel void probe(__global float *a) { a[0] = unknown_name; }", "unknown_name"),
        (
            "__kernel void probe(__global const float *a, __global float *b, const int n)"
            " { b[get_global_id(0)] = 1.0f; }",
            "wrong numbers",
        ),
        (None, "probe.cl"),
    ],
    ids=["does not build", "wrong numbers", "no probe"],
)
def test_device_that_fails_its_probe_is_listed_but_not_used(opencl_device, tmp_path, probe, reason):
    if probe:
        (tmp_path / "probe.cl").write_text(probe)
    out = run_python(
        "from tledface import _core\n"
        "from tledface.device import devices, resolve\n"
        f"_core.set_kernel_folder({str(tmp_path)!r})\n"
        "broken = devices()[1]\n"
        "print(broken.works); print(broken.reason); print(resolve('auto').info.id)\n"
        "for spec in (broken.id, 'opencl'):\n"
        "    try: resolve(spec)\n"
        "    except ValueError as error: print(error)\n"
    )
    works, why, auto, one, any_opencl = out.splitlines()
    assert works == "False" and auto == "native"
    assert reason in why and reason in one and reason in any_opencl


# Opening


@pytest.mark.parametrize("spec", ["opencl:997", "opencl:", "opencl:-1", "opencl:1x", "cuda", ""])
def test_unknown_device_is_one_clear_line(spec):
    message = message_of(resolve, spec)
    assert message.startswith(f"device '{spec}': ")
    assert "native" in message and "tledface doctor" in message


def test_wrong_type_is_named():
    assert "got float" in message_of(resolve, 3.5)


def test_auto_is_a_gpu_that_works_or_native():
    gpus = [device.id for device in devices() if device.kind == "gpu" and device.works]
    expected = gpus[0] if gpus else "native"
    assert resolve().info.id == resolve("auto").info.id == expected


def test_resolve_takes_listed_and_open_devices():
    device = resolve(devices()[0])
    assert device.info.id == "native"
    assert resolve(device) is device


# Buffers


def test_buffer_round_trip(any_device):
    rng = np.random.default_rng(1)
    values = rng.standard_normal((37, 3)).astype(np.float32)
    buffer = any_device._allocate(values.nbytes + 8)
    assert buffer.nbytes == values.nbytes + 8
    back = np.ones(values.nbytes + 8, np.uint8)
    buffer.read(back)
    assert not back.any()
    buffer.write(values, offset=8)
    part = np.empty((12, 3), np.float32)
    buffer.read(part, offset=8 + values[:25].nbytes)
    np.testing.assert_array_equal(part, values[25:])


def test_empty_buffer(any_device):
    buffer = any_device._allocate(0)
    assert buffer.nbytes == 0
    buffer.write(np.empty(0, np.float32))


def test_a_buffer_of_all_there_could_be_is_refused():
    with pytest.raises(InputError, match="not enough memory"):
        resolve("native")._allocate(2**64 - 1)


# In a process of its own with memory for the stacks of five more threads and a half.
STACK = 256 << 20
FEW_THREADS = f"""
import resource
import numpy as np
from tledface import _core

used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
most = used + 11 * {STACK} // 2
resource.setrlimit(resource.RLIMIT_AS, (most, most))
cells = np.array([[0, 0, 0], [9, 0, 0]])
points = np.repeat([[0.5, 0.5, 0.5], [9.5, 0.5, 0.5]], 5000, axis=0)
element, distance = _core.nearest_cells(cells, [1.0, 1.0, 1.0], points)
print(element.sum(), distance.max())
"""


def test_fewer_threads_than_asked_for_do_the_same():
    hard = resource.getrlimit(resource.RLIMIT_STACK)[1]
    done = subprocess.run(
        [sys.executable, "-c", FEW_THREADS],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env=os.environ | {"TLEDFACE_NUM_THREADS": "16", "MALLOC_ARENA_MAX": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_STACK, (STACK, hard)),
    )
    assert (done.returncode, done.stdout) == (0, "5000 0.0\n"), done.stderr


def test_copy_outside_an_opencl_buffer_is_an_error(opencl_device):
    buffer = opencl_device._allocate(12)
    with pytest.raises(IndexError, match="12 bytes: cannot copy 8 at offset 8"):
        buffer.write(np.zeros(2, np.float32), offset=8)


def test_strided_array_is_an_error(any_device):
    message = message_of(any_device._allocate(800).write, np.zeros((10, 10))[:, ::2])
    assert "not C-contiguous" in message


def test_buffer_of_another_device_is_no_argument(opencl_device, kernel_folder):
    with pytest.raises(ValueError, match="argument 0: the buffer belongs to another device"):
        opencl_device._launch("options", [resolve("native")._allocate(16)], 1)


def test_too_large_a_buffer_says_how_much(opencl_device):
    message = message_of(opencl_device._allocate, 2**50)
    assert "no room for a buffer of 1024.0 TiB" in message
    assert "the device has" in message


# Kernels


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("local_size", [0, 64])
def test_kernel_of_included_sources(opencl_device, kernel_folder, precision, local_size):
    if precision == "double" and not opencl_device.info.has_double:
        pytest.skip(f"{opencl_device.info.id} has no double precision")
    dtype = np.float32 if precision == "single" else np.float64
    values = np.linspace(-2, 2, 101, dtype=dtype)
    buffer = opencl_device._allocate(values.nbytes)
    buffer.write(values)
    opencl_device._launch(
        "square_all", [buffer, 100], 100, precision=precision, local_size=local_size
    )
    result = np.empty_like(values)
    buffer.read(result)
    np.testing.assert_array_equal(result[:100], values[:100] ** 2)
    assert result[100] == values[100]


@pytest.mark.parametrize(("lanes", "rows"), [(16, True), (8, False)])
def test_options_reach_the_program(opencl_device, kernel_folder, lanes, rows):
    buffer = opencl_device._allocate(16)
    opencl_device._launch("options", [buffer], 1, lanes=lanes, vector_rows=rows)
    result = np.empty(4, np.int32)
    buffer.read(result)
    assert result.tolist() == [1, lanes, int(rows), 0]


def test_build_error_names_file_and_line(opencl_device, kernel_folder):
    file = kernel_folder / "square.cl"
    file.write_text(SQUARE.replace("return x * x", "return x * unknown_name"))
    message = message_of(opencl_device._launch, "square_all", [], 1, error=SimulationError)
    assert f"{file}:7" in message and "unknown_name" in message


def test_line_after_an_include_is_right(opencl_device, kernel_folder):
    file = kernel_folder / "program.cl"
    file.write_text(PROGRAM.replace("int i = get_global_id(0);", "int i = unknown_name;", 1))
    message = message_of(opencl_device._launch, "square_all", [], 1, error=SimulationError)
    assert f"{file}:5" in message


def test_changed_kernel_file_is_built_again(opencl_device, kernel_folder):
    values = np.full(4, 3, np.float32)
    buffer = opencl_device._allocate(values.nbytes)
    for factor, expected in (("x * x", 9), ("x + x", 6)):
        (kernel_folder / "square.cl").write_text(SQUARE.replace("x * x", factor))
        buffer.write(values)
        opencl_device._launch("square_all", [buffer, 4], 4)
        result = np.empty_like(values)
        buffer.read(result)
        assert (result == expected).all()


def test_missing_include_names_who_asks_for_it(opencl_device, kernel_folder):
    (kernel_folder / "square.cl").unlink()
    message = message_of(opencl_device._launch, "square_all", [], 1)
    assert "square.cl: cannot be read" in message
    assert f"included from {kernel_folder / 'program.cl'}:1" in message


def test_missing_kernel_folder(opencl_device, monkeypatch):
    monkeypatch.setenv("TLEDFACE_KERNELS", "/nowhere")
    assert "TLEDFACE_KERNELS=/nowhere" in message_of(opencl_device._launch, "square_all", [], 1)


def test_unknown_kernel_is_named(opencl_device, kernel_folder):
    message = message_of(opencl_device._launch, "no_such", [], 1, error=SimulationError)
    assert "no_such" in message and "CL_INVALID_KERNEL_NAME" in message


@pytest.mark.parametrize("rows", [True, False])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_shipped_kernels_build(opencl_device, precision, rows):
    # Building comes before the kernel's name is looked up.
    if precision == "double" and not opencl_device.info.has_double:
        pytest.skip(f"{opencl_device.info.id} has no double precision")
    lanes = opencl_device.preferred_lanes(is_double=precision == "double")
    message = message_of(
        opencl_device._launch, "no_such", [], 1, precision=precision, lanes=lanes,
        vector_rows=rows, error=SimulationError,
    )  # fmt: skip
    assert "CL_INVALID_KERNEL_NAME" in message


def test_two_runs_agree_bit_for_bit(opencl_device, kernel_folder):
    values = np.random.default_rng(2).standard_normal(10_001).astype(np.float32)
    results = []
    for device in (opencl_device, opencl_device, resolve(opencl_device.info.id)):
        buffer = device._allocate(values.nbytes)
        buffer.write(values)
        device._launch("mix_all", [buffer, len(values)], len(values), local_size=64)
        result = np.empty_like(values)
        buffer.read(result)
        results.append(result.tobytes())
    assert len(set(results)) == 1 and np.isfinite(np.frombuffer(results[0], np.float32)).all()


def test_preferred_lanes(any_device):
    single = any_device.preferred_lanes(is_double=False)
    double = any_device.preferred_lanes(is_double=True)
    assert single in {4, 8, 16} and double in {2, 4, 8, 16} and double <= single


# pyopencl


def pyopencl_device(handle_of):
    cl = required("pyopencl")
    try:
        listed = [device for platform in cl.get_platforms() for device in platform.get_devices()]
    except cl.Error as error:  # no driver is registered with pyopencl's loader
        pytest.skip(f"pyopencl lists no device: {error}")
    for device in listed:
        if device.name.strip() == handle_of.info.name:
            return device
    pytest.skip("pyopencl does not list the device that tledface uses")


def test_pyopencl_device_is_taken(opencl_device):
    device = pyopencl_device(opencl_device)
    assert resolve(device).info.id == opencl_device.info.id


def test_buffer_and_queue_are_shared_with_pyopencl(opencl_device):
    expected = pyopencl_device(opencl_device)
    import pyopencl as cl

    queue = pyopencl_queue(opencl_device)
    assert queue.device == expected
    values = np.arange(100, dtype=np.float32)
    buffer = opencl_device._allocate(values.nbytes)
    buffer.write(values)
    shared = cl.Buffer.from_int_ptr(buffer.opencl_handle, retain=True)
    result = np.empty_like(values)
    cl.enqueue_copy(queue, result, shared)
    np.testing.assert_array_equal(result, values)
    cl.enqueue_copy(queue, shared, -values)
    buffer.read(result)
    np.testing.assert_array_equal(result, -values)


@pytest.mark.parametrize("megabytes", [1, 5])
def test_a_shared_buffer_outlives_ours(opencl_device, megabytes):
    pyopencl_device(opencl_device)
    import pyopencl as cl

    queue = pyopencl_queue(opencl_device)
    values = np.arange(megabytes << 18, dtype=np.float32)
    buffer = opencl_device._allocate(values.nbytes)
    buffer.write(values)
    shared = cl.Buffer.from_int_ptr(buffer.opencl_handle, retain=True)
    del buffer
    # What our memory would be used for next.
    others = [opencl_device._allocate(values.nbytes) for _ in range(4)]
    result = np.empty_like(values)
    cl.enqueue_copy(queue, result, shared)
    np.testing.assert_array_equal(result, values)
    assert len(others) == 4


@pytest.mark.parametrize("order", ["pyopencl first", "tledface first"])
def test_pyopencl_in_either_order(opencl_device, order):
    pyopencl_device(opencl_device)
    steps = ["import pyopencl", "from tledface.device import devices; devices()"]
    if order == "tledface first":
        steps.reverse()
    out = run_python(
        "\n".join(steps) + "\nfrom tledface.device import resolve\n"
        "listed = [d for p in pyopencl.get_platforms() for d in p.get_devices()]\n"
        f"device, = [d for d in listed if d.name.strip() == {opencl_device.info.name!r}][:1]\n"
        "print(resolve(device).info.name)"
    )
    assert out.strip() == opencl_device.info.name


def test_unknown_handle_is_refused():
    assert "comes from another library" in message_of(_core.device_from_handle, 12345)


def test_native_device_has_no_queue():
    assert "device 'native': has no OpenCL queue" in message_of(pyopencl_queue, resolve("native"))


# Doctor


def test_doctor_report_is_json_and_names_every_device():
    found = json.loads(json.dumps(doctor.report()))
    assert [device["id"] for device in found["devices"]] == [device.id for device in devices()]
    assert found["threads"] >= 1
    assert found["packages"]["numpy"] == np.__version__
    assert found["opencl_library"] == _core.opencl_loader_report()


def test_doctor_text_is_paste_ready(monkeypatch):
    monkeypatch.setenv("TLEDFACE_KERNELS", str(Path(__file__).parent))
    text = doctor.text()
    for device in devices():
        assert device.id in text and device.name in text
    assert "TLEDFACE_KERNELS=" in text and _core.opencl_loader_report() in text
