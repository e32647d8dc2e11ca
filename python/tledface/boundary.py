"""A scene's ``[boundary]`` on a model: which nodes are held, which slide, and what binds them.

Rigid entries come first, in the order of ``GROUP_KINDS``: boxes, cut faces, attachments,
ligaments; then planes of symmetry; then sliding. Held components add up. A node held in all
components does not slide; one on a plane of symmetry slides within it. A node as near to two bones
slides on the one that the scene lists first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tledface import _core
from tledface.errors import InputError
from tledface.geometry.lines import near_lines, read_lines
from tledface.motion import RigidMotion
from tledface.sliding import GROUP_KINDS, NodeGroup, SlidingSurface

if TYPE_CHECKING:
    from tledface.model import Model
    from tledface.scene import Scene, SlidingSpec

__all__ = ["Bone", "bind_boundary", "bone_names", "boundary_text", "grid_planes"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Boxes = Sequence[tuple[Sequence[float], Sequence[float]]]

# Nodes this near a box's side or a plane (in voxels) count as on it.
_MARGIN = 1e-6
# Bones whose distances to a node differ by less than this (in voxels) are equally near.
_TIE = 1e-6
# How far from the tissue that it carries a bone may be, in voxels, where no reach is given: a
# boundary voxel is kept when half full, so its nodes lie within a voxel's diagonal of the bone.
_SLIDING_REACH = 2.0
# A node counts as on the bone's side if it has an exposed face whose outward normal has more than
# this cosine with the way to the bone. Of the faces that make up a slanted surface the steepest has
# 1 / sqrt(3) at least; those of a cut across the tissue have about 0.
_TOWARDS_BONE = 0.5
# Nearer than this to a surface (m), the way to it is that of its normal.
_ON_SURFACE = 1e-9


@dataclass(frozen=True, eq=False)
class Bone:
    """A bone by name: vertices (nv, 3) m, faces (nf, 3), closed and outwards."""

    name: str
    vertices: Floats
    faces: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _Claim:
    """What an entry binds: nodes and the components that it holds."""

    group: NodeGroup
    components: str


def bone_names(paths: Sequence[Any]) -> list[str]:
    """Names of bone files: their stems, a later equal one with a number after it."""
    names: list[str] = []
    for path in paths:
        stem = name = path.stem
        number = 2
        while name in names or name == "bones":
            name, number = f"{stem} {number}", number + 1
        names.append(name)
    return names


def grid_planes(scene: Scene) -> list[float | None]:
    """Where voxel faces must lie along x, y, z for the scene's planes of symmetry, m."""
    planes: list[float | None] = [None, None, None]
    for plane in scene.boundary.symmetry:
        planes["xyz".index(plane.axis)] = plane.at
    return planes


def bind_boundary(
    model: Model,
    scene: Scene,
    bones: Sequence[Bone],
    skin: tuple[Floats, NDArray[np.integer]],
) -> tuple[dict[str, Any], list[str]]:
    """Hold and let slide the nodes that a scene's ``[boundary]`` names.

    Args:
        model: The scene's model, with its muscles.
        scene: The scene.
        bones: Its bones, in order.
        skin: vertices (nv, 3) m and outer faces (nf, 3) of the skin.

    Returns:
        A report for ``model.report["boundary"]``: nodes by entry, rigid, partly held, sliding and
        symmetry nodes, ``bound_twice``; and a line for each entry that binds no node.

    Raises:
        InputError: a bone that is not there, a muscle that is not, a file that cannot be read.
    """
    claims = [
        *_boxes(model, scene),
        *_cuts(model, scene),
        *_attachments(model, scene, bones),
        *_ligaments(model, scene),
        *_symmetry(model, scene),
    ]
    problems = []
    held: list[_Claim] = []
    for claim in claims:
        if not len(claim.group.nodes):
            problems.append(_nothing(model, claim.group))
            continue
        model.fix(_mask(model, claim.group.nodes), claim.components)
        held.append(claim)
    twice = []
    for number, claim in enumerate(held):
        where = _mask(model, claim.group.nodes)
        twice += [_twice(claim, where, other) for other in held[number + 1 :]]
    report: dict[str, Any] = {}
    spec = scene.boundary.sliding
    if spec is not None:
        found, shared = _slide(model, spec, bones, skin, held)
        twice += shared
        if not found:
            problems.append(
                "boundary.sliding: no node slides; no outermost node lies near a bone of "
                f"{', '.join(spec.on)} that faces the skin: check on, facing, reach and boxes"
            )
    _move(model, scene)
    model.groups += [claim.group for claim in held]
    model.groups.sort(key=_precedence)
    rigid = model.fixed.all(axis=1)
    report |= {
        "groups": [
            {"kind": group.kind, "name": group.name, "nodes": len(group.nodes)}
            for group in model.groups
        ],
        "rigid_nodes": int(np.count_nonzero(rigid)),
        "partly_held_nodes": int(np.count_nonzero(model.fixed.any(axis=1) & ~rigid)),
        "sliding_nodes": len(model.sliding),
        "bound_twice": [entry for entry in twice if entry["nodes"]],
    }
    return report, problems


