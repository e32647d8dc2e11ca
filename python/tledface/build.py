"""From a scene to a voxel model: surfaces, layers, muscles, held nodes and the bound skin."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tledface.boundary import Bone, bind_boundary, bone_names, grid_planes
from tledface.errors import InputError
from tledface.geometry import (
    SurfaceFile,
    VoxelSet,
    long_axes,
    make_field,
    mean_fibres,
    outer_faces,
    read_polygons,
    section_ratio,
)
from tledface.geometry.report import surface_repairs
from tledface.geometry.sources import read_sources, sample
from tledface.geometry.surfaces import SURFACE_FORMATS
from tledface.model import Model
from tledface.polygons import Polygons
from tledface.scene import MuscleSpec, Scene, VolumeSpec
from tledface.surface import BoundSurface

__all__ = ["BuildWarning", "build_model"]

Floats = NDArray[np.float64]

# Where only a region of the skin has tissue, vertices of a bound surface farther than this from any
# voxel (in voxels) stay at rest.
_BIND_REACH = 3.0


class BuildWarning(UserWarning):
    """Something in a scene that has no effect."""


def build_model(scene: Scene) -> Model:
    """Build a scene's voxel model.

    Args:
        scene: A checked scene.

    Returns:
        The model, with the skin bound to it as surface "skin" and those of ``[[surfaces]]``, and
        with its ``[boundary]``. ``model.report`` says what was done: counts, repairs of the
        surfaces, voxels removed, seconds, warnings.

    Raises:
        InputError: a surface that cannot be used, too many voxels for the memory, no tissue, a
            muscle that no voxel holds, a boundary entry that names no bone.

    A boundary entry without nodes gives a ``BuildWarning``.
    """
    start = time.perf_counter()
    sources = read_sources(scene)
    skin, muscles = sources.skin, sources.muscles
    read = time.perf_counter()
    voxels = sample(scene, sources, align=grid_planes(scene))
    sampled = time.perf_counter()
    model = _assemble(scene, voxels, [len(surfaces) for surfaces in muscles])
    fibres = _add_muscles(model, scene, voxels, muscles)
    model.gravity = np.asarray(scene.solver.gravity)
    outer = skin.solid.faces[outer_faces(skin.solid, scene.geometry.outer)]
    boundary, problems = bind_boundary(
        model,
        scene,
        [
            Bone(name, bone.solid.vertices, bone.solid.faces)
            for name, bone in zip(
                bone_names([bone.path for bone in sources.bones]), sources.bones, strict=True
            )
        ],
        (skin.solid.vertices, outer),
    )
    assembled = time.perf_counter()
    problems += _bind_surfaces(model, scene, skin)
    report: dict[str, Any] = {
        "elements": model.n_elements,
        "nodes": model.n_nodes,
        "fixed_nodes": int(model.fixed.any(axis=1).sum()),
        "boundary": boundary,
        "partly_filled": int(np.count_nonzero(voxels.fill < 1.0 - 1e-9)),
        "muscle_elements": {muscle.name: len(muscle.elements) for muscle in model.muscles},
        "fibres": fibres,
        "dropped_components": _removed(voxels, "unconnected", "parts", []),
        "dropped_loose_voxels": _removed(voxels, "loose", "voxels", 0),
        **voxels.report,
        "bound_vertices": {
            name: [int(np.count_nonzero(bound.bound)), len(bound.vertices)]
            for name, bound in model.surfaces.items()
        },
        "surfaces": {file.solid.name: file.solid.report for file in sources.files},
        "repairs": [repair for file in sources.files for repair in surface_repairs(file.solid)],
        "warnings": problems,
        "seconds": {
            "read": read - start,
            "voxelise": sampled - read,
            "assemble": assembled - sampled,
            "bind": time.perf_counter() - assembled,
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
    layers, muscles = scene.layers, scene.parts
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
) -> dict[str, dict[str, Any]]:
    """Add each muscle to its voxels; returns a report of their fibres by name."""
    column = len(scene.layers)
    report = {}
    for spec, surfaces in zip(scene.parts, muscles, strict=True):
        shares = voxels.fractions[:, column : column + len(surfaces)]
        column += len(surfaces)
        weight = shares.sum(axis=1)
        where = weight > 0.0
        if not where.any():
            raise InputError(_missed(spec, surfaces, model))
        if not isinstance(spec, MuscleSpec):
            continue
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


def _missed(spec: MuscleSpec | VolumeSpec, surfaces: list[SurfaceFile], model: Model) -> str:
    kind = "muscle" if isinstance(spec, MuscleSpec) else "volume"
    boxes = np.stack([surface.bounds for surface in surfaces])
    span = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    tissue = np.stack([model.nodes.min(axis=0), model.nodes.max(axis=0)])
    return (
        f"{kind} {spec.name!r}: no voxel holds any of {', '.join(str(s.path) for s in surfaces)}; "
        f"it spans {_show_box(span)}, the voxels span {_show_box(tissue)}; move it inside the "
        "skin and outside the bones, or check region and depth"
    )


def _bind_surfaces(model: Model, scene: Scene, skin: SurfaceFile) -> list[str]:
    """Bind the skin and the scene's other surfaces, vertex for vertex as their files have them.

    Returns what a user should know of the skin.
    """
    geometry, near = scene.geometry, _BIND_REACH * float(model.voxel.max())
    # Without a region, far vertices are parts too thin for the voxels, which go with the body.
    reach = None if geometry.region is None else near
    if skin.path.suffix.lower() in SURFACE_FORMATS:
        vertices, polygons = read_polygons(skin.path, unit_scale=geometry.unit_scale)
    else:  # a skin that no surface file holds
        vertices, polygons = skin.vertices, Polygons.of_triangles(skin.faces)
    model.surfaces["skin"] = BoundSurface.on(model, vertices, polygons, reach=reach)
    for spec in scene.surfaces:
        vertices, polygons = read_polygons(spec.file, unit_scale=spec.unit_scale)
        bound = BoundSurface.on(
            model,
            vertices,
            polygons,
            reach=reach if spec.reach is None else spec.reach,
            fade=spec.fade,
        )
        if bound.distance(model.voxel).min() > max(near, spec.reach or 0.0):
            raise InputError(
                f"surface {spec.name!r}: no vertex of {spec.file} lies near the tissue; it spans "
                f"{_show_box(np.stack([vertices.min(axis=0), vertices.max(axis=0)]))}, the voxels "
                f"{_show_box(np.stack([model.nodes.min(axis=0), model.nodes.max(axis=0)]))}; bring "
                "it into the scene's frame, give its units, or a larger reach"
            )
        model.surfaces[spec.name] = bound
    bound = model.surfaces["skin"]
    if len(bound.bound_faces):
        return []
    return [
        f"skin {skin.path}: none of its {len(bound.faces):,} faces has all its corners within "
        f"{1e3 * near:.3g} mm of the tissue, so none moves with it: a run measures no folds, "
        "and its picture shows the voxels; divide its long faces, or take a larger region"
    ]


def _show_box(box: Floats) -> str:
    low, high = ("(" + ", ".join(f"{1e3 * x:.5g}" for x in corner) + ")" for corner in box)
    return f"{low} to {high} mm"
