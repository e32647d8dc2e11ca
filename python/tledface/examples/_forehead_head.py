"""A head without an atlas: skull, skin and brow muscles as closed surfaces, made from formulas.

The skull is a vault (a superellipse from above, an ellipse from the side) with what a forehead has:
superciliary arches, glabella, nasal root, temples, and the orbits under their rims. Skin and
muscles are that vault moved outwards, without the orbits. Sizes are those of an adult head in
textbooks of anatomy. Frame: mm, x to the person's left, y backwards, z up; the superior orbital
rims are 1.55 m above the floor, so that the boxes of a standing atlas hold here too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tledface.geometry.aponeurosis import closed_sheet
from tledface.io.surfaces import write_surface

__all__ = ["write_head"]

Floats = NDArray[np.float64]

# mm. The upright axis of the vault, its greatest section, and where the rims are highest.
_AXIS_Y, _EQUATOR, _RIM = -90.0, 1562.0, 1550.0
_LENGTH, _WIDTH, _HEIGHT, _FLOOR = 92.0, 65.0, 80.0, 1495.0
_SQUARENESS = 2.5  # exponent of the section: foreheads are flat in front and turn at the temples
# Soft tissue over the bone at the midline, and how much more there is at the temples.
_SKIN, _TEMPLE_SKIN = 4.6, 3.0
# Distance of grid points where the forehead is, and the angle from the front that counts so.
_SPACING, _FRONT = 1.0, np.radians(80.0)
# Frontalis: over the bone from .. to, mm.
_FRONTALIS = (0.25, 2.45)


def write_head(folder: Path, fat: float) -> None:
    """Write ``skull``, ``skin``, ``frontalis_r`` .. ``corrugator_l`` as PLY files, mm.

    Arguments: ``fat``, mm, more fat than the least over the muscles, so skin this much further out.
    """
    angles, heights = _grid()
    _write(folder / "skull.ply", *_ball(_skull(angles, heights)))
    _write(folder / "skin.ply", *_ball(_skin(angles, heights, fat)))
    for side, name in ((-1.0, "r"), (1.0, "l")):
        _write_sheet(folder / f"frontalis_{name}.ply", *_frontalis(side))
        _write_sheet(folder / f"corrugator_{name}.ply", *_corrugator(side))
    _write_sheet(folder / "procerus.ply", *_procerus())


def _write(path: Path, vertices: Floats, faces: NDArray[np.int64]) -> None:
    write_surface(path, vertices, faces)


def _write_sheet(path: Path, upper: Floats, lower: Floats) -> None:
    sheet = closed_sheet(upper, lower)
    write_surface(path, sheet.vertices, sheet.faces)


# -- the vault -----------------------------------------------------------------------------------


def _grid() -> tuple[Floats, Floats]:
    """Angles from the front (columns, all round) and heights (rows), fine on the forehead."""
    n_front = round(2.0 * _FRONT * 75.0 / _SPACING)
    front = np.linspace(-_FRONT, _FRONT, n_front, endpoint=False)
    back = np.linspace(_FRONT, 2.0 * np.pi - _FRONT, 50, endpoint=False)
    low = np.arange(_FLOOR, 1524.0, 4.0)
    middle = np.arange(1524.0, 1610.0, _SPACING)
    # Evenly over the slope up to near the pole, which is a point of its own.
    start, end = np.arcsin((1610.0 - _EQUATOR) / _HEIGHT), np.arcsin(0.998)
    crown = _EQUATOR + _HEIGHT * np.sin(np.linspace(start, end, 50))
    return np.concatenate([front, back]), np.concatenate([low, middle, crown])


def _gauss(value: Floats, centre: float, width: float) -> Floats:
    return np.asarray(np.exp(-(((value - centre) / width) ** 2)))


def _step(value: Floats, at: float, width: float) -> Floats:
    """0 below, 1 above, over about four widths."""
    return np.asarray(0.5 + 0.5 * np.tanh((value - at) / width))


def _rim(x: Floats) -> Floats:
    """Height of the superior orbital rim, an arch that is highest at x = 31 mm."""
    return np.asarray(_RIM - 6.0 * ((abs(x) - 31.0) / 17.0) ** 2)


def _vault(angle: Floats, z: Floats) -> Floats:
    """Points of the bone without orbits, broadcast over angle and height: (..., 3) mm."""
    angle, z = np.broadcast_arrays(angle, z)
    sine, cosine = np.sin(angle), np.cos(angle)
    section = (abs(sine / _WIDTH) ** _SQUARENESS + abs(cosine / _LENGTH) ** _SQUARENESS) ** (
        -1.0 / _SQUARENESS
    )
    rise = np.clip((z - _EQUATOR) / _HEIGHT, 0.0, 1.0)
    radius = section * np.sqrt(1.0 - rise**2)
    x, front = abs(radius * sine), _step(cosine, 0.2, 0.1)
    # Superciliary arches that rise outwards, glabella between them, the nose under it, temples.
    arch = 1.8 * _gauss(x, 21.0, 11.0) * _gauss(z - 0.15 * x, 1552.0, 5.5)
    glabella = 0.9 * _gauss(x, 0.0, 11.0) * _gauss(z, 1557.0, 7.0)
    root = -2.6 * _gauss(x, 0.0, 9.0) * _gauss(z, 1541.0, 6.5)
    nose = 7.0 * _gauss(x, 0.0, 7.0) * (1.0 - _step(z, 1531.0, 6.0))
    # Behind the temporal line the bone falls back, most at eye level.
    temple = -4.0 * _step(x, 53.0, 4.0) * _gauss(z, 1558.0, 30.0)
    radius = radius + front * (arch + glabella + root + nose + temple)
    return np.stack([radius * sine, _AXIS_Y - radius * cosine, z], axis=-1)


def _outward(angle: Floats, z: Floats) -> Floats:
    """Unit normals of the vault, by differences."""
    step = 0.5
    turn = step / 75.0
    along = _vault(angle + turn, z) - _vault(angle - turn, z)
    up = _vault(angle, z + step) - _vault(angle, z - step)
    normal = np.cross(along, up)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def _over(angle: Floats, z: Floats, height: Floats | float) -> Floats:
    """Points of the vault moved outwards by ``height``, mm."""
    return _vault(angle, z) + np.asarray(height)[..., None] * _outward(angle, z)


def _inwards(points: Floats, distance: Floats) -> Floats:
    """Points moved towards the vault's axis, level."""
    away = points[..., :2] - (0.0, _AXIS_Y)
    radius = np.linalg.norm(away, axis=-1, keepdims=True)
    moved = points.copy()
    moved[..., :2] -= away / radius * distance[..., None]
    return moved


