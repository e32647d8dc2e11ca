"""What is installed here and what works: for ``tledface doctor`` and for bug reports."""

from __future__ import annotations

import os
import platform
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from tledface import _core
from tledface.device import devices

__all__ = ["report", "text"]

_PACKAGES = ("numpy", "h5py", "trimesh", "pydantic", "matplotlib", "pyopencl", "vtk")
_VARIABLES = (
    "TLEDFACE_OPENCL_LIBRARY",
    "TLEDFACE_KERNELS",
    "TLEDFACE_NUM_THREADS",
    "TLEDFACE_INSTRUCTION_SET",
    "TLEDFACE_AUTOTUNE",
    "TLEDFACE_COMMAND_BUFFERS",
    "OCL_ICD_VENDORS",
    "OCL_ICD_FILENAMES",
    "POCL_DEVICES",
    "POCL_MAX_PTHREAD_COUNT",
)


def report() -> dict[str, Any]:
    """Versions, machine, OpenCL library and every device, as plain values for JSON.

    Returns:
        ``tledface``, ``python``, ``system``, ``compiler`` (str), ``threads`` (int), ``packages``
        (name to version, None where not installed), ``environment`` (variables that are set and
        matter), ``opencl_library`` (str) and ``devices`` (list of dict with the fields of
        `tledface.device.Device`).
    """
    listed = devices()
    return {
        "tledface": _version("tledface"),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": platform.platform(),
        "compiler": _core.compiler(),
        "threads": _core.thread_count(),
        "packages": {name: _version(name) for name in _PACKAGES},
        "environment": {name: os.environ[name] for name in _VARIABLES if name in os.environ},
        "opencl_library": _core.opencl_loader_report(),
        "devices": [asdict(device) for device in listed],
    }


def text() -> str:
    """The report as lines to paste into a bug report."""
    found = report()
    packages = ", ".join(f"{name} {number or '–'}" for name, number in found["packages"].items())
    lines = [
        f"tledface {found['tledface']}, {found['python']}, {found['system']}",
        f"compiler:  {found['compiler']}",
        f"threads:   {found['threads']}",
        f"packages:  {packages}",
        f"OpenCL:    {found['opencl_library']}",
    ]
    lines += [f"variable:  {name}={value}" for name, value in found["environment"].items()]
    lines.append("devices:")
    for device in found["devices"]:
        state = "works" if device["works"] else f"does not work: {device['reason']}"
        real = "single and double" if device["has_double"] else "single only"
        lines.append(f"  {device['id']:<9} {device['name']} ({device['kind']}): {state}")
        driver = f", driver {device['driver']}" if device["driver"] else ""
        lines.append(
            f"            {device['platform']}{driver}; {device['compute_units']} units, "
            f"{device['memory_bytes'] / 2**30:.1f} GiB, {real}"
            + (", command buffers" if device["command_buffers"] else "")
        )
    return "\n".join(lines)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
