"""The forehead of the atlas as a scene: skin, skull, muscles, and a galea made for it."""

from pathlib import Path

from tledface.geometry import read_surface
from tledface.geometry.aponeurosis import aponeurosis
from tledface.scene import Scene

BONES = {
    "frontal": "FMA52734",
    "parietal_r": "FMA52788",
    "parietal_l": "FMA52789",
    "sphenoid": "FMA52736",
    "zygomatic_r": "FMA52892",
    "zygomatic_l": "FMA52893",
    "nasal_r": "FMA53647",
    "nasal_l": "FMA53648",
    "maxilla_r": "FMA53649",
    "maxilla_l": "FMA53650",
}
FRONTALIS = ("FMA46759", "FMA46760")
TOP = 1622.0  # mm, of the tissue
INF = float("inf")


def neo_hookean(youngs_modulus):
    return {
        "model": "neo_hookean",
        "youngs_modulus": youngs_modulus,
        "poissons_ratio": 0.49,
        "density": "1100 kg/m^3",
    }


def forehead(atlas, work, voxel=0.5, half=False):
    """The scene; the galea's surface goes into the folder ``work``."""
    atlas, work = Path(atlas), Path(work)
    skin_file = atlas / "derived_skin_closed.ply"

    def files(*names):
        return [str(atlas / f"{name}.obj") for name in names]

    skin = read_surface(skin_file, unit_scale=1e-3).solid
    muscles = [read_surface(f, unit_scale=1e-3).solid for f in files(*FRONTALIS)]
    galea = aponeurosis(skin, muscles, top=(TOP + 4) * 1e-3, overlap=3e-3, thickness=1e-3)
    galea.apply_scale(1e3)
    galea.export(work / "galea.ply")

    def muscle(name, fibre, *names):
        return {
            "name": name,
            "surfaces": files(*names),
            "fibre": fibre,
            "sigma_act": "5 MPa",
            "material": neo_hookean("0.5 MPa"),
        }

    right = -58.0
    left = 0.0 if half else 58.0
    boundary = {
        # Temples, and where the tissue was cut off.
        "fixed": [
            {"box": [[-INF, -INF, -INF], [-44, INF, INF]]},
            {"box": [[44, -INF, -INF], [INF, INF, INF]]},
        ],
        "cuts": [{"side": "z+"}, {"side": "y+"}],
        "sliding": {
            "on": ["bones"],
            "facing": 0.6,
            "boxes": [[[-60, -200, 1546], [60, -100, TOP]]],
        },
    }
    if half:
        boundary["fixed"] = boundary["fixed"][:1]
        boundary["symmetry"] = [{"axis": "x", "at": 0}]
    corrugators = [muscle("corrugator_r", {"kind": "nurbs", "from": "+x", "to": "-x"}, "FMA46796")]
    if not half:
        left_one = {"kind": "nurbs", "from": "-x", "to": "+x"}
        corrugators.append(muscle("corrugator_l", left_one, "FMA46797"))
    tables = {
        "schema": 1,
        "units": "mm",
        "geometry": {
            "skin": str(skin_file),
            "bones": files(*BONES.values()),
            "voxel": voxel,
            "region": [[right, -200, 1534], [left, -128, TOP]],
            "outer": [[[-90, -210, 1510.5], [90, -72.5, 1700]]],
            "depth": 5.6,
            "depth_in": [{"box": [[-60, -200, 1500], [60, -100, 1548]], "depth": 4.7}],
            "behind_bone": 0.35,
            "behind_bone_in": [[[-60, -200, 1500], [60, -100, 1556]]],
            "partial": "full",
        },
        "layers": [
            {"name": "corneum", "thickness": 0.02, "material": neo_hookean("48 MPa")},
            {"name": "dermis", "thickness": 1.8, "material": neo_hookean("81.4 kPa")},
            {"name": "hypodermis", "material": neo_hookean("34 kPa")},
        ],
        "muscles": [
            muscle("frontalis", {"kind": "sheet", "to": "+z"}, *FRONTALIS),
            muscle("procerus", {"kind": "sheet", "to": "+z"}, "FMA55610", "FMA55611"),
            *corrugators,
        ],
        "volumes": [
            {
                "name": "galea",
                "surfaces": [str(work / "galea.ply")],
                "material": neo_hookean("24 MPa"),
            }
        ],
        "boundary": boundary,
        "solver": {"duration": "30 ms", "damping": "200 1/s", "mass_scaling": 10},
    }
    return Scene.from_dict(tables)
