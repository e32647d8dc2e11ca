"""Surfaces, sliding nodes and node groups in the model file: see docs/reference/model-file.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.io.schedules import read_schedule, write_schedule
from tledface.motion import RigidMotion
from tledface.polygons import Labels, Polygons
from tledface.schedule import as_schedule
from tledface.sliding import GROUP_KINDS, NodeGroup, Sliding, SlidingSurface
from tledface.surface import BoundSurface

__all__ = [
    "COMPRESSION",
    "numbered",
    "read_groups",
    "read_sliding",
    "read_surfaces",
    "write_groups",
    "write_sliding",
    "write_surfaces",
]

COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


def numbered(file: h5py.Group, name: str) -> list[h5py.Group]:
    """The groups ``name/0``, ``name/1``, … of a file; none where it has no ``name``."""
    return [file[name][str(n)] for n in range(len(file[name]))] if name in file else []


def write_surfaces(surfaces: Mapping[str, BoundSurface], file: h5py.Group) -> None:
    """Write bound surfaces."""
    for number, (name, surface) in enumerate(surfaces.items()):
        group = file.create_group(f"surfaces/{number}")
        group.attrs["name"] = name
        for key in ("vertices", "faces", "element", "local"):
            group.create_dataset(key, data=getattr(surface, key), **COMPRESSION)
        if surface.follow is not None:
            group.create_dataset("follow", data=surface.follow, **COMPRESSION)
        if not surface.polygons.is_plain:
            _write_polygons(surface.polygons, group.create_group("polygons"))


def read_surfaces(
    file: h5py.Group, elements: NDArray[np.int32], voxel: NDArray[np.float64] | None
) -> dict[str, BoundSurface]:
    """Read what `write_surfaces` wrote; voxel: (3,) m, None for a conforming mesh."""
    surfaces = {}
    for group in numbered(file, "surfaces"):
        element = group["element"][()]
        vertices = group["vertices"][()]
        name = str(group.attrs["name"])
        polygons = None
        if "polygons" in group:
            polygons = _read_polygons(group["polygons"])
            polygons.check(len(vertices), f"surface {name!r}")
        surfaces[name] = BoundSurface(
            vertices,
            group["faces"][()],
            element,
            group["local"][()],
            elements[element],
            follow=group["follow"][()] if "follow" in group else None,
            polygons=polygons,
            voxel=voxel,
        )
    return surfaces


def _write_polygons(polygons: Polygons, group: h5py.Group) -> None:
    group.attrs["n_normals"] = polygons.n_normals
    group.attrs["library"] = polygons.library
    for key in ("sizes", "vertex", "uv", "uv_of", "normal_of"):
        values = getattr(polygons, key)
        if values is not None:
            group.create_dataset(key, data=values, **COMPRESSION)
    for kind, labels in polygons.labels.items():
        part = group.create_group(f"labels/{kind}")
        part.create_dataset("names", data=labels.names, dtype=h5py.string_dtype())
        part.create_dataset("of", data=labels.of, **COMPRESSION)


def _read_polygons(group: h5py.Group) -> Polygons:
    def optional(key: str) -> Any:
        return group[key][()] if key in group else None

    labels = {}
    for kind, part in group["labels"].items() if "labels" in group else ():
        labels[str(kind)] = Labels(list(part["names"].asstr()[()]), part["of"][()])
    return Polygons(
        group["sizes"][()],
        group["vertex"][()],
        uv=optional("uv"),
        uv_of=optional("uv_of"),
        normal_of=optional("normal_of"),
        n_normals=int(group.attrs["n_normals"]),
        labels=labels,
        library=str(group.attrs["library"]),
    )


def write_sliding(sliding: Sliding, file: h5py.Group) -> None:
    """Write sliding nodes and what they slide on; nothing where there are none."""
    if not len(sliding) and not sliding.surfaces:
        return
    group = file.create_group("sliding")
    laws = [key for key in ("friction", "release") if getattr(sliding, key).any()]
    for key in ("nodes", "surface", "distance", *laws):
        group.create_dataset(key, data=getattr(sliding, key), **COMPRESSION)
    for number, surface in enumerate(sliding.surfaces):
        part = group.create_group(f"surfaces/{number}")
        part.attrs["name"] = surface.name
        part.create_dataset("vertices", data=surface.vertices, **COMPRESSION)
        part.create_dataset("faces", data=surface.faces, **COMPRESSION)
        if isinstance(surface.motion, RigidMotion):
            _write_motion(surface.motion, part.create_group("motion"))


def read_sliding(file: h5py.Group, n_nodes: int) -> Sliding:
    """Read what `write_sliding` wrote; raises InputError where it names what is not there."""
    if "sliding" not in file:
        return Sliding()
    group = file["sliding"]
    surfaces = [
        SlidingSurface(
            str(part.attrs["name"]),
            part["vertices"][()],
            part["faces"][()],
            _read_motion(part["motion"]) if "motion" in part else None,
        )
        for part in numbered(group, "surfaces")
    ]
    nodes = group["nodes"][()].astype(np.int64)
    surface = group["surface"][()].astype(np.int32)
    distance = group["distance"][()].astype(np.float64)
    if not len(nodes) == len(surface) == len(distance):
        raise InputError("sliding has nodes, surface and distance of different lengths")
    if len(nodes) and not (
        (nodes[0] >= 0 and nodes[-1] < n_nodes and (np.diff(nodes) > 0).all())
        and (surface.min() >= 0 and surface.max() < len(surfaces))
    ):
        raise InputError("sliding names a node or a surface that is not there")
    friction = group["friction"][()] if "friction" in group else np.zeros(len(nodes))
    release = group["release"][()] if "release" in group else np.zeros(len(nodes))
    if not len(nodes) == len(friction) == len(release):
        raise InputError("sliding has nodes, friction and release of different lengths")
    return Sliding(nodes, surface, distance, surfaces, friction, release.astype(bool))


def _write_motion(motion: RigidMotion, group: h5py.Group) -> None:
    for key in ("about", "axis", "angle", "shift"):
        group.attrs[key] = getattr(motion, key)
    write_schedule(as_schedule(motion.share), group.create_group("share"))


def _read_motion(group: h5py.Group) -> RigidMotion:
    values = {key: group.attrs[key] for key in ("about", "axis", "shift")}
    share = read_schedule(group["share"])
    if share is None:
        raise InputError("sliding has a motion without its share over time")
    return RigidMotion(**values, angle=float(group.attrs["angle"]), share=share)


def write_groups(groups: Sequence[NodeGroup], file: h5py.Group) -> None:
    """Write which nodes are bound by what."""
    for number, named in enumerate(groups):
        group = file.create_group(f"groups/{number}")
        group.attrs["kind"] = named.kind
        group.attrs["name"] = named.name
        group.create_dataset("nodes", data=named.nodes, **COMPRESSION)


def read_groups(file: h5py.Group, n_nodes: int) -> list[NodeGroup]:
    """Read what `write_groups` wrote; raises InputError where it names what is not there."""
    groups = []
    for group in numbered(file, "groups"):
        nodes = group["nodes"][()].astype(np.int64)
        kind, name = str(group.attrs["kind"]), str(group.attrs["name"])
        if kind not in GROUP_KINDS:
            raise InputError(f"group {name!r} is of kind {kind!r}, known: {', '.join(GROUP_KINDS)}")
        if len(nodes) and (nodes.min() < 0 or nodes.max() >= n_nodes):
            raise InputError(f"group {name!r} names node {nodes.max()} of {n_nodes}")
        groups.append(NodeGroup(kind, name, nodes))
    return groups