def _skull(angles: Floats, heights: Floats) -> Floats:
    """The bone's outside, (rows, columns, 3): the vault with its orbits."""
    points = _vault(angles[None, :], heights[:, None])
    x, z = abs(points[..., 0]), points[..., 2]
    opening = _step(x, 11.0, 1.5) * (1.0 - _step(x, 51.0, 2.0)) * (points[..., 1] < _AXIS_Y)
    # The roof of the orbit runs back level from its rim; the floor is beyond the tissue.
    depth = 26.0 * opening * (1.0 - _step(z - _rim(x), 0.0, 0.8))
    return _inwards(points, depth)


def _skin(angles: Floats, heights: Floats, fat: float) -> Floats:
    """The skin, (rows, columns, 3): over the vault, sunk between brow and eye."""
    angle, z = np.broadcast_arrays(angles[None, :], heights[:, None])
    x = abs(_vault(angle, z)[..., 0])
    cover = _SKIN + fat + _TEMPLE_SKIN * _step(x, 50.0, 5.0) * _gauss(z, 1555.0, 40.0)
    points = _over(angle, z, cover)
    sunk = 6.0 * _step(x, 15.0, 4.0) * (1.0 - _step(x, 49.0, 4.0)) * (points[..., 1] < _AXIS_Y)
    depth = sunk * (1.0 - _step(points[..., 2] - _rim(x), -4.5, 2.6))
    # The upper lid bulges over the eye.
    lid = 4.0 * _gauss(x, 31.0, 12.0) * _gauss(points[..., 2], 1526.0, 10.0)
    return _inwards(points, depth - lid * (points[..., 1] < _AXIS_Y))


