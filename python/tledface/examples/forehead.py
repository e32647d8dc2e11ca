"""The forehead of Warburton and Maddock (2014): the brow is raised or frowns, and the skin folds.

Skin (corneum, dermis, hypodermis) on a skull, frontalis, procerus, corrugators and the galea that
frontalis pulls against; the deep side slides on the bone, the temples are held. The frontalis lifts
the brow and throws the forehead into horizontal folds; corrugators and procerus frown. The surfaces
are made from formulas, or come from an atlas. The fat over the muscles decides how long the folds
are, more than anything else.
"""

from __future__ import annotations

import math
from pathlib import Path

from tledface.errors import InputError
from tledface.examples import _forehead_atlas as atlas
from tledface.examples._forehead_head import write_head
from tledface.examples._forehead_measures import Measures, measure, measure_surfaces
from tledface.examples._forehead_scene import TOP, Choices, scene_text
from tledface.geometry import read_surface
from tledface.geometry.aponeurosis import aponeurosis
from tledface.io._atomic import atomic_path
from tledface.io.surfaces import write_surface
from tledface.units import parse

__all__ = ["ABOUT_VARIANTS", "VARIANTS", "Measures", "measure", "measure_surfaces", "write"]

VARIANTS: dict[str, dict[str, object]] = {
    "reference": {},
    "frown": {"animation": "frown"},
    "young": {"corneum": "24 MPa"},
    "strong-muscles": {"sigma_act": "50 MPa", "level": 0.4},
    "frontalis-only": {"frontalis_only": True},
    "single-layer": {"single_layer": True},
    "no-galea": {"galea": False},
    "fixed-bone": {"sliding": False},
}
ABOUT_VARIANTS: dict[str, str] = {
    "reference": "frontalis raises the brow: horizontal folds",
    "frown": "procerus and corrugators frown: creases at the nasal root and between the brows",
    "young": "a corneum half as stiff (24 MPa), as in younger skin",
    "strong-muscles": "muscles ten times as strong (50 MPa), activated to 0.4",
    "frontalis-only": "no procerus and no corrugators",
    "single-layer": "skin of one material: no folds",
    "no-galea": "frontalis has nothing to pull against",
    "fixed-bone": "the deep side is held to the bone instead of sliding: a third of the rise",
}

_ANIMATIONS = ("raise", "frown")
# mm. A coarse voxel may be long the way that folds run: across the forehead, upright in a frown.
_VOXEL = 0.5
_COARSE_VOXEL = {"raise": (1.0, 0.6, 0.6), "frown": (0.6, 0.6, 1.0)}


def write(
    folder: str | Path,
    *,
    data: Path | None = None,
    half: bool = False,
    coarse: bool = False,
    voxel: float | None = None,
    fat: float = 1.5,
    animation: str = "raise",
    single_layer: bool = False,
    corneum: str = "48 MPa",
    sigma_act: str = "5 MPa",
    level: float = 0.75,
    galea: bool = True,
    galea_modulus: str = "24 MPa",
    sliding: bool = True,
    frontalis_only: bool = False,
) -> Path:
    """Write the forehead's surfaces and scene.

    Args:
        folder: Existing or new folder; files of the same names are replaced.
        data: Folder of the BodyParts3D 3.0 atlas (files by FMA id); None: made from formulas.
        half: The right half only, with a plane of symmetry.
        coarse: The half in larger voxels, to be seen within a minute.
        voxel: Voxel size, mm; None: 0.5, or for ``coarse`` 1 x 0.6 x 0.6 (frown: 0.6 x 0.6 x 1).
        fat: Fat over the muscles beyond the least, mm: the skin lies this much further out.
        animation: ``"raise"`` (frontalis) or ``"frown"`` (procerus and corrugators).
        single_layer: One skin material instead of three: no folds form.
        corneum: Young's modulus of the stratum corneum, with its unit.
        sigma_act: Active and passive reference stress of all muscles, with its unit.
        level: Activation of the muscles at the end, 0 to 1.
        galea: Whether there is one.
        galea_modulus: Its Young's modulus, with its unit.
        sliding: Whether the deep side slides on the bone; else it is held.
        frontalis_only: Leave out procerus and corrugators; not with ``animation="frown"``.

    Returns:
        The scene file, ``forehead.toml``.

    Raises:
        InputError: a value out of range, no such atlas, the folder cannot be made.
    """
    if coarse and voxel is None:
        edges = _COARSE_VOXEL.get(animation, _COARSE_VOXEL["raise"])
    else:
        edges = (_VOXEL if voxel is None else voxel,) * 3
    choices = Choices(
        half=half or coarse,
        voxel=edges,
        fat=fat,
        animation=animation,
        single_layer=single_layer,
        corneum=corneum,
        sigma_act=sigma_act,
        level=level,
        galea=galea_modulus,
        has_galea=galea,
        sliding=sliding,
        frontalis_only=frontalis_only,
    )
    _check(choices)
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another") from None
    if data is None:
        write_head(folder, fat)
        names = ("skull", "frontalis_r", "frontalis_l", "procerus", "corrugator_r", "corrugator_l")
        files = {name: Path(f"{name}.ply") for name in names}
        bones = ["skull"]
    else:
        files = atlas.write_atlas(Path(data).absolute(), folder, fat)
        bones = list(atlas.BONES)
    files |= {"skin": Path("skin.ply"), "galea": Path("galea.ply")}
    if galea:
        _write_galea(folder, files)
    path = folder / "forehead.toml"
    with atomic_path(path, "scene") as part:
        part.write_text(scene_text(files, bones, choices), encoding="utf-8")
    return path


def _check(choices: Choices) -> None:
    if not all(math.isfinite(edge) and edge > 0.0 for edge in choices.voxel):
        raise InputError(f"forehead voxel: got {choices.voxel[0]}, allowed is a length above 0 mm")
    if not -1.0 <= choices.fat <= 6.0:
        raise InputError(f"forehead fat: got {choices.fat}, allowed is -1 to 6 mm")
    if not 0.0 <= choices.level <= 1.0:
        raise InputError(f"forehead level: got {choices.level}, allowed is 0 to 1")
    if choices.animation not in _ANIMATIONS:
        known = ", ".join(_ANIMATIONS)
        raise InputError(f"forehead animation: got {choices.animation!r}; allowed: {known}")
    if choices.frontalis_only and choices.animation == "frown":
        raise InputError(
            "forehead frontalis_only: got it with animation = 'frown', which frontalis has no part "
            "in; take one of the two"
        )
    moduli = {
        "corneum": choices.corneum,
        "sigma_act": choices.sigma_act,
        "galea_modulus": choices.galea,
    }
    for name, value in moduli.items():
        if not parse(value, "pressure", key=f"forehead {name}") > 0.0:
            raise InputError(f"forehead {name}: got {value!r}; allowed is a pressure above 0")


def _write_galea(folder: Path, files: dict[str, Path]) -> None:
    """The galea from frontalis' upper edge to a little above the tissue's end."""
    skin = read_surface(folder / files["skin"], unit_scale=1e-3).solid
    frontalis = [
        read_surface(folder / files[f"frontalis_{side}"], unit_scale=1e-3).solid for side in "rl"
    ]
    sheet = aponeurosis(skin, frontalis, top=(TOP + 4.0) * 1e-3, overlap=3e-3, thickness=1e-3)
    write_surface(folder / files["galea"], 1e3 * sheet.vertices, sheet.faces)
