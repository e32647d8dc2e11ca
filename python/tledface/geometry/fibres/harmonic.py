"""Fibres as gradients of potentials in the muscle: sheets, spindles and sphincters.

Each is a solution of one problem, the potential phi in the muscle's volume that minimises
the integral of |grad phi - t|^2 with phi given on some ends:

* between two given ends, t = 0, phi = 0 and 1 on them: fibres run from one to the other and
  converge where an end is small;
* towards a direction u, t = the unit vector along u - (u.n) n with the sheet's normal n: the fibres
  nearest to parallel ones that follow the sheet and do not cross its surface;
* round an axis, t = the gradient of the angle about it; there the fibres are what is left,
  t - grad phi: free of sources, tangent to the surface, and closed round the hole.

A spindle without given ends takes the first mode of the Laplace operator, whose gradient runs
along the length and converges at both ends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tledface import _core
from tledface.errors import InputError
from tledface.fibre_kinds import AlongEnd, BoxEnd, CurveEnd, End, Fibre
from tledface.geometry.fibres.ends import end_nodes, end_values
from tledface.geometry.fibres.potential import GridField, MuscleGrid

__all__ = [
    "length_levels",
    "length_potential",
    "sheet_field",
    "sphincter_field",
    "spindle_field",
]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A mode's direction is noise where it is this near to its greatest and least value (of its range).
_LEVEL = 0.02
# An end that runs out to a point is held over this share of the length, or these cells if more.
_LEAST_END = 0.03
_END_CELLS = 1.5
# Caps lie within this share of the length, and these widths of the mean section, from an end, face
# along the fibres (cosine), and are at least this share of the mean section.
_END_ZONE = 0.2
_CAP_WIDTHS = 0.75
_ACROSS = 0.7
_LEAST_CAP = 0.1
# Sheet normals are means over this many thicknesses.
_NORMAL_REACH = 1.0
# A ring that is open by more than this (turns) is a bent spindle between its two ends.
_ANGLE_BINS = 120
_OPEN_BINS = 3
# Share of the angle's gradient that a closed ring keeps as circulation, at least.
_LEAST_CIRCULATION = 1e-3


def spindle_field(grid: MuscleGrid, options: Fibre) -> GridField:
    """Fibres from one end to the other, converging where the muscle does."""
    return grid.field(grid.recover(length_potential(grid, options)))


def sheet_field(grid: MuscleGrid, options: Fibre) -> GridField:
    """Fibres between two edges of a sheet, or towards a direction, tangent to the sheet."""
    start, end = options.start, options.end
    if isinstance(start, BoxEnd | CurveEnd) and isinstance(end, BoxEnd | CurveEnd):
        return grid.field(grid.recover(length_potential(grid, options)))
    return grid.field(grid.recover(_towards(grid, start, end)))


def length_potential(grid: MuscleGrid, options: Fibre) -> Floats:
    """Return the harmonic potential (n,) from one end of a muscle to the other."""
    return _lengthwise(grid, options)[0]


def length_levels(grid: MuscleGrid, options: Fibre) -> Floats:
    """Return a potential (n,) along the same way that rises as the length does, level on caps."""
    potential, zones = _lengthwise(grid, options)
    field = grid.field(grid.recover(potential))
    load = grid.load_of(field.directions(grid.centres))
    even = grid.solve(load, guess=potential)
    caps = [
        (cap, float(np.average(grid.at_surface(even)[cap], weights=grid.surface.areas[cap])))
        for cap in _caps(grid, field, zones, float(np.ptp(even)))
        if cap is not None
    ]
    return grid.solve(load, caps=caps, guess=even) if caps else even


def _lengthwise(grid: MuscleGrid, options: Fibre) -> tuple[Floats, tuple[Mask, Mask]]:
    """The harmonic potential (n,), and the nodes near its two ends."""
    start, end = options.start, options.end
    if isinstance(start, BoxEnd | CurveEnd) and isinstance(end, BoxEnd | CurveEnd):
        return _between(grid, start, end)
    mode = grid.slowest_mode()
    centred = grid.weights * (mode - np.average(mode, weights=grid.weights))
    rise = (centred[:, None] * grid.positions).sum(axis=0)
    if isinstance(start, AlongEnd) and isinstance(end, AlongEnd):
        forward = float(rise @ np.subtract(end.direction, start.direction)) > 0.0
    else:
        forward = rise[np.argmax(np.abs(rise))] > 0.0
    mode = mode if forward else -mode
    # The mode is level at its ends, and in a bent muscle most so on one side of them: its direction
    # there is carried on from within.
    share = _share(mode)
    potential = _even(grid, mode, (share < _LEVEL) | (share > 1.0 - _LEVEL))
    zones = share < _LEVEL, share > 1.0 - _LEVEL
    for _ in range(2):
        share = _share(potential)
        length = max(float(np.ptp(potential)), 1.0)
        depth = max(_LEAST_END, _END_CELLS / length)
        width = np.sqrt(grid.solid.volume / (length * grid.spacing)) / grid.spacing
        zone = max(min(_END_ZONE, _CAP_WIDTHS * width / length), depth)
        zones = share < zone, share > 1.0 - zone
        potential = _connected(grid, potential, zones, (share < depth, share > 1.0 - depth))
    return potential, zones


def sphincter_field(grid: MuscleGrid, options: Fibre) -> GridField:
    """Fibres round the hole of a ring, or along a ring that is cut open."""
    axis = _ring_axis(grid.solid) if options.axis is None else np.asarray(options.axis)
    frame = _frame(axis)
    points = grid.sample_points()
    plane = np.einsum("msk,jk->msj", points, frame[:2])
    inside = grid.inside.astype(bool)
    given = None if options.centre is None else frame[:2] @ np.asarray(options.centre)
    centre = _hole_centre(grid, plane[inside], given)
    offset = plane - centre
    distance2 = np.einsum("msk,msk->ms", offset, offset)
    if distance2[inside].min() < (0.5 * grid.spacing) ** 2:
        raise _no_hole(
            grid, axis, frame.T @ [*centre, float(frame[2] @ points[inside].mean(axis=0))]
        )
    gap = _gap(np.arctan2(offset[..., 1], offset[..., 0])[inside])
    if gap is not None:
        return grid.field(grid.recover(_along_open_ring(grid, frame, centre, gap)))
    # The gradient of the angle: across the offset, 1 / distance long.
    turn = frame[1] * offset[..., :1] - frame[0] * offset[..., 1:]
    # Samples outside count little in the potential, yet one may lie on the axis itself.
    turn *= (grid.spacing / np.maximum(distance2, distance2[inside].min()))[..., None]
    potential = grid.solve(grid.load_of(turn))
    if 1.0 - grid.energy(potential) / grid.norm2(turn) < _LEAST_CIRCULATION:
        raise _no_hole(grid, axis, None)
    return grid.field(grid.recover(potential, turn))


def _between(
    grid: MuscleGrid, start: BoxEnd | CurveEnd, end: BoxEnd | CurveEnd
) -> tuple[Floats, tuple[Mask, Mask]]:
    """The potential (n,) between two ends of which no direction is given, and their nodes."""
    zones = end_nodes(grid, start, "from"), end_nodes(grid, end, "to")
    ends = end_values(grid, zones[0], zones[1])
    potential = _even(grid, grid.solve(None, ends), ~np.isnan(ends))
    for _ in range(2):
        potential = _connected(grid, potential, zones, zones)
    return potential, zones


def _towards(grid: MuscleGrid, start: End | None, end: End | None) -> Floats:
    """The potential (n,) of a sheet towards a direction, level at the other end if it is given."""
    along = np.zeros(3)
    if isinstance(start, AlongEnd):
        along -= start.direction
    if isinstance(end, AlongEnd):
        along += end.direction
    load = grid.load_of(_in_sheet(grid, along))
    for part, key in ((start, "from"), (end, "to")):
        if part is None or isinstance(part, AlongEnd):
            continue
        zone = end_nodes(grid, part, key)
        if zone.all():
            raise InputError(f"{grid.solid.name}: {key}: holds the whole muscle; make it smaller")
        return _even(grid, grid.solve(load, np.where(zone, 0.0, np.nan)), zone)
    return grid.solve(load)


def _even(grid: MuscleGrid, potential: Floats, unknown: Mask) -> Floats:
    """The potential (n,) whose gradient is nearest to unit vectors along that of another.

    Where the other is ``unknown`` its direction is carried on from around.
    """
    field = grid.field(grid.recover(potential), unknown)
    return grid.solve(grid.load_of(field.directions(grid.centres)))


def _connected(
    grid: MuscleGrid, potential: Floats, zones: tuple[Mask, Mask], held: tuple[Mask, Mask]
) -> Floats:
    """The harmonic potential (n,) between a muscle's two ends.

    The caps in the zones become level. At an end without a cap the potential keeps its values at
    the nodes held.
    """
    field = grid.field(grid.recover(potential))
    levels = [float(np.average(potential[part], weights=grid.weights[part])) for part in held]
    ends = np.full(len(grid.nodes), np.nan)
    caps = []
    found = _caps(grid, field, zones, levels[1] - levels[0])
    for cap, part, level in zip(found, held, levels, strict=True):
        if cap is None:
            ends[part] = potential[part]
        else:
            caps.append((cap, level))
    return grid.solve(None, ends, caps, guess=potential)


def _caps(
    grid: MuscleGrid, field: GridField, zones: tuple[Mask, Mask], length: float
) -> list[Mask | None]:
    """The parts of the surface in the zones that lie across the fibres, as masks of its points.

    None for an end that has none, as it runs out to a point or an edge. ``length`` is in cells.
    """
    surface = grid.surface
    across = np.einsum("ij,ij->i", surface.normals, field.directions(surface.points))
    section = grid.solid.volume / (max(length, 1.0) * grid.spacing)
    found: list[Mask | None] = []
    for zone, sign in zip(zones, (-1.0, 1.0), strict=True):
        near = grid.at_surface(zone)
        cap = near & (sign * across > _ACROSS)
        # Fibres may not yet meet all of a cap, and then never would: the rest faces the same way.
        facing = (surface.areas[cap, None] * surface.normals[cap]).sum(axis=0)
        facing /= max(float(np.linalg.norm(facing)), 1e-300)
        cap |= near & ((surface.normals * facing).sum(axis=1) > _ACROSS)
        found.append(cap if surface.areas[cap].sum() > _LEAST_CAP * section else None)
    return found


def _share(potential: Floats) -> Floats:
    """The potential from 0 to 1."""
    return np.asarray((potential - potential.min()) / max(float(np.ptp(potential)), 1e-300))


def _in_sheet(grid: MuscleGrid, direction: Floats) -> Floats:
    """Unit vectors (m, 3) of the cells, along a direction as seen in the sheet."""
    direction = direction / np.linalg.norm(direction)
    normals = _sheet_normals(grid)
    tangent = direction - (normals * direction).sum(axis=1)[:, None] * normals
    length = np.linalg.norm(tangent, axis=1)
    if np.median(length) < 0.1:
        raise InputError(
            f"{grid.solid.name}: {_show(direction)} stands upright on this sheet; allowed: ends "
            "along the sheet"
        )
    # Where the sheet turns its face to the direction, there is little to follow.
    result: Floats = tangent / np.maximum(length, 0.1)[:, None]
    return result


def _sheet_normals(grid: MuscleGrid) -> Floats:
    """Unit normals (m, 3) of the sheet at the cells, of either sign.

    The principal direction of the outward normals of the surface around: a sheet's two faces
    outweigh its rim.
    """
    surface = grid.surface
    normals = surface.normals
    place = np.floor((surface.points - grid.origin) / grid.spacing).astype(np.int64)
    shape = tuple(n - 1 for n in grid.shape)
    keys = np.ravel_multi_index(tuple(np.clip(place, 0, np.array(shape) - 1).T), shape)
    thickness = 2.0 * grid.solid.volume / grid.solid.area
    sigma = max(1.0, _NORMAL_REACH * thickness / grid.spacing)
    tensors = np.empty((len(grid.cells), 3, 3))
    cells = tuple(grid.cells.T)
    for a in range(3):
        for b in range(a, 3):
            flat = np.bincount(
                keys, surface.areas * normals[:, a] * normals[:, b], int(np.prod(shape))
            )
            smooth = ndimage.gaussian_filter(flat.reshape(shape), sigma, mode="constant")
            tensors[:, a, b] = tensors[:, b, a] = smooth[cells]
    _, vectors = np.linalg.eigh(tensors)
    return np.asarray(vectors[:, :, -1])


def _ring_axis(solid: _core.Surface) -> Floats:
    """The direction in which a volume is flattest."""
    xx, yy, zz, xy, yz, xz = solid.covariance
    _, vectors = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    axis: Floats = vectors[:, 0]
    return axis if axis[np.argmax(np.abs(axis))] > 0.0 else -axis


def _frame(axis: Floats) -> Floats:
    """Rows: two unit vectors across the axis and the axis, right-handed."""
    least = np.eye(3)[np.argmin(np.abs(axis))]
    first = np.cross(axis, least)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis])


def _hole_centre(grid: MuscleGrid, plane: Floats, given: Floats | None) -> Floats:
    """The middle of the hole seen along the axis (2,): its point farthest from the muscle."""
    if given is not None:
        return given
    pixel = grid.spacing / 2.0
    low = plane.min(axis=0) - 2.0 * pixel
    place = np.floor((plane - low) / pixel).astype(np.int64)
    image = np.zeros(place.max(axis=0) + 3, dtype=bool)
    image[tuple(place.T)] = True
    # Samples lie half a pixel apart; slanting to the pixels they leave pinholes.
    image = ndimage.binary_closing(image, iterations=1)
    holes = ndimage.binary_fill_holes(image) & ~image
    if holes.any():
        depth = ndimage.distance_transform_edt(holes)
        best = np.unravel_index(int(np.argmax(depth)), depth.shape)
        if depth[best] > 1.5:
            result: Floats = low + pixel * (np.asarray(best) + 0.5)
            return result
    # An open ring has no hole in its image: its centre of mass lies in its opening.
    return np.asarray(plane.mean(axis=0))


def _gap(angles: Floats) -> tuple[float, float] | None:
    """The widest range of angles without a sample, as where it begins and ends; None: closed."""
    place = ((angles + np.pi) / (2.0 * np.pi) * _ANGLE_BINS).astype(int) % _ANGLE_BINS
    empty = np.bincount(place, minlength=_ANGLE_BINS) == 0
    if not empty.any():
        return None
    first_full = int(np.argmin(empty))
    runs, _ = ndimage.label(np.roll(empty, -first_full))
    sizes = np.bincount(runs.reshape(-1))[1:]
    if sizes.max() < _OPEN_BINS:
        return None
    where = np.flatnonzero(runs == 1 + int(np.argmax(sizes))) + first_full
    step = 2.0 * np.pi / _ANGLE_BINS
    return float(where[0] * step - np.pi), float((where[-1] + 1) * step - np.pi)


def _along_open_ring(
    grid: MuscleGrid, frame: Floats, centre: Floats, gap: tuple[float, float]
) -> Floats:
    """The potential from one end of an open ring to the other."""
    offset = np.einsum("nk,jk->nj", grid.positions, frame[:2]) - centre
    after = (np.arctan2(offset[:, 1], offset[:, 0]) - gap[1]) % (2.0 * np.pi)
    length = 2.0 * np.pi - (gap[1] - gap[0]) % (2.0 * np.pi)
    margin = 0.02 * length
    # Nodes of cut cells lie a little within the gap, before its end or after its begin.
    middle = 0.5 * (2.0 * np.pi + length)
    start, end = (after < margin) | (after > middle), (after > length - margin) & (after <= middle)
    values = end_values(grid, start, end)
    potential = _even(grid, grid.solve(None, values), start | end)
    return _connected(grid, potential, (start, end), (start, end))


def _no_hole(grid: MuscleGrid, axis: Floats, centre: Floats | None) -> InputError:
    where = "" if centre is None else f" through {_show(1e3 * centre)} mm"
    return InputError(
        f"{grid.solid.name}: not a ring round the axis {_show(axis)}{where}; a sphincter needs a "
        "hole that its axis passes: give axis and centre, or another kind of fibre"
    )


def _show(vector: Floats) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in vector) + ")"
