"""The benchmark's workloads beside the roofline: what the device can do at best, in the same run.

Bodies and measurement are the core's (``csrc/bench``): a round times plain memory traffic, plain
arithmetic, a copy and the solver one after the other, and ratios are taken round by round, so that
a busy machine slows both sides of them. What the keys mean stands in bench/README.md.
"""

from __future__ import annotations

import json as json_module
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tledface import _core
from tledface import device as device_module
from tledface.autotune import tune, tune_recording
from tledface.bench_report import report
from tledface.errors import InputError
from tledface.progress import spinner

__all__ = ["LARGE", "QUICK", "SIZES", "flatness", "main", "measure", "sizes", "table"]

# Seconds each; minutes and gigabytes each.
QUICK = ("flat-block", "face", "armadillo")
LARGE = ("dense-block", "sparse-shell")
# Elements of the slab, from what a cache holds to what none does.
SIZES = (102_400, 409_600, 1_638_400, 6_553_600, 16_257_024)
# Above this much of state, MiB, no cache of a CPU's cores or of a GPU is taken to hold it.
_PAST_CACHES = 64.0


def measure(
    workload: str,
    device: Any = "auto",
    *,
    hourglass: str = "physical",
    precision: str = "single",
    kernels: str = "auto",
    elements: int | None = None,
    rounds: int = 7,
    seconds: float = 0.1,
    checks: bool = True,
    array_mb: int = 512,
) -> dict[str, Any]:
    """Time a workload beside the roofline of its device, and check the run.

    Args:
        workload: One of `QUICK`, `LARGE`, or ``"slab"``.
        device: As `tledface.Simulator` takes it.
        hourglass: ``"physical"`` or ``"joldes"``.
        precision: ``"single"`` or ``"double"``.
        kernels: As `tledface.Simulator` takes them.
        elements: About how many instead of the workload's own, of the same thickness.
        rounds: Of blocks taken in turns.
        seconds: Of each block.
        checks: Whether to check energy and compare with float64.
        array_mb: MiB of the arrays that no cache holds; less only to try things out.

    Raises:
        InputError: no such workload, device or option.
        SimulationError: the state is not finite, so that the speed means nothing.
    """
    for name, got, allowed in (
        ("hourglass", hourglass, ("physical", "joldes")),
        ("precision", precision, ("single", "double")),
    ):
        if got not in allowed:
            raise InputError(f"{name}: got {got!r}; allowed: {', '.join(allowed)}")
    opened = device_module.resolve(device)
    if kernels == "auto":
        tune(opened, precision=precision, hourglass=hourglass)
    tune_recording(opened)
    text = _core.bench_measure(
        opened,
        workload,
        elements=elements or 0,
        physical=hourglass == "physical",
        is_double=precision == "double",
        kernels=kernels,
        rounds=rounds,
        seconds=seconds,
        checks=checks,
        array_bytes=array_mb << 20,
    )
    result: dict[str, Any] = json_module.loads(text)
    return result


def sizes(
    device: Any = "auto", *, counts: Sequence[int] = SIZES, rounds: int = 7, quiet: bool = True
) -> dict[str, Any]:
    """Time a slab 16 voxels thick at several sizes.

    Returns:
        ``rows``, one `measure` a size without its checks, and `flatness`.
    """
    rows = []
    for count in counts:
        with spinner(f"slab, {count:,} elements", quiet=quiet):
            rows.append(measure("slab", device, elements=count, rounds=rounds, checks=False))
    return {"rows": rows, **flatness(rows)}


