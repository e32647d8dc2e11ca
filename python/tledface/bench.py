"""The benchmark as `tledface bench` runs it: workloads beside the roofline, and what choices gain.

Workloads and roofline are those of `bench_workloads`. Beside them the block as a conforming mesh
(`measure`), what it is worth that blocks of lanes hold one law each (`measure_laws`), and what
sliding costs (`bench_face`).
"""

from __future__ import annotations

import json as json_module
import os
import statistics
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from tledface import _core, bench_workloads
from tledface import device as device_module
from tledface.bench_face import measure_sliding

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["flat_block", "law_block", "main", "measure", "measure_laws"]

_CELLS = (120, 120, 9)
_LAW_CELLS = (96, 96, 9)  # of 2, 3 or 4 laws each has whole blocks of lanes
_ACTIVATION = 0.3
_WARM_UP = 200  # steps
_BATCH = 200  # steps a timing
_TIMINGS = 7
_LAW_WARM_UP, _LAW_BATCH = 50, 50
_REPEATABLE = 50  # steps of the two runs that are compared bit for bit


def flat_block(cells: tuple[int, int, int] = _CELLS) -> Model:
    """A skin block of the demo's size: layers of Warburton & Maddock's Table I, a muscle sheet.

    Voxels of 0.5 mm; density 11 000 kg/m3, tissue scaled by ten as in the paper. The top layer
    holds 4 % of stratum corneum; the muscle is two voxels thick over the middle 60 % in x and all
    of y.
    """
    from tledface.constitutive import material
    from tledface.model import Model

    def tissue(youngs_modulus: float) -> Any:
        return material(
            "neo_hookean", youngs_modulus=youngs_modulus, poissons_ratio=0.49, density=11000.0
        )

    h = 0.5e-3
    nx, _, nz = cells
    top = nz * h
    x0, x1 = nx // 5 * h, (nx - nx // 5) * h
    size = (cells[0] * h, cells[1] * h, cells[2] * h)
    model = Model.block(cells=cells, size=size, material=tissue(34e3))
    model.set_material(lambda c: c[:, 2] > top - 1.75e-3, tissue(81.4e3))
    model.set_material(lambda c: c[:, 2] > top - h, tissue(0.04 * 48e6 + 0.96 * 81.4e3))

    def sheet(c: Any) -> Any:
        return (c[:, 2] > h) & (c[:, 2] < 3 * h) & (c[:, 0] > x0) & (c[:, 0] < x1)

    model.set_material(sheet, tissue(0.5e6))
    model.add_muscle("frontalis", sheet, fibre=(1, 0, 0), sigma_act=5e6, sigma_pas=5e6)
    model.fix(lambda X: X[:, 2] < 0.1 * h, "z")
    model.fix(lambda X: (X[:, 0] < 0.1 * h) | (X[:, 0] > size[0] - 0.1 * h))
    return model


def measure(
    model: Model, device: Any = "auto", *, hourglass: str = "physical", precision: str = "single"
) -> dict[str, Any]:
    """Time steps of a model on a device.

    Returns:
        ``device``, ``workload`` numbers and ``ms_per_step``, ``melem_steps_per_s``,
        ``copy_gb_s`` (host), ``effective_bytes`` (copy bandwidth x time / elements), medians of
        timings taken in turns, with ``spread`` (largest over smallest time) and
        ``bitwise_repeatable`` (two runs compared).
    """
    from tledface.simulator import Simulator

    opened = device_module.resolve(device)

    def started() -> Simulator:
        sim = Simulator(model, device=opened, hourglass=hourglass, precision=precision)
        for muscle in model.muscles:
            sim.activate(muscle.name, _ACTIVATION)
        return sim

    runs = [started() for _ in range(2)]
    for sim in runs:
        sim.step(_REPEATABLE)
    repeatable = np.array_equal(runs[0].u, runs[1].u)
    sim = runs[0]
    del runs
    levels = np.full((_BATCH, len(model.muscles)), _ACTIVATION)
    core = sim._core
    core.step(_WARM_UP, levels[:1].repeat(_WARM_UP, axis=0))
    core.finish()
    times, copies = [], []
    for _ in range(_TIMINGS):
        copies.append(_core.copy_bandwidth())
        begin = time.perf_counter()
        core.step(_BATCH, levels)
        core.finish()
        times.append((time.perf_counter() - begin) / _BATCH)
    if core.first_non_finite_node() >= 0:
        raise RuntimeError("bench: the state is not finite, the speed means nothing")
    seconds, copy = statistics.median(times), statistics.median(copies)
    return {
        "device": opened.info.name,
        "workload": "flat-block",
        "cells": [] if model.is_conforming else (model.cells.max(axis=0) + 1).tolist(),
        "elements": model.n_elements,
        "muscle_elements": sum(len(m.elements) for m in model.muscles),
        "sliding_nodes": len(model.sliding),
        "precision": precision,
        "hourglass": hourglass,
        "kernels": _kernels(model, core),
        "fill": core.fill,
        "threads": _core.thread_count(),
        "load_average": os.getloadavg()[0],
        "ms_per_step": seconds * 1e3,
        "melem_steps_per_s": model.n_elements / seconds / 1e6,
        "spread": max(times) / min(times),
        "copy_gb_s": copy,
        "effective_bytes": copy * 1e9 * seconds / model.n_elements,
        "bitwise_repeatable": bool(repeatable),
    }


