"""The forehead's scene file: its text from the surfaces and the choices of a variant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tledface.examples._scene_text import layer, neo_hookean

__all__ = ["TOP", "Choices", "scene_text"]

# mm: where the tissue ends above, below, sideways; where the temples begin, which do not move.
TOP, _BOTTOM, _SIDE, _TEMPLE = 1622.0, 1534.0, 50.0, 44.0
# mm of tissue kept under the skin, and under the skin below the orbital rim, without more fat.
_DEPTH, _DEPTH_BELOW_RIM = 5.6, 4.7
_RAMP, _STEP = "30 ms", "4 us"

_LAYERS = (
    ("corneum", 0.02, None),
    ("dermis", 1.8, "81.4 kPa"),
    ("hypodermis", None, "34 kPa"),
)
_SINGLE_LAYER = (("skin", None, "81.4 kPa"),)


@dataclass(frozen=True)
class Choices:
    """What `forehead.write` was asked for; lengths in mm, moduli and stresses as text."""

    half: bool
    voxel: tuple[float, float, float]
    fat: float
    animation: str
    single_layer: bool
    corneum: str
    sigma_act: str
    level: float
    galea: str
    has_galea: bool
    sliding: bool
    frontalis_only: bool


def scene_text(files: Mapping[str, Path], bones: list[str], choices: Choices) -> str:
    """Return the TOML; ``files`` by name (skin, frontalis_r ..), ``bones`` names among them."""
    left = 0.0 if choices.half else _SIDE
    listed = ",\n  ".join(_quoted(files[name]) for name in bones)
    layers = _SINGLE_LAYER if choices.single_layer else _LAYERS
    blocks = [
        f"""\
# A forehead after Warburton and Maddock (2014), Table I. Made by tledface.
schema = 1
units = "mm"
# The corneum's stiffness is blended into its voxel, as in the paper.
layer_bending = "blended"

[geometry]
skin = {_quoted(files["skin"])}
bones = [
  {listed},
]
voxel = [{", ".join(f"{edge:g}" for edge in choices.voxel)}]
region = [[{-_SIDE:g}, -210, {_BOTTOM:g}], [{left:g}, -128, {TOP:g}]]
# Not the cuts that close the skin below and behind.
outer = [[[-100, -220, 1511], [100, -73, 1720]]]
depth = {_DEPTH + choices.fat:g}
# Thinner below the orbital rim, and none that runs back into the orbit.
depth_in = [
  {{ box = [[-60, -210, 1500], [60, -100, 1548]], depth = {_DEPTH_BELOW_RIM + choices.fat:g} }},
]
behind_bone = 0.35
behind_bone_in = [[[-60, -210, 1500], [60, -100, 1556]]]
"""
    ]
    for name, thickness, modulus in layers:
        blocks.append(layer(name, thickness, modulus or choices.corneum))
    blocks += _muscles(files, choices)
    if choices.has_galea:
        blocks.append(
            f"""\
[[volumes]]
name = "galea"
surfaces = [{_quoted(files["galea"])}]
{neo_hookean(choices.galea)}
"""
        )
    blocks += [_boundary(choices), _solver()]
    return "\n".join(blocks)


def _quoted(path: Path) -> str:
    return '"' + path.as_posix().replace('"', '\\"') + '"'


def _muscles(files: Mapping[str, Path], choices: Choices) -> list[str]:
    raised = choices.animation == "raise"
    sides = ("r",) if choices.half else ("r", "l")
    blocks = [
        _muscle(files, "frontalis", ("_r", "_l"), '{ kind = "sheet", to = "+z" }', raised, choices)
    ]
    if choices.frontalis_only:
        return blocks
    halves = ("_r", "_l") if "procerus_r" in files else ("",)
    blocks.append(
        _muscle(files, "procerus", halves, '{ kind = "sheet", to = "+z" }', not raised, choices)
    )
    for side in sides:
        outwards = ('"+x"', '"-x"') if side == "r" else ('"-x"', '"+x"')
        fibre = '{{ kind = "nurbs", from = {}, to = {} }}'.format(*outwards)
        blocks.append(_muscle(files, f"corrugator_{side}", ("",), fibre, not raised, choices))
    return blocks


def _muscle(
    files: Mapping[str, Path],
    name: str,
    parts: tuple[str, ...],
    fibre: str,
    active: bool,
    choices: Choices,
) -> str:
    surfaces = ", ".join(_quoted(files[name + part]) for part in parts)
    ramp = (
        f'activation = {{ ramp = [0.0, {choices.level:g}], over = "{_RAMP}" }}\n' if active else ""
    )
    return (
        f'[[muscles]]\nname = "{name}"\nsurfaces = [{surfaces}]\nfibre = {fibre}\n'
        f'sigma_act = "{choices.sigma_act}"\n{neo_hookean("0.5 MPa")}\n{ramp}'
    )


def _boundary(choices: Choices) -> str:
    temples = [f"  {{ box = [[-inf, -inf, -inf], [{-_TEMPLE:g}, inf, inf]] }},"]
    if not choices.half:
        temples.append(f"  {{ box = [[{_TEMPLE:g}, -inf, -inf], [inf, inf, inf]] }},")
    lines = [
        "[boundary]",
        "# The temples are held; so is the tissue where it ends above and behind.",
        "fixed = [",
        *temples,
        "]",
        'cuts = [{ side = "z+" }, { side = "y+" }]',
    ]
    if choices.half:
        lines.append('symmetry = [{ axis = "x", at = 0 }]')
    if not choices.frontalis_only:
        # At its origin, the nasal bones.
        lines += _attachment("procerus", 2.0, ((-10, 1530), (10, 1536)))
    if choices.animation == "frown":
        # Only where they pull: relaxed, their passive stress would tether the brow that is raised.
        lines += _attachment("corrugator_r", 2.0, ((-14, 1534), (-1, 1551)))
        if not choices.half:
            lines += _attachment("corrugator_l", 2.0, ((1, 1534), (14, 1551)))
    lines += ["", "[boundary.sliding]", 'on = ["bones"]', "facing = 0.6"]
    lines.append(f"boxes = [[[-60, -210, 1546], [60, -100, {TOP:g}]]]")
    if not choices.sliding:
        lines.append("held = true")
    return "\n".join([*lines, ""])


def _attachment(
    muscle: str, reach: float, box: tuple[tuple[int, int], tuple[int, int]]
) -> list[str]:
    """The muscle's nodes within ``reach`` of bone in a box of x and z."""
    (left, low), (right, high) = box
    return [
        "",
        "[[boundary.attachments]]",
        f'muscle = "{muscle}"',
        'bone = "bones"',
        f"reach = {reach:g}",
        f"boxes = [[[{left}, -210, {low}], [{right}, -128, {high}]]]",
    ]


def _solver() -> str:
    return f"""\
[solver]
duration = "{_RAMP}"
dt = "auto"
damping = "200 1/s"
# Only what does not allow this step is made heavier.
mass_scaling = {{ dt = "{_STEP}" }}

[output]
fps = 400
"""
