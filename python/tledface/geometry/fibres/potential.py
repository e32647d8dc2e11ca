"""Laplace problems inside a closed surface, on a grid that the surface cuts.

Trilinear elements on the cells of a regular grid; the integrals run over the samples of each cell
that lie inside the surface, so that the cut cells see the true boundary and no staircase (finite
cell method: Parvizian, Düster, Rank, Computational Mechanics 41, 2007). Without a condition the
boundary is natural: the field does not cross the surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from tledface import _core
from tledface.errors import InputError
from tledface.geometry.fibres.surface_points import SurfacePoints, surface_points

__all__ = ["GridField", "MuscleGrid"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Samples along a cell's edge: fractions of cut cells to about 1 %.
_SAMPLES = 4
# Cells across the typical thickness 2 V / A, and how many there may be in all.
_CELLS_ACROSS = 3.0
_MAX_CELLS = 30_000
# The part of a cut cell outside the surface counts this much, so that the value of a node with a
# sliver of muscle is smooth and not noise.
_OUTSIDE = 1e-2
_TOLERANCE = 1e-6
_MAX_ITERATIONS = 20_000
_CELLS_AT_ONCE = 20_000
# Stiffness of a cap against that of the cells next to it.
_CAP_STIFFNESS = 20.0
# A node that stands for less muscle (in cells) sees more of the outside.
_SLIVER = 0.1
# Steps towards the first mode; it only begins what is then made harmonic.
_MODE_STEPS = 8
# Share of the median flow below which a direction is noise.
_FLOWS = 1e-3
# Cells by which a field goes on outside the muscle.
_MARGIN = 3
_CORNERS = np.array([(a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1)])


def _shape_functions(points: Floats) -> tuple[Floats, Floats]:
    """Trilinear shape functions (n, 8) and gradients (n, 8, 3) at points of the unit cell."""
    sides = np.where(_CORNERS[None] == 1, points[:, None], 1.0 - points[:, None])
    slopes = np.where(_CORNERS == 1, 1.0, -1.0)
    gradient = np.stack(
        [slopes[:, axis] * sides[:, :, axis - 1] * sides[:, :, axis - 2] for axis in range(3)],
        axis=2,
    )
    return sides.prod(axis=2), gradient


_AT = (np.stack(np.meshgrid(*[np.arange(_SAMPLES)] * 3, indexing="ij"), axis=-1) + 0.5) / _SAMPLES
_AT = _AT.reshape(-1, 3)
_SHAPE, _GRADIENT = _shape_functions(_AT)
_STIFFNESS = np.einsum("sak,sbk->sab", _GRADIENT, _GRADIENT).reshape(-1, 64)
_MASS = np.einsum("sa,sb->sab", _SHAPE, _SHAPE).reshape(-1, 64)
# Nodal value b -> component k of its gradient, weighted by the shape function of node a.
_RECOVERY = np.einsum("sa,sbk->sabk", _SHAPE, _GRADIENT).reshape(len(_AT), -1)


@dataclass(frozen=True, eq=False)
class GridField:
    """Directions at the nodes of a grid, trilinear between them.

    Attributes:
        origin: (3,) m.
        spacing: m.
        index: (nx, ny, nz) int32 row of ``vectors``, -1 where a node has none.
        vectors: (n, 3) unit vectors.
    """

    origin: Floats
    spacing: float
    index: NDArray[np.int32]
    vectors: Floats

    def directions(self, points: Floats) -> Floats:
        """Unit directions at (n, 3) points, m; outside the grid's nodes that of the nearest."""
        place = (points - self.origin) / self.spacing
        cell = np.clip(np.floor(place).astype(np.int64), 0, np.array(self.index.shape) - 2)
        local = place - cell
        total = np.zeros((len(points), 3))
        known = ((local > -1e-6) & (local < 1.0 + 1e-6)).all(axis=1)
        for corner in _CORNERS:
            rows = self.index[tuple((cell + corner).T)]
            known &= rows >= 0
            weight = np.where(corner == 1, local, 1.0 - local).prod(axis=1)
            total += weight[:, None] * self.vectors[rows]
        length = np.linalg.norm(total, axis=1)
        lost = np.flatnonzero(~known | (length < 0.05))
        if len(lost):
            nodes = np.argwhere(self.index >= 0)
            _, nearest = cKDTree(nodes).query(place[lost])
            total[lost] = self.vectors[self.index[tuple(nodes[nearest].T)]]
            length[lost] = 1.0
        result: Floats = total / length[:, None]
        return result