def _kernels(model: Model, core: _core.Simulator) -> str:
    if model.is_conforming:
        return "hexahedra"
    return "rows" if core.uses_rows else "gather"


def law_block(
    laws: int, *, interleaved: bool, fast_axis: int = 0, cells: tuple[int, int, int] = _LAW_CELLS
) -> Model:
    """A block of equal numbers of elements of several laws, of the same moduli at rest.

    Args:
        laws: How many, 2 to 4; the number of cells along x and y must be a multiple of four times
            that, since blocks of lanes are up to four high.
        interleaved: Neighbours along the first of the solver's axes have different laws, so that
            every block of lanes holds all; else each law has its own part of the block.
        fast_axis: That axis, 0 or 1: `Simulator.axis_order`.
        cells: Number of elements along x, y, z.
    """
    from tledface.constitutive import material
    from tledface.model import Model

    h, mu, bulk = 0.5e-3, 27e3, 1.3e6
    common: dict[str, Any] = {"bulk_modulus": bulk, "density": 11000.0}
    ratio = (3 * bulk - 2 * mu) / (2 * (3 * bulk + mu))
    materials = [
        material("mooney_rivlin", c10=0.4 * mu, c01=0.1 * mu, **common),
        material("ogden", mu1=mu, alpha1=2.0, **common),
        material("holzapfel_gasser_ogden", mu=mu, k1=5e3, k2=1.0, first=(1, 0, 0), **common),
        material(
            "neo_hookean_coupled",
            youngs_modulus=2 * mu * (1 + ratio),
            poissons_ratio=ratio,
            density=11000.0,
        ),
    ][:laws]
    plain = Model.block(
        cells=cells, size=(cells[0] * h, cells[1] * h, cells[2] * h), material=materials[0]
    )
    along = plain.cells[:, fast_axis if interleaved else 1 - fast_axis]
    law = along % laws if interleaved else along * laws // cells[1 - fast_axis]
    model = Model.from_voxels(
        plain.voxel,
        plain.origin,
        plain.cells,
        [m.model for m in materials],
        materials,
        np.eye(laws)[law],
    )
    model.fix(lambda X: X[:, 2] < 0.1 * h)
    model.gravity = (0.0, 0.0, -9.81)
    return model


