"""The layered block of Hung, Mithraratne, Sagar and Hunter (2009), contracted by calcium.

30 x 11 x 7.5 mm of stratum corneum, skin (living epidermis and dermis), subcutis and frontalis,
with the Mooney-Rivlin constants of the paper's Table I and its active stress (eq. 3 and 4, Table
II). The wall at x = 0 is held, the bottom slides in its plane, the other sides are free. The paper
solves for equilibrium at a level of calcium; here calcium rises over 50 ms under damping near the
critical one, then rests for 20 ms, which leaves the block within 0.1 mm of equilibrium.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError
from tledface.examples._box import box_surface
from tledface.io._atomic import atomic_path
from tledface.io.surfaces import write_surface
from tledface.metrics import line_profile

__all__ = [
    "ABOUT_VARIANTS",
    "LENGTH",
    "SCENARIOS",
    "VARIANTS",
    "WIDTH",
    "BlockFolds",
    "measure",
    "thickness",
    "write",
]

Floats = NDArray[np.float64]

LENGTH, WIDTH = 30.0, 11.0  # mm

SCENARIOS = ("base", "homogeneous-skin", "soft-skin", "thick-subcutis", "thin-skin")

VARIANTS: dict[str, dict[str, object]] = {
    "reference": {},
    **{scenario: {"scenario": scenario, "calcium": 0.6} for scenario in SCENARIOS},
    "section": {"bending": "section"},
    "fine": {"voxel": 0.25},
    "fine-section": {"voxel": 0.25, "bending": "section"},
}
ABOUT_VARIANTS = {
    "reference": "calcium 0.9, the paper's Fig. 5",
    "base": "calcium 0.6, Fig. 6, which the next four are compared with",
    "homogeneous-skin": "corneum as soft as the skin, Fig. 7: no wrinkles",
    "soft-skin": "half the skin's stiffness, Fig. 8: a deeper fold",
    "thick-subcutis": "twice the subcutis, Fig. 9: a shallower one",
    "thin-skin": "half the skin's thickness, Fig. 10: folds closer together",
    "section": "calcium 0.9, the corneum bends as thin as it is",
    "fine": "calcium 0.9 at 0.25 mm: finer folds",
    "fine-section": "both",
}

# mm, from the outside in.
_LAYERS = {"stratum corneum": 0.02, "skin": 3.96, "subcutis": 0.96, "frontalis": 2.56}
# Table I, kPa. The corneum has a thousand times the constants of the skin.
_SKIN = {"c10": 9.4, "c11": 82.0}
_SUBCUTIS = {"c10": 3.0}
_MUSCLE = {"c10": 10.0, "c20": 10.0, "c30": 6.67}
_CORNEUM = 1000.0
_DENSITY = 1100.0  # kg/m3
# The corneum is as much heavier, so that it sets the time step less (at rest mass is nothing): at
# 0.5 mm the step is 3.6 times as long and the block weighs twice as much.
_CORNEUM_DENSITY = 400.0
_RISE, _REST = 50.0, 20.0  # ms
# The slowest motion, the block's length against its wall, has a period of some 16 ms.
_DAMPING = 400.0  # 1/s
_LEAST_BULK = 200.0  # kPa, ten times the skin's shear modulus
# Sampling of layers and muscle that puts the muscle's top, 2.56 mm, within 0.03 mm.
_SAMPLE = 0.0625  # mm
_PROFILE_SPACING = 0.02  # mm


def write(
    folder: str | Path,
    *,
    scenario: str = "base",
    calcium: float = 0.9,
    voxel: float = 0.5,
    bending: str = "blended",
    bulk_modulus: float = 1000.0,
) -> Path:
    """Write the block's surfaces and scene.

    Args:
        folder: Existing or new folder; files of the same names are replaced.
        scenario: One of `SCENARIOS`: "homogeneous-skin" gives the corneum the skin's constants,
            "soft-skin" halves those of the skin, "thick-subcutis" doubles the subcutis,
            "thin-skin" halves the skin's thickness.
        calcium: Level of calcium at the end, 0 to 1.
        voxel: Voxel size, mm, at most 1; the nearest that divides each edge of the block is taken.
        bending: "blended", as the paper's elements in effect do, or "section": the corneum's
            bending stiffness that of its own thickness.
        bulk_modulus: kPa, in place of the paper's exact incompressibility; the corneum has a
            thousand times as much.

    Returns:
        The scene file, ``hung-block.toml``.

    Raises:
        InputError: the folder cannot be made, or a value that is not allowed.
    """
    folder = Path(folder)
    for key, word, words in (
        ("scenario", scenario, SCENARIOS),
        ("bending", bending, ("blended", "section")),
    ):
        if word not in words:
            allowed = ", ".join(words)
            raise InputError(f"hung block {key}: got {word!r}, allowed is one of {allowed}")
    if not 0.0 <= calcium <= 1.0:
        raise InputError(f"hung block calcium: got {calcium}, allowed is a level from 0 to 1")
    if not 0.0 < voxel <= 1.0:
        raise InputError(f"hung block voxel: got {voxel}, allowed is above 0 up to 1 mm")
    if not _LEAST_BULK <= bulk_modulus < math.inf:
        raise InputError(
            f"hung block bulk_modulus: got {bulk_modulus}, allowed is {_LEAST_BULK:g} kPa or more; "
            "with less the tissue gives way by volume"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another") from None
    size = np.array([LENGTH, WIDTH, thickness(scenario)])
    muscle = (LENGTH, WIDTH, _LAYERS["frontalis"])
    write_surface(folder / "skin.stl", *box_surface((0.0, 0.0, 0.0), size.tolist(), 0.5))
    write_surface(folder / "frontalis.stl", *box_surface((0.0, 0.0, 0.0), muscle))
    path = folder / "hung-block.toml"
    text = _scene(scenario, calcium, size, size / np.rint(size / voxel), bending, bulk_modulus)
    with atomic_path(path, "scene") as part:
        part.write_text(text, encoding="utf-8")
    return path


def thickness(scenario: str) -> float:
    """Thickness of the whole block, mm, in one of `SCENARIOS`."""
    return sum(_layers(scenario).values())


@dataclass(frozen=True)
class BlockFolds:
    """Crests and troughs along the block's middle, lengths in m.

    Attributes:
        crests: (n, 2) place from the wall and height above its top.
        troughs: (n - 1, 2) the lowest points between them, in the same way.
        end: Place of the free end.
    """

    crests: Floats = field(repr=False)
    troughs: Floats = field(repr=False)
    end: float

    @property
    def spacing(self) -> float:
        """Mean distance between neighbouring crests; NaN below two."""
        places = self.crests[:, 0]
        return float(np.diff(places).mean()) if len(places) > 1 else math.nan

    @property
    def depth(self) -> float:
        """Crest to trough: depth of the deepest trough below the chord between its crests."""
        left, right = self.crests[:-1], self.crests[1:]
        share = (self.troughs[:, 0] - left[:, 0]) / (right[:, 0] - left[:, 0])
        chord = left[:, 1] + share * (right[:, 1] - left[:, 1])
        return float((chord - self.troughs[:, 1]).max(initial=0.0))

    @property
    def first_crest(self) -> float:
        """Height of the first crest above the top of the wall; NaN without one."""
        return float(self.crests[0, 1]) if len(self.crests) else math.nan


def measure(vertices: ArrayLike, faces: ArrayLike, *, least: float = 5e-5) -> BlockFolds:
    """Measure the folds along the middle of the block's deformed skin.

    Args:
        vertices: (nv, 3) m, of the surface ``skin``, deformed.
        faces: (nf, 3) int.
        least: m, crests stand out from the troughs beside them by this much.

    Raises:
        InputError: no surface above the middle.

    The profile is measured as it is. `tledface.metrics.wrinkles` takes the shape of a line out of
    it first, longer than a third of its length: here that is the distance between folds.
    """
    points = np.asarray(vertices, dtype=np.float64)
    spacing, end = _PROFILE_SPACING * 1e-3, float(points[:, 0].max())
    middle = WIDTH / 2 * 1e-3
    # Beside the middle, where the line would run along edges of triangles.
    line = (0.0, middle + 1e-6, 0.0), (end, middle + 1e-6, 0.0)
    place, height = line_profile(points, faces, *line, spacing)
    there = np.isfinite(height)
    place, height = place[there], height[there]
    if not len(height):
        raise InputError(f"hung block: no skin above y = {middle} m; is this the block's surface?")
    crests, troughs = _turns(height - height[0], least)
    found = np.stack([place, height - height[0]], axis=1)
    return BlockFolds(found[crests], found[troughs], float(place[-1]))


def _turns(height: Floats, least: float) -> tuple[list[int], list[int]]:
    """Crests of a line that begins at a wall, and the troughs between them.

    A crest counts once the line has fallen by ``least`` behind it, a trough once it has risen so.
    """
    crests: list[int] = []
    troughs: list[int] = []
    rising, at = True, 0
    for now, value in enumerate(height.tolist()):
        if rising == (value > height[at]):
            at = now
        elif abs(value - height[at]) >= least:
            if at > 0:
                (crests if rising else troughs).append(at)
            rising, at = not rising, now
    lead = int(bool(troughs) and (not crests or troughs[0] < crests[0]))
    return crests, troughs[lead : lead + max(len(crests) - 1, 0)]


def _layers(scenario: str) -> dict[str, float]:
    layers = dict(_LAYERS)
    if scenario == "thick-subcutis":
        layers["subcutis"] *= 2.0
    if scenario == "thin-skin":
        layers["skin"] /= 2.0
    return layers


def _material(constants: dict[str, float], bulk: float, density: float = _DENSITY) -> str:
    terms = ", ".join(f'{name} = "{value:g} kPa"' for name, value in constants.items())
    return (
        f'material = {{ model = "mooney_rivlin", {terms}, bulk_modulus = "{bulk:g} kPa", '
        f'density = "{density:g} kg/m^3" }}'
    )


def _scene(
    scenario: str, calcium: float, size: Floats, voxel: Floats, bending: str, bulk: float
) -> str:
    factor = 1.0 if scenario == "homogeneous-skin" else _CORNEUM
    heavier = 1.0 if scenario == "homogeneous-skin" else _CORNEUM_DENSITY
    softer = 0.5 if scenario == "soft-skin" else 1.0
    skin = {name: softer * value for name, value in _SKIN.items()}
    corneum = {name: factor * value for name, value in _SKIN.items()}
    layers = _layers(scenario)
    samples = max(2, round(float(voxel.max()) / _SAMPLE))
    top = size[2]
    return f"""\
