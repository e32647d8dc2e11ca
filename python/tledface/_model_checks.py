"""Checks of the arrays that make a model; each failure is one complete line for the user."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.constitutive import Material
from tledface.errors import InputError, shown

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Node keys pack three grid indices in one int64.
MAX_CELL = 2_000_000
_FRACTION_SUM_TOLERANCE = 1e-6
# Nodes have 32-bit numbers. The least that a model takes is asked about only where it is much.
_MAX_NODES = 2**31 - 1
_BYTES_PER_CELL, _SMALL_BLOCK = 300, 10**7


def show(values: Floats) -> str:
    """Format a vector for a message."""
    return "(" + ", ".join(f"{v:.6g}" for v in values) + ")"


def unlike(values: Floats, *, shape_fits: bool) -> str:
    """Say why numbers are refused: their shape, or where the first that is not finite stands."""
    if not shape_fits:
        return f"shape {values.shape}"
    bad = np.argwhere(~np.isfinite(values))
    if not len(bad):
        return f"shape {values.shape}"
    value, place = values[tuple(bad[0])], ", ".join(map(str, bad[0].tolist()))
    more = f" ({len(bad)} such of {values.size})" if len(bad) > 1 else ""
    return f"{value} at [{place}]{more}, which is not finite"


def numbers_of(value: object, *shapes: tuple[int, ...]) -> tuple[Floats, str]:
    """What a function gave, and why that is refused: "" for finite numbers of one of the shapes."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return np.empty(0), shown(value)
    fits = array.shape in shapes and not isinstance(value, (str, bytes))
    if fits and np.isfinite(array).all():
        return array, ""
    return array, unlike(array, shape_fits=fits) if array.ndim else shown(value)


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value is a finite number."""
    number = isinstance(value, (int, float, np.floating, np.integer))
    try:
        return number and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number beyond all floats
        return False


def check_number(
    name: str,
    value: float,
    *,
    least: float,
    unit: str,
    exclusive: bool = False,
    most: float = math.inf,
) -> None:
    """Raise InputError unless ``value`` is a number of at least (or above) ``least``."""
    if not is_number(value) or not least <= value <= most or (exclusive and value == least):
        bound = f"above {least:g}" if exclusive else f"{least:g} or more"
        if math.isfinite(most):
            bound = f"from {least:g} to {most:g}"
        raise InputError(f"{name}: got {value!r}; allowed: a number {bound} ({unit})")


def floats(what: str, values: ArrayLike) -> Floats:
    """Return a float64 copy."""
    try:
        return np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be numbers: {error}") from None


def vector(what: str, values: ArrayLike) -> Floats:
    """Return three finite numbers."""
    vector = floats(what, values)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{what} must be three finite numbers, got {values!r}")
    return vector


def checked_points(what: str, vertices: ArrayLike) -> Floats:
    """Return the vertices of a surface, (n, 3) m."""
    points = floats(f"{what} vertices", vertices)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{what} vertices: got shape {points.shape}; allowed: (n, 3) metres")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise InputError(
            f"{what} vertices: vertex {int(np.argmin(finite))} is not finite "
            f"({np.count_nonzero(~finite)} such of {len(points)}); allowed: finite metres"
        )
    return points


def checked_faces(
    what: str, faces: ArrayLike, n_vertices: int, *, none: bool = False
) -> NDArray[np.integer]:
    """Return the triangles of a surface, (m, 3) vertices each; ``none``: there may be none."""
    triangles = np.asarray(faces)
    fits = triangles.ndim == 2 and triangles.shape[1:] == (3,) and triangles.dtype.kind in "iu"
    if not fits or not (none or len(triangles)):
        least = "" if none else ", one at least"
        raise InputError(
            f"{what} faces: got shape {triangles.shape} of {triangles.dtype}; allowed: (m, 3) "
            f"whole numbers of vertices{least}; triangulate other polygons first"
        )
    if triangles.size and (triangles.min() < 0 or triangles.max() >= n_vertices):
        raise InputError(
            f"{what} faces: got vertices {triangles.min()} to {triangles.max()}; allowed: 0 to "
            f"{n_vertices - 1}"
        )
    return triangles


def checked_cells(cells: ArrayLike) -> NDArray[np.int32]:
    """Return (n_elem, 3) grid indices; distinctness is checked where they are sorted."""
    grid = np.asarray(cells)
    if grid.ndim != 2 or grid.shape[1:] != (3,) or grid.dtype.kind not in "iu" or not len(grid):
        raise InputError(
            f"cells: got shape {grid.shape} of {grid.dtype}, need (n_elem, 3) whole numbers and "
            "at least one element"
        )
    if grid.min() < 0 or grid.max() > MAX_CELL:
        raise InputError(
            f"cells: grid indices {grid.min()} to {grid.max()} found, allowed 0 to {MAX_CELL}"
        )
    return np.array(grid, dtype=np.int32, order="C")


def checked_block(nx: int, ny: int, nz: int) -> None:
    """Refuse a block of more elements than can be numbered, or than there is memory for."""
    got = f"block cells: got ({nx}, {ny}, {nz})"
    if max(nx, ny, nz) > MAX_CELL or (nx + 1) * (ny + 1) * (nz + 1) > _MAX_NODES:
        raise InputError(
            f"{got}; allowed: {MAX_CELL} along an axis and {_MAX_NODES:.3g} nodes in all; take "
            "fewer cells"
        )
    count = nx * ny * nz
    if count > _SMALL_BLOCK:
        from tledface.geometry.memory import available_memory

        needed, there = _BYTES_PER_CELL * count, available_memory()
        if needed > there:
            raise InputError(
                f"{got}, which need at least {needed / 1e9:.3g} GB of memory, {there / 1e9:.3g} GB "
                "are there; take fewer cells"
            )


def checked_name(what: str, given: Any) -> str:
    """Return a name, or refuse what is none, or none in files."""
    if not isinstance(given, str) or not given.strip() or "\0" in given:
        raise InputError(f"{what}: name must be a non-empty text without NUL, got {given!r}")
    return given


def checked_material(what: str, given: Any) -> Material:
    """Return a material, or refuse what is none."""
    if not isinstance(given, Material):
        raise InputError(
            f"{what}: got {given!r} as material; allowed: what tledface.material gives"
        )
    return given


def checked_tissues(tissues: Sequence[str], materials: Sequence[Material]) -> list[str]:
    """Return distinct tissue names, one per material."""
    names = [checked_name("tissue", name) for name in tissues]
    if not names or len(set(names)) != len(names):
        raise InputError(f"tissues: got {names}, need one or more distinct names")
    if len(materials) != len(names):
        raise InputError(f"tissues: {len(names)} names but {len(materials)} materials")
    for given in materials:
        checked_material("tissues", given)
    return names


def checked_fractions(fractions: ArrayLike, n_elem: int, tissues: list[str]) -> Floats:
    """Return (n_elem, n_tissues) fractions whose rows sum to 1."""
    table = floats("fractions", fractions)
    if table.shape != (n_elem, len(tissues)):
        raise InputError(f"fractions: got shape {table.shape}, need ({n_elem}, {len(tissues)})")
    with np.errstate(invalid="ignore"):
        good = (table >= 0.0).all(axis=1)
        good &= np.abs(table.sum(axis=1) - 1.0) <= _FRACTION_SUM_TOLERANCE
    if not good.all():
        element = int(np.argmin(good))
        raise InputError(
            f"fractions: element {element} has {show(table[element])}, need values of 0 to 1 "
            f"that sum to 1 ({np.count_nonzero(~good)} bad elements of {n_elem})"
        )
    return table


def checked_fill(fill: ArrayLike | None, n_elem: int) -> Floats | None:
    """Return what each element weighs, above 0 to 1, or None."""
    if fill is None:
        return None
    values = floats("fill", fill)
    if values.shape != (n_elem,):
        raise InputError(f"fill: got shape {values.shape}, need ({n_elem},)")
    good = (values > 0.0) & (values <= 1.0)
    if not good.all():
        element = int(np.argmin(good))
        raise InputError(f"fill: element {element} has {values[element]:g}, need above 0, up to 1")
    return values


def checked_section(
    section_ratio: ArrayLike | None, layer_normal: ArrayLike | None, n_elem: int
) -> tuple[Floats | None, Floats | None]:
    """Return section ratio and layer normal, both or neither."""
    if section_ratio is None and layer_normal is None:
        return None, None
    if section_ratio is None or layer_normal is None:
        raise InputError("section_ratio and layer_normal must be given together")
    ratio, normal = floats("section_ratio", section_ratio), floats("layer_normal", layer_normal)
    if ratio.shape != (n_elem,) or normal.shape != (n_elem, 3):
        raise InputError(
            f"section_ratio, layer_normal: got shapes {ratio.shape} and {normal.shape}, need "
            f"({n_elem},) and ({n_elem}, 3)"
        )
    if not (np.isfinite(ratio) & (ratio >= 0.0)).all():
        raise InputError("section_ratio: values must be finite and at least 0")
    length = np.linalg.norm(normal, axis=1)
    good = (np.abs(length - 1.0) <= 1e-6) | ((length == 0.0) & (ratio == 1.0))
    if not good.all():
        element = int(np.argmin(good))
        raise InputError(
            f"layer_normal: element {element} has length {length[element]:.6g}, need a unit "
            "vector, or zero where section_ratio is 1"
        )
    return ratio, normal


def checked_fibre(name: str, fibre: ArrayLike, mask: Mask) -> Floats:
    """Return one unit direction per selected element, (m, 3)."""
    vectors = floats(f"muscle {name!r}: fibre", fibre)
    m = int(np.count_nonzero(mask))
    if vectors.shape == (3,):
        vectors = np.broadcast_to(vectors, (m, 3))
    elif vectors.shape == (len(mask), 3):
        vectors = vectors[mask]
    elif vectors.shape != (m, 3):
        raise InputError(
            f"muscle {name!r}: fibre has shape {vectors.shape}, need (3,), ({m}, 3) for the "
            f"selected elements or ({len(mask)}, 3) for all"
        )
    length = np.linalg.norm(vectors, axis=1)
    good = np.isfinite(length) & (length > 0.0)
    if not good.all():
        index = int(np.argmin(good))
        raise InputError(
            f"muscle {name!r}: fibre of element {int(np.flatnonzero(mask)[index])} is "
            f"{show(vectors[index])}, need a finite direction of non-zero length"
        )
    return np.ascontiguousarray(vectors / length[:, None])


def checked_weight(name: str, weight: ArrayLike, mask: Mask) -> Floats:
    """Return one weight per selected element, (m,)."""
    values = floats(f"muscle {name!r}: weight", weight)
    m = int(np.count_nonzero(mask))
    if values.shape == ():
        values = np.full(m, float(values))
    elif values.shape == (len(mask),):
        values = values[mask]
    elif values.shape != (m,):
        raise InputError(
            f"muscle {name!r}: weight has shape {values.shape}, need a number, ({m},) or "
            f"({len(mask)},)"
        )
    good = (values >= 0.0) & (values <= 1.0)
    if not good.all():
        index = int(np.argmin(good))
        raise InputError(
            f"muscle {name!r}: weight of element {int(np.flatnonzero(mask)[index])} is "
            f"{values[index]:g}, allowed 0 to 1"
        )
    return np.ascontiguousarray(values)