def _ball(grid: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Close a grid of rings (rows upwards, columns round the axis) at its floor and its pole."""
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    right = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], right[:-1], right[1:], index[1:]
    sides = [np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    floor = np.array([0.0, _AXIS_Y, grid[0, :, 2].mean()])
    last = grid[-1]
    pole = np.array([0.0, _AXIS_Y, 2.0 * last[:, 2].mean() - grid[-2][:, 2].mean()])
    n = rows * columns
    caps = [
        np.stack([right[0], index[0], np.full(columns, n)], axis=1),
        np.stack([index[-1], right[-1], np.full(columns, n + 1)], axis=1),
    ]
    return np.concatenate([grid.reshape(-1, 3), [floor, pole]]), np.concatenate([*sides, *caps])


# -- muscles -------------------------------------------------------------------------------------


def _angle_of(x: Floats, z: Floats) -> Floats:
    """The angle at which the vault has this x, by bisection."""
    low, high = np.zeros_like(x), np.full_like(x, _FRONT)
    for _ in range(40):
        middle = 0.5 * (low + high)
        short = _vault(middle, z)[..., 0] < x
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return low


def _sheet(x: Floats, z: Floats, low: Floats | float, high: Floats | float) -> tuple[Floats, ...]:
    """Two grids over the vault at places (x, z), ``low`` and ``high`` above the bone."""
    angle = np.sign(x) * _angle_of(abs(x), z)
    return _over(angle, z, high), _over(angle, z, low)


def _frontalis(side: float) -> tuple[Floats, ...]:
    """A half: from the brow upwards, the halves apart above like a V."""
    x = np.linspace(0.7, 56.0, 56)
    bottom = _rim(x) - 1.5 + np.clip(x - 46.0, 0.0, None) * 1.3
    bottom = np.where(x < 14.0, np.maximum(bottom, 1541.5 + 0.0 * x), bottom)
    top = 1584.0 + 24.0 * np.sin(np.clip(x / 34.0, 0.0, 1.0) * np.pi / 2.0)
    top -= 12.0 * (np.clip(x - 36.0, 0.0, None) / 20.0) ** 2
    share = np.linspace(0.0, 1.0, 66)[:, None]
    z = bottom * (1.0 - share) + top * share
    return _sheet(side * np.broadcast_to(x, z.shape), z, *_FRONTALIS)


def _procerus() -> tuple[Floats, ...]:
    """From the nasal bones up between the brows, where it spreads."""
    z = np.linspace(1528.0, 1566.0, 39)
    half = np.interp(z, [1528.0, 1540.0, 1554.0, 1566.0], [4.0, 5.5, 13.0, 5.0])
    x = half[:, None] * np.linspace(-1.0, 1.0, 25)
    low = np.interp(z, [1528.0, 1538.0, 1548.0], [0.1, 0.8, 2.2])[:, None] + 0.0 * x
    return _sheet(x, np.broadcast_to(z[:, None], x.shape), low, low + 1.2)


def _corrugator(side: float) -> tuple[Floats, ...]:
    """From the bone by the nasal root outwards and up, through frontalis into the dermis.

    It leaves the bone within 9 mm and then lies under the dermis: where it is deep, the fat over it
    takes up what it shortens, and no skin folds. Origin 3 to 14 mm beside the midline after Janis
    et al., Plast. Reconstr. Surg. 120 (2007) 1647.
    """
    along = np.linspace(0.0, 1.0, 28)
    x = 3.0 + 25.0 * along
    z = 1545.5 + 8.5 * along + 1.5 * np.sin(np.pi * along)
    width = np.interp(along, [0.0, 0.5, 1.0], [9.0, 11.0, 7.0])
    across = np.linspace(-0.5, 0.5, 12)[:, None]
    low = np.interp(along, [0.0, 0.25, 1.0], [0.1, 2.0, 2.9]) + 0.0 * across
    thick = np.interp(along, [0.0, 0.3], [2.0, 2.4])
    slope = np.arctan2(np.gradient(z), np.gradient(x))
    grid_x = x - np.sin(slope) * width * across
    grid_z = z + np.cos(slope) * width * across
    return _sheet(side * grid_x, grid_z, low, low + thick)
