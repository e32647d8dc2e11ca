"""What sliding and looks cost: the benchmark's face with its nodes on the bone, and let go.

The body is the core's (``csrc/bench/workloads.cpp``): a shell of skin with the numbers of
Warburton & Maddock's forehead (Table II), thrown along its bone at the speed at which a brow
rises, so that nodes change triangles as often.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

from tledface import _core
from tledface import device as device_module
from tledface.autotune import tune

__all__ = ["measure_sliding", "started"]

# 1/s, of the activation: 0.75 in 50 ms, as in the paper.
_RISE = 15.0
# Of the limit at rest: muscles and strain lower it.
_SHARE = 0.8
# Turns are short beside what others do on the machine, and long beside filling caches anew.
_WARM_UP, _BATCH, _TIMINGS = 150, 40, 25


def started(
    body: _core.Workload, device: Any, *, hourglass: str = "physical", sliding: bool = True
) -> _core.Simulator:
    """A simulator of a body on its way, its nodes on their surfaces or, without them, let go."""
    sim = _core.Simulator(
        device,
        body.model,
        precision="single",
        hourglass=hourglass,
        kappa=0.075,
        damping=0.0,
        sliding=body.sliding if sliding else None,
    )
    sim.dt = _SHARE * sim.bound_at_rest()[0]
    velocity = np.zeros((body.n_nodes, 3))
    velocity[:, 1] = body.speed / sim.dt
    sim.set_state(np.zeros_like(velocity), velocity, 0.0)
    return sim


def advance(sim: _core.Simulator, steps: int) -> None:
    """Take steps in which the muscle's activation rises as in the paper."""
    sim.step(steps, _RISE * sim.dt * (sim.n_steps + np.arange(steps)[:, None]))


def _ms_per_look(sim: _core.Simulator) -> float:
    """Of a look at the limit and at whether all is finite, as a run has them; median."""
    levels, taken = np.full(1, _RISE * sim.time), []
    for _ in range(_TIMINGS + 1):
        begin = time.perf_counter()
        sim.first_non_finite_node()
        sim.limit_now(levels, 0.0, 0.8, 1.1)
        taken.append(time.perf_counter() - begin)
    return 1e3 * statistics.median(taken[1:])


def measure_sliding(
    device: Any = "auto", elements: int | None = None, *, hourglass: str = "physical"
) -> dict[str, Any]:
    """Time steps of the face with its sliding nodes and with the same nodes let go, in turns.

    Args:
        device: As `tledface.Simulator` takes it.
        elements: About how many instead of the workload's own.
        hourglass: ``"physical"`` or ``"joldes"``.

    Returns:
        ``elements``, ``nodes``, ``sliding_nodes``, ``ms_per_step``, ``without`` (ms), and
        ``sliding_share`` of a step: medians over turns, with the ``spread`` of the share;
        ``ms_per_look`` at the limit of the step.
    """
    opened = device_module.resolve(device)
    tune(opened, precision="single", hourglass=hourglass)
    body = _core.Workload("face", elements or 0)
    sims = [started(body, opened, hourglass=hourglass, sliding=on) for on in (True, False)]
    taken: list[list[float]] = [[], []]
    for sim in sims:
        advance(sim, _WARM_UP)
        sim.finish()
    for _ in range(_TIMINGS):
        for sim, times in zip(sims, taken, strict=True):
            begin = time.perf_counter()
            advance(sim, _BATCH)
            sim.finish()
            times.append((time.perf_counter() - begin) / _BATCH)
    if any(sim.first_non_finite_node() >= 0 for sim in sims):
        raise RuntimeError("bench: the state is not finite, the speed means nothing")
    shares = [1.0 - off / on for on, off in zip(*taken, strict=True)]
    return {
        "device": opened.info.name,
        "workload": "face",
        "hourglass": hourglass,
        "elements": body.n_elements,
        "nodes": body.n_nodes,
        "muscle_elements": body.n_muscle_elements,
        "sliding_nodes": len(body.sliding_nodes),
        "dt": sims[0].dt,
        "ms_per_step": 1e3 * statistics.median(taken[0]),
        "without": 1e3 * statistics.median(taken[1]),
        "sliding_share": statistics.median(shares),
        "spread": max(shares) - min(shares),
        "ms_per_look": _ms_per_look(sims[0]),
    }
