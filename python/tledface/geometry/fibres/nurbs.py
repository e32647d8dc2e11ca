"""A spline volume fitted along a muscle, and its derivative along the length as fibre direction.

The volume is a tensor product of B-splines (a NURBS volume of equal weights: weights add exact
circles, which a least-squares fit to a scanned muscle has no use for). Its parameters are u along
the length, v and w across.

1. A potential in the muscle rises along its length (`harmonic.length_levels`); its level sets
   are the sections. Their centroids give the medial curve, whose arc length is u.
2. A frame is carried along the medial curve without twist (double reflection: Wang et al., ACM
   Transactions on Graphics 27, 2008), then turned by the principal direction of the sections, as
   far as they have one.
3. v and w are coordinates in the frame over the section's half widths, taken from its second
   moments; w counts from the section's own parabola, so that a curved sheet keeps to its middle.
4. Control points by least squares from the samples inside the muscle and their (u, v, w).

A line of constant (v, w) then keeps its place in the section while that widens, narrows or turns:
it is a fibre, and dV/du its direction. The parameters of a point come from the volume by Newton's
method (`csrc/voxel/spline_volume.cpp`); Python libraries for NURBS evaluate one point at a time,
some thousand times slower.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from tledface import _core
from tledface.errors import InputError
from tledface.fibre_kinds import Fibre
from tledface.geometry.fibres.harmonic import length_levels
from tledface.geometry.fibres.potential import MuscleGrid

__all__ = ["NurbsField", "fit_volume"]

Floats = NDArray[np.float64]

_STATIONS = 40
_FIT_SAMPLES = 40_000
# Half widths from standard deviations of a section: those of an ellipse.
_HALF_WIDTH = 2.0
# Sections whose deviator is shorter than this are round.
_ROUND = 0.2
# Half widths do not fall below this share of their mean, or the ends' parameters run away.
_LEAST_WIDTH = 0.08
# Control points across; along the length as the shape needs, between these.
_ACROSS = 5
_ALONG = (6, 16)
# Weight of second differences of control points, for the corners of the (v, w) square that hold
# no sample.
_SMOOTHING = 1e-4
_NEAR = 0.5


@dataclass(frozen=True, eq=False)
class NurbsField:
    """A volume and its inverse.

    Attributes:
        degree: Of u, v, w.
        knots: Clamped knots of each, 0 to 1.
        control: (nu, nv, nw, 3) m.
        residual: m, root mean square of what the fit leaves.
        samples, parameters: (n, 3) m and (n, 3), what the volume was fitted to.
    """

    degree: tuple[int, int, int]
    knots: tuple[Floats, Floats, Floats]
    control: Floats
    residual: float
    samples: Floats
    parameters: Floats
    tree: cKDTree
    spacing: float

    def directions(self, points: Floats) -> Floats:
        """Unit dV/du at the parameters of (n, 3) points, m."""
        _, along, left = self.locate(points)
        # Farther out the volume says nothing: the nearest sample of the muscle does.
        outside = np.flatnonzero(left > self.spacing**2)
        if len(outside):
            _, nearest = self.tree.query(points[outside])
            _, along[outside], _ = self.locate(self.samples[nearest])
        length = np.linalg.norm(along, axis=1)
        # Only a volume folded onto itself has a point without direction: its neighbour's serves.
        lost = np.flatnonzero(length < 1e-12 * max(float(np.median(length)), 1e-300))
        if len(lost):
            good = np.flatnonzero(length > 0.0)
            along[lost] = along[good[cKDTree(points[good]).query(points[lost])[1]]]
            length[lost] = np.linalg.norm(along[lost], axis=1)
        result: Floats = along / length[:, None]
        return result

    def locate(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Parameters (n, 3) of points, dV/du (n, 3) m there, and the squared distance left."""
        return _core.locate_in_volume(
            degree=self.degree,
            knots=[knots.tolist() for knots in self.knots],
            control=self.control.reshape(-1, 3),
            points=points,
            guesses=self._guesses(points),
        )

    def _guesses(self, points: Floats) -> Floats:
        """Parameters of the nearest sample of the fit; one search for points close together."""
        place = np.floor(points / (_NEAR * self.spacing)).astype(np.int64)
        place -= place.min(axis=0)
        extent = place.max(axis=0) + 1
        keys = np.ravel_multi_index(tuple(place.T), tuple(extent))
        _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        _, nearest = self.tree.query(points[first])
        return np.asarray(self.parameters[nearest][inverse.reshape(-1)])