class MuscleGrid:
    """A closed surface's inside on a cubic grid, with the matrices of Laplace problems in it.

    Attributes:
        solid: The surface.
        origin: (3,) m; node (i, j, k) lies at origin + (i, j, k) spacing.
        spacing: m, a fraction of the muscle's thickness.
        cells: (m, 3) cells with a sample inside, of the largest connected part.
        inside: (m, 64) uint8, which of a cell's samples are.
        nodes: (n, 3) indices of the cells' nodes.
        corners: (m, 8) rows of ``nodes``.
        left_out: Share of the inside that hangs together with nothing else.
    """

    def __init__(self, solid: _core.Surface, *, spacing: float | None = None) -> None:
        """Sample the inside; raises InputError for a surface that holds no sample."""
        self.solid = solid
        vertices = solid.vertices
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        thickness = 2.0 * solid.volume / solid.area
        least = (solid.volume / _MAX_CELLS) ** (1.0 / 3.0)
        self.spacing = spacing or max(thickness / _CELLS_ACROSS, least)
        # Off the surface's own planes by an odd part of a cell.
        self.origin = low - 0.37 * self.spacing
        count = np.ceil((high - self.origin) / self.spacing + 0.5).astype(int)
        cells, inside = _core.samples_inside(
            solid, self.origin.tolist(), [self.spacing] * 3, count.tolist(), _SAMPLES
        )
        if not len(cells):
            raise InputError(f"{solid.name}: too thin for a fibre field; check the surface")
        cells = cells.astype(np.int64)
        self.shape = tuple(int(n) + 1 for n in count)
        nodes, corners = self._number(cells)
        kept, self.left_out = _largest_part(corners, len(nodes), inside.sum(axis=1))
        self.cells, self.inside = cells[kept], inside[kept]
        self.nodes, self.corners = self._number(self.cells)
        self._shares = np.where(self.inside == 1, 1.0, _OUTSIDE) / len(_AT)
        self._stiffness = self._assemble(_STIFFNESS)
        self._mass = self._assemble(_MASS)
        held = (_weighted(self.inside, _SHAPE) / len(_AT)).reshape(-1)
        # Muscle that each node stands for, in cells.
        self._held = np.bincount(self.corners.reshape(-1), held, minlength=len(self.nodes))

    @property
    def positions(self) -> Floats:
        """(n, 3) m, of the nodes."""
        result: Floats = self.origin + self.spacing * self.nodes
        return result

    @property
    def centres(self) -> Floats:
        """(m, 3) m, of the cells."""
        result: Floats = self.origin + self.spacing * (self.cells + 0.5)
        return result

    @cached_property
    def surface(self) -> SurfacePoints:
        """Points of the surface, less than a spacing apart."""
        return surface_points(self.solid, self.spacing)

    def at_surface(self, nodal: NDArray[Any]) -> NDArray[Any]:
        """A nodal value (n,) at the node nearest to each point of the surface."""
        return np.asarray(nodal[self._next_to_surface])

    @cached_property
    def _next_to_surface(self) -> Ints:
        place = (self.surface.points - self.origin) / self.spacing
        return np.asarray(cKDTree(self.nodes).query(place)[1])

    @cached_property
    def _rows(self) -> Ints:
        index = np.full(self.shape, -1, dtype=np.int64)
        index[tuple(self.nodes.T)] = np.arange(len(self.nodes))
        return index

    @property
    def weights(self) -> Floats:
        """(n,) volume that each node stands for, in cells."""
        return np.asarray(self._mass.sum(axis=1)).reshape(-1)

    def sample_points(self, chosen: slice = slice(None)) -> Floats:
        """(m, 64, 3) m, of the samples of some cells."""
        result: Floats = self.origin + self.spacing * (self.cells[chosen][:, None] + _AT)
        return result

    def at_samples(self, values: Floats) -> tuple[Floats, Floats]:
        """Points (k, 3) inside the surface and nodal values there (k,)."""
        chosen = self.inside.astype(bool)
        return self.sample_points()[chosen], np.einsum("ma,sa->ms", values[self.corners], _SHAPE)[
            chosen
        ]

    def solve(
        self,
        load: Floats | None = None,
        ends: Floats | None = None,
        caps: Sequence[tuple[NDArray[np.bool_], float]] = (),
        guess: Floats | None = None,
        tolerance: float = _TOLERANCE,
    ) -> Floats:
        """Return the potential (n,), in units of the spacing, that balances a load.

        Args:
            load: (n,) as `load_of` gives it; None: none.
            ends: (n,) prescribed values, NaN where there are none; None: nowhere, the mean is 0.
            caps: Parts of the surface, as masks of its points, and the potential's value there;
                held by a stiff penalty, as the surface lies between the nodes.
            guess: (n,) to start from.
            tolerance: Norm of what is left over that of the load.
        """
        load = np.zeros(len(self.nodes)) if load is None else load
        guess = np.zeros(len(self.nodes)) if guess is None else guess
        matrix = self._stiffness
        if not caps and ends is None:
            found = _conjugate_gradients(matrix, load - load.mean(), guess, tolerance)
            return np.asarray(found - found.mean())
        for part, value in caps:
            at, known = self._shape_at(self.surface.points[part], self.surface.normals[part])
            weights = _CAP_STIFFNESS / self.spacing**2 * self.surface.areas[part][known]
            matrix = sparse.csr_array(matrix + at.T @ (sparse.diags_array(weights) @ at))
            load = load + at.T @ (weights * value)
        values = np.zeros(len(self.nodes)) if ends is None else np.nan_to_num(ends)
        free = np.flatnonzero(np.isnan(ends)) if ends is not None else np.arange(len(self.nodes))
        right = (load - matrix @ values)[free]
        values[free] = _conjugate_gradients(matrix[free][:, free], right, guess[free], tolerance)
        return values

    def load_of(self, field: Floats) -> Floats:
        """Return the load (n,) whose potential has the gradient nearest to a field.

        ``field`` is (m, 3), one vector for each cell, or (m, 64, 3), one for each sample.
        """
        load = np.zeros(len(self.nodes))
        for part in self._parts():
            mask = self._shares[part]
            if field.ndim == 2:
                summed = _weighted(mask, _GRADIENT.reshape(len(_AT), -1)).reshape(-1, 8, 3)
                values = np.einsum("mak,mk->ma", summed, field[part])
            else:
                values = np.einsum("ms,msk,sak->ma", mask, field[part], _GRADIENT)
            load += np.bincount(
                self.corners[part].reshape(-1), values.reshape(-1), minlength=len(load)
            )
        return load

    def energy(self, potential: Floats) -> float:
        """Integral of the squared gradient over the inside, in cells."""
        return _dot(potential, self._stiffness @ potential)

    def norm2(self, field: Floats) -> float:
        """Integral of the squared length of a field at samples (m, 64, 3), in cells."""
        return float(np.einsum("ms,msk,msk->", self._shares, field, field))

    def slowest_mode(self) -> Floats:
        """Return the first mode of the Laplace operator (n,), which runs along the length.

        By inverse iteration from the way through the muscle to its far end.
        """
        weights = self.weights
        mode = self._far_ends()
        before = np.inf
        for _ in range(_MODE_STEPS):
            mode = mode - _dot(weights, mode) / weights.sum()
            mode /= np.sqrt(_dot(weights, mode**2))
            quotient = self.energy(mode)
            if abs(before - quotient) < 1e-2 * quotient:
                break
            before = quotient
            mode = self.solve(weights * mode, guess=mode / quotient, tolerance=1e-3)
        return mode

    def recover(self, potential: Floats, field: Floats | None = None) -> Floats:
        """Return the gradient at nodes (n, 3), or what is left of ``field`` without it.

        The mass-weighted mean over samples, then a few steps towards the projection, which takes
        away most of the lag of a mean near the boundary.
        """
        right = np.zeros((len(self.nodes), 3))
        for part in self._parts():
            mask = self._shares[part]
            at = potential[self.corners[part]]
            operator = _weighted(mask, _RECOVERY).reshape(-1, 8, 8, 3)
            values = np.einsum("mabk,mb->mak", operator, at)
            if field is not None:
                given = np.einsum("ms,msk,sa->mak", mask, field[part], _SHAPE)
                values = given - values
            right += self._gather(part, values)
        weights = np.maximum(self.weights, 1e-12)[:, None]
        vectors = right / weights
        for _ in range(4):
            vectors = vectors + (right - self._mass @ vectors) / weights
        return vectors

    def field(self, vectors: Floats, unknown: Mask | None = None) -> GridField:
        """Return nodal vectors (n, 3) as a field of directions, carried a few cells outwards.

        Nodes in ``unknown``, with a sliver of muscle only, and in blind corners that next to
        nothing flows through take the direction of what lies around them.
        """
        length = np.linalg.norm(vectors, axis=1)
        good = (length > 0.0) & (self._held > _SLIVER)
        if unknown is not None and (good & ~unknown).any():
            good &= ~unknown
        good &= length > _FLOWS * np.median(length[good])
        index = np.full(self.shape, -1, dtype=np.int32)
        index[tuple(self.nodes[good].T)] = np.arange(int(good.sum()))
        units = vectors[good] / length[good][:, None]
        count = 0
        while count < len(units):
            count = len(units)
            if (index[tuple(self.nodes.T)] >= 0).all():
                break
            index, units = _grow(index, units)
        for _ in range(_MARGIN):
            index, units = _grow(index, units)
        return GridField(self.origin, self.spacing, index, units)

    def _number(self, cells: NDArray[np.integer]) -> tuple[Ints, Ints]:
        corners = cells[:, None] + _CORNERS
        keys = np.ravel_multi_index(tuple(corners.reshape(-1, 3).T), self.shape)
        unique, inverse = np.unique(keys, return_inverse=True)
        nodes = np.stack(np.unravel_index(unique, self.shape), axis=1)
        return nodes, inverse.reshape(-1, 8)

    def _shape_at(self, points: Floats, normals: Floats) -> tuple[sparse.csr_array, Mask]:
        """Rows of nodal weights at the surface points that have a cell, and which those are.

        A point whose cell holds no sample is moved inwards, by a cell's side at most.
        """
        place = (points - self.origin) / self.spacing
        known = np.zeros(len(points), dtype=bool)
        corners = np.zeros((len(points), 8), dtype=np.int64)
        limit = np.array(self.shape) - 2
        for _ in range(_SAMPLES + 1):
            rest = np.flatnonzero(~known)
            cell = np.clip(np.floor(place[rest]).astype(np.int64), 0, limit)
            found = self._rows[tuple((cell[:, None] + _CORNERS).reshape(-1, 3).T)].reshape(-1, 8)
            good = (found >= 0).all(axis=1)
            known[rest[good]] = True
            corners[rest[good]] = found[good]
            place[rest[~good]] -= normals[rest[~good]] / _SAMPLES
        local = place[known] - self.nodes[corners[known, 0]]
        shape, _ = _shape_functions(local)
        rows = np.repeat(np.arange(len(local)), 8)
        entries = (shape.reshape(-1), (rows, corners[known].reshape(-1)))
        return sparse.csr_array(entries, shape=(len(local), len(self.nodes))), known

    def _parts(self) -> list[slice]:
        starts = range(0, len(self.cells), _CELLS_AT_ONCE)
        return [slice(start, start + _CELLS_AT_ONCE) for start in starts]

    def _assemble(self, at_samples: Floats) -> sparse.csr_array:
        entries = _weighted(self._shares, at_samples).reshape(-1)
        rows = np.repeat(self.corners, 8, axis=1).reshape(-1)
        columns = np.tile(self.corners, (1, 8)).reshape(-1)
        size = len(self.nodes)
        return sparse.coo_array((entries, (rows, columns)), shape=(size, size)).tocsr()

    def _gather(self, part: slice, values: Floats) -> Floats:
        rows = self.corners[part].reshape(-1)
        flat = values.reshape(-1, 3)
        size = len(self.nodes)
        return np.stack([np.bincount(rows, flat[:, k], minlength=size) for k in range(3)], axis=1)

    def _far_ends(self) -> Floats:
        """Shortest way through the muscle (n,) from one far end, found by two sweeps."""
        pattern = self._stiffness.tocoo()
        steps = np.linalg.norm(self.nodes[pattern.row] - self.nodes[pattern.col], axis=1)
        graph = sparse.csr_array((steps, (pattern.row, pattern.col)), shape=pattern.shape)
        start = int(np.argmin((self.nodes * [1.0, 1e-3, 1e-6]).sum(axis=1)))
        for _ in range(2):
            way = csgraph.dijkstra(graph, directed=False, indices=start)
            start = int(np.argmax(way))
        return np.asarray(csgraph.dijkstra(graph, directed=False, indices=start))


