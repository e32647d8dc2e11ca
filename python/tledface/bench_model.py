"""The benchmark of model creation: voxel samples a second, over triangles and samples a voxel.

A ball of layered skin with a bone ball in it and a muscle ball across both: every kind of voxel
that a head has. A sample counts if its voxel holds tissue.
"""

from __future__ import annotations

import json as json_module
import os
import time
from typing import Any

import numpy as np
import trimesh

from tledface import _core
from tledface.geometry import voxelise

__all__ = ["main", "measure"]

_RADIUS = 0.05  # m
_VOXEL = 2e-3
_LAYERS = (2e-5, 1.82e-3)  # m, ends of corneum and dermis
_SUBDIVISIONS = (3, 4, 5, 6, 7)  # 1 280 to 327 680 triangles of skin
_SAMPLES = (2, 4, 8)
_REPEATS = 3


def measure(
    subdivisions: int, samples: int, *, voxel: float = _VOXEL, repeats: int = _REPEATS
) -> dict[str, Any]:
    """Time one model; a dictionary of plain values, the best of some repeats.

    Args:
        subdivisions: Of the icosahedron: 20 x 4^n triangles of skin; bone and muscle as many.
        samples: Along each edge of a voxel.
        voxel: m.
        repeats: Timings of which the best counts.

    Returns:
        ``triangles``, ``samples``, ``voxels``, ``prepare_s`` (checks of the three surfaces),
        ``voxelise_s``, ``voxelise_cpu_s`` (of all threads), ``msamples_per_s``,
        ``volume_error`` (of the tissue, against the balls').
    """
    skin, bone = (
        trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
        for radius in (_RADIUS, 0.8 * _RADIUS)
    )
    muscle = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.4 * _RADIUS)
    muscle.apply_translation([0.7 * _RADIUS, 0.0, 0.0])
    prepare, sample, cpu = [], [], []
    for _ in range(repeats):
        begin = time.perf_counter()
        solids = [
            _core.prepare_surface(mesh.vertices, mesh.faces.astype(np.int32), name)
            for mesh, name in ((skin, "skin"), (bone, "bone"), (muscle, "muscle"))
        ]
        prepare.append(time.perf_counter() - begin)
        begin, cpu_begin = time.perf_counter(), time.process_time()
        voxels = voxelise(
            solids[0],
            voxel=voxel,
            boundaries=_LAYERS,
            bones=[solids[1]],
            muscles=[solids[2]],
            samples=samples,
            fill=1e-9,
            clean=False,
        )
        sample.append(time.perf_counter() - begin)
        cpu.append(time.process_time() - cpu_begin)
    true = 4.0 / 3.0 * np.pi * _RADIUS**3 * (1.0 - 0.8**3)
    seconds = min(sample)
    return {
        "triangles": sum(len(solid.faces) for solid in solids),
        "samples": samples,
        "voxels": len(voxels.cells),
        "prepare_s": min(prepare),
        "voxelise_s": seconds,
        "voxelise_cpu_s": min(cpu),
        "msamples_per_s": len(voxels.cells) * samples**3 / seconds / 1e6,
        "volume_error": abs(voxels.report["tissue_volume"] / true - 1.0),
    }


def main(*, json: bool = False, quiet: bool = False) -> dict[str, Any]:
    """Measure over triangles and over samples; print a table, or one JSON object."""
    rows = [measure(subdivisions, 4) for subdivisions in _SUBDIVISIONS]
    rows += [measure(5, samples) for samples in _SAMPLES if samples != 4]
    if max(row["volume_error"] for row in rows) > 0.02:
        raise RuntimeError("bench: the volume is wrong, the speed means nothing")
    result = {
        "workload": "model",
        "voxel_mm": 1e3 * _VOXEL,
        "threads": _core.thread_count(),
        "load_average": os.getloadavg()[0],
        "rows": rows,
    }
    if json:
        print(json_module.dumps(result, indent=1))
    elif not quiet:
        print(_table(result))
    return result


def _table(result: dict[str, Any]) -> str:
    lines = [
        f"{result['threads']} threads, load {result['load_average']:.1f}; "
        f"voxels of {result['voxel_mm']:g} mm",
        "triangles  samples  voxels  surfaces s  voxels s  CPU s  M samples/s",
    ]
    lines += [
        f"{r['triangles']:9,} {r['samples']:>7}^3 {r['voxels']:7,} {r['prepare_s']:11.3f} "
        f"{r['voxelise_s']:9.3f} {r['voxelise_cpu_s']:6.2f} {r['msamples_per_s']:12.2f}"
        for r in result["rows"]
    ]
    return "\n".join(lines)