def fit_volume(grid: MuscleGrid, options: Fibre) -> NurbsField:
    """Fit a volume along a muscle; raises InputError for a muscle without a length."""
    points, level = grid.at_samples(length_levels(grid, options))
    if np.ptp(level) <= 0.0:
        raise InputError(f"{grid.solid.name}: no length to fit a volume along")
    u, length = _along(points, level)
    v, w, aspect = _across(points, u, length)
    parameters = np.column_stack([u, v, w])
    step = max(1, len(points) // _FIT_SAMPLES)
    points, parameters = points[::step], parameters[::step]
    degree = (options.degree, min(options.degree, 3), min(options.degree, 2))
    along = int(np.clip(np.ceil(2.0 * aspect) + 4, *_ALONG))
    counts = (max(along, degree[0] + 1), _ACROSS, _ACROSS - 1)
    knots = tuple(_clamped(count, p) for count, p in zip(counts, degree, strict=True))
    control, residual = _least_squares(points, parameters, degree, knots)
    return NurbsField(
        degree,
        (knots[0], knots[1], knots[2]),
        control.reshape(*counts, 3),
        residual,
        points,
        parameters,
        cKDTree(points),
        grid.spacing,
    )


def _along(points: Floats, level: Floats) -> tuple[Floats, float]:
    """The share of the length (n,) at which each sample lies, and the length, m."""
    share = (level - level.min()) / np.ptp(level)
    # Levels are not evenly spaced along the medial curve: its arc length is.
    for _ in range(2):
        curve = _smooth(*_stations(points, share))
        fine = np.linspace(0.0, 1.0, 201)
        way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(curve(fine), axis=0), axis=1))]
        share = np.interp(share, fine, way / way[-1])
    return share, float(way[-1])


def _stations(points: Floats, share: Floats) -> tuple[Floats, Floats, Floats]:
    """Mean share, centroid and number of samples of each section that holds some."""
    place = np.minimum((share * _STATIONS).astype(int), _STATIONS - 1)
    counts = np.bincount(place, minlength=_STATIONS).astype(np.float64)
    full = counts > 0.0
    held = np.maximum(counts, 1.0)
    columns = [share, *points.T]
    means = np.column_stack(
        [np.bincount(place, column, minlength=_STATIONS) / held for column in columns]
    )[full]
    return means[:, 0], means[:, 1:], counts[full]


