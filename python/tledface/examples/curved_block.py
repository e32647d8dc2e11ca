"""Skin on a curved bone with a forehead's muscles: Warburton and Maddock (2014), Fig. 10.

Skin 4.5 mm thick everywhere, three layers, on a bone curved in two directions; its lower nodes
slide on the bone. Two frontalis bellies hang from a galea that ends in the held upper rim; procerus
and corrugators below them start from the bone, at rest. The sides are held like temples, the lower
rim is free. The frontalis lifts the lower rim and folds the skin above it crosswise.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tledface.errors import InputError
from tledface.examples._bowl import Bowl
from tledface.examples._scene_text import layer, neo_hookean
from tledface.io._atomic import atomic_path
from tledface.io.surfaces import write_surface

__all__ = ["ABOUT_VARIANTS", "VARIANTS", "write"]

VARIANTS: dict[str, dict[str, object]] = {
    "reference": {},
    "single-material": {"single_material": True},
    "young": {"corneum_modulus": 24.0},
    "fat": {"thickness": 6.0},
}
ABOUT_VARIANTS: dict[str, str] = {
    "reference": "three layers, corneum of 48 MPa",
    "single-material": "all skin of one material: no folds",
    "young": "corneum of 24 MPa",
    "fat": "1.5 mm more fat over the muscles: fewer and larger folds",
}

# mm: a forehead's radii, and the block on it (arc lengths on the bone, thickness of the skin).
_BONE = Bowl(horizontal=72.0, upright=85.0)
_HALF_WIDTH, _HALF_HEIGHT, THICKNESS = 54.0, 53.0, 4.5
# Skin and bone go on beyond the block, whose rim is a cut, by more than the thickness; the skin's
# inner side lies in the bone.
_BEYOND, _INSIDE = 8.0, -16.0
# Heights of the muscles over the bone.
_LOW, _HIGH = 0.5, 1.5
# A belly of the frontalis: lower and upper edge; the galea reaches into it by the overlap.
_BROW, _CREST, _OVERLAP = -36.0, 18.0, 3.0
_DERMIS, _HYPODERMIS, _MUSCLE = "81.4 kPa", "34 kPa", "0.5 MPa"
# Surfaces and fibres.
_MUSCLES = {
    "frontalis": (["frontalis_left", "frontalis_right"], '{ kind = "sheet", to = "+z" }'),
    "procerus": (["procerus"], '{ kind = "sheet", to = "+z" }'),
    "corrugator_left": (["corrugator_left"], '{ kind = "nurbs", from = "-x", to = "+x" }'),
    "corrugator_right": (["corrugator_right"], '{ kind = "nurbs", from = "+x", to = "-x" }'),
}


def write(
    folder: str | Path,
    *,
    single_material: bool = False,
    half: bool = False,
    coarse: bool = False,
    corneum: float = 0.02,
    corneum_modulus: float = 48.0,
    galea_modulus: float = 4.8,
    thickness: float = THICKNESS,
    voxel: float = 0.5,
) -> Path:
    """Write the block's surfaces and scene.

    Args:
        folder: Existing or new folder; files of the same names are replaced.
        single_material: One skin material (the dermis) instead of three: no folds form.
        half: Only the half x < 0, with a plane of symmetry.
        coarse: The half, with voxels half as large again.
        corneum: Thickness of the stratum corneum, mm.
        corneum_modulus: Its Young's modulus, MPa.
        galea_modulus: That of the galea, MPa. A fifth of the paper's tendon gives the same folds,
            and a rise 1 mm less, in half as many steps.
        thickness: Of the skin with all its layers, mm; the muscles stay where they are.
        voxel: Voxel size, mm.

    Returns:
        The scene file, ``curved-block.toml``.

    Raises:
        InputError: the folder cannot be made, or a value that is not allowed.
    """
    folder = Path(folder)
    for name, value, unit, least, most in (
        ("corneum", corneum, "mm", 0.0, 1.8),
        ("corneum_modulus", corneum_modulus, "MPa", 0.0, np.inf),
        ("galea_modulus", galea_modulus, "MPa", 0.0, np.inf),
        ("thickness", thickness, "mm", _HIGH, _BEYOND),
        ("voxel", voxel, "mm", 0.0, 2.0),
    ):
        if not least < value <= most:
            limit = f", at most {most:g} {unit}" if np.isfinite(most) else ""
            raise InputError(
                f"curved block {name}: got {value}, allowed is more than {least:g} {unit}{limit}"
            )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another") from None
    if coarse:
        half, voxel = True, 1.5 * voxel
    for name, solid in _solids(thickness, voxel, half).items():
        write_surface(folder / f"{name}.ply", *solid)
    path = folder / "curved-block.toml"
    layers = [
        ("stratum corneum", corneum, f"{corneum_modulus:g} MPa"),
        ("dermis", 1.8, _DERMIS),
        ("hypodermis", None, _HYPODERMIS),
    ]
    if single_material:
        layers = [("skin", None, _DERMIS)]
    with atomic_path(path, "scene") as part:
        part.write_text(_scene(layers, galea_modulus, half, voxel), encoding="utf-8")
    return path


def _rim(voxel: float) -> tuple[float, float]:
    """Where the block ends, x and z (mm): on faces of voxels."""
    side = _BONE.places(_HALF_WIDTH, 0.0, 0.0)[0]
    top = _BONE.places(0.0, _HALF_HEIGHT, 0.0)[2]
    return voxel * round(float(side) / voxel), voxel * round(float(top) / voxel)


def _skin(thickness: float, voxel: float, half: bool) -> Any:
    """The skin, whose rows and columns end where the block does, and one of each beyond it."""
    side, top = _rim(voxel)
    high = _BONE.upright * np.arcsin(top / (_BONE.upright + thickness))
    rows = np.linspace(-high, high, 2 * round(high / voxel) + 1)
    rows = np.concatenate([[-high - _BEYOND], rows, [high + _BEYOND]])
    shares = np.linspace(-1.0, 1.0, 2 * round(_HALF_WIDTH / voxel) + 1)
    if half:
        shares = shares[: len(shares) // 2 + 1]
    wide = _BONE.horizontal * np.arcsin(side / _BONE.radius(rows, thickness))[:, None]
    u = wide * shares
    u = np.concatenate([u[:, :1] - _BEYOND, u, u[:, -1:] + _BEYOND], axis=1)
    return _BONE.solid(u, np.broadcast_to(rows[:, None], u.shape), _INSIDE, thickness)


def _solids(thickness: float, voxel: float, half: bool) -> dict[str, Any]:
    """The closed surfaces by name: vertices (mm) and faces."""
    high = _HALF_HEIGHT + 2 * _BEYOND
    # Wide enough to be under the skin at the corners, where the same x is farther round the bone.
    wide = _HALF_WIDTH + 5 * _BEYOND
    sheet = _BONE.sheet
    solids: dict[str, Any] = {
        "skin": _skin(thickness, voxel, half),
        "bone": sheet(-wide, wide, -high, high, 1.5 * _INSIDE, 0.0),
        "galea": sheet(-44.0, 44.0, _CREST - _OVERLAP, high, _LOW, _HIGH),
        "procerus": sheet(-5.0, 5.0, -high, _BROW + 4.0, _LOW, _HIGH),
    }
    for side, sign in (("left", 1.0), ("right", -1.0)):
        edges: list[Any] = [_medial, _lateral]
        if sign < 0.0:
            edges = [lambda v: -_lateral(v), lambda v: -_medial(v)]
        left, right = edges
        solids[f"frontalis_{side}"] = sheet(left, right, _BROW, _CREST, _LOW, _HIGH)
        solids[f"corrugator_{side}"] = _corrugator(sign)
    return solids


def _medial(v: Any) -> Any:
    """The inner edge of the left belly: a narrow gap that opens upwards in a V."""
    return 1.5 + 2.5 * np.clip((np.asarray(v) - _BROW) / (_CREST - _BROW), 0.0, 1.0)


def _lateral(v: Any) -> Any:
    """The outer edge of the left belly, which turns in towards the brow."""
    return 40.0 - 8.0 * np.clip((_BROW + 16.0 - np.asarray(v)) / 16.0, 0.0, 1.0) ** 2


def _corrugator(sign: float) -> Any:
    """A spindle from the bone beside the nasal root outwards and a little upwards."""
    along, across = np.meshgrid(np.linspace(0.0, 1.0, 21), np.linspace(-1.0, 1.0, 9))
    half = 1.5 + 2.0 * np.sin(np.pi * along)
    u, v = 5.0 + 24.0 * along, -44.0 + 4.0 * along + half * across
    u, v = (u, v) if sign > 0.0 else (-u[:, ::-1], v[:, ::-1])
    return _BONE.solid(u, v, 0.0, 2.0)


def _scene(
    layers: list[tuple[str, float | None, str]],
    galea_modulus: float,
    half: bool,
    voxel: float,
) -> str:
    side, top = _rim(voxel)
    right, front = 0.0 if half else side, -(_BONE.horizontal + 2 * _BEYOND)
    blocks = [
        f"""\
