"""Surfaces bound to a voxel model: binding by nearest element, motion by trilinear interpolation.

A vertex holds the index of its element and its trilinear coordinates there, 0 to 1 across the
element. Corner order is the VTK hexahedron's. A vertex outside goes with the nearest place of its
element: by the displacement there and on along its gradient, of which more than so much strain is
not believed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface._model_checks import checked_faces, checked_points
from tledface.errors import InputError
from tledface.polygons import Polygons

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

# A vertex further outside its element than this (in voxels) moves as the point at this distance.
_EXTRAPOLATION_LIMIT = 1.0

# What lies outside an element is strained at most this much (Frobenius norm of F - R), and turned
# with it as far as it is turned. A voxel at a free edge may be sheared to several times its length:
# skin a voxel away from it, moved by all of that, is drawn out into a spike.
_STRAIN_LIMIT = 1.0

# Vertices whose gradients are at hand at a time.
_CHUNK = 65536

# Ends of an element's edges along each axis.
_EDGES = ((0, 3, 4, 7), (1, 2, 5, 6)), ((0, 1, 4, 5), (3, 2, 7, 6)), ((0, 1, 2, 3), (4, 5, 6, 7))


class BoundSurface:
    """A surface that follows the displacement of a voxel model, vertex for vertex.

    Attributes:
        vertices: (nv, 3) float64, m, rest positions in the model's frame.
        faces: (nf, 3) int32, counter-clockwise seen from outside: ``polygons`` as triangles.
        element: (nv,) int32, index of the element that carries each vertex.
        local: (nv, 3) float64, trilinear coordinates in that element, 0 to 1 inside.
        corner_nodes: (nv, 8) int32, the nodes of that element.
        follow: (nv,) float64, the share of the displacement that each vertex takes: 1, and less
            to 0 (it stays at rest) beyond ``reach``; or None, all take it.
        polygons: The faces as the surface's file has them.
        voxel: (3,) m, sides of the elements; None where no vertex lies outside its element.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        element: ArrayLike,
        local: ArrayLike,
        corner_nodes: ArrayLike,
        *,
        follow: ArrayLike | None = None,
        polygons: Polygons | None = None,
        voxel: ArrayLike | None = None,
    ) -> None:
        """Hold a known binding; `BoundSurface.on` finds one."""
        self.vertices: NDArray[np.float64] = np.ascontiguousarray(vertices, dtype=np.float64)
        self.faces: NDArray[np.int32] = np.ascontiguousarray(faces, dtype=np.int32)
        self.element: NDArray[np.int32] = np.ascontiguousarray(element, dtype=np.int32)
        self.local: NDArray[np.float64] = np.ascontiguousarray(local, dtype=np.float64)
        self.corner_nodes: NDArray[np.int32] = np.ascontiguousarray(corner_nodes, dtype=np.int32)
        self.follow: NDArray[np.float64] | None = (
            None if follow is None else np.ascontiguousarray(follow, dtype=np.float64)
        )
        self.polygons: Polygons = (
            Polygons.of_triangles(self.faces) if polygons is None else polygons
        )
        self.voxel: NDArray[np.float64] | None = (
            None if voxel is None else np.asarray(voxel, dtype=np.float64)
        )
        self._weights = _weights(self.local)
        self._outside = np.flatnonzero(((self.local < 0.0) | (self.local > 1.0)).any(axis=1))
        if self._outside.size and self.voxel is None:
            raise InputError(
                f"surface: vertex {self._outside[0]} lies outside its element and voxel is None; "
                "give the sides of the elements"
            )
        # The elements of those outside, each once, and whose each vertex is.
        _, first, self._carrier = np.unique(
            self.element[self._outside], return_index=True, return_inverse=True
        )
        self._carrying = self.corner_nodes[self._outside[first]]

    @classmethod
    def on(
        cls,
        model: Model,
        vertices: ArrayLike,
        faces: ArrayLike | Polygons,
        *,
        reach: float | None = None,
        fade: float = 0.0,
    ) -> BoundSurface:
        """Bind a surface to the nearest elements of a model; all vertices keep their order.

        Args:
            model: The model that will carry the surface.
            vertices: (nv, 3) float, m, in the model's frame.
            faces: (nf, 3) int, or polygons.
            reach: Vertices farther than this (m) from any voxel stay at rest; None: none do.
            fade: Over this length (m) beyond ``reach`` the displacement fades out instead.

        Raises:
            InputError: wrong shapes, a coordinate that is not finite, a face without its vertex.

        Example: ``model.surfaces["mask"] = BoundSurface.on(model, mesh.vertices, mesh.faces)``.
        """
        points = checked_points("surface", vertices)
        if isinstance(faces, Polygons):
            faces.check(len(points), "surface faces")
            polygons, given = faces, np.asarray(faces.triangles())
        else:
            polygons, given = None, np.asarray(faces)
        triangles = checked_faces("surface", given, len(points), none=True)
        element, local, distance = bind(points, model)
        follow = None if reach is None else _follow(distance, reach, fade)
        if follow is not None and (follow == 1.0).all():
            follow = None
        corners = model.elements[element]
        return cls(
            points,
            triangles,
            element,
            local,
            corners,
            follow=follow,
            polygons=polygons,
            voxel=model.voxel,
        )

    @property
    def bound(self) -> NDArray[np.bool_]:
        """(nv,) whether a vertex moves with the voxels at all."""
        if self.follow is None:
            return np.ones(len(self.vertices), dtype=bool)
        return self.follow > 0.0

    def distance(self, voxel: ArrayLike) -> NDArray[np.float64]:
        """How far each vertex lies from its element at rest, (nv,) m, 0 inside; voxel (3,) m."""
        outside = np.maximum(np.maximum(-self.local, self.local - 1.0), 0.0) * np.asarray(voxel)
        squared: NDArray[np.float64] = np.einsum("ij,ij->i", outside, outside)
        return np.sqrt(squared)

    @property
    def bound_faces(self) -> NDArray[np.int32]:
        """Those of ``faces`` whose vertices all move with the voxels."""
        if self.follow is None:
            return self.faces
        return np.ascontiguousarray(self.faces[self.bound[self.faces].all(axis=1)])

    def interpolate(self, field: ArrayLike) -> NDArray[np.float64]:
        """Interpolate a nodal vector field, (n_nodes, 3), to the vertices, (nv, 3).

        Outside its element a vertex has the value of the nearest place in it, and what the gradient
        there adds.

        Raises:
            InputError: another shape, or fewer nodes than the surface is bound to.
        """
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

    def of_elements(self, field: ArrayLike) -> NDArray[np.float64]:
        """Carry a field of the elements to the vertices.

        Args:
            field: (n_elem,) float, in the order of the model that the surface is bound to.

        Returns:
            (nv,), NaN for vertices that stay at rest. The mean over those elements that carry a
            vertex and meet at a node, interpolated from the nodes to the vertex: smooth along the
            surface, and only of what lies right under it.

        Raises:
            InputError: another shape, or fewer elements than the surface is bound to.
        """
        values = np.asarray(field, dtype=np.float64)
        if values.ndim != 1 or (self.element.size and self.element.max() >= len(values)):
            raise InputError(
                f"element field: got shape {values.shape}, need (n_elem,), more than the element "
                f"{self.element.max(initial=0)} that the surface is bound to"
            )
        carrying, first = np.unique(self.element, return_index=True)
        nodes = self.corner_nodes[first]
        total = np.bincount(nodes.reshape(-1), np.repeat(values[carrying], 8))
        at_nodes = total / np.maximum(np.bincount(nodes.reshape(-1)), 1)
        # A vertex outside its element has the value of the nearest point in it.
        weights = _weights(np.clip(self.local, 0.0, 1.0))
        result: NDArray[np.float64] = (weights * at_nodes[self.corner_nodes]).sum(axis=1)
        result[~self.bound] = np.nan
        return result

    def displaced(self, u: ArrayLike) -> NDArray[np.float64]:
        """Return the vertices moved by a displacement.

        Args:
            u: (n_nodes, 3) float, m.

        Returns:
            (nv, 3) m; exactly the rest positions where ``u`` is zero.

        Raises:
            InputError: another shape, or fewer nodes than the surface is bound to.
        """
        moved = self.interpolate(u)
        if self._outside.size:
            much = self._outside[self._may_be_strained(np.asarray(u))[self._carrier]]
            for begin in range(0, len(much), _CHUNK):
                chosen = much[begin : begin + _CHUNK]
                moved[chosen] -= self._disbelieved(np.asarray(u), chosen)
        if self.follow is not None:
            moved *= self.follow[:, None]
        moved += self.vertices
        return moved

    def _may_be_strained(self, u: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Of each carrying element whether its gradient may be too much anywhere in it."""
        assert self.voxel is not None
        at = u[self._carrying]
        square = np.zeros(len(at))
        for axis, (low, high) in enumerate(_EDGES):
            # The gradient along an axis is a mean of the four edges'.
            edges = ((at[:, high] - at[:, low]) ** 2).sum(axis=2)
            square += edges.max(axis=1) / self.voxel[axis] ** 2
        may_be: NDArray[np.bool_] = square > _STRAIN_LIMIT**2
        return may_be

    def _disbelieved(
        self, u: NDArray[np.floating], chosen: NDArray[np.integer]
    ) -> NDArray[np.float64]:
        """What too much strain adds to the displacement of vertices outside their elements, m."""
        assert self.voxel is not None
        local = self.local[chosen]
        slopes = _slopes(np.clip(local, 0.0, 1.0)) / self.voxel
        way = _beyond(local) * self.voxel
        gradient = np.matmul(u[self.corner_nodes[chosen]].transpose(0, 2, 1), slopes)
        result = np.zeros_like(way)
        # The nearest rotation is no farther off than the identity: nothing else can be too much.
        much = np.flatnonzero((gradient**2).sum(axis=(1, 2)) > _STRAIN_LIMIT**2)
        if much.size == 0:
            return result
        deformation = gradient[much] + np.eye(3)
        finite = np.isfinite(deformation).all(axis=(1, 2))
        much, deformation = much[finite], deformation[finite]
        strain = deformation - _rotations(deformation)
        norm = np.sqrt((strain**2).sum(axis=(1, 2)))
        too_much = np.maximum(0.0, 1.0 - _STRAIN_LIMIT / np.maximum(norm, _STRAIN_LIMIT))
        result[much] = too_much[:, None] * np.einsum("nij,nj->ni", strain, way[much])
        return result


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
    points = checked_points("surface", vertices)
    if model.is_conforming:
        raise InputError(
            "bind: surfaces can be bound to voxel models only; a conforming mesh carries its own "
            "boundary, surfaces['surface']"
        )
    grid = (points - model.origin) / model.voxel
    element, distance = _core.nearest_cells(model.cells, model.voxel.tolist(), grid)
    return element, grid - model.cells[element], distance


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
    if model.is_conforming:
        return _mesh_boundary_codes(model.elements)
    return exposed_corners(model.cells)


def exposed_corners(occupied_cells: NDArray[np.int32]) -> NDArray[np.int64]:
    """Corners of the exposed faces of cells (m, 3): (n, 4) codes, cell * 8 + corner.

    Counter-clockwise from outside. Codes rather than nodes, so that a vertex knows a cell that
    carries it.
    """
    cells = occupied_cells.astype(np.int64)
    extent = cells.max(axis=0) + 3
    key = _pack(cells + 1, extent)
    occupied = np.sort(key)
    quads = []
    for corners, step in zip(_FACE_CORNERS, _FACE_STEPS, strict=True):
        neighbour = key + _pack(step, extent)
        slot = np.minimum(np.searchsorted(occupied, neighbour), len(occupied) - 1)
        owner = np.flatnonzero(occupied[slot] != neighbour)
        quads.append(np.stack([owner * 8 + corner for corner in corners], axis=1))
    return np.concatenate(quads)


def _mesh_boundary_codes(elements: NDArray[np.int32]) -> NDArray[np.int64]:
    """The same of a conforming mesh: faces whose four nodes no other face has."""
    codes = np.arange(len(elements))[:, None, None] * 8 + _FACE_CORNERS
    quads = codes.reshape(-1, 4)
    nodes = np.sort(elements.reshape(-1)[quads], axis=1)
    _, inverse, count = np.unique(nodes, axis=0, return_inverse=True, return_counts=True)
    outer: NDArray[np.int64] = quads[count[inverse.reshape(-1)] == 1]
    return outer


def _pack(cells: NDArray[np.int64], extent: NDArray[np.int64]) -> NDArray[np.int64]:
    key: NDArray[np.int64] = cells[..., 0] + extent[0] * (cells[..., 1] + extent[1] * cells[..., 2])
    return key


def _beyond(local: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far outside the element, of each coordinate, as much of it as counts."""
    limit = _EXTRAPOLATION_LIMIT
    return np.clip(local - np.clip(local, 0.0, 1.0), -limit, limit)


def _weights(local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of each corner, (n, 8): trilinear within the element, linear beyond."""
    inside = np.clip(local, 0.0, 1.0)
    factors = np.stack([1.0 - inside, inside])
    weights = np.empty((len(local), 8))
    for corner, (i, j, k) in enumerate(HEX_CORNERS):
        weights[:, corner] = factors[i, :, 0] * factors[j, :, 1] * factors[k, :, 2]
    beyond = _beyond(local)
    outside = np.flatnonzero(beyond.any(axis=1))
    for begin in range(0, len(outside), _CHUNK):
        chosen = outside[begin : begin + _CHUNK]
        weights[chosen] += np.matmul(_slopes(inside[chosen]), beyond[chosen, :, None])[:, :, 0]
    return weights


def _slopes(inside: NDArray[np.float64]) -> NDArray[np.float64]:
    """Derivatives of the trilinear shares by the coordinates, (n, 8, 3)."""
    factors = np.stack([1.0 - inside, inside])
    slopes = np.empty((len(inside), 8, 3))
    for corner, (i, j, k) in enumerate(HEX_CORNERS):
        slopes[:, corner, 0] = (2 * i - 1) * factors[j, :, 1] * factors[k, :, 2]
        slopes[:, corner, 1] = (2 * j - 1) * factors[i, :, 0] * factors[k, :, 2]
        slopes[:, corner, 2] = (2 * k - 1) * factors[i, :, 0] * factors[j, :, 1]
    return slopes


def _rotations(deformation: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation nearest to each of (n, 3, 3), inverted ones among them."""
    left, _, right = np.linalg.svd(deformation)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    rotation: NDArray[np.float64] = left @ right
    return rotation


def _follow(distance: NDArray[np.float64], reach: float, fade: float) -> NDArray[np.float64]:
    """1 within reach, then down a smooth step to 0 over the length ``fade``."""
    if fade <= 0.0:
        return (distance <= reach).astype(np.float64)
    t = np.clip((distance - reach) / fade, 0.0, 1.0)
    return 1.0 - t * t * (3.0 - 2.0 * t)
