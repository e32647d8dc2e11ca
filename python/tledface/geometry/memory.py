"""How much memory a voxel model will need, and whether there is that much."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError

__all__ = ["available_memory", "check_memory", "estimate_voxels"]

# Bytes a voxel, without and for each tissue: the peak of a build (measured: 430 a voxel for 1.4
# million voxels of 4 tissues) and about as much again for the solver's arrays.
_BYTES_PER_VOXEL = 700
_BYTES_PER_TISSUE = 80
# Part of the available memory that a model may take.
_USABLE = 0.9


def available_memory() -> int:
    """Return the memory this process may still take, bytes: the machine's or its group's rest."""
    limits = []
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                limits.append(int(line.split()[1]) * 1024)
    except (OSError, ValueError):
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES"))
    for limit, used in (
        ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
        (
            "/sys/fs/cgroup/memory/memory.limit_in_bytes",
            "/sys/fs/cgroup/memory/memory.usage_in_bytes",
        ),
    ):
        try:
            limits.append(int(Path(limit).read_text()) - int(Path(used).read_text()))
        except (OSError, ValueError):  # no such group, or its limit reads "max"
            continue
    return max(0, min(limits))


def estimate_voxels(
    voxel: NDArray[np.float64], box: NDArray[np.float64], volume: float, shell: float
) -> float:
    """Return a bound on the number of voxels that hold tissue.

    Args:
        voxel: (3,) m.
        box: (2, 3) m, box of the tissue.
        volume: Volume of the tissue, m3.
        shell: Area of its surface, m2: a voxel layer along it may be partly filled.
    """
    in_box = float(np.prod(np.maximum(np.ceil((box[1] - box[0]) / voxel), 1.0)))
    filled = volume / float(np.prod(voxel)) + shell / float(voxel.min()) ** 2
    return min(in_box, filled)


def check_memory(n_voxels: float, n_tissues: int, voxel: NDArray[np.float64]) -> float:
    """Return the bytes that a model needs.

    Raises:
        InputError: more than there is; says how much of each, and which voxel size would fit.
    """
    needed = n_voxels * (_BYTES_PER_VOXEL + _BYTES_PER_TISSUE * n_tissues)
    usable = _USABLE * available_memory()
    if needed > usable:
        factor = float((needed / max(usable, 1.0)) ** (1.0 / 3.0))
        fits = " x ".join(f"{_round_up(1e3 * edge * factor):g}" for edge in np.unique(voxel))
        raise InputError(
            f"voxel: {_edges(voxel)} mm gives about {n_voxels:.3g} voxels, which need "
            f"{needed / 1e9:.3g} GB of memory, {usable / 1e9:.3g} GB are usable; "
            f"a voxel of {fits} mm would fit, or keep less tissue (depth, region)"
        )
    return needed


def _edges(voxel: NDArray[np.float64]) -> str:
    return " x ".join(f"{1e3 * edge:g}" for edge in np.unique(voxel))


def _round_up(value: float) -> float:
    """Round up to two digits."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return float(np.ceil(value / unit) * unit)
