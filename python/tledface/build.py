"""From a scene to a voxel model: surfaces, layers, muscles, held nodes and the bound skin."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.geometry import (
    SurfaceFile,
    VoxelSet,
    long_axes,
    make_field,
    mean_fibres,
    read_surface,
    section_ratio,
    voxelise,
)
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

    Where volumes overlap, bone comes before muscle before skin layers. A fixed box without nodes
    gives a ``BuildWarning``.
    """
    start = time.perf_counter()
    geometry = scene.geometry
    skin = read_surface(geometry.skin, unit_scale=geometry.unit_scale)
    bones = [read_surface(path, unit_scale=geometry.unit_scale) for path in geometry.bones]
    muscles = [
        [read_surface(path, unit_scale=geometry.unit_scale) for path in muscle.surfaces]
        for muscle in scene.muscles
    ]
    parts = [surface for surfaces in muscles for surface in surfaces]
    read = time.perf_counter()
    voxels = voxelise(
        skin.solid,
        voxel=geometry.voxel,
        boundaries=_boundaries([layer.thickness for layer in scene.layers[:-1]]),
        bones=[bone.solid for bone in bones],
        muscles=[part.solid for part in parts],
        samples=geometry.samples,
        depth=geometry.depth,
        region=geometry.region,
        outer=geometry.outer,
        fill=geometry.fill,
    )
    sampled = time.perf_counter()
    model = _assemble(scene, voxels, [len(surfaces) for surfaces in muscles])
    fibres = _add_muscles(model, scene, voxels, muscles)
    problems = _fix_boxes(model, scene)
    model.gravity = np.asarray(scene.solver.gravity)
    model.surfaces["skin"], left_out = _bind_skin(model, skin)
    report: dict[str, Any] = {
        "elements": model.n_elements,
        "nodes": model.n_nodes,
        "fixed_nodes": int(model.fixed.any(axis=1).sum()),
        "partly_filled": int(np.count_nonzero(voxels.fill < 1.0 - 1e-9)),
        "muscle_elements": {muscle.name: len(muscle.elements) for muscle in model.muscles},
        "fibres": fibres,
        "dropped_components": voxels.report["unconnected"],
        "dropped_loose_voxels": voxels.report["loose"],
        "memory_estimate": voxels.report["memory_estimate"],
        "skin_vertices": len(model.surfaces["skin"].vertices),
        "skin_vertices_left_out": left_out,
        "surfaces": {str(file.path): file.solid.report for file in (skin, *bones, *parts)},
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


def _boundaries(thicknesses: Sequence[float | None]) -> list[float]:
    return [float(depth) for depth in np.cumsum([t for t in thicknesses if t is not None])]


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
        surfaces={},
    )


def _add_muscles(
    model: Model, scene: Scene, voxels: VoxelSet, muscles: list[list[SurfaceFile]]
) -> dict[str, dict[str, Any]]:
    """Add each muscle to its voxels; returns a report of their fibres by name."""
    column = len(scene.layers)
    report = {}
    for spec, surfaces in zip(scene.muscles, muscles, strict=True):
        shares = voxels.fractions[:, column : column + len(surfaces)]
        column += len(surfaces)
        weight = shares.sum(axis=1)
        where = weight > 0.0
        if not where.any():
            raise InputError(_missed_muscle(spec, surfaces, model))
        try:
            fibre, report[spec.name] = _fibres(spec, surfaces, shares[where], where, voxels, scene)
        except InputError as error:
            raise InputError(f"muscle {spec.name!r}: fibre: {error}") from None
        model.add_muscle(
            spec.name,
            where,
            fibre,
            sigma_act=spec.sigma_act,
            sigma_pas=spec.sigma_pas,
            lambda_opt=spec.lambda_opt,
            lambda_pas=spec.lambda_pas,
            weight=np.minimum(weight[where], 1.0),
            law=spec.law,
        )
    return report


def _fibres(
    spec: MuscleSpec,
    surfaces: list[SurfaceFile],
    shares: Floats,
    where: NDArray[np.bool_],
    voxels: VoxelSet,
    scene: Scene,
) -> tuple[Floats, dict[str, Any]]:
    """Return the fibre direction of each of a muscle's elements, (m, 3), and what to report."""
    if isinstance(spec.fibre, tuple):
        fibre = np.broadcast_to(np.asarray(spec.fibre, dtype=np.float64), (len(shares), 3))
        return fibre, {"kind": "constant"}
    solids = [surface.solid for surface in surfaces]
    if isinstance(spec.fibre, str):
        return _along_axes(shares, long_axes(solids)), {"kind": spec.fibre}
    scale = scene.geometry.unit_scale
    found = mean_fibres(
        [make_field(solid, spec.fibre, unit_scale=scale) for solid in solids],
        solids,
        voxels.cells[where],
        origin=voxels.origin,
        voxel=voxels.voxel,
        samples=scene.geometry.samples,
    )
    return found.fibre, {
        "kind": spec.fibre.kind,
        "mean_alignment": float(found.alignment.mean()),
        "least_alignment": float(found.alignment.min()),
        "voxels_without_sample": int(np.count_nonzero(~found.sampled)),
    }


def _along_axes(shares: Floats, axes: Floats) -> Floats:
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
