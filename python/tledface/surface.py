"""Surfaces bound to a voxel model: binding by nearest element, motion by trilinear interpolation.

A vertex holds the index of its element and its trilinear coordinates there, 0 to 1 across the
element. Corner order is the VTK hexahedron's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["HEX_CORNERS", "BoundSurface", "bind", "boundary_surface"]

HEX_CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
    dtype=np.int32,
)

# Local corners of the face in direction -x, +x, -y, ...; counter-clockwise seen from outside.
_FACE_CORNERS = np.array(
    [[0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 3, 2, 1], [4, 5, 6, 7]],
)
_FACE_STEPS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])

# A vertex further outside its element than this (in voxels) moves as the point at this distance:
# trilinear extrapolation grows with the cube of the distance.
_EXTRAPOLATION_LIMIT = 1.0
_BIND_CHUNK = 4096


class BoundSurface:
    """A triangle surface that follows the displacement of a voxel model.

    Attributes:
        vertices: (nv, 3) float64, m, rest positions in the model's frame.
        faces: (nf, 3) int32, counter-clockwise seen from outside.
        element: (nv,) int32, index of the element that carries each vertex.
        local: (nv, 3) float64, trilinear coordinates in that element, 0 to 1 inside.
        corner_nodes: (nv, 8) int32, the nodes of that element.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        element: ArrayLike,
        local: ArrayLike,
        corner_nodes: ArrayLike,
    ) -> None:
        """Hold a known binding; `BoundSurface.on` finds one."""
        self.vertices: NDArray[np.float64] = np.ascontiguousarray(vertices, dtype=np.float64)
        self.faces: NDArray[np.int32] = np.ascontiguousarray(faces, dtype=np.int32)
        self.element: NDArray[np.int32] = np.ascontiguousarray(element, dtype=np.int32)
        self.local: NDArray[np.float64] = np.ascontiguousarray(local, dtype=np.float64)
        self.corner_nodes: NDArray[np.int32] = np.ascontiguousarray(corner_nodes, dtype=np.int32)
        self._weights = _trilinear_weights(self.local)

    @classmethod
    def on(cls, model: Model, vertices: ArrayLike, faces: ArrayLike) -> BoundSurface:
        """Bind a surface to the nearest elements of a model.

        Args:
            model: The model that will carry the surface.
            vertices: (nv, 3) float, m, in the model's frame.
            faces: (nf, 3) int.

        Raises:
            InputError: wrong shapes, a coordinate that is not finite, a face without its vertex.
        """
        points = _checked_points(vertices)
        triangles = np.asarray(faces)
        if triangles.ndim != 2 or triangles.shape[1:] != (3,) or triangles.dtype.kind not in "iu":
            raise InputError(
                f"surface faces: got shape {triangles.shape} of {triangles.dtype}, need (n, 3) "
                "integers; triangulate the surface first"
            )
        if triangles.size and (triangles.min() < 0 or triangles.max() >= len(points)):
            raise InputError(
                f"surface faces: vertex index {triangles.min()} to {triangles.max()} found, "
                f"allowed 0 to {len(points) - 1}"
            )
        element, local, _ = bind(points, model)
        return cls(points, triangles, element, local, model.elements[element])

    def interpolate(self, field: ArrayLike) -> NDArray[np.float64]:
        """Interpolate a nodal vector field, (n_nodes, 3), to the vertices, (nv, 3)."""
        values = np.asarray(field)
        if values.ndim != 2 or values.shape[1] != 3:
            raise InputError(f"nodal field: got shape {values.shape}, need (n_nodes, 3)")
        if self.corner_nodes.size and self.corner_nodes.max() >= len(values):
            raise InputError(
                f"nodal field: {len(values)} rows, the surface is bound to node "
                f"{self.corner_nodes.max()}; pass the field of the model it was bound to"
            )
        result = np.zeros_like(self.vertices)
        for corner in range(8):
            nodes = self.corner_nodes[:, corner]
            result += self._weights[:, corner, None] * values.take(nodes, axis=0)
        return result

    def displaced(self, u: ArrayLike) -> NDArray[np.float64]:
        """Return the vertices moved by a displacement.

        Args:
            u: (n_nodes, 3) float, m.

        Returns:
            (nv, 3) m; exactly the rest positions where ``u`` is zero.
        """
        return self.vertices + self.interpolate(u)