def flatness(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Largest over smallest cost of an element step: ns, and in units of the same run's arithmetic.

    Returns:
        ``ns_per_element`` and ``relative_cost`` (1 / ``arithmetic_fraction``) of each size, and
        their ``flatness`` and ``relative_flatness`` over the sizes that no cache holds; None where
        there are fewer than two.
    """
    cost = [1e6 * row["ms_per_step"] / row["elements"] for row in rows]
    relative = [1.0 / row["arithmetic_fraction"] for row in rows]
    past = [i for i, row in enumerate(rows) if row["device_mb"] > _PAST_CACHES]

    def spread(values: list[float]) -> float | None:
        chosen = [values[i] for i in past]
        return max(chosen) / min(chosen) if len(chosen) > 1 else None

    return {
        "elements": [row["elements"] for row in rows],
        "ns_per_element": cost,
        "relative_cost": relative,
        "flatness": spread(cost),
        "relative_flatness": spread(relative),
    }


def main(
    *,
    device: Any = "auto",
    workloads: Sequence[str] = QUICK,
    with_sizes: bool = False,
    rounds: int = 7,
    output: Path | None = None,
    json: bool = False,
    quiet: bool = False,
) -> dict[str, Any]:
    """Measure workloads in both hourglass forms; print the table, or JSON.

    Args:
        device: As `tledface.Simulator` takes it.
        workloads: Names, see `measure`.
        with_sizes: Measure `sizes` too.
        rounds: Of blocks taken in turns.
        output: A ``.json`` file; the table goes into the ``.md`` file of the same name.
        json: Print JSON instead of the table.
        quiet: Print nothing.

    Raises:
        InputError: no such workload, device or file.
    """
    if output is not None and output.suffix != ".json":
        raise InputError(f"output {output}: ending {output.suffix!r} is not known; allowed: .json")
    for name in workloads:
        _core.workload_elements(name)
    opened = device_module.resolve(device)
    silent = quiet or json
    rows = []
    for name in workloads:
        for form in ("physical", "joldes"):
            with spinner(f"{name}, {form}", quiet=silent):
                rows.append(measure(name, opened, hourglass=form, rounds=rounds))
    result: dict[str, Any] = {"workload": "workloads", "rows": rows}
    if with_sizes:
        result["sizes"] = sizes(opened, rounds=rounds, quiet=silent)
    text = table(result)
    report(result, text, output=output, json=json, quiet=quiet)
    return result


def table(result: dict[str, Any]) -> str:
    """Return rows, their checks and sizes as Markdown tables."""
    lines: list[str] = []
    rows = result["rows"]
    every = rows + result.get("sizes", {}).get("rows", [])
    if every:
        head = every[0]
        loads = [load for row in every for load in row["load_average"]]
        driver = f", driver {head['driver']}" if head["driver"] else ""
        lines += [
            f"{head['device']}, {head['platform']}{driver}; {head['processor']}, "
            f"{head['threads']} threads, load {min(loads):.1f} to {max(loads):.1f}",
            "",
        ]
    if rows:
        lines += [
            "| workload | elements | sliding | form | ms a step | M elem-steps/s | of roofline "
            "| one thread | bound by | effective bytes | fill | one thread / all | launches |",
            "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
            *(_speed_row(row) for row in rows),
            "",
            "| workload | form | repeats | off float64 (steps) | energy missing | bytes, floor "
            "| instructions, floor | axpy GB/s | arithmetic G/s | copy GB/s | kernels, ms |",
            "|---|---|---|---|---|---|---|---|---|---|---|",
            *(_check_row(row) for row in rows),
        ]
    if "sizes" in result:
        lines += ["", *_size_rows(result["sizes"])]
    return "\n".join(lines)


def _speed_row(row: dict[str, Any]) -> str:
    low, high = row["roofline_fraction_range"]
    by = "bytes" if row["bytes_fraction"] > row["arithmetic_fraction"] else "arithmetic"
    ratio = f"{row['thread_ratio']:.2f}" if "thread_ratio" in row else ""
    one = row.get("one_thread_roofline_fraction")
    alone = "" if one is None else f"{one:.2f}"
    return (
        f"| {row['workload']} | {row['elements']:,} | {row['sliding_nodes']:,} | "
        f"{row['hourglass']} | {row['ms_per_step']:.3f} | {row['melem_steps_per_s']:.0f} | "
        f"{row['roofline_fraction']:.2f} ({low:.2f} to {high:.2f}) | {alone} | {by} | "
        f"{row['effective_bytes']:.0f} | {row['fill']:.0%} | {ratio} | "
        f"{row['launches_per_step']:g} |"
    )


def _check_row(row: dict[str, Any]) -> str:
    kernels = ", ".join(f"{name} {k['ms']:.3f}" for name, k in row["per_kernel"].items())
    energy = row["energy"]
    holds = "" if energy["holds"] else f", ABOVE {energy['bound']:g}"
    return (
        f"| {row['workload']} | {row['hourglass']} | "
        f"{'yes' if row['bitwise_repeatable'] else 'NO'} | "
        f"{row['float64_error']:.1e} ({row['float64_steps']}) | {energy['error']:.1e}{holds} | "
        f"{row['floor_bytes']:.1f} | {row['floor_instructions']:.0f} | {row['axpy_gb_s']:.1f} | "
        f"{row['arithmetic_g_s']:.0f} | {row['copy_gb_s']:.1f} | {kernels} |"
    )


def _size_rows(found: dict[str, Any]) -> list[str]:
    lines = [
        "| slab, elements | ns an element step | over the same run's arithmetic | of roofline "
        "| fill |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['elements']:,} | {cost:.3f} | {relative:.2f} | {row['roofline_fraction']:.2f} | "
        f"{row['fill']:.0%} |"
        for row, cost, relative in zip(
            found["rows"], found["ns_per_element"], found["relative_cost"], strict=True
        )
    ]
    if found["flatness"] is not None:
        lines += [
            "",
            f"Past the caches the dearest size costs {found['flatness']:.2f} times the cheapest, "
            f"{found['relative_flatness']:.2f} times over the same run's arithmetic.",
        ]
    return lines
