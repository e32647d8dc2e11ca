"""The benchmark's face: a shell of skin that slides over bone, sized as the forehead of [W].

Warburton & Maddock's Table II has 503 530 elements, 629 178 nodes and 118 276 sliding nodes for it.
The shell here has the same proportions on a bone with brows, dents and triangles of 1.7 mm, and is
thrown along it at the speed at which a brow rises, so that nodes change triangles as often.
"""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tledface import device as device_module

if TYPE_CHECKING:
    import trimesh

    from tledface.model import Model
    from tledface.simulator import Simulator

__all__ = ["COLUMNS", "face_shell", "measure_sliding"]

# 344^2 columns of 4.25 voxels are 503 000 elements with 119 000 nodes on the bone.
COLUMNS = 344
_H = 0.5e-3
_THICKNESS = 4.25 * _H
_GAP = 0.25e-3  # between bone and voxels, m
_TRIANGLE = 1.7e-3
# m a step: 12 mm of brow rise in 10 000 steps.
SPEED = 1.2e-6
_ACTIVATION = 0.02
_WARM_UP, _BATCH, _TIMINGS = 150, 100, 9


def _bone_height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """A vault with two brows and some unevenness, m."""
    vault = -(x**2 + y**2) / (2 * 0.25)
    brows = sum(
        1.5e-3 * np.exp(-(((x - at) / 20e-3) ** 2) - ((y + 20e-3) / 6e-3) ** 2)
        for at in (-25e-3, 25e-3)
    )
    uneven = 0.1e-3 * np.sin(x / 2.1e-3) * np.sin(y / 2.7e-3)
    return np.asarray(vault + brows + uneven)


def _bone(width: float) -> trimesh.Trimesh:
    import trimesh

    n = max(2, round((width + 20e-3) / _TRIANGLE))
    line = np.linspace(-(width + 20e-3) / 2, (width + 20e-3) / 2, n + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    points = np.stack([x, y, _bone_height(x, y)], axis=-1).reshape(-1, 3)
    i = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return trimesh.Trimesh(points, faces, process=False)


def face_shell(columns: int = COLUMNS) -> Model:
    """A shell of ``columns`` x ``columns`` voxels, 4.25 deep: Table I's layers, 30 % with muscle.

    Its inner nodes slide on the bone, whatever lies at its rim is free.
    """
    from tledface.constitutive import material
    from tledface.model import Model

    def tissue(youngs_modulus: float) -> Any:
        return material(
            "neo_hookean", youngs_modulus=youngs_modulus, poissons_ratio=0.49, density=11000.0
        )

    centre = (np.arange(columns) + 0.5 - columns / 2) * _H
    x, y = np.meshgrid(centre, centre, indexing="ij")
    bottom = np.ceil((_bone_height(x, y) + _GAP) / _H - 0.5).astype(int)
    top = np.ceil((_bone_height(x, y) + _GAP + _THICKNESS) / _H - 0.5).astype(int)
    depth = int((top - bottom).max())
    layer = np.arange(depth)
    inside = layer < (top - bottom)[..., None]
    i, j, k = np.nonzero(inside)
    under_skin = (top - bottom)[i, j] - 1 - k
    low = int(bottom.min())
    cells = np.stack([i, j, bottom[i, j] + k - low], axis=1)
    order = np.lexsort((cells[:, 0], cells[:, 1], cells[:, 2]))
    cells, under_skin, k = cells[order], under_skin[order], k[order]
    share = np.zeros((len(cells), 4))
    share[under_skin == 0, 0] = 0.04
    share[:, 1] = np.where(under_skin < 3, 1.0, 0.0) - share[:, 0]
    share[:, 2] = 1.0 - share[:, 0] - share[:, 1]
    # A sheet over the bone: the second voxel from below, part of the first.
    muscle = (k == 1) | ((k == 0) & (cells[:, 1] % 4 == 0))
    share[muscle] = (0.0, 0.0, 0.0, 1.0)
    model = Model.from_voxels(
        (_H, _H, _H),
        (-columns / 2 * _H, -columns / 2 * _H, low * _H),
        cells,
        ["corneum", "dermis", "hypodermis", "muscle"],
        [tissue(48e6), tissue(81.4e3), tissue(34e3), tissue(0.5e6)],
        share,
    )
    model.add_muscle("frontalis", muscle, fibre=(0, 1, 0), sigma_act=5e6, sigma_pas=5e6)
    lowest = np.zeros(model.n_nodes, dtype=bool)
    lowest[np.unique(model.elements[k == 0][:, :4])] = True
    model.slide(lowest, _bone(columns * _H), "bone")
    return model


def started(model: Model, device: Any, **options: Any) -> Simulator:
    """A simulator of the shell on its way along the bone, its muscle contracting."""
    from tledface.simulator import Simulator

    sim = Simulator(model, device=device, **options)
    sim.activate("frontalis", _ACTIVATION)
    velocity = np.zeros_like(model.nodes)
    velocity[:, 1] = SPEED / sim.dt
    sim.set_state(np.zeros_like(velocity), velocity)
    return sim


def measure_sliding(
    device: Any = "auto", columns: int = COLUMNS, *, hourglass: str = "physical"
) -> dict[str, Any]:
    """Time steps of the face with its sliding nodes and with the same nodes let go, in turns.

    Returns:
        ``elements``, ``nodes``, ``sliding_nodes``, ``ms_per_step``, ``without`` (ms), and
        ``sliding_share`` of a step: medians over turns, with the ``spread`` of the share.
    """
    from tledface.sliding import Sliding

    opened = device_module.resolve(device)
    model = face_shell(columns)
    sims = [started(model, opened, hourglass=hourglass)]
    counts = len(model.sliding)
    model.sliding = Sliding()
    sims.append(started(model, opened, hourglass=hourglass))
    levels = np.full((max(_WARM_UP, _BATCH), 1), _ACTIVATION)
    taken: list[list[float]] = [[], []]
    for sim in sims:
        sim._core.step(_WARM_UP, levels[:_WARM_UP])
        sim._core.finish()
    for _ in range(_TIMINGS):
        for sim, times in zip(sims, taken, strict=True):
            begin = time.perf_counter()
            sim._core.step(_BATCH, levels[:_BATCH])
            sim._core.finish()
            times.append((time.perf_counter() - begin) / _BATCH)
    if any(sim._core.first_non_finite_node() >= 0 for sim in sims):
        raise RuntimeError("bench: the state is not finite, the speed means nothing")
    shares = [1.0 - off / on for on, off in zip(*taken, strict=True)]
    return {
        "device": opened.info.name,
        "workload": "face",
        "hourglass": hourglass,
        "elements": model.n_elements,
        "nodes": model.n_nodes,
        "muscle_elements": len(model.muscles[0].elements),
        "sliding_nodes": counts,
        "dt": sims[0].dt,
        "ms_per_step": 1e3 * statistics.median(taken[0]),
        "without": 1e3 * statistics.median(taken[1]),
        "sliding_share": statistics.median(shares),
        "spread": max(shares) - min(shares),
    }