def boundary_text(report: dict[str, Any]) -> list[str]:
    """Lines for a person: what binds nodes, and which are bound twice."""
    lines = [
        f"{group['name']}: {group['nodes']:,} nodes ({group['kind']})" for group in report["groups"]
    ]
    return lines + [
        f"{entry['nodes']:,} nodes bound twice, by {entry['first']} and {entry['second']}: "
        f"{entry['kept']}"
        for entry in report["bound_twice"]
    ]


def _precedence(group: NodeGroup) -> int:
    return GROUP_KINDS.index(group.kind)


def _boxes(model: Model, scene: Scene) -> list[_Claim]:
    return [
        _claim("fixed", f"fixed[{n}]", _in_boxes(model, [spec.box]), spec.components)
        for n, spec in enumerate(scene.boundary.fixed)
    ]


def _cuts(model: Model, scene: Scene) -> list[_Claim]:
    if not scene.boundary.cuts:
        return []
    faces, centres, normals = model.boundary()
    claims = []
    for number, spec in enumerate(scene.boundary.cuts):
        axis, sign = "xyz".index(spec.side[0]), 1.0 if spec.side[1] == "+" else -1.0
        at = spec.at
        if at is None:
            region = scene.geometry.region
            if region is None:
                raise InputError(
                    f"boundary.cuts[{number}].at: key missing; without a region of [geometry] "
                    "there is no side to take; give it, as at = 1600"
                )
            at = region[int(sign > 0)][axis]
        # A voxel is kept when filled to this share, so the cut may lie this far off its face.
        fill = scene.geometry.fill
        off = (max(fill, 1.0 - fill) + _MARGIN) * model.voxel[axis]
        cut = (sign * normals[:, axis] > 0.5) & (np.abs(centres[:, axis] - at) <= off)
        where = np.zeros(model.n_nodes, dtype=bool)
        where[faces[cut]] = True
        if spec.boxes:
            where &= _in_boxes(model, spec.boxes)
        claims.append(_claim("cut", f"cuts[{number}] {spec.side}", where, spec.components))
    return claims


def _attachments(model: Model, scene: Scene, bones: Sequence[Bone]) -> list[_Claim]:
    claims = []
    elements = {muscle.name: muscle.elements for muscle in model.muscles}
    for number, spec in enumerate(scene.boundary.attachments):
        near = [
            bones[n] for n in _named(bones, [spec.bone], f"boundary.attachments[{number}].bone")
        ]
        nodes = np.unique(model.elements[elements[spec.muscle]])
        if spec.boxes:
            nodes = nodes[_in_boxes(model, spec.boxes)[nodes]]
        where = np.zeros(model.n_nodes, dtype=bool)
        if len(nodes):
            meshes = [(bone.vertices, bone.faces) for bone in near]
            distance = _core.nearest_surfaces(meshes, model.nodes[nodes], 0.0)["distance"]
            where[nodes[distance <= spec.reach + _MARGIN * model.voxel.min()]] = True
        claims.append(_claim("attachment", f"{spec.muscle} on {spec.bone}", where, "xyz"))
    return claims


def _ligaments(model: Model, scene: Scene) -> list[_Claim]:
    claims = []
    for spec in scene.boundary.ligaments:
        if spec.file is not None:
            lines = read_lines(spec.file, unit_scale=scene.geometry.unit_scale)
        else:
            lines = [np.array(spec.points, dtype=np.float64)]
        margin = _MARGIN * float(model.voxel.min())
        where = near_lines(model.nodes, lines, spec.radius + margin)
        claims.append(_claim("ligament", spec.name, where, "xyz"))
    return claims


