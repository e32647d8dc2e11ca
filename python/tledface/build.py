"""From a scene to a voxel model: surfaces, layers, muscles, held nodes and the bound skin."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.geometry import SurfaceFile, VoxelSet, long_axes, section_ratio
from tledface.geometry.report import surface_repairs
from tledface.geometry.sources import read_sources, sample
from tledface.model import Model
from tledface.scene import MuscleSpec, Scene
from tledface.surface import BoundSurface, bind

__all__ = ["BuildWarning", "build_model"]

Floats = NDArray[np.float64]

# Skin vertices farther than this from any voxel (in voxels) are left out of the bound surface.
_BIND_REACH = 3.0
# Nodes this near a box's side (in voxels) count as within it.
_BOX_MARGIN = 1e-6


class BuildWarning(UserWarning):
    """Something in a scene that has no effect."""


def build_model(scene: Scene) -> Model:
    """Build a scene's voxel model.

    Args:
        scene: A checked scene.

    Returns:
        The model, with the skin bound to it as surface "skin". ``model.report`` says what was
        done: counts, repairs of the surfaces, voxels removed, seconds, warnings.

    Raises:
        InputError: a surface that cannot be used, too many voxels for the memory, no tissue, a
            muscle that no voxel holds.

    A fixed box without nodes gives a ``BuildWarning``.
    """
    start = time.perf_counter()
    sources = read_sources(scene)
    skin, muscles = sources.skin, sources.muscles
    read = time.perf_counter()
    voxels = sample(scene, sources)
    sampled = time.perf_counter()
    model = _assemble(scene, voxels, [len(surfaces) for surfaces in muscles])
    _add_muscles(model, scene, voxels, muscles)
    problems = _fix_boxes(model, scene)
    model.gravity = np.asarray(scene.solver.gravity)
    model.surfaces["skin"], left_out = _bind_skin(model, skin)
    report: dict[str, Any] = {
        "elements": model.n_elements,
        "nodes": model.n_nodes,
        "fixed_nodes": int(model.fixed.any(axis=1).sum()),
        "partly_filled": int(np.count_nonzero(voxels.fill < 1.0 - 1e-9)),
        "muscle_elements": {muscle.name: len(muscle.elements) for muscle in model.muscles},
        "dropped_components": _removed(voxels, "unconnected", "parts", []),
        "dropped_loose_voxels": _removed(voxels, "loose", "voxels", 0),
        **voxels.report,
        "skin_vertices": len(model.surfaces["skin"].vertices),
        "skin_vertices_left_out": left_out,
        "surfaces": {file.solid.name: file.solid.report for file in sources.files},
        "repairs": [repair for file in sources.files for repair in surface_repairs(file.solid)],
        "warnings": problems,
        "seconds": {
            "read": read - start,
            "voxelise": sampled - read,
            "assemble": time.perf_counter() - sampled,
        },
    }
    model.report = report
    for problem in problems:
        warnings.warn(problem, BuildWarning, stacklevel=2)
    return model


def _removed(voxels: VoxelSet, kind: str, key: str, none: Any) -> Any:
    found = voxels.report["left_out"].get(kind, {"removed": False})
    return found[key] if found["removed"] else none


def _assemble(scene: Scene, voxels: VoxelSet, surfaces_per_muscle: list[int]) -> Model:
    """Merge the surfaces of each muscle into one tissue and make the model."""
    layers, muscles = scene.layers, scene.muscles
    materials = [*(layer.material for layer in layers), *(muscle.material for muscle in muscles)]
    muscle_of = np.repeat(np.arange(len(muscles)), surfaces_per_muscle)
    tissue_of = np.concatenate([np.arange(len(layers)), len(layers) + muscle_of]).astype(int)
    fractions = np.zeros((len(voxels.cells), len(materials)))
    for column, tissue in enumerate(tissue_of):
        fractions[:, tissue] += voxels.fractions[:, column]
    section = scene.layer_bending == "section"
    moduli = [materials[tissue].youngs_modulus for tissue in tissue_of]
    return Model.from_voxels(
        voxels.voxel,
        voxels.origin,
        voxels.cells,
        [*(layer.name for layer in layers), *(muscle.name for muscle in muscles)],
        materials,
        fractions,
        section_ratio=section_ratio(voxels, moduli) if section else None,
        layer_normal=voxels.normal if section else None,
        fill=voxels.weight if (voxels.weight < 1.0).any() else None,
        surfaces={},
    )


def _add_muscles(
    model: Model, scene: Scene, voxels: VoxelSet, muscles: list[list[SurfaceFile]]
) -> None:
    column = len(scene.layers)
    for spec, surfaces in zip(scene.muscles, muscles, strict=True):
        shares = voxels.fractions[:, column : column + len(surfaces)]
        column += len(surfaces)
        weight = shares.sum(axis=1)
        where = weight > 0.0
        if not where.any():
            raise InputError(_missed_muscle(spec, surfaces, model))
        model.add_muscle(
            spec.name,
            where,
            _fibres(spec, surfaces, shares[where]),
            sigma_act=spec.sigma_act,
            sigma_pas=spec.sigma_pas,
            lambda_opt=spec.lambda_opt,
            lambda_pas=spec.lambda_pas,
            weight=np.minimum(weight[where], 1.0),
            law=spec.law,
        )


def _fibres(spec: MuscleSpec, surfaces: list[SurfaceFile], shares: Floats) -> Floats:
    """Return the fibre direction of each of a muscle's elements, (m, 3)."""
    if not isinstance(spec.fibre, str):
        return np.broadcast_to(np.asarray(spec.fibre, dtype=np.float64), (len(shares), 3))
    axes = long_axes([surface.solid for surface in surfaces])
    mean = shares @ axes
    length = np.linalg.norm(mean, axis=1)
    # Surfaces at right angles cannot cancel, but equal shares of opposite ones could.
    main = axes[np.argmax(shares, axis=1)]
    return np.where((length > 1e-3 * shares.sum(axis=1))[:, None], mean, main)