# Skin on a curved bone with a forehead's muscles, as in Fig. 10 of Warburton and Maddock (2014),
# materials of its Table I. Made by tledface.
schema = 1
units = "mm"
# The corneum's stiffness is blended into its voxel, as in the paper; "section" gives finer folds.
layer_bending = "blended"

[geometry]
skin = "skin.ply"
bones = ["bone.ply"]
voxel = {voxel:g}
# Voxels that the skin fills in part weigh in part: else its folds are beaded.
partial = "bone-full"
region = [[{-side:g}, {front:g}, {-top:g}], [{right:g}, 0, {top:g}]]
"""
    ]
    for name, thickness, modulus in layers:
        blocks.append(layer(name, thickness, modulus))
    for name, (files, fibre) in _MUSCLES.items():
        kept = [file for file in files if not (half and file.endswith("_left"))]
        if kept:
            blocks.append(_muscle(name, kept, fibre, name == "frontalis"))
    tendon = neo_hookean(f"{galea_modulus:g} MPa")
    blocks.append(f'[[volumes]]\nname = "galea"\nsurfaces = ["galea.ply"]\n{tendon}\n')
    blocks.append(_boundary(half))
    blocks.append(
        """\
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


def _muscle(name: str, files: list[str], fibre: str, contracts: bool) -> str:
    activation = 'activation = { ramp = [0.0, 0.75], over = "50 ms" }\n' if contracts else ""
    surfaces = ", ".join(f'"{file}.ply"' for file in files)
    return f"""\
[[muscles]]
name = "{name}"
surfaces = [{surfaces}]
fibre = {fibre}
sigma_act = "5 MPa"
{neo_hookean(_MUSCLE)}
{activation}"""


def _boundary(half: bool) -> str:
    """What is held: the upper rim and the sides, muscles at their bones; what slides."""
    rooted = f"{_BONE.places(0.0, -_HALF_HEIGHT + 4.0, 0.0)[2]:.2f}"
    medial = f"{_BONE.places(0.0, -41.0, 0.0)[2]:.2f}"
    lines = [
        "[boundary]",
        'cuts = [{ side = "z+" }, { side = "x-" }' + ("" if half else ', { side = "x+" }') + "]",
        "attachments = [",
        '  { muscle = "procerus", bone = "bone", reach = 1, boxes = '
        f"[[[-inf, -inf, -inf], [inf, inf, {rooted}]]] }},",
    ]
    for side in ("right",) if half else ("left", "right"):
        lines.append(
            f'  {{ muscle = "corrugator_{side}", bone = "bone", reach = 2, boxes = '
            f"[[[-9, -inf, -inf], [9, inf, {medial}]]] }},"
        )
    lines.append("]")
    if half:
        lines.append('symmetry = [{ axis = "x" }]')
    lines.append('sliding = ["bone"]')
    return "\n".join(lines) + "\n"
