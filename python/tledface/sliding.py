"""Nodes that slide on surfaces at the distance they start with, and why nodes are held at all."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface.errors import InputError

__all__ = [
    "GROUP_KINDS",
    "NodeGroup",
    "Sliding",
    "SlidingSurface",
    "tangential",
]

Floats = NDArray[np.float64]

# In the order in which they take precedence.
GROUP_KINDS = ("fixed", "cut", "attachment", "ligament", "symmetry", "sliding")


@dataclass(frozen=True, eq=False)
class NodeGroup:
    """Nodes that one entry of a scene's ``[boundary]`` binds; a node may be in several.

    ``kind`` is one of ``GROUP_KINDS``, ``nodes`` (n,) int64 rise.
    """

    kind: str
    name: str
    nodes: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SlidingSurface:
    """A triangle surface that nodes slide on; equal vertices are merged.

    Attributes:
        name: Distinct among a model's sliding surfaces.
        vertices: (nv, 3) float64, m, in the model's frame.
        faces: (nf, 3) int32; distances count positive on the side that sees them
            counter-clockwise.
    """

    name: str
    vertices: Floats
    faces: NDArray[np.int32]

    @classmethod
    def of(cls, name: str, surface: trimesh.Trimesh) -> SlidingSurface:
        """Check and weld a mesh; it may be open.

        Raises:
            InputError: no mesh, no triangles, or a vertex that is not finite.
        """
        vertices = np.asarray(getattr(surface, "vertices", None), dtype=np.float64)
        faces = np.asarray(getattr(surface, "faces", None))
        if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
            raise InputError(
                f"slide: surface {name!r} is {type(surface).__name__}; allowed: a trimesh.Trimesh "
                "with vertices (nv, 3) in m and faces (nf, 3)"
            )
        if not np.isfinite(vertices).all():
            raise InputError(f"slide: surface {name!r} has vertices that are not finite; repair it")
        welded, triangles = _core.weld(vertices, faces)
        if not len(triangles):
            raise InputError(f"slide: surface {name!r} has no triangle of any area; give another")
        return cls(name, welded, triangles)


@dataclass(frozen=True, eq=False)
class Sliding:
    """All sliding nodes of a model, each on one surface.

    Attributes:
        nodes: (n,) int64, rising.
        surface: (n,) int32, index into ``surfaces``.
        distance: (n,) float64, m, to the surface at rest; negative behind it.
        surfaces: What they slide on.
    """

    nodes: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    surface: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    distance: Floats = field(default_factory=lambda: np.empty(0))
    surfaces: list[SlidingSurface] = field(default_factory=list)

    def __len__(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    def without(self, nodes: ArrayLike) -> Sliding:
        """The same without some nodes; surfaces stay."""
        keep = ~np.isin(self.nodes, np.asarray(nodes))
        if keep.all():
            return self
        return Sliding(self.nodes[keep], self.surface[keep], self.distance[keep], self.surfaces)

    def having(self, nodes: ArrayLike, distance: ArrayLike, surface: SlidingSurface) -> Sliding:
        """The same with more nodes on a surface; nodes that slid elsewhere change over.

        Raises:
            InputError: another surface has that name.
        """
        index = next((n for n, s in enumerate(self.surfaces) if s.name == surface.name), None)
        surfaces = list(self.surfaces)
        if index is None:
            index = len(surfaces)
            surfaces.append(surface)
        elif not (
            np.array_equal(surfaces[index].vertices, surface.vertices)
            and np.array_equal(surfaces[index].faces, surface.faces)
        ):
            raise InputError(
                f"slide: the model has another surface {surface.name!r}; choose another name"
            )
        added = np.asarray(nodes, dtype=np.int64)
        rest = self.without(added)
        joined = np.concatenate([rest.nodes, added])
        order = np.argsort(joined, kind="stable")
        on = np.concatenate([rest.surface, np.full(len(added), index, dtype=np.int32)])
        far = np.concatenate([rest.distance, np.asarray(distance, dtype=np.float64)])
        return Sliding(joined[order], on[order], far[order], surfaces)


def tangential(forces: Floats, nodes: NDArray[np.int64], normals: Floats) -> Floats:
    """Forces less what the surfaces take: their part along the normals of sliding nodes.

    Args:
        forces: (n_nodes, 3) N.
        nodes: (n,) the sliding nodes.
        normals: (n, 3) unit normals, or zero.
    """
    if not len(nodes):
        return forces
    result = forces.copy()
    part = result[nodes]
    result[nodes] = part - normals * (part * normals).sum(axis=1, keepdims=True)
    return result