def _symmetry(model: Model, scene: Scene) -> list[_Claim]:
    claims = []
    for spec in scene.boundary.symmetry:
        axis = "xyz".index(spec.axis)
        away = model.nodes[:, axis] - spec.at
        margin = _MARGIN * model.voxel[axis]
        where = np.abs(away) <= margin
        if (away > margin).any() and (away < -margin).any():
            raise InputError(
                f"boundary.symmetry: there is tissue on both sides of {spec.axis} = "
                f"{1e3 * spec.at:g} mm; keep one side with region of [geometry]"
            )
        name = f"{spec.axis} = {1e3 * spec.at:g} mm"
        claims.append(_claim("symmetry", name, where, spec.axis))
    return claims


def _move(model: Model, scene: Scene) -> None:
    known = [surface.name for surface in model.sliding.surfaces]
    for spec in scene.boundary.motions:
        if spec.bone not in known:
            there = ", ".join(map(repr, known)) if known else "none"
            raise InputError(
                f"boundary.motions: got bone {spec.bone!r}; bones that nodes slide on: {there}"
            )
        motion = RigidMotion(
            spec.about, spec.axis, math.radians(spec.degrees), spec.shift, spec.share
        )
        model.move_surface(spec.bone, motion)


def _slide(
    model: Model,
    spec: SlidingSpec,
    bones: Sequence[Bone],
    skin: tuple[Floats, NDArray[np.integer]],
    held: Sequence[_Claim],
) -> tuple[int, list[dict[str, Any]]]:
    """Let nodes slide, or hold them; return how many, and what else binds nodes that could."""
    chosen = _named(bones, spec.on, "boundary.sliding.on")
    faces, _, normals = model.boundary()
    outermost = np.unique(faces).astype(np.int64)
    tie = _TIE * float(model.voxel.min())
    # Of all bones, so that no node slides on one that lies behind another.
    meshes = [(bone.vertices, bone.faces) for bone in bones]
    found = _core.nearest_surfaces(meshes, model.nodes[outermost], tie)
    reach = _SLIDING_REACH * float(model.voxel.max()) if spec.reach is None else spec.reach
    good: Mask = np.isin(found["surface"], chosen) & (np.abs(found["distance"]) <= reach)
    good &= _faces_bone(model, faces, normals, outermost, found)
    rows = np.flatnonzero(good)
    free = float(model.voxel.max())
    good[rows] = _faces_skin(found, rows, skin, meshes, spec.facing, free)
    if spec.boxes:
        good &= _in_boxes(model, spec.boxes)[outermost]
    if spec.excluded:
        good &= ~_in_boxes(model, spec.excluded)[outermost]
    could = _mask(model, outermost[good])
    rigid: Mask = np.asarray(model.fixed.all(axis=1))
    twice = [
        {
            "first": _label(claim.group),
            "second": "sliding",
            "nodes": int(np.count_nonzero(could[claim.group.nodes])),
            "kept": "rigid" if model.fixed[claim.group.nodes].all() else "both hold",
        }
        for claim in held
    ]
    slides: Mask = good & ~rigid[outermost]
    for number in chosen:
        here = np.flatnonzero(slides & (found["surface"] == number))
        if not len(here):
            continue
        bone = bones[number]
        nodes = outermost[here]
        if spec.held:
            model.fix(_mask(model, nodes), "xyz")
            model.groups.append(NodeGroup("fixed", bone.name, nodes))
            continue
        ground = SlidingSurface(bone.name, bone.vertices, bone.faces)
        model._slide(
            nodes, found["distance"][here], ground, friction=spec.friction, release=spec.release
        )
        model.groups.append(NodeGroup("sliding", bone.name, nodes))
    n_tied = np.count_nonzero(np.logical_and(slides, found["tied"]))
    twice.append(
        {
            "first": "one bone",
            "second": "another, equally near",
            "nodes": int(n_tied),
            "kept": "on the first in the scene",
        }
    )
    return int(np.count_nonzero(slides)), twice