# Hung, Mithraratne, Sagar and Hunter (2009), Tables I and II: {scenario}. Made by tledface.
schema = 1
units = "mm"
# The paper's elements, 2 mm long and longer, in effect blend the corneum; "section" gives it the
# bending stiffness of its 0.02 mm and finer folds.
layer_bending = "{bending}"

[geometry]
skin = "skin.stl"
voxel = [{", ".join(f"{edge:.12g}" for edge in voxel.tolist())}]
samples = {min(samples, 16)}
# The block's top is the skin's outside; its sides and bottom are cuts.
outer = [[[-1, -1, {top - 0.01:g}], [{LENGTH + 1:g}, {WIDTH + 1:g}, {top + 0.01:g}]]]

# The density of the corneum lets steps be longer; in a block near equilibrium it means nothing.
[[layers]]
name = "stratum corneum"
thickness = {layers["stratum corneum"]:g}
{_material(corneum, factor * bulk, heavier * _DENSITY)}

[[layers]]
name = "skin"
thickness = {layers["skin"]:g}
{_material(skin, bulk)}

[[layers]]
name = "subcutis"
thickness = {layers["subcutis"]:g}
{_material(_SUBCUTIS, bulk)}

[[muscles]]
name = "frontalis"
surfaces = ["frontalis.stl"]
fibre = [1, 0, 0]
law = "calcium"
sigma_act = "100 kPa"
{_material(_MUSCLE, bulk)}
activation = {{ ramp = [0.0, {calcium:g}], over = "{_RISE:g} ms" }}

[boundary]
fixed = [
  {{ box = [[-inf, -inf, -inf], [0.01, inf, inf]] }},
  {{ box = [[-inf, -inf, -inf], [inf, inf, 0.01]], components = "z" }},
]

[solver]
duration = "{_RISE + _REST:g} ms"
dt = "auto"
damping = "{_DAMPING:g} 1/s"

[output]
fps = 200
"""
