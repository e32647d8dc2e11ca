"""Real anatomy: closed surfaces of an atlas in, a raised brow out."""

import math

import numpy as np
import trimesh

from tledface.io.surfaces import write_surface
from tledface.run import simulator_of
from tledface.scene import Scene
from tledface.surface import BoundSurface


def test_brow_rises_on_real_anatomy(shared_data, tmp_path):
    """Skin, frontal bone and both frontalis of an atlas at 1 mm, frontalis to 0.5."""
    atlas = shared_data / "bodyparts3d"
    frontalis = [str(atlas / f"FMA{number}.obj") for number in (46759, 46760)]

    def tissue(youngs_modulus):
        return {
            "model": "neo_hookean",
            "youngs_modulus": youngs_modulus,
            "poissons_ratio": 0.49,
            "density": "1100 kg/m^3",
        }

    held = [  # the scalp above the muscle, the temples
        [[-60, -200, 1606], [60, 0, 1700]],
        [[-60, -200, 1500], [-50, 0, 1700]],
        [[50, -200, 1500], [60, 0, 1700]],
    ]
    tables = {
        "schema": 1,
        "units": "mm",
        "geometry": {
            "skin": str(atlas / "derived_skin_closed.ply"),
            "bones": [str(atlas / "FMA52734.obj")],
            "voxel": 1.0,
            "depth": 7.0,
            "region": [[-56, -200, 1535], [56, -120, 1625]],
        },
        "layers": [
            {"name": "corneum", "thickness": 0.02, "material": tissue("48 MPa")},
            {"name": "dermis", "thickness": 1.8, "material": tissue("81.4 kPa")},
            {"name": "hypodermis", "material": tissue("34 kPa")},
        ],
        "muscles": [
            {
                "name": "frontalis",
                "surfaces": frontalis,
                "fibre": [0, 0, 1],
                "sigma_act": "5 MPa",
                "material": tissue("0.5 MPa"),
                "activation": {"ramp": [0.0, 0.5], "over": "30 ms"},
            }
        ],
        "boundary": {"fixed": [{"box": box} for box in held]},
        "solver": {"duration": "30 ms", "damping": "200 1/s", "mass_scaling": 10},
    }
    scene = Scene.from_dict(tables, tmp_path)
    model = scene.build()
    assert 50_000 < model.n_elements < 120_000
    sim = simulator_of(scene, model, "native")
    sim.run(until=scene.solver.duration)
    u = sim.u
    assert np.isfinite(u).all()
    assert abs(u).max() < 0.03
    rise = []
    for path in frontalis:
        muscle = trimesh.load(path, process=False)
        edge = muscle.vertices[:, 2] < muscle.vertices[:, 2].min() + 6.0
        vertices = muscle.vertices[edge] * 1e-3
        bound = BoundSurface.on(model, vertices, np.zeros((0, 3), int))
        rise.append((bound.displaced(u) - vertices)[:, 2].mean())
    assert min(rise) > 1e-3
    assert math.isclose(*rise, rel_tol=0.2)  # left and right alike
    skin = sim.surface("skin")
    write_surface(tmp_path / "skin.ply", skin.vertices, skin.faces)
    assert (tmp_path / "skin.ply").stat().st_size > 100_000