def _faces_bone(
    model: Model,
    faces: NDArray[np.int32],
    normals: Floats,
    outermost: NDArray[np.int64],
    found: Any,
) -> Mask:
    """Which of the outermost nodes have an exposed face that looks towards their bone."""
    way = np.zeros((model.n_nodes, 3))
    way[outermost] = -_direction(model.nodes[outermost] - found["point"], found)
    towards = np.einsum("fcj,fj->fc", way[faces], normals) > _TOWARDS_BONE
    where = np.zeros(model.n_nodes, dtype=bool)
    where[faces[towards]] = True
    return where[outermost]


def _direction(away: Floats, found: Any) -> Floats:
    """Unit vectors from a surface outwards through each point, also for points behind it."""
    length = np.abs(found["distance"])
    away = away * np.where(found["distance"] < 0.0, -1.0, 1.0)[:, None]
    near = length <= _ON_SURFACE
    return np.where(near[:, None], found["normal"], away / np.where(near, 1.0, length)[:, None])


def _faces_skin(
    found: Any,
    rows: NDArray[np.int64],
    skin: tuple[Floats, NDArray[np.integer]],
    bones: Sequence[tuple[Floats, NDArray[np.int32]]],
    facing: float,
    free: float,
) -> Mask:
    """Whether a bone faces the skin where it is nearest to a node, for some rows of ``found``.

    Its outward normal and the way to the nearest skin have a cosine above ``facing``, and no bone
    lies on that way, which the floor of a cavity would have; bone nearer than ``free`` (m) to
    where it starts is roughness.
    """
    start = found["point"][rows]
    vertices, faces = _core.weld(*skin)
    out = _core.nearest_surfaces([(vertices, faces)], start, 0.0)
    # Outwards through the skin, also where a bone pokes through it.
    way = _direction(start - out["point"], out)
    faces_it = np.einsum("ij,ij->i", way, found["normal"][rows]) > facing
    far = -out["distance"] > free
    blocked = np.zeros(len(rows), dtype=bool)
    blocked[far] = _core.segments_meet(bones, (start + free * way)[far], out["point"][far])
    return np.asarray(faces_it & ~blocked)


def _named(bones: Sequence[Bone], names: Sequence[str], where: str) -> list[int]:
    """Numbers of the bones of these names, rising."""
    known = [bone.name for bone in bones]
    chosen: set[int] = set()
    for name in names:
        if name == "bones" and bones:
            chosen.update(range(len(bones)))
        elif name in known:
            chosen.add(known.index(name))
        else:
            given = ", ".join(["bones", *known]) if bones else "none, [geometry] has no bones"
            raise InputError(f"{where}: got {name!r}; allowed: {given}")
    return sorted(chosen)


def _in_boxes(model: Model, boxes: Boxes) -> Mask:
    margin = _MARGIN * model.voxel
    where = np.zeros(model.n_nodes, dtype=bool)
    for low, high in boxes:
        inside = (model.nodes >= np.asarray(low) - margin) & (
            model.nodes <= np.asarray(high) + margin
        )
        where |= inside.all(axis=1)
    return where


def _claim(kind: str, name: str, where: Mask, components: str) -> _Claim:
    return _Claim(NodeGroup(kind, name, np.flatnonzero(where)), components)


def _twice(a: _Claim, where: Mask, b: _Claim) -> dict[str, Any]:
    """Nodes that two entries hold in the same component; ``where`` are the nodes of the first."""
    common = bool(set(a.components) & set(b.components))
    return {
        "first": _label(a.group),
        "second": _label(b.group),
        "nodes": int(np.count_nonzero(where[b.group.nodes])) if common else 0,
        "kept": "held once",
    }


def _mask(model: Model, nodes: NDArray[np.int64]) -> Mask:
    where = np.zeros(model.n_nodes, dtype=bool)
    where[nodes] = True
    return where


def _label(group: NodeGroup) -> str:
    return group.name if group.name.startswith(group.kind) else f"{group.kind} {group.name}"


def _nothing(model: Model, group: NodeGroup) -> str:
    span = np.stack([model.nodes.min(axis=0), model.nodes.max(axis=0)])
    low, high = ("(" + ", ".join(f"{1e3 * x:.5g}" for x in corner) + ")" for corner in span)
    what = {
        "fixed": "no node lies in the box",
        "cut": "no cut face of the voxels lies there",
        "attachment": "no node of the muscle lies within reach of the bone",
        "ligament": "no node lies within the radius",
        "symmetry": "no node lies on the plane",
    }[group.kind]
    return f"boundary.{_label(group)}: {what}; the nodes span {low} to {high} mm"
