"""The flat skin block of Warburton and Maddock (2014), Tables I and II, as surfaces and a scene.

60 x 60 x 4.5 mm of skin (stratum corneum, dermis, hypodermis) at 0.5 mm voxels, a frontalis band
over the middle near the bottom with its fibres along x. The bottom slides in its plane, the sides
are free (rigid ends would stretch the skin beside the muscle and halve the folds). The muscle pulls
the skin above it together into four folds 6 mm apart; skin of one material only bulges.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.examples._scene_text import layer, neo_hookean
from tledface.io._atomic import atomic_path
from tledface.io.surfaces import write_surface

__all__ = ["ABOUT_VARIANTS", "LENGTH", "THICKNESS", "VARIANTS", "WIDTH", "write"]

VARIANTS: dict[str, dict[str, object]] = {
    "reference": {},
    "single-material": {"single_material": True},
    # Half the corneum in voxels half as high: the top layer of voxels has the same material, as in
    # the paper's Fig. 12, and is half as thick.
    "thin": {"voxel_height": 0.25, "corneum": 0.01},
    "young": {"corneum_modulus": 24.0},
}
ABOUT_VARIANTS: dict[str, str] = {
    "reference": "three layers, corneum of 48 MPa",
    "single-material": "all skin of one material: no folds",
    "thin": "voxels 0.25 mm high: finer folds",
    "young": "corneum of 24 MPa",
}

_Layers = list[tuple[str, float | None, str]]

# mm. A band of 40 mm shortens to 27 mm, which holds four folds; 30 mm long, three.
LENGTH, WIDTH, THICKNESS = 60.0, 60.0, 4.5
_BAND_DEPTHS = (0.5, 1.5)
# Of length and width, left free at each end of the band.
_MARGIN = 1.0 / 6.0

_DERMIS, _HYPODERMIS = "81.4 kPa", "34 kPa"


def write(
    folder: str | Path,
    *,
    single_material: bool = False,
    corneum: float = 0.02,
    corneum_modulus: float = 48.0,
    width: float = WIDTH,
    voxel: float = 0.5,
    voxel_height: float | None = None,
    triangle: float = 0.5,
) -> Path:
    """Write the block's surfaces and scene.

    Args:
        folder: Existing or new folder; files of the same names are replaced.
        single_material: One skin material (the dermis) instead of three: no folds form.
        corneum: Thickness of the stratum corneum, mm.
        corneum_modulus: Its Young's modulus, MPa.
        width: Width of the block, mm; the muscle covers the middle two thirds.
        voxel: Voxel size, mm.
        voxel_height: Voxel size in depth, mm; None: ``voxel``.
        triangle: Size of the triangles on the top, mm.

    Returns:
        The scene file, ``flat-block.toml`` or ``flat-block-single.toml``.

    Raises:
        InputError: the folder cannot be made, or a size is not above 0.
    """
    folder = Path(folder)
    height = voxel if voxel_height is None else voxel_height
    for name, size in (
        ("corneum", corneum),
        ("width", width),
        ("voxel", voxel),
        ("voxel_height", height),
        ("triangle", triangle),
    ):
        if not size > 0.0:
            raise InputError(f"flat block {name}: got {size}, allowed is a length above 0 mm")
    if not corneum_modulus > 0.0:
        raise InputError(
            f"flat block corneum_modulus: got {corneum_modulus}, allowed is a pressure above 0 MPa"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another") from None
    write_surface(folder / "skin.stl", *_skin(triangle, width))
    low, high = (
        (share * LENGTH, share * width, depth)
        for share, depth in zip((_MARGIN, 1.0 - _MARGIN), _BAND_DEPTHS, strict=True)
    )
    write_surface(folder / "frontalis.stl", *_box(low, high))
    path = folder / ("flat-block-single.toml" if single_material else "flat-block.toml")
    layers: _Layers = [
        ("stratum corneum", corneum, f"{corneum_modulus:g} MPa"),
        ("dermis", 1.8, _DERMIS),
        ("hypodermis", None, _HYPODERMIS),
    ]
    if single_material:
        layers = [("skin", None, _DERMIS)]
    text = _scene(layers, (voxel, voxel, height), width)
    with atomic_path(path, "scene") as part:
        part.write_text(text, encoding="utf-8")
    return path


def _skin(triangle: float, width: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return a closed block: fine triangles on top, strips down the sides, a fan below."""
    nx = max(1, round(LENGTH / triangle))
    ny = max(1, round(width / triangle))
    x, y = np.linspace(0.0, LENGTH, nx + 1), np.linspace(0.0, width, ny + 1)
    top = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((nx + 1, ny + 1), THICKNESS)], -1)
    index = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    # Diagonals alternate so that the top has no preferred direction.
    even = (np.add.outer(np.arange(nx), np.arange(ny)) % 2 == 0)[..., None]
    one = np.where(even, np.stack([a, b, c], -1), np.stack([a, b, d], -1)).reshape(-1, 3)
    two = np.where(even, np.stack([a, c, d], -1), np.stack([b, c, d], -1)).reshape(-1, 3)
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    vertices = top.reshape(-1, 3)
    below = vertices[rim] * (1.0, 1.0, 0.0)
    lower = len(vertices) + np.arange(len(rim))
    centre = np.full(len(rim), len(vertices) + len(rim))
    after, lower_after = np.roll(rim, -1), np.roll(lower, -1)
    sides = [
        np.stack([rim, lower, after], 1),
        np.stack([after, lower, lower_after], 1),
        np.stack([lower_after, lower, centre], 1),
    ]
    middle = [[LENGTH / 2, width / 2, 0.0]]
    return np.concatenate([vertices, below, middle]), np.concatenate([one, two, *sides])


def _box(
    low: tuple[float, float, float], high: tuple[float, float, float]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    quads = np.array(
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    )
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return np.asarray(low) + corners * (np.asarray(high) - np.asarray(low)), faces


def _scene(layers: _Layers, voxel: tuple[float, float, float], width: float) -> str:
    blocks = [
        f"""\
# Flat skin block: Warburton and Maddock (2014), Tables I and II. Made by tledface.
schema = 1
units = "mm"
# The corneum's stiffness is blended into its voxel, as in the paper; "section" gives finer folds.
layer_bending = "blended"

[geometry]
skin = "skin.stl"
voxel = [{", ".join(f"{edge:g}" for edge in voxel)}]
# The block's top is the skin's outside; its sides and bottom are cuts.
outer = [[[-1, -1, {THICKNESS - 0.01:g}], [{LENGTH + 1:g}, {width + 1:g}, {THICKNESS + 0.01:g}]]]
"""
    ]
    for name, thickness, modulus in layers:
        blocks.append(layer(name, thickness, modulus))
    blocks.append(
        f"""\
[[muscles]]
name = "frontalis"
surfaces = ["frontalis.stl"]
fibre = [1, 0, 0]
sigma_act = "5 MPa"
{neo_hookean("0.5 MPa")}
activation = {{ ramp = [0.0, 0.75], over = "50 ms" }}

[boundary]
fixed = [
  {{ box = [[-1, -1, -0.01], [{LENGTH + 1:g}, {width + 1:g}, 0.01]], components = "z" }},
]

[solver]
duration = "50 ms"
dt = "auto"
damping = "200 1/s"
mass_scaling = 10

[output]
fps = 200
"""
    )
    return "\n".join(blocks)
