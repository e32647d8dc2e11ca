"""Nodes that slide on surfaces at the distance they start with, and why nodes are held at all."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface.errors import InputError
from tledface.motion import Motion

if TYPE_CHECKING:
    import trimesh

__all__ = [
    "GROUP_KINDS",
    "NodeGroup",
    "Sliding",
    "SlidingSurface",
    "tangential",
]

Floats = NDArray[np.float64]

# Of a triangle's longest side squared: less of twice its area is rounding.
_NO_AREA = 1e-12
# Of its farthest coordinate: in single precision a height of less, 64 units of its last place, is
# rounding. What is nearest on such a triangle is then anywhere along it.
_NO_HEIGHT = 2.0**-18
# Layers of slivers that a rim is freed of.
_LAYERS = 2

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
        motion: Pose of time, see `Model.move_surface`; None: it stands still.
    """

    name: str
    vertices: Floats
    faces: NDArray[np.int32]
    motion: Motion | None = None

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
        # Triangles without area are none for the solver, so distances must not be to them either:
        # at an open rim nothing else is there.
        triangles = triangles[_has_area(welded[triangles])]
        if not len(triangles):
            raise InputError(f"slide: surface {name!r} has no triangle of any area; give another")
        return cls(name, welded, triangles)

    @property
    def is_open(self) -> bool:
        """Whether a side belongs to one triangle only."""
        return bool((_side_counts(self.faces)[1] == 1).any())

    def without_slivers(self, centre: Floats, tolerance: float) -> SlidingSurface:
        """The surface without triangles at its open rim that are next to nothing.

        Which side of the surface a node beyond the rim is on is for the triangle there to say,
        and where that is a sliver rounding says it. Left out are those that lie all within
        ``tolerance`` (m) of a side that they share with another, so that the surface does not
        move by more, and those whose height single precision does not tell from 0, as if they
        had no area.

        Args:
            centre: (3,) m, what positions are counted from.
            tolerance: m.
        """
        corners = self.vertices[self.faces]
        height = _heights(corners)
        least = _NO_HEIGHT * np.abs(corners - centre).max(axis=(1, 2))
        thin = np.flatnonzero(height.min(axis=1) <= np.maximum(tolerance, least))
        if not len(thin):
            return self
        sides, count = _side_counts(self.faces)
        left = np.ones(len(self.faces), dtype=bool)
        for _ in range(_LAYERS):
            for face in thin[left[thin] & (count[sides[thin]] == 1).any(axis=1)]:
                along = (count[sides[face]] > 1) & _stays_beside(corners[face], tolerance)
                if height[face].min() <= least[face] or along.any():
                    left[face] = False
                    count[sides[face]] -= 1
        if not left.any():
            raise InputError(
                f"slide: surface {self.name!r} has no triangle of any area; give another"
            )
        return replace(self, faces=self.faces[left])


def _has_area(corners: Floats) -> NDArray[np.bool_]:
    """Which triangles (n, 3, 3) have an area, but for rounding."""
    sides = corners[:, (1, 2, 0)] - corners
    double_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.asarray(double_area > _NO_AREA * (sides**2).sum(axis=2).max(axis=1))


def _heights(corners: Floats) -> Floats:
    """Heights (n, 3) of triangles (n, 3, 3) over their sides, each from one corner to the next."""
    sides = corners[:, (1, 2, 0)] - corners
    double_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.asarray(double_area[:, None] / np.linalg.norm(sides, axis=2))


def _stays_beside(corners: Floats, tolerance: float) -> NDArray[np.bool_]:
    """For each side of a triangle (3, 3): whether the third corner is that near to it."""
    near = np.empty(3, dtype=bool)
    for k in range(3):
        begin, end, third = corners[k], corners[k - 2], corners[k - 1]
        along = end - begin
        share = np.clip((third - begin) @ along / (along @ along), 0.0, 1.0)
        near[k] = np.linalg.norm(third - begin - share * along) <= tolerance
    return near


