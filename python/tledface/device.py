"""Devices: what this machine has, whether it works, and opening one.

The native device is always there. OpenCL is looked for at run time; each device it lists runs a
small kernel before it counts as working, once a process.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tledface import _core
from tledface.errors import InputError

if TYPE_CHECKING:
    import pyopencl

__all__ = ["Device", "devices", "pyopencl_queue", "resolve"]

# Beside the compiled module rather than this file: an editable install keeps the two apart.
_core.set_kernel_folder(str(Path(_core.__file__).parent / "kernels_cl"))


@dataclass(frozen=True)
class Device:
    """One device of this machine.

    Attributes:
        id: What ``device=`` takes: ``"native"``, ``"opencl:0"``, …
        name: As the driver gives it.
        kind: ``"native"``, ``"cpu"``, ``"gpu"`` or ``"accelerator"``.
        works: A probe kernel compiled, ran and gave the right numbers.
        reason: Why it does not work; empty where it does.
        platform: OpenCL platform and version; the instruction set for the native device.
        driver: Driver version.
        has_double: ``precision="double"`` is possible.
        compute_units: Cores or multiprocessors.
        memory_bytes: Memory of the device in bytes.
        command_buffers: Launches can be recorded and replayed: a trial gave the right bits.
    """

    id: str
    name: str
    kind: str
    works: bool
    reason: str
    platform: str
    driver: str
    has_double: bool
    compute_units: int
    memory_bytes: int
    command_buffers: bool


def devices() -> list[Device]:
    """All devices of this machine, native first, each one probed.

    The first call compiles the probe kernels, which can take seconds; later ones are free.

    Returns:
        Devices; those that do not work are listed too, with the reason.
    """
    _find_opencl()
    return [_describe(info) for info in _core.all_devices()]


def resolve(device: Any = None) -> _core.Device:
    """Open what a caller gave as ``device=``.

    Args:
        device: None and ``"auto"``: a GPU that works, else native. ``"native"``, ``"opencl:N"``.
            ``"opencl"``: the first OpenCL device that works, GPUs first. A `Device` or a
            ``pyopencl.Device``.

    Raises:
        InputError: no such device, or one that does not work (with the reason).
    """
    if isinstance(device, _core.Device):
        return device
    if isinstance(device, Device):
        device = device.id
    if device is None:
        device = "auto"
    if device != "native":
        _find_opencl()
    if isinstance(device, str):
        return _core.open_device(device)
    handle = getattr(device, "int_ptr", None)
    if isinstance(handle, int) and type(device).__name__ == "Device":
        return _core.device_from_handle(handle)
    raise InputError(
        f"device: got {type(device).__name__}, allowed are None, 'auto', 'native', 'opencl', "
        "'opencl:N', a tledface Device or a pyopencl.Device"
    )


def pyopencl_queue(device: _core.Device) -> pyopencl.CommandQueue:
    """Return the device's own command queue for pyopencl.

    The queue is in order: what pyopencl enqueues on it runs after everything tledface has enqueued.

    Args:
        device: An open OpenCL device.

    Raises:
        InputError: the device is not an OpenCL one, or pyopencl is not installed.
    """
    if device.opencl_queue is None:
        raise InputError(
            f"device '{device.info.id}': has no OpenCL queue; open an OpenCL device "
            "(device='opencl')"
        )
    try:
        import pyopencl
    except ImportError:
        raise InputError(
            'pyopencl is not installed; pip install "tledface[opencl]" brings it'
        ) from None
    return pyopencl.CommandQueue.from_int_ptr(device.opencl_queue, retain=True)


def _describe(info: _core.DeviceInfo) -> Device:
    return Device(
        id=info.id,
        name=info.name,
        kind=info.kind,
        works=info.works,
        reason=info.reason,
        platform=info.platform,
        driver=info.driver,
        has_double=info.has_double,
        compute_units=info.compute_units,
        memory_bytes=info.memory_bytes,
        command_buffers=info.command_buffers,
    )


def _find_opencl() -> None:
    """Offer the loader in pyopencl's wheel, for machines without one, or without its drivers."""
    spec = find_spec("pyopencl")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        package = Path(folder)
        wheel_folders = (package / ".libs", package.parent / "pyopencl.libs")
        for library in sorted(file for at in wheel_folders for file in at.glob("libOpenCL*.so*")):
            _core.add_opencl_library(str(library))