def _missed_muscle(spec: MuscleSpec, surfaces: list[SurfaceFile], model: Model) -> str:
    boxes = np.stack([surface.bounds for surface in surfaces])
    span = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    tissue = np.stack([model.nodes.min(axis=0), model.nodes.max(axis=0)])
    return (
        f"muscle {spec.name!r}: no voxel holds any of {', '.join(str(s.path) for s in surfaces)}; "
        f"it spans {_show_box(span)}, the voxels span {_show_box(tissue)}; move it inside the "
        "skin and outside the bones, or check region and depth"
    )


def _fix_boxes(model: Model, scene: Scene) -> list[str]:
    problems = []
    margin = _BOX_MARGIN * model.voxel
    for number, spec in enumerate(scene.boundary.fixed):
        low, high = (np.asarray(corner) for corner in spec.box)
        within = (model.nodes >= low - margin) & (model.nodes <= high + margin)
        where = np.asarray(within.all(axis=1))
        if where.any():
            model.fix(where, spec.components)
            continue
        span = np.stack([model.nodes.min(axis=0), model.nodes.max(axis=0)])
        problems.append(
            f"boundary.fixed[{number}]: no node lies in the box "
            f"{_show_box(np.stack([low, high]))}; the nodes span {_show_box(span)}"
        )
    return problems


def _bind_skin(model: Model, skin: SurfaceFile) -> tuple[BoundSurface, int]:
    """Bind the skin's vertices near voxels; returns the surface and how many were left out."""
    vertices, faces = skin.vertices, skin.faces.astype(np.int64)
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    reach = _BIND_REACH * model.voxel.max()
    low, high = model.nodes.min(axis=0) - reach, model.nodes.max(axis=0) + reach
    candidates = np.flatnonzero(used & ((vertices >= low) & (vertices <= high)).all(axis=1))
    near = np.zeros(len(vertices), dtype=bool)
    if len(candidates):
        _, _, distance = bind(vertices[candidates], model)
        near[candidates] = distance <= reach
    kept_faces = faces[near[faces].all(axis=1)]
    kept = np.zeros(len(vertices), dtype=bool)
    kept[kept_faces] = True
    number = np.cumsum(kept) - 1
    surface = BoundSurface.on(model, vertices[kept], number[kept_faces])
    return surface, int(np.count_nonzero(used & ~kept))


def _show_box(box: Floats) -> str:
    low, high = ("(" + ", ".join(f"{1e3 * x:.5g}" for x in corner) + ")" for corner in box)
    return f"{low} to {high} mm"