def _side_counts(faces: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The number (n, 3) of each side of triangles, and of how many triangles each is a side."""
    ends = np.sort(np.stack([faces, faces[:, (1, 2, 0)]], axis=2), axis=2).astype(np.int64)
    keys = ends[..., 0] * (int(faces.max(initial=0)) + 1) + ends[..., 1]
    _, sides, count = np.unique(keys, return_inverse=True, return_counts=True)
    return sides.reshape(-1, 3), count


@dataclass(frozen=True, eq=False)
class Sliding:
    """All sliding nodes of a model, each on one surface.

    Attributes:
        nodes: (n,) int64, rising.
        surface: (n,) int32, index into ``surfaces``.
        distance: (n,) float64, m, to the surface at rest; negative behind it.
        surfaces: What they slide on.
        friction: (n,) float64, coefficients.
        release: (n,) bool, whether the node may leave its surface.
    """

    nodes: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    surface: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    distance: Floats = field(default_factory=lambda: np.empty(0))
    surfaces: list[SlidingSurface] = field(default_factory=list)
    friction: Floats = field(default_factory=lambda: np.empty(0))
    release: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))

    def __post_init__(self) -> None:
        """Fill in that nothing rubs or lets go where that was not said."""
        for name, plain in (("friction", 0.0), ("release", False)):
            if len(getattr(self, name)) != len(self.nodes):
                object.__setattr__(self, name, np.full(len(self.nodes), plain))

    @property
    def moving(self) -> list[int]:
        """The surfaces that move."""
        return [n for n, surface in enumerate(self.surfaces) if surface.motion is not None]

    def __len__(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    def without(self, nodes: ArrayLike) -> Sliding:
        """The same without some nodes; surfaces stay."""
        keep = ~np.isin(self.nodes, np.asarray(nodes))
        if keep.all():
            return self
        return replace(
            self,
            **{
                name: getattr(self, name)[keep]
                for name in ("nodes", "surface", "distance", "friction", "release")
            },
        )

    def having(
        self,
        nodes: ArrayLike,
        distance: ArrayLike,
        surface: SlidingSurface,
        *,
        friction: float = 0.0,
        release: bool = False,
    ) -> Sliding:
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
        rubs = np.concatenate([rest.friction, np.full(len(added), float(friction))])
        lets_go = np.concatenate([rest.release, np.full(len(added), bool(release))])
        return Sliding(joined[order], on[order], far[order], surfaces, rubs[order], lets_go[order])

    def with_motion(self, name: str, motion: Motion) -> Sliding:
        """The same with the motion of a surface; raises InputError where there is none."""
        known = [surface.name for surface in self.surfaces]
        if name not in known:
            there = ", ".join(map(repr, known)) if known else "none"
            raise InputError(f"move_surface: got {name!r}; surfaces that nodes slide on: {there}")
        surfaces = list(self.surfaces)
        index = known.index(name)
        surfaces[index] = replace(surfaces[index], motion=motion)
        return replace(self, surfaces=surfaces)


def tangential(forces: Floats, sliding: Sliding, normals: Floats) -> Floats:
    """Forces less what the surfaces take of them.

    That is their part along the normals of sliding nodes and, where they rub, of the rest as much
    as friction can hold.

    Args:
        forces: (n_nodes, 3) N.
        sliding: The n sliding nodes.
        normals: (n, 3) unit normals, or zero.
    """
    if not len(sliding):
        return forces
    result = forces.copy()
    part = result[sliding.nodes]
    pressing = (part * normals).sum(axis=1, keepdims=True)
    along = part - normals * pressing
    if sliding.friction.any():
        size = np.linalg.norm(along, axis=1, keepdims=True)
        held = sliding.friction[:, None] * abs(pressing)
        along *= 1.0 - np.minimum(held / np.maximum(size, np.finfo(float).tiny), 1.0)
    result[sliding.nodes] = along
    return result
