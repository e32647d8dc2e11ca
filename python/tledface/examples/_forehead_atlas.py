"""The forehead of a BodyParts3D 3.0 atlas: files by their FMA ids, skin and corrugators made ready.

The skin is moved outwards by the fat that the scene asks for and refined, since its triangles are
too coarse to show folds. The atlas' corrugators are 1 mm thick and lie on the bone along all their
length; here they are thicker and rise from their origin through frontalis to the dermis, as
anatomists find them (Isse and Elahi, Aesthet. Surg. J. 21 (2001) 209). On the bone they slide under
the fat, and the skin over them does not fold.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.geometry import read_surface
from tledface.io.surfaces import write_surface

__all__ = ["BONES", "MUSCLES", "write_atlas"]

Floats = NDArray[np.float64]

SKIN = "derived_skin_closed.ply"
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
MUSCLES = {
    "frontalis_r": "FMA46759",
    "frontalis_l": "FMA46760",
    "procerus_r": "FMA55610",
    "procerus_l": "FMA55611",
    "corrugator_r": "FMA46796",
    "corrugator_l": "FMA46797",
}
# mm that each side of a corrugator is moved outwards.
_THICKER = 0.75
# mm beside the midline, and how far a corrugator is moved towards the skin there: it leaves the
# bone beside its origin, is nearest to the skin by the inner third of the brow, ends in its fat.
# It stays this far under the skin, in the dermis.
_BESIDE, _RAISED, _UNDER_SKIN = (9.0, 12.0, 19.0, 31.0), (0.0, 3.0, 4.2, 1.5), 0.8
# Times that normals are averaged with their neighbours' before vertices are moved along them.
_SMOOTHING = 8


def write_atlas(data: Path, folder: Path, fat: float) -> dict[str, Path]:
    """Write ``skin.ply`` and the corrugators; returns the file of each bone and muscle by name.

    Files in ``folder`` are named as seen from there, so that it can be moved.

    Arguments: ``data``, folder of the atlas; ``fat``, mm, how far the skin is moved outwards.
    Raises InputError: no such folder, a file that is missing or cannot be read.
    """
    if not data.is_dir():
        raise InputError(
            f"forehead data {data}: is no folder; give the one with the atlas' surfaces"
        )
    files = {name: data / f"{fma}.obj" for name, fma in (BONES | MUSCLES).items()}
    missing = [path.name for path in (data / SKIN, *files.values()) if not path.is_file()]
    if missing:
        raise InputError(
            f"forehead data {data}: {missing[0]} is missing"
            + (f", and {len(missing) - 1} more" if len(missing) > 1 else "")
            + f"; a BodyParts3D 3.0 folder with a closed skin {SKIN} is needed"
        )
    # One refinement: triangles of 0.9 mm, an eighth of a fold.
    skin = folder / "skin.ply"
    write_surface(skin, *_refined(*_moved(data / SKIN, fat)))
    for side in "rl":
        name = f"corrugator_{side}"
        write_surface(folder / f"{name}.ply", *_raised(*_moved(files[name], _THICKER), skin))
        files[name] = Path(f"{name}.ply")
    return files


def _raised(
    vertices: Floats, faces: NDArray[np.int32], skin: Path
) -> tuple[Floats, NDArray[np.int32]]:
    """A corrugator, mm, its vertices moved towards the skin's nearest points."""
    squared, _, nearest, _ = read_surface(skin).solid.closest_points(vertices)
    depth = np.sqrt(squared)
    way = np.interp(abs(vertices[:, 0]), _BESIDE, _RAISED)
    way = np.clip(depth - _UNDER_SKIN, 0.0, way)
    share = way / np.maximum(depth, 1e-9)
    return vertices + share[:, None] * (nearest - vertices), faces


def _moved(path: Path, distance: float) -> tuple[Floats, NDArray[np.int32]]:
    """A closed surface, mm, its vertices moved outwards along smoothed normals."""
    solid = read_surface(path).solid
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    # A vertex's new normal: half its own, half its neighbours'.
    edges = mesh.edges_unique
    normals = np.array(mesh.vertex_normals)
    valence = np.bincount(edges.ravel(), minlength=len(normals))[:, None]
    for _ in range(_SMOOTHING):
        around = np.zeros_like(normals)
        np.add.at(around, edges[:, 0], normals[edges[:, 1]])
        np.add.at(around, edges[:, 1], normals[edges[:, 0]])
        normals = 0.5 * normals + 0.5 * around / np.maximum(valence, 1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return solid.vertices + distance * normals, solid.faces


def _refined(vertices: Floats, faces: NDArray[np.int32]) -> tuple[Floats, NDArray[np.int64]]:
    """The surface with each triangle split in four, smoothly (Loop's scheme)."""
    points, triangles = trimesh.remesh.subdivide_loop(vertices, faces, iterations=1)  # type: ignore[no-untyped-call]
    return np.asarray(points), np.asarray(triangles)
