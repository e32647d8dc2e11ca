"""Models of distorted hexahedra: conforming meshes from mesh generators, next to the voxel models.

Everything but the grid is the same: tissues, muscles, conditions, simulation, output. Elements cost
more than voxels, whose shape functions are constants (docs/explanation/solver.md), so this is for
meshes that exist already and for bodies that voxels approximate badly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface._model_checks import Floats, checked_fractions, checked_tissues, floats, unlike
from tledface.constitutive import Material
from tledface.errors import InputError
from tledface.model import Model

if TYPE_CHECKING:
    import meshio

__all__ = ["HexahedralModel", "read_mesh"]

# Cell data that mesh generators write region numbers to.
_REGION_NAMES = ("gmsh:physical", "medit:ref", "cell_tags", "region", "material", "tissue")


class HexahedralModel(Model):
    """A conforming mesh of hexahedra. Make one with `Model.from_hexahedra` or `Model.from_mesh`.

    Attributes are those of `Model` but for the grid: ``voxel``, ``origin``, ``cells`` and
    ``node_ijk`` are not there, nor the section of layered voxels.
    """

    is_conforming = True

    def __init__(
        self,
        nodes: ArrayLike,
        elements: ArrayLike,
        tissues: Sequence[str],
        tissue_materials: Sequence[Material],
        fractions: ArrayLike,
    ) -> None:
        """Check and hold the arrays; see `Model.from_hexahedra`."""
        points = floats("nodes", nodes)
        fits = points.ndim == 2 and points.shape[1] == 3
        if not fits or not np.isfinite(points).all():
            got = unlike(points, shape_fits=fits)
            raise InputError(f"nodes: got {got}; allowed: finite metres of shape (n, 3)")
        corners = np.asarray(elements)
        if corners.ndim != 2 or corners.shape[1] != 8 or corners.dtype.kind not in "iu":
            raise InputError(
                f"elements: got shape {corners.shape} of {corners.dtype}, need (n, 8) whole "
                "numbers, the nodes of each hexahedron in VTK order"
            )
        if len(corners) == 0:
            raise InputError("elements: got none, at least one hexahedron is needed")
        if corners.min() < 0 or corners.max() >= len(points):
            raise InputError(
                f"elements: node {corners.min()} to {corners.max()} found, allowed 0 to "
                f"{len(points) - 1}"
            )
        unused = len(points) - len(np.unique(corners))
        if unused:
            raise InputError(
                f"nodes: {unused} of {len(points)} belong to no element; leave them out"
            )
        self.nodes = np.array(points)
        self.elements = corners.astype(np.int32)
        self.section_ratio = self.layer_normal = self.fill = None
        names = checked_tissues(tissues, tissue_materials)
        self._hold(
            names,
            list(tissue_materials),
            checked_fractions(fractions, len(corners), names),
            surfaces=None,
        )
        # The core refuses inverted elements and knows the volumes.
        from tledface._core_model import core_model

        core = core_model(self)
        self._volumes, self._edge = np.asarray(core.element_volumes), float(core.shortest_edge)

    def __getattr__(self, name: str) -> Any:
        """Say why a name of the grid is missing."""
        if name in ("voxel", "origin", "cells", "node_ijk"):
            raise AttributeError(f"{name}: a conforming mesh has no grid of voxels")
        raise AttributeError(name)

    @property
    def centres(self) -> Floats:
        """Means of each element's corners, (n_elem, 3) m, reference."""
        return np.asarray(self.nodes[self.elements].mean(axis=1))

    @property
    def volumes(self) -> Floats:
        """Volume of each element, (n_elem,) m3, exact for its trilinear shape."""
        return self._volumes

    @property
    def shortest_edge(self) -> float:
        """Shortest side of the boxes nearest to the elements, m."""
        return self._edge


def read_mesh(
    path: str | Path,
    materials: Material | Mapping[str | int, Material],
    *,
    scale: float = 1.0,
    regions: str | None = None,
) -> HexahedralModel:
    """Read hexahedra with meshio; see `Model.from_mesh`."""
    try:
        import meshio
    except ImportError:
        raise InputError(
            'mesh files need meshio, which is missing; pip install "tledface[mesh]" brings it'
        ) from None
    path = Path(path)
    if not path.is_file():
        raise InputError(f"mesh {path}: no such file")
    if not (np.isfinite(scale) and scale > 0.0):
        raise InputError(f"mesh {path}: scale is {scale!r}, need metres a unit, above 0")
    try:
        mesh = meshio.read(path)
    except SystemExit:  # what meshio does with a file that it cannot read
        raise InputError(f"mesh {path}: meshio cannot read it") from None
    except Exception as error:  # meshio's readers raise whatever they meet
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"mesh {path}: cannot be read ({reason})") from None
    blocks = [i for i, block in enumerate(mesh.cells) if block.type == "hexahedron"]
    if not blocks:
        kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "no cells"
        raise InputError(f"mesh {path}: it has {kinds}; elements of kind 'hexahedron' are needed")
    elements = np.concatenate([mesh.cells[i].data for i in blocks])
    used, corners = np.unique(elements, return_inverse=True)
    region = _regions(mesh, blocks, regions, path) if isinstance(materials, Mapping) else None
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"mesh {path}: its points have shape {points.shape}, need (n, 3)")
    if isinstance(materials, Mapping):
        assert region is not None
        names, laws, fractions = _tissues_of(region, materials, mesh, path)
    else:
        names, laws, fractions = ["tissue"], [materials], np.ones((len(elements), 1))
    try:
        return HexahedralModel(points[used] * scale, corners.reshape(-1, 8), names, laws, fractions)
    except InputError as error:
        raise InputError(f"mesh {path}: {error}") from None


def _regions(
    mesh: meshio.Mesh, blocks: list[int], name: str | None, path: Path
) -> NDArray[np.int64]:
    known = list(mesh.cell_data)
    if name is None:
        name = next((n for n in _REGION_NAMES if n in known), None)
    if name is None or name not in known:
        got = ", ".join(known) if known else "none"
        raise InputError(
            f"mesh {path}: region numbers are needed for several materials; its cell data: {got}; "
            "say which with regions="
        )
    values = np.concatenate([np.asarray(mesh.cell_data[name][i]).reshape(-1) for i in blocks])
    numbers = values.astype(np.int64)
    if not (numbers == values).all():
        raise InputError(f"mesh {path}: cell data {name!r} are not whole numbers")
    return numbers


def _tissues_of(
    region: NDArray[np.int64],
    materials: Mapping[str | int, Material],
    mesh: meshio.Mesh,
    path: Path,
) -> tuple[list[str], list[Material], Floats]:
    # Names of regions, where the file has them: name -> (number, dimension). Groups of surfaces
    # have numbers of their own.
    names_of = {}
    for name, data in mesh.field_data.items():
        number, *dimension = np.asarray(data).reshape(-1).tolist()
        if dimension in ([], [3]):
            names_of[int(number)] = name
    names, laws, fractions = [], [], []
    for number in np.unique(region).tolist():
        name = names_of.get(number, str(number))
        law = materials.get(number, materials.get(name))
        if law is None:
            given = ", ".join(map(repr, materials)) or "none"
            raise InputError(
                f"mesh {path}: region {name!r} has no material; materials were given for {given}"
            )
        names.append(name)
        laws.append(law)
        fractions.append((region == number).astype(np.float64))
    return names, laws, np.stack(fractions, axis=1)
