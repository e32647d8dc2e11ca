"""A scene of two spheres, skin about bone with a muscle between, that tests bind nodes of."""

import numpy as np
import trimesh

from test_build import MATERIAL, box, export
from tledface.build import build_model
from tledface.scene import Scene

INF = float("inf")
CENTRE = np.array([3.0, -2.0, 40.0])  # mm; nothing may depend on where the body is


def ball(radius, subdivisions=4, centre=CENTRE):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    mesh.apply_translation(centre)
    return mesh


def tables(folder, *, voxel=1.0, boundary=None, **geometry):
    """Skin and bone, two spheres of 12 and 8 mm about one centre, and a muscle between them."""
    export(ball(12.0), folder / "skin.stl")
    export(ball(8.0), folder / "skull.ply")
    x, y, z = CENTRE
    export(box([x - 5, y - 3, z + 7], [x + 5, y + 3, z + 10]), folder / "muscle.stl")
    return {
        "schema": 1,
        "units": "mm",
        "geometry": {"skin": "skin.stl", "bones": ["skull.ply"], "voxel": voxel} | geometry,
        "layers": [{"name": "fat", "material": MATERIAL}],
        "muscles": [
            {
                "name": "lid",
                "surfaces": ["muscle.stl"],
                "fibre": [1, 0, 0],
                "sigma_act": "1 MPa",
                "material": MATERIAL,
            }
        ],
        "boundary": boundary or {},
        "solver": {"duration": "1 ms"},
    }


def build(folder, **changes):
    return build_model(Scene.from_dict(tables(folder, **changes), folder))


def groups(model):
    return {(group.kind, group.name): group.nodes for group in model.groups}


def crossed(starts, ends, triangles):
    """Which segments cross any triangle (Moeller and Trumbore)."""
    a, ab, ac = (
        triangles[:, 0],
        triangles[:, 1] - triangles[:, 0],
        triangles[:, 2] - triangles[:, 0],
    )
    found = []
    for start, end in zip(starts, ends, strict=True):
        run = end - start
        across = np.cross(run, ac)
        det = np.einsum("ij,ij->i", ab, across)
        det[det == 0.0] = np.nan  # parallel: no comparison holds
        u = np.einsum("ij,ij->i", start - a, across) / det
        turned = np.cross(start - a, ab)
        v = turned @ run / det
        t = np.einsum("ij,ij->i", ac, turned) / det
        found.append(((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)).any())
    return np.array(found)
