"""A soft body of three densities under gravity: Warburton and Maddock (2014), Fig. 11, Table II.

The Armadillo of the Stanford scans (or any closed body that stands upright, arms apart) in voxels
of 2.5 mm. Its trunk is held, gravity pulls at the rest. The left arm and leg weigh 1250 kg/m3, the
right ones 750, everything else 1000, with a Poisson ratio of 0.4, as in the paper; the paper does
not give the stiffness, which here is the one that needs its time step of 0.15 ms.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.geometry import read_polygons
from tledface.io._atomic import atomic_path
from tledface.io.surfaces import write_surface

__all__ = ["ABOUT_VARIANTS", "LIMBS", "TRUNK", "VARIANTS", "write"]

Floats = NDArray[np.float64]

VARIANTS: dict[str, dict[str, object]] = {
    "reference": {},
    "soft": {"modulus": 10.0, "damping": 20.0, "duration": 800.0},
}
ABOUT_VARIANTS = {
    "reference": "the densities of the paper, and the stiffness that goes with its time step",
    "soft": "a fifth of the stiffness: its arms hang down",
}

# Shares of the body's box, of a figure that looks along -y with +z up: its left is towards +x.
# Low and high corner; mirrored in x for the right side.
LIMBS = {
    "arm": ((0.70, -0.01, 0.46), (1.01, 1.01, 1.01)),
    "leg": ((0.54, -0.01, -0.01), (1.01, 1.01, 0.42)),
}
TRUNK = ((0.36, -0.01, 0.50), (0.64, 1.01, 0.74))

_DENSITIES = {"left": 1250, "right": 750}
_REPOSITORY = "graphics.stanford.edu/data/3Dscanrep"
_AXES = ("-x", "+x", "-y", "+y", "-z", "+z")


def write(
    folder: str | Path,
    *,
    data: Path | None = None,
    height: float = 151.9,
    voxel: float = 2.5,
    modulus: float = 48.0,
    damping: float = 40.0,
    duration: float = 400.0,
    up: str = "+y",
    front: str = "-z",
) -> Path:
    """Write the body's surface, boxes around its limbs, and the scene.

    Args:
        folder: Existing or new folder; files of the same names are replaced.
        data: The body's closed surface in any unit: OFF, PLY, OBJ, STL or glTF.
        height: Height that the body gets, mm. The Armadillo has 15 105 voxels with these defaults,
            15 107 in the paper.
        voxel: Voxel size, mm.
        modulus: Young's modulus, kPa.
        damping: Mass-proportional damping, 1/s.
        duration: How long gravity acts, ms.
        up: The axis of the file that points up.
        front: The axis that the body looks along.

    Returns:
        The scene file, ``armadillo.toml``.

    Raises:
        InputError: no mesh, one that cannot be read, a number that is not above 0 (damping: below
            0), axes that are unknown or parallel, or the folder cannot be made.
    """
    folder = Path(folder)
    if data is None:
        raise InputError(
            "armadillo: needs a mesh of yours; the Stanford 3D Scanning Repository "
            f"({_REPOSITORY}) has the Armadillo, then: tledface demo armadillo --data Armadillo.ply"
        )
    sizes = {"height": height, "voxel": voxel, "modulus": modulus, "duration": duration}
    for name, value in sizes.items():
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"armadillo {name}: got {value}, allowed is a number above 0")
    if not (math.isfinite(damping) and damping >= 0.0):
        raise InputError(f"armadillo damping: got {damping}, allowed is a number from 0 up, 1/s")
    turn = _turn(up, front)
    vertices, polygons = read_polygons(data)
    # Vertices that no face uses are no part of the body, but keep their place in the file.
    used = vertices[np.unique(polygons.vertex)]
    tall = float(np.ptp(used @ turn.T, axis=0)[2])
    if not tall > 0.0:
        raise InputError(f"{data}: the body is flat along {up}; choose another axis for up")
    vertices = vertices @ turn.T * (height / tall)
    used = used @ turn.T * (height / tall)
    low, span = used.min(axis=0), np.ptp(used, axis=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another") from None
    skin = "skin.ply" if polygons.is_plain else "skin.obj"
    write_surface(folder / skin, vertices, polygons)
    for side in _DENSITIES:
        for limb, shares in LIMBS.items():
            box = low + np.array(_mirrored(shares) if side == "right" else shares) * span
            solid = trimesh.creation.box(bounds=box)
            write_surface(folder / f"{side}_{limb}.ply", solid.vertices, solid.faces)
    path = folder / "armadillo.toml"
    text = _scene(skin, low + np.array(TRUNK) * span, voxel, modulus, damping, duration)
    with atomic_path(path, "scene") as part:
        part.write_text(text, encoding="utf-8")
    return path


def _turn(up: str, front: str) -> Floats:
    """The rotation that takes ``up`` to +z and ``front`` to -y."""
    for name, axis in (("up", up), ("front", front)):
        if axis not in _AXES:
            raise InputError(f"armadillo {name}: got {axis!r}; allowed: {', '.join(_AXES)}")
    if up[1] == front[1]:
        raise InputError(f"armadillo front: got {front!r}, the axis of up; choose another")
    high, forth = (
        (1.0 if a[0] == "+" else -1.0) * np.eye(3)["xyz".index(a[1])] for a in (up, front)
    )
    return np.stack([np.cross(high, forth), -forth, high])


def _mirrored(
    box: tuple[tuple[float, float, float], tuple[float, float, float]],
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    low, high = box
    return (1.0 - high[0], *low[1:]), (1.0 - low[0], *high[1:])


def _scene(
    skin: str, trunk: Floats, voxel: float, modulus: float, damping: float, duration: float
) -> str:
    def material(density: int) -> str:
        return (
            f'material = {{ model = "neo_hookean", youngs_modulus = "{modulus:g} kPa", '
            f'poissons_ratio = 0.4, density = "{density} kg/m^3" }}'
        )

    def corner(values: Floats) -> str:
        return f"[{', '.join(f'{value:.3f}' for value in values)}]"

    blocks = [
        f"""\
# A body of several densities under gravity: Warburton and Maddock (2014), Figure 11. Made by
# tledface.
schema = 1
units = "mm"

[geometry]
skin = "{skin}"
voxel = {voxel:g}

[[layers]]
name = "body"
{material(1000)}
"""
    ]
    for side, density in _DENSITIES.items():
        boxes = ", ".join(f'"{side}_{limb}.ply"' for limb in LIMBS)
        blocks.append(
            f'[[volumes]]\nname = "{side} limbs"\nsurfaces = [{boxes}]\n{material(density)}\n'
        )
    blocks.append(
        f"""\
[boundary]
# The trunk.
fixed = [{{ box = [{corner(trunk[0])}, {corner(trunk[1])}] }}]

[solver]
duration = "{duration:g} ms"
dt = "auto"
damping = "{damping:g} 1/s"
gravity = [0, 0, "-9.81 m/s^2"]

[output]
fps = {max(20.0, 8000.0 / duration):g}
"""
    )
    return "\n".join(blocks)