def bind(
    vertices: ArrayLike, model: Model
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Find the element nearest to each point and the point's trilinear coordinates in it.

    Args:
        vertices: (n, 3) float, m, in the model's frame.
        model: The voxel model.

    Returns:
        element (n,) int32, the nearest element and the lowest index among equally near ones;
        local (n, 3), beyond 0 to 1 where the point lies outside the element;
        distance (n,) m, from the point to the element, 0 inside.

    Raises:
        InputError: wrong shape or a coordinate that is not finite.

    A branch and bound over an octree of the occupied voxels, exact at any distance.
    """
    points = _checked_points(vertices)
    if model.is_conforming:
        raise InputError(
            "bind: surfaces can be bound to voxel models only; a conforming mesh carries its own "
            "boundary, surfaces['surface']"
        )
    origin, voxel = model.origin, model.voxel
    levels, order = _octree(model.cells)
    element = np.empty(len(points), dtype=np.int32)
    distance = np.empty(len(points))
    grid = (points - origin) / voxel
    for start in range(0, len(points), _BIND_CHUNK):
        part = slice(start, start + _BIND_CHUNK)
        element[part], distance[part] = _nearest_cells(grid[part], levels, order, voxel)
    local = grid - model.cells[element]
    return element, local, distance


def boundary_surface(model: Model) -> BoundSurface:
    """Return the outer boundary of the voxels as triangles, normals outwards.

    Each exposed voxel face gives two triangles; vertices are the model's nodes, shared between
    the faces that meet there.
    """
    codes = _boundary_codes(model)
    nodes = model.elements.reshape(-1)[codes]
    used, first, inverse = np.unique(nodes, return_index=True, return_inverse=True)
    code = codes.reshape(-1)[first]
    quad = inverse.reshape(-1, 4)
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    element, local = code // 8, HEX_CORNERS[code % 8].astype(np.float64)
    return BoundSurface(model.nodes[used], faces, element, local, model.elements[element])


def boundary_faces(model: Model) -> NDArray[np.int32]:
    """Return the exposed voxel faces, (n, 4) node indices, counter-clockwise from outside."""
    return np.ascontiguousarray(model.elements.reshape(-1)[_boundary_codes(model)])


def _boundary_codes(model: Model) -> NDArray[np.int64]:
    """Corners of the exposed voxel faces, (n, 4), as codes element * 8 + corner.

    Codes rather than nodes, so that a vertex knows an element that carries it.
    """
    if model.is_conforming:
        return _mesh_boundary_codes(model.elements)
    cells = model.cells.astype(np.int64)
    extent = cells.max(axis=0) + 3
    key = _pack(cells + 1, extent)
    occupied = np.sort(key)
    quads, owners = [], []
    for corners, step in zip(_FACE_CORNERS, _FACE_STEPS, strict=True):
        neighbour = key + _pack(step, extent)
        slot = np.minimum(np.searchsorted(occupied, neighbour), len(occupied) - 1)
        owner = np.flatnonzero(occupied[slot] != neighbour)
        quads.append(np.stack([owner * 8 + corner for corner in corners], axis=1))
        owners.append(owner)
    return np.concatenate(quads)


def _mesh_boundary_codes(elements: NDArray[np.int32]) -> NDArray[np.int64]:
    """The same of a conforming mesh: faces whose four nodes no other face has."""
    codes = np.arange(len(elements))[:, None, None] * 8 + _FACE_CORNERS
    quads = codes.reshape(-1, 4)
    nodes = np.sort(elements.reshape(-1)[quads], axis=1)
    _, inverse, count = np.unique(nodes, axis=0, return_inverse=True, return_counts=True)
    outer: NDArray[np.int64] = quads[count[inverse.reshape(-1)] == 1]
    return outer


def _checked_points(vertices: ArrayLike) -> NDArray[np.float64]:
    points = np.asarray(vertices, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"surface vertices: got shape {points.shape}, need (n, 3)")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise InputError(
            f"surface vertices: vertex {int(np.argmin(finite))} is not finite "
            f"({np.count_nonzero(~finite)} such of {len(points)}); repair the mesh"
        )
    return points


def _pack(cells: NDArray[np.int64], extent: NDArray[np.int64]) -> NDArray[np.int64]:
    key: NDArray[np.int64] = cells[..., 0] + extent[0] * (cells[..., 1] + extent[1] * cells[..., 2])
    return key


def _trilinear_weights(local: NDArray[np.float64]) -> NDArray[np.float64]:
    limit = _EXTRAPOLATION_LIMIT
    clamped = np.clip(local, -limit, 1.0 + limit)
    factors = np.stack([1.0 - clamped, clamped])
    weights = np.empty((len(local), 8))
    for corner, (i, j, k) in enumerate(HEX_CORNERS):
        weights[:, corner] = factors[i, :, 0] * factors[j, :, 1] * factors[k, :, 2]
    return weights


def _spread_bits(value: NDArray[np.int64]) -> NDArray[np.int64]:
    """Put two zero bits after each of the low 21 bits."""
    value = value & 0x1FFFFF
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        value = (value | (value << shift)) & mask
    return value


_Level = tuple[NDArray[np.int32], NDArray[np.int64]]


def _octree(cells: NDArray[np.int32]) -> tuple[list[_Level], NDArray[np.int64]]:
    """Blocks of the occupied voxels, coarse to fine, and the Morton order of the elements.

    A level is (blocks (n, 3) in units of its own size, first child of each and the end (n + 1,)).
    The children of a block follow one another because everything is in Morton order; the
    children of the finest blocks are the elements in that order.
    """
    wide = cells.astype(np.int64)
    morton = (
        _spread_bits(wide[:, 0]) | (_spread_bits(wide[:, 1]) << 1) | (_spread_bits(wide[:, 2]) << 2)
    )
    order = np.argsort(morton, kind="stable")
    code = morton[order]
    blocks = cells[order]
    levels: list[_Level] = [(blocks, np.empty(0, dtype=np.int64))]
    # At least one level above the cells, so that a single cell is no special case.
    while len(blocks) > 1 or len(levels) == 1:
        code = code >> 3
        first = np.flatnonzero(np.concatenate([[True], code[1:] != code[:-1]]))
        ends = np.append(first, len(code))
        code = code[first]
        blocks = blocks[first] >> 1
        levels.append((blocks, ends))
    return levels[::-1], order


def _nearest_cells(
    grid: NDArray[np.float64],
    levels: list[_Level],
    order: NDArray[np.int64],
    voxel: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    n_points = len(grid)
    everyone = np.arange(n_points)

    def children(
        depth: int, point: NDArray[np.int64], block: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Pairs of a point and a child of its block, and their squared distance."""
        ends = levels[depth - 1][1]
        count = ends[block + 1] - ends[block]
        shift = np.repeat(ends[block] - (np.cumsum(count) - count), count)
        point = np.repeat(point, count)
        block = np.arange(len(point)) + shift
        size = 1 << (len(levels) - 1 - depth)
        outside = levels[depth][0][block] * size - grid[point]
        np.maximum(outside, -outside - size, out=outside)
        np.maximum(outside, 0.0, out=outside)
        outside *= voxel
        return point, block, np.einsum("ij,ij->i", outside, outside)

    # A greedy descent gives a close upper bound, which leaves few candidates to the exact pass.
    block = np.zeros(n_points, dtype=np.int64)
    for depth in range(1, len(levels)):
        point, child, near = children(depth, everyone, block)
        starts = np.searchsorted(point, everyone)
        bound = np.minimum.reduceat(near, starts)
        block = np.minimum.reduceat(np.where(near == bound[point], child, len(order)), starts)
    point, block = everyone, np.zeros(n_points, dtype=np.int64)
    for depth in range(1, len(levels)):
        point, block, near = children(depth, point, block)
        keep = near <= bound[point]
        point, block, near = point[keep], block[keep], near[keep]
    starts = np.searchsorted(point, everyone)
    nearest = np.minimum.reduceat(near, starts)
    candidate = np.where(near == nearest[point], order[block], len(order))
    return np.minimum.reduceat(candidate, starts), np.sqrt(nearest)