def measure_laws(
    laws: int, device: Any = "auto", cells: tuple[int, int, int] = _LAW_CELLS
) -> dict[str, Any]:
    """Time the same elements with their laws in uniform blocks of lanes, and interleaved.

    Returns:
        ``laws`` (names), ``lanes`` of a block, ``uniform`` and ``interleaved``, each with
        ``melem_steps_per_s`` and ``spread`` of timings taken in turns, and ``gain``, uniform over
        interleaved. Interleaved is the worst case: every block computes every law.
    """
    from tledface.simulator import Simulator

    opened = device_module.resolve(device)

    def started(*, interleaved: bool, fast_axis: int) -> Simulator:
        model = law_block(laws, interleaved=interleaved, fast_axis=fast_axis, cells=cells)
        return Simulator(model, device=opened)

    uniform = started(interleaved=False, fast_axis=0)
    fast_axis = int(uniform.axis_order[0])
    if fast_axis == 1:
        uniform = started(interleaved=False, fast_axis=1)
    sims = {"uniform": uniform, "interleaved": started(interleaved=True, fast_axis=fast_axis)}
    times: dict[str, list[float]] = {name: [] for name in sims}
    for sim in sims.values():
        sim._core.step(_LAW_WARM_UP, np.empty((_LAW_WARM_UP, 0)))
        sim._core.finish()
    for _ in range(_TIMINGS):
        for name, sim in sims.items():
            begin = time.perf_counter()
            sim._core.step(_LAW_BATCH, np.empty((_LAW_BATCH, 0)))
            sim._core.finish()
            times[name].append((time.perf_counter() - begin) / _LAW_BATCH)
    if any(sim._core.first_non_finite_node() >= 0 for sim in sims.values()):
        raise RuntimeError("bench: the state is not finite, the speed means nothing")
    model = uniform.model
    result: dict[str, Any] = {
        "laws": list(model.tissues),
        "elements": model.n_elements,
        "lanes": uniform._core.lanes,
    }
    for name, taken in times.items():
        rate = model.n_elements / statistics.median(taken) / 1e6
        result[name] = {"melem_steps_per_s": rate, "spread": max(taken) / min(taken)}
    result["gain"] = (
        result["uniform"]["melem_steps_per_s"] / (result["interleaved"]["melem_steps_per_s"])
    )
    return result


def main(*, device: Any = "auto", json: bool = False, quiet: bool = False) -> dict[str, Any]:
    """Measure the quick workloads, a mesh, laws in uniform blocks, sliding; print tables or JSON.

    The object is `bench_workloads.measure` of the flat block in the default hourglass form, with
    the other form's under ``"joldes"`` and those of face and armadillo, each in both forms, under
    ``"workloads"``; the same block as a conforming mesh, whose elements are stored and gathered,
    under ``"conforming"``, and its time over the voxels' as ``voxels_save``; what `measure_laws`
    gives for two and four laws under ``"sorting"``; what sliding costs under ``"face"``, see
    `bench_face`.
    """
    physical, joldes, *others = (
        bench_workloads.measure(name, device, hourglass=form)
        for name in bench_workloads.QUICK
        for form in ("physical", "joldes")
    )
    conforming = measure(flat_block().as_hexahedra(), device)
    sorting = [measure_laws(laws, device) for laws in (2, 4)]
    face = measure_sliding(device)
    result = {
        **physical,
        "joldes": joldes,
        "workloads": others,
        "conforming": conforming,
        "voxels_save": conforming["ms_per_step"] / physical["ms_per_step"],
        "sorting": sorting,
        "face": face,
    }
    if json:
        print(json_module.dumps(result, indent=1))
    elif not quiet:
        print(bench_workloads.table({"rows": [physical, joldes, *others]}))
        print(
            f"\nflat block as a conforming mesh: {conforming['ms_per_step']:.3f} ms a step, "
            f"{result['voxels_save']:.1f} times the voxels'"
        )
        print(_law_table(sorting))
        print(_face_table(face))
    return result


def _law_table(results: list[dict[str, Any]]) -> str:
    lines = ["", "laws  uniform blocks  interleaved lanes  gain  (M elem-steps/s)"]
    lines += [
        f"{len(r['laws']):4d} {r['uniform']['melem_steps_per_s']:15.1f} "
        f"{r['interleaved']['melem_steps_per_s']:18.1f} {r['gain']:5.2f}"
        for r in results
    ]
    return "\n".join(lines)


def _face_table(face: dict[str, Any]) -> str:
    return (
        f"\nface, {face['elements']:,} elements, {face['nodes']:,} nodes, "
        f"{face['sliding_nodes']:,} sliding: {face['ms_per_step']:.2f} ms/step, "
        f"{face['sliding_share']:.0%} of it for sliding, {face['ms_per_look']:.2f} ms a look"
    )
