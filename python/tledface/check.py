"""What a scene or a model holds and costs before it is run.

Voxels, nodes and what binds them, memory, time step, an estimate of the time.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tledface import device as device_module
from tledface.boundary import boundary_text
from tledface.frame_plan import require_room
from tledface.geometry.report import GEOMETRY_KEYS, geometry_lines
from tledface.progress import spinner
from tledface.run import shown_surface, simulator_of

if TYPE_CHECKING:
    from tledface.model import Model
    from tledface.scene import Scene
    from tledface.simulator import Simulator

__all__ = ["Check", "check_scene"]

# Steps are timed in batches until this much time has gone by (s).
_TIMING = 1.0
_BATCH = 50


@dataclass(frozen=True)
class Check:
    """Counts, sizes (bytes), times (s) of a scene on a device.

    ``size_m`` is the extent of the voxels along each axis, ``voxel_m`` that of one (m);
    ``tissues`` and ``muscles`` count the voxels that hold some of each, ``boundary`` is the report
    on what binds nodes, ``surfaces`` counts the vertices of each that move with the tissue, and
    all; ``geometry`` is the part of the model's report about its volumes (m3); ``memory_bytes`` is
    the peak of the process while building and simulating.
    """

    scene: str
    elements: int
    nodes: int
    size_m: list[float]
    voxel_m: list[float]
    tissues: dict[str, int]
    muscles: dict[str, int]
    fixed_nodes: int
    sliding_nodes: int
    boundary: dict[str, Any]
    surfaces: dict[str, list[int]]
    dropped_voxels: int
    geometry: dict[str, Any]
    memory_bytes: int | None
    dt_s: float
    substeps: int
    dt_crit_s: float
    dt_tissue: str
    steps: int
    estimated_s: float
    device: str

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    def text(self) -> str:
        """A few lines for a person."""
        tissues = ", ".join(f"{name} {count:,}" for name, count in self.tissues.items())
        muscles = ", ".join(f"{name} {count:,}" for name, count in self.muscles.items())
        surfaces = ", ".join(
            f"{name} {moving:,} of {count:,}" for name, (moving, count) in self.surfaces.items()
        )
        memory = "unknown" if self.memory_bytes is None else f"{self.memory_bytes / 2**20:.0f} MiB"
        return "\n".join(
            [
                f"scene      {self.scene}: valid",
                f"size       {_extent(self.size_m)} mm, in voxels of {_extent(self.voxel_m)} mm",
                f"voxels     {self.elements:,}; {self.dropped_voxels:,} loose ones left out",
                *(f"{label:<10} {text}" for label, text in geometry_lines(self.geometry)),
                f"nodes      {self.nodes:,}, {self.fixed_nodes:,} of them held"
                + (f", {self.sliding_nodes:,} sliding" if self.sliding_nodes else ""),
                *(f"           {line}" for line in self._bound_lines()),
                f"tissues    {tissues} (voxels that hold some)",
                f"muscles    {muscles or 'none'}",
                f"surfaces   {surfaces} (vertices that move with the tissue)",
                f"memory     {memory} at most while building and simulating",
                f"time step  {self.dt_s * 1e6:.3g} us"
                + (f" of {self.substeps} short ones" if self.substeps > 1 else "")
                + f"; the bound is {self.dt_crit_s * 1e6:.3g} us, set by {self.dt_tissue}",
                f"time       about {_duration(self.estimated_s)} for {self.steps:,} steps "
                f"on {self.device}",
            ]
        )

    def _bound_lines(self) -> list[str]:
        return boundary_text(self.boundary) if self.boundary else []


def _extent(sides: list[float]) -> str:
    """Lengths (m) in mm."""
    return " x ".join(f"{1e3 * side:.4g}" for side in sides)


def check_scene(
    scene: Scene,
    *,
    device: Any = "auto",
    quiet: bool = False,
    model: Model | None = None,
    name: str | None = None,
) -> Check:
    """Build a scene, time a few steps on the device, and count.

    ``model`` is the scene's model where it is built already, ``name`` that of its file. Raises
    InputError as building and simulating do; writes nothing.
    """
    opened = device_module.resolve(device)
    if model is None:
        with spinner("building the model", quiet=quiet):
            model = scene.build()
    with spinner("timing some steps", quiet=quiet):
        sim = simulator_of(scene, model, opened)
        require_room(scene, sim, shown_surface(model))
        dt, dt_crit = sim.dt, sim.dt_crit
        step_time = _time_step(sim)
    report = model.report
    holding = (model.fractions > 0.0).sum(axis=0)
    steps = round(scene.solver.duration / scene.solver.time_scaling / dt)
    return Check(
        scene=name or str(scene.path or "scene"),
        elements=model.n_elements,
        nodes=model.n_nodes,
        size_m=np.ptp(model.nodes, axis=0).tolist(),
        voxel_m=model.voxel.tolist(),
        tissues={name: int(n) for name, n in zip(model.tissues, holding, strict=True)},
        muscles={muscle.name: len(muscle.elements) for muscle in model.muscles},
        fixed_nodes=int(model.fixed.any(axis=1).sum()),
        sliding_nodes=len(model.sliding),
        boundary=report.get("boundary", {}),
        surfaces={
            name: [int(np.count_nonzero(bound.bound)), len(bound.vertices)]
            for name, bound in model.surfaces.items()
        },
        geometry={key: report[key] for key in GEOMETRY_KEYS if key in report},
        dropped_voxels=sum(report.get("dropped_components", []))
        + report.get("dropped_loose_voxels", 0),
        memory_bytes=_peak_memory(),
        dt_s=dt,
        substeps=sim.substeps,
        dt_crit_s=dt_crit,
        dt_tissue=sim.dt_crit_tissue,
        steps=steps,
        estimated_s=steps * step_time,
        device=opened.info.name,
    )


def _time_step(sim: Simulator) -> float:
    """Seconds for a step, measured after a first batch that warms caches and clocks up."""
    sim.step(_BATCH)
    steps, elapsed = 0, 0.0
    started = time.perf_counter()
    while elapsed < _TIMING or steps == 0:
        sim.step(_BATCH)
        # Reading the state waits for a device that works in the background.
        _ = sim.u
        steps += _BATCH
        elapsed = time.perf_counter() - started
    return elapsed / steps


def _peak_memory() -> int | None:
    """The process's peak memory so far in bytes; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    import sys

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
