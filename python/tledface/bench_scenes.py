"""The benchmark of the shipped scenes: a step of each on each device, beside the paper's.

The paper is Warburton and Maddock (2014), [W] in the documentation; its figures are of Table II.

Each scene is built as `tledface demo` would, and its muscles contract before the clock starts,
once, on the first device; every device then goes on from that state. Steps are the simulator's own,
with loads, sliding and the watch over the time step.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tledface import _core
from tledface import device as device_module
from tledface.bench_report import report
from tledface.catalogue import REFERENCE, Example, shipped
from tledface.errors import InputError
from tledface.progress import spinner

if TYPE_CHECKING:
    from tledface.model import Model
    from tledface.scene import Scene

__all__ = ["PAPER", "SCENES", "main", "measure", "measure_scene", "table"]

# Scene and variant of each row.
SCENES = (
    ("forehead", REFERENCE),
    ("flat-block", REFERENCE),
    ("flat-block", "thin"),
    ("curved-block", REFERENCE),
    ("armadillo", REFERENCE),
)
# Warburton and Maddock (2014), Table II, a GTX 680: nodes, elements, time step and time of a step
# (ms); the sliding nodes are of its section 6.
PAPER: dict[str, dict[str, float]] = {
    "forehead": {
        "elements": 503_530,
        "nodes": 629_178,
        "sliding_nodes": 118_276,
        "dt_ms": 0.005,
        "ms_per_step": 6.83,
    },
    "flat-block": {"elements": 129_600, "nodes": 146_410, "dt_ms": 0.005, "ms_per_step": 1.48},
    "curved-block": {"elements": 414_868, "nodes": 485_400, "dt_ms": 0.005, "ms_per_step": 4.04},
    "armadillo": {"elements": 15_107, "nodes": 19_698, "dt_ms": 0.15, "ms_per_step": 0.14},
}

_CITED = "Warburton and Maddock (2014), Table II"

_WARM_UP = 1000  # steps in which every muscle that the scene contracts rises to _ACTIVATION
_ACTIVATION = 0.3
_GO_ON = 50  # steps on each device before the clock starts
_BATCH = 50  # steps a timing
_TIMINGS = 7


def measure(
    scene: Scene, model: Model, devices: Sequence[Any], *, warm_up: int = _WARM_UP
) -> list[dict[str, Any]]:
    """Time the steps of a scene's model, contracted, on devices.

    Args:
        scene: Gives solver settings and which muscles contract.
        model: Its model.
        devices: Opened ones.
        warm_up: Steps before the state that is timed.

    Returns:
        For each device ``device``, ``kernels``, ``dt_ms`` (of the first device in that state),
        ``ms_per_step`` and ``melem_steps_per_s`` (medians), ``spread`` (largest over smallest
        time), ``copy_gb_s`` (host) and ``load_average``.

    Raises:
        SimulationError: the state is no longer finite.
    """
    from tledface.run import simulator_of
    from tledface.schedule import ramp

    duration = scene.solver.duration
    contracting = [m.name for m in scene.muscles if m.activation(duration) > 0.0]
    state: tuple[Any, Any, float] | None = None
    dt = 0.0
    results = []
    for opened in devices:
        sim = simulator_of(scene, model, opened)
        rise = warm_up * sim.dt * scene.solver.time_scaling
        for muscle in model.muscles:
            level = _ACTIVATION if muscle.name in contracting else 0.0
            sim.activate(muscle.name, ramp(0.0, level, rise))
        if state is None:
            sim.step(warm_up)
            state = (sim.u, sim.velocity, sim.time)
            dt = sim.dt
        else:
            sim.set_state(state[0], state[1], time=state[2])
        sim.step(_GO_ON)
        sim._core.finish()
        times, copies = [], []
        for _ in range(_TIMINGS):
            copies.append(_core.copy_bandwidth())
            begin = time.perf_counter()
            sim.step(_BATCH)
            sim._core.finish()
            times.append((time.perf_counter() - begin) / _BATCH)
        seconds = statistics.median(times)
        results.append(
            {
                "device": opened.info.name,
                "kernels": "rows" if sim._core.uses_rows else "gather",
                "dt_ms": dt * 1e3,
                "ms_per_step": seconds * 1e3,
                "melem_steps_per_s": model.n_elements / seconds / 1e6,
                "spread": max(times) / min(times),
                "copy_gb_s": statistics.median(copies),
                "load_average": os.getloadavg()[0],
            }
        )
    return results


def measure_scene(
    name: str, variant: str, devices: Sequence[Any], *, data: Path | None = None, quiet: bool = True
) -> dict[str, Any]:
    """Build a shipped scene and time its steps; raises InputError if it cannot be built."""
    from tledface.scene import Scene

    modules = shipped()
    if name not in modules or not hasattr(modules[name], "write"):
        scenes = ", ".join(n for n, module in modules.items() if hasattr(module, "write"))
        raise InputError(f"bench --scene {name}: no such scene; shipped: {scenes}")
    example = Example.of(name, modules[name])
    arguments, _ = example.arguments(variant, data=data)
    with tempfile.TemporaryDirectory() as folder, spinner(f"{name} {variant}", quiet=quiet):
        scene = Scene.load(example.call(Path(folder), **arguments))
        model = scene.build()
        results = measure(scene, model, devices)
    return {
        "scene": name,
        "variant": variant,
        "elements": model.n_elements,
        "nodes": model.n_nodes,
        "sliding_nodes": len(model.sliding),
        "muscle_elements": sum(len(muscle.elements) for muscle in model.muscles),
        "paper": PAPER.get(name) if variant == REFERENCE else None,
        "results": results,
    }


def main(
    *,
    device: str = "auto",
    scenes: Sequence[str] = ("all",),
    data: Path | None = None,
    output: Path | None = None,
    json: bool = False,
    quiet: bool = False,
) -> dict[str, Any]:
    """Measure scenes and print the table (or JSON); both go to files beside each other, if asked.

    Args:
        device: ``auto`` for every device that works, or one.
        scenes: ``NAME`` or ``NAME:VARIANT`` each, or ``all`` for those of `SCENES`.
        data: The mesh of the armadillo.
        output: A ``.json`` file; the table goes into the ``.md`` file of the same name.
        json: Print JSON instead of the table.
        quiet: Print nothing.

    Raises:
        InputError: no such scene, variant, device or file; of ``all``, scenes that cannot be built
            are left out and named.
    """
    if output is not None and output.suffix != ".json":
        raise InputError(f"output {output}: ending {output.suffix!r} is not known; allowed: .json")
    opened = _devices(device)
    rows, skipped = [], {}
    for word in scenes:
        for name, variant in SCENES if word == "all" else [_split(word)]:
            try:
                mesh = data if name == "armadillo" else None
                row = measure_scene(name, variant, opened, data=mesh, quiet=quiet or json)
            except InputError as error:
                if word != "all":
                    raise
                skipped[f"{name}:{variant}"] = str(error)
                continue
            rows.append(row)
    result = {
        "workload": "scenes",
        "activation": _ACTIVATION,
        "warm_up_steps": _WARM_UP,
        "threads": _core.thread_count(),
        "rows": rows,
        "skipped": skipped,
    }
    text = table(result)
    report(result, text, output=output, json=json, quiet=quiet)
    return result


def table(result: dict[str, Any]) -> str:
    """Return the rows as a Markdown table: each scene of the paper, then the same scene here."""
    lines = [
        "| scene | computed by | elements | nodes | sliding nodes | time step, ms | ms a step |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in result["rows"]:
        variant = "" if row["variant"] == REFERENCE else f", {row['variant']}"
        title = f"{row['scene']}{variant}"
        if row["paper"]:
            paper = row["paper"]
            sliding = f"{paper['sliding_nodes']:,}" if "sliding_nodes" in paper else "not said"
            lines.append(
                f"| {title} | [W], GTX 680 | {paper['elements']:,} | {paper['nodes']:,} | "
                f"{sliding} | {paper['dt_ms']:g} | {paper['ms_per_step']:.2f} |"
            )
        for found in row["results"]:
            lines.append(
                f"| {title} | {found['device']}, {found['kernels']} | {row['elements']:,} | "
                f"{row['nodes']:,} | {row['sliding_nodes']:,} | {found['dt_ms']:.4f} | "
                f"{found['ms_per_step']:.2f} |"
            )
    if any(row["paper"] for row in result["rows"]):
        lines += ["", f"[W] is {_CITED}."]
    loads = [found["load_average"] for row in result["rows"] for found in row["results"]]
    spreads = [found["spread"] for row in result["rows"] for found in row["results"]]
    if loads:
        lines += [
            "",
            f"{result['threads']} threads, load {min(loads):.1f} to {max(loads):.1f}, spread of "
            f"timings {min(spreads):.2f} to {max(spreads):.2f}.",
        ]
    lines += [f"Left out: {name} ({why})." for name, why in result["skipped"].items()]
    return "\n".join(lines)


def _devices(wanted: str) -> list[Any]:
    if wanted != "auto":
        return [device_module.resolve(wanted)]
    return [device_module.resolve(d.id) for d in device_module.devices() if d.works]


def _split(word: str) -> tuple[str, str]:
    name, colon, variant = word.partition(":")
    return name, variant if colon else REFERENCE