def _smooth(at: Floats, values: Floats, counts: Floats) -> BSpline:
    """A cubic spline through values at stations, smoother than they are."""
    pieces = int(np.clip(len(at) // 4, 1, 7))
    inner = np.linspace(0.0, 1.0, pieces + 1)[1:-1]
    degree = min(3, len(at) - 1)
    # A piece without a station would leave the fit open.
    inner = np.array([x for x in inner if at[0] < x < at[-1]])
    knots = np.r_[[0.0] * (degree + 1), inner, [1.0] * (degree + 1)]
    weights = np.sqrt(counts / counts.max())
    try:
        return make_lsq_spline(at, values, knots, k=degree, w=weights)
    except (ValueError, np.linalg.LinAlgError):
        ends = np.r_[[0.0] * (degree + 1), [1.0] * (degree + 1)]
        return make_lsq_spline(at, values, ends, k=degree, w=weights)


def _across(points: Floats, u: Floats, length: float) -> tuple[Floats, Floats, float]:
    """Coordinates v and w (n,) in the sections, about 0 to 1, and length over width."""
    middles, centroids, counts = _stations(points, u)
    curve = _smooth(middles, centroids, counts)
    fine = np.linspace(0.0, 1.0, 201)
    frames = _frames(curve(fine), curve(fine, 1))
    place = np.minimum((u * 200.0).round().astype(int), 200)
    offset = points - curve(u)
    flat = np.einsum("nij,nj->ni", frames[place, :2], offset)
    flat = _turned(flat, u, fine, place)
    section = np.minimum((u * _STATIONS).astype(int), _STATIONS - 1)
    held = np.bincount(section, minlength=_STATIONS) > 0
    at = np.arange(_STATIONS)[held]

    def mean(values: Floats) -> Floats:
        total = np.bincount(section, values, minlength=_STATIONS)[held]
        return np.asarray(total / np.bincount(section, minlength=_STATIONS)[held])

    def spread(values: Floats) -> Floats:
        variance = np.maximum(mean(values**2) - mean(values) ** 2, 0.0)
        return _HALF_WIDTH * np.sqrt(variance)

    def along(values: Floats) -> Floats:
        return np.asarray(_smooth(middles, values, counts)(u))

    width = along(spread(flat[:, 0]))
    width = np.maximum(width, _LEAST_WIDTH * width.mean())
    first = (flat[:, 0] - along(mean(flat[:, 0]))) / width
    # The parabola w = b v^2 + c of each section by the normal equations of one unknown pair.
    square = first**2
    index = np.searchsorted(at, section)
    bow = mean((square - mean(square)[index]) * flat[:, 1])
    bow = bow / np.maximum(mean((square - mean(square)[index]) ** 2), 1e-12)
    second = flat[:, 1] - along(bow) * square
    second = second - along(mean(second))
    height = along(spread(second))
    height = np.maximum(height, _LEAST_WIDTH * height.mean())
    second = second / height
    aspect = length / (2.0 * float(max(width.mean(), height.mean())))
    return 0.5 * (1.0 + first), 0.5 * (1.0 + second), aspect


def _frames(points: Floats, tangents: Floats) -> Floats:
    """Rows across and along a curve (n, 3, 3), carried without twist by double reflection."""
    tangents = tangents / np.maximum(np.linalg.norm(tangents, axis=1), 1e-300)[:, None]
    across = np.cross(tangents[0], np.eye(3)[np.argmin(np.abs(tangents[0]))])
    across /= np.linalg.norm(across)
    rows = [across]
    for a in range(len(points) - 1):
        move = points[a + 1] - points[a]
        scale = max(float(move @ move), 1e-300)
        turned = rows[-1] - 2.0 / scale * (move @ rows[-1]) * move
        tangent = tangents[a] - 2.0 / scale * (move @ tangents[a]) * move
        second = tangents[a + 1] - tangent
        scale = max(float(second @ second), 1e-300)
        turned = turned - 2.0 / scale * (second @ turned) * second
        turned -= (turned @ tangents[a + 1]) * tangents[a + 1]
        rows.append(turned / np.linalg.norm(turned))
    first = np.stack(rows)
    return np.stack([first, np.cross(tangents, first), tangents], axis=1)


def _turned(flat: Floats, u: Floats, fine: Floats, place: NDArray[np.int64]) -> Floats:
    """Section coordinates (n, 2) with the first along the principal direction of the sections.

    The deviator of a section's second moments is a complex number at twice the direction's angle,
    0 to about 1 long. A round section has next to none, and its direction is noise: there the frame
    stays as it was carried, or as the sections together have it.
    """
    square = (flat[:, 0] + 1j * flat[:, 1]) ** 2
    size = max(float(np.abs(square).mean()), 1e-300)
    section = np.minimum((u * _STATIONS).astype(int), _STATIONS - 1)
    count = np.bincount(section, minlength=_STATIONS)
    held = count > 0
    real, imaginary = (
        np.bincount(section, values, minlength=_STATIONS)[held]
        / np.maximum(np.bincount(section, np.abs(square), minlength=_STATIONS)[held], 1e-300)
        for values in (square.real, square.imag)
    )
    deviator = real + 1j * imaginary
    deviator *= np.abs(deviator) ** 2 / (np.abs(deviator) ** 2 + _ROUND**2)
    overall = square.mean() / size
    still = overall / np.abs(overall) if np.abs(overall) > _ROUND else 1.0
    kept = deviator + 0.5 * _ROUND * still
    # Neighbours smooth what is left, four sections each way.
    window = np.hanning(11)[1:-1]
    kept = np.convolve(np.pad(kept, 4, mode="edge"), window / window.sum(), mode="valid")
    middles = (np.arange(_STATIONS)[held] + 0.5) / _STATIONS
    angle = _smooth(middles, 0.5 * np.unwrap(np.angle(kept)), np.abs(kept) + 1e-3)
    turned = (flat[:, 0] + 1j * flat[:, 1]) * np.exp(-1j * angle(fine))[place]
    return np.column_stack([turned.real, turned.imag])


def _row_products(a: sparse.csr_array, b: sparse.csr_array) -> sparse.csr_array:
    """Row by row the products of all entries of a and b; each has equally many in every row."""
    count = a.shape[0]
    a_at, b_at = a.indices.reshape(count, -1, 1), b.indices.reshape(count, 1, -1)
    values = a.data.reshape(count, -1, 1) * b.data.reshape(count, 1, -1)
    columns = a_at.astype(np.int64) * b.shape[1] + b_at
    per_row = values.shape[1] * values.shape[2]
    starts = np.arange(count + 1) * per_row
    entries = (values.reshape(-1), columns.reshape(-1), starts)
    return sparse.csr_array(entries, shape=(count, a.shape[1] * b.shape[1]))


def _clamped(count: int, degree: int) -> Floats:
    inner = np.linspace(0.0, 1.0, count - degree + 1)
    return np.concatenate([[0.0] * degree, inner, [1.0] * degree])


def _least_squares(
    points: Floats,
    parameters: Floats,
    degree: tuple[int, int, int],
    knots: tuple[Floats, ...],
) -> tuple[Floats, float]:
    """Control points (n, 3) nearest to V(parameters) = points, and the root mean square left."""
    inside = np.clip(parameters, 0.0, 1.0)
    bases = [
        sparse.csr_array(BSpline.design_matrix(inside[:, axis], knots[axis], degree[axis]))
        for axis in range(3)
    ]
    # Sparse products: a dense one would add in another order for each number of threads.
    rows = _row_products(_row_products(bases[0], bases[1]), bases[2])
    normal = (rows.T @ rows).toarray() / len(points)
    counts = [basis.shape[1] for basis in bases]
    smooth = np.zeros_like(normal)
    for axis in range(3):
        parts = [sparse.eye_array(count) for count in counts]
        size = counts[axis]
        if size > 2:
            bend = sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(size - 2, size))
            parts[axis] = bend
            whole = sparse.kron(sparse.kron(parts[0], parts[1]), parts[2])
            smooth += (whole.T @ whole).toarray()
    scale = np.trace(normal) / len(normal)
    middle = points.mean(axis=0)
    normal = normal + scale * (_SMOOTHING * smooth + 1e-10 * np.eye(len(normal)))
    right = rows.T @ (points - middle) / len(points)
    control = splu(sparse.csc_array(normal)).solve(right) + middle
    left = rows @ control - points
    return control, float(np.sqrt((left**2).sum(axis=1).mean()))