def _largest_part(corners: Ints, n_nodes: int, volume: NDArray[np.integer]) -> tuple[Mask, float]:
    """Which cells belong to the part that holds most, and the share of the others."""
    links = np.stack([np.repeat(corners[:, :1], 8, axis=1), corners], axis=2).reshape(-1, 2)
    ones = np.ones(len(links), dtype=np.int8)
    graph = sparse.coo_array((ones, (links[:, 0], links[:, 1])), shape=(n_nodes, n_nodes))
    _, label = csgraph.connected_components(graph, directed=False)
    part = label[corners[:, 0]]
    held = np.bincount(part, volume)
    main = int(np.argmax(held))
    return part == main, 1.0 - float(held[main] / held.sum())


def _conjugate_gradients(
    matrix: sparse.csr_array, right: Floats, guess: Floats, tolerance: float
) -> Floats:
    """Solve with the diagonal as preconditioner, summing in an order that threads do not change.

    SciPy's own leaves the products to the BLAS, which adds in another order for each number of
    threads and here waits longer for its threads than it computes.
    """
    inverse = 1.0 / np.maximum(np.asarray(matrix.diagonal()), 1e-300)
    found = guess.copy()
    left = right - matrix @ guess
    wanted = tolerance**2 * _dot(right, right)
    step = scaled = inverse * left
    steepness = _dot(left, scaled)
    for _ in range(_MAX_ITERATIONS):
        if _dot(left, left) <= wanted:
            break
        pushed = matrix @ step
        share = steepness / _dot(step, pushed)
        found += share * step
        left -= share * pushed
        scaled = inverse * left
        before, steepness = steepness, _dot(left, scaled)
        step = scaled + (steepness / before) * step
    return found


def _weighted(weights: NDArray[Any], at_samples: Floats) -> Floats:
    """Sums (m, k) over samples; sparse, so that it does not depend on the number of threads."""
    return np.asarray(sparse.csr_array(weights, dtype=np.float64) @ at_samples)


def _dot(a: Floats, b: Floats) -> float:
    return float((a * b).sum())


def _grow(index: NDArray[np.int32], vectors: Floats) -> tuple[NDArray[np.int32], Floats]:
    """Give each node next to known ones (over a face, edge or corner) their mean direction."""
    padded = np.pad(index, 1, constant_values=-1)
    known = padded >= 0
    total = np.zeros((*padded.shape, 3))
    total[known] = vectors[padded[known]]
    for axis in range(3):
        shifted = [np.roll(total, step, axis=axis) for step in (-1, 1)]
        total = total + shifted[0] + shifted[1]
    total = total[1:-1, 1:-1, 1:-1]
    length = np.linalg.norm(total, axis=3)
    new = (index < 0) & (length > 0.1)
    grown = index.copy()
    grown[new] = len(vectors) + np.arange(int(new.sum()))
    return grown, np.concatenate([vectors, total[new] / length[new][:, None]])
