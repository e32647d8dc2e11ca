"""The voxel model: what the solver simulates, as plain NumPy arrays.

A model is a set of occupied cells of a regular grid. Elements are those cells in the order given;
nodes are the corners of occupied cells, numbered with x fastest, then y, then z. Each element
holds the fractions of the tissues in it; muscles, held nodes and bound surfaces refer to elements
and nodes by index.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import units
from tledface._model_checks import (
    Floats,
    Mask,
    checked_block,
    checked_cells,
    checked_fibre,
    checked_fill,
    checked_fractions,
    checked_name,
    checked_section,
    checked_tissues,
    checked_weight,
    show,
    vector,
)
from tledface._model_conditions import ConditionsMixin
from tledface._model_directions import DirectionsMixin
from tledface._model_grid import number_nodes
from tledface._model_tissues import TissuesMixin
from tledface.constitutive import Material
from tledface.errors import InputError
from tledface.muscle import LAWS, Muscle
from tledface.surface import BoundSurface, boundary_surface

if TYPE_CHECKING:
    from tledface.conforming import HexahedralModel

__all__ = ["Model", "Where"]

Where = NDArray[np.bool_] | Callable[[Floats], NDArray[np.bool_]]

# m; volumes of voxels within keep to single precision.
_VOXELS = (1e-9, 1e6)


class Model(TissuesMixin, ConditionsMixin, DirectionsMixin):
    """A voxel model. Make one with `Model.block`, `Model.from_voxels`, a scene, or `Model.load`.

    Attributes:
        voxel: (3,) float64, m, edge lengths of a cell.
        origin: (3,) float64, m, low corner of cell (0, 0, 0).
        cells: (n_elem, 3) int32, grid index of each element.
        elements: (n_elem, 8) int32, node indices in VTK hexahedron order.
        node_ijk: (n_nodes, 3) int32, grid index of each node.
        nodes: (n_nodes, 3) float64, m, reference positions.
        tissues: names of the tissues.
        tissue_materials: the material of each tissue.
        fractions: (n_elem, n_tissues) float64, rows sum to 1.
        section_ratio: (n_elem,) bending over mean modulus of a layered voxel, or None (blended).
        layer_normal: (n_elem, 3) unit normal of the layers in a voxel, or None.
        directions: (n_elem, 3) by tissue, then direction of its law: what `set_directions` gave.
        fill: (n_elem,) what density, stiffness and muscle weights are multiplied by, above 0 to 1,
            or None (all 1): partly filled voxels.
        fixed: (n_nodes, 3) bool, held components: they keep the displacement they start with.
        muscles: the muscles, in the order they were added.
        prescribed, body_forces, pressures: what `prescribe`, `body_force`, `pressure` gave.
        sliding: nodes that slide on surfaces, see `slide`.
        groups: which nodes the entries of a scene's ``[boundary]`` bind, and why.
        report: what the build of a scene found and left out; empty for other models.

    Raises:
        InputError: arrays that are no model, as for `from_voxels`.
    """

    # Elements are hexahedra of any shape (tledface.conforming) instead of voxels.
    is_conforming = False

    def __init__(
        self,
        voxel: ArrayLike,
        origin: ArrayLike,
        cells: ArrayLike,
        tissues: Sequence[str],
        tissue_materials: Sequence[Material],
        fractions: ArrayLike,
        *,
        section_ratio: ArrayLike | None = None,
        layer_normal: ArrayLike | None = None,
        fill: ArrayLike | None = None,
        surfaces: Mapping[str, BoundSurface] | None = None,
    ) -> None:
        """Check and hold the arrays; see `from_voxels` for the arguments."""
        self.voxel = vector("voxel", voxel)
        least, most = _VOXELS
        if not ((self.voxel >= least) & (self.voxel <= most)).all():
            raise InputError(
                f"voxel: got {show(self.voxel)} m; allowed: edges of {least:g} to {most:g} m"
            )
        self.origin = vector("origin", origin)
        self.cells = checked_cells(cells)
        self.node_ijk, self.elements = number_nodes(self.cells)
        self.nodes: Floats = self.origin + self.node_ijk * self.voxel
        names = checked_tissues(tissues, tissue_materials)
        table = checked_fractions(fractions, len(self.cells), names)
        self.section_ratio: Floats | None
        self.layer_normal: Floats | None
        self.section_ratio, self.layer_normal = checked_section(
            section_ratio, layer_normal, len(self.cells)
        )
        self.fill = checked_fill(fill, len(self.cells))
        self._hold(names, list(tissue_materials), table, surfaces)

    def _hold(
        self,
        tissues: list[str],
        tissue_materials: list[Material],
        fractions: Floats,
        surfaces: Mapping[str, BoundSurface] | None,
    ) -> None:
        self.tissues, self.tissue_materials, self.fractions = tissues, tissue_materials, fractions
        self.fixed: Mask = np.zeros((len(self.nodes), 3), dtype=bool)
        self.muscles: list[Muscle] = []
        self._init_conditions()
        self.directions: dict[str, dict[str, Floats]] = {}
        self.report: dict[str, Any] = {}
        self._gravity = np.zeros(3)
        self._surfaces: dict[str, BoundSurface] | None = (
            None if surfaces is None else dict(surfaces)
        )

    @classmethod
    def block(
        cls,
        cells: tuple[int, int, int],
        size: tuple[float, float, float],
        material: Material,
        *,
        tissue: str = "tissue",
    ) -> Model:
        """Return a structured block of one material with its low corner at the origin.

        Args:
            cells: Number of elements along x, y, z, each at least 1.
            size: Edge lengths of the block, m.
            material: Material of every element.
            tissue: Name of that tissue.

        Elements are numbered with x fastest, then y, then z.

        Raises:
            InputError: a count below 1, not whole or beyond the memory, a size that is not
                positive and finite.
        """
        counts = np.asarray(cells)
        if counts.shape != (3,) or counts.dtype.kind not in "iu" or (counts < 1).any():
            raise InputError(f"block cells: got {cells!r}, need three whole numbers of at least 1")
        edges = vector("block size", size)
        if not (edges > 0.0).all():
            raise InputError(f"block size: got {show(edges)} m, every edge must be above 0")
        nx, ny, nz = (int(n) for n in counts)
        checked_block(nx, ny, nz)
        grid = np.empty((nz, ny, nx, 3), dtype=np.int32)
        grid[..., 0] = np.arange(nx)
        grid[..., 1] = np.arange(ny)[:, None]
        grid[..., 2] = np.arange(nz)[:, None, None]
        return cls(
            edges / counts,
            np.zeros(3),
            grid.reshape(-1, 3),
            [tissue],
            [material],
            np.ones((nx * ny * nz, 1)),
        )

    @classmethod
    def from_voxels(
        cls,
        voxel: ArrayLike,
        origin: ArrayLike,
        cells: ArrayLike,
        tissues: Sequence[str],
        tissue_materials: Sequence[Material],
        fractions: ArrayLike,
        *,
        section_ratio: ArrayLike | None = None,
        layer_normal: ArrayLike | None = None,
        fill: ArrayLike | None = None,
        surfaces: Mapping[str, BoundSurface] | None = None,
    ) -> Model:
        """Return a model of the given cells.

        Args:
            voxel: (3,) m, edge lengths of a cell.
            origin: (3,) m, low corner of cell (0, 0, 0).
            cells: (n_elem, 3) int, distinct grid indices of at least 0; their order is kept.
            tissues: Distinct tissue names.
            tissue_materials: One material per tissue.
            fractions: (n_elem, n_tissues), 0 to 1, rows summing to 1.
            section_ratio: (n_elem,) bending over mean modulus of a layered voxel; needs
                ``layer_normal``. None: voxels bend with their mean modulus.
            layer_normal: (n_elem, 3) unit normal of the layers.
            fill: (n_elem,) above 0 to 1, what a partly filled element's density, stiffness and
                muscles are multiplied by; None: 1.
            surfaces: Bound surfaces by name; None gives the boundary of the voxels as "surface".

        Raises:
            InputError: any of the above does not hold; the message names the array and element.
        """
        return cls(
            voxel,
            origin,
            cells,
            tissues,
            tissue_materials,
            fractions,
            section_ratio=section_ratio,
            layer_normal=layer_normal,
            fill=fill,
            surfaces=surfaces,
        )

    @classmethod
    def from_hexahedra(
        cls,
        nodes: ArrayLike,
        elements: ArrayLike,
        tissues: Sequence[str],
        tissue_materials: Sequence[Material],
        fractions: ArrayLike,
    ) -> HexahedralModel:
        """Return a model of distorted hexahedra, a conforming mesh instead of voxels.

        Args:
            nodes: (n_nodes, 3) m, each used by an element.
            elements: (n_elem, 8) int, nodes in VTK hexahedron order.
            tissues, tissue_materials, fractions: as for `from_voxels`.

        Raises:
            InputError: any of the above does not hold, or an element is inside out.
        """
        from tledface.conforming import HexahedralModel

        return HexahedralModel(nodes, elements, tissues, tissue_materials, fractions)

    @classmethod
    def from_mesh(
        cls,
        path: str | Path,
        materials: Material | Mapping[str | int, Material],
        *,
        scale: float = 1.0,
        regions: str | None = None,
    ) -> HexahedralModel:
        """Return a model of the hexahedra of a mesh file (Gmsh, VTK, Abaqus, …; needs meshio).

        Args:
            path: The file; cells of other kinds in it are left out.
            materials: One material, or one for each region, by number or, where the file names
                regions, by name.
            scale: Metres a unit of the file.
            regions: Cell data with region numbers; None looks for the usual names.

        Raises:
            InputError: no such file, meshio is missing or cannot read it, no hexahedron, a region
                without material, an element that is inside out.
        """
        from tledface.conforming import read_mesh

        return read_mesh(path, materials, scale=scale, regions=regions)

    def as_hexahedra(self) -> HexahedralModel:
        """Return the same body as a conforming mesh, with its muscles, held nodes and gravity.

        For bodies whose nodes are to be moved off the grid. Layered voxels lose their section
        modulus; prescribed motion, sliding nodes, loads and bound surfaces are not taken along.
        """
        model = self.from_hexahedra(
            self.nodes, self.elements, self.tissues, self.tissue_materials, self.fractions
        )
        model.fill = self.fill
        model.directions = dict(self.directions)
        model.muscles = list(self.muscles)
        model.fixed[:] = self.fixed
        model.gravity = self.gravity
        return model

    def __repr__(self) -> str:
        """Return a one-line summary."""
        return (
            f"<tledface.{type(self).__name__} {self.n_elements} elements, {self.n_nodes} nodes, "
            f"tissues {self.tissues}, muscles {[m.name for m in self.muscles]}>"
        )

    @property
    def n_elements(self) -> int:
        """Number of elements."""
        return len(self.elements)

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def centres(self) -> Floats:
        """Element centres, (n_elem, 3) m, reference."""
        return self.origin + (self.cells + 0.5) * self.voxel

    @property
    def volumes(self) -> Floats:
        """Volume of each element, (n_elem,) m3."""
        return np.full(self.n_elements, float(np.prod(self.voxel)))

    @property
    def shortest_edge(self) -> float:
        """Shortest edge of an element, m."""
        return float(self.voxel.min())

    @property
    def gravity(self) -> Floats:
        """Acceleration of gravity, (3,) m/s2."""
        return self._gravity

    @gravity.setter
    def gravity(self, value: ArrayLike) -> None:
        gravity = vector("gravity", value)
        if np.abs(gravity).max() > units.MOST:
            raise InputError(
                f"gravity: got {show(gravity)} m/s2; allowed: up to {units.MOST:g} m/s2"
            )
        self._gravity = gravity

    @property
    def surfaces(self) -> dict[str, BoundSurface]:
        """Bound surfaces by name; "surface" is the voxels' own boundary if none was bound."""
        if self._surfaces is None:
            self._surfaces = {"surface": boundary_surface(self)}
        return self._surfaces

    def add_muscle(
        self,
        name: str,
        where: Where,
        fibre: ArrayLike,
        *,
        sigma_act: float,
        sigma_pas: float | None = None,
        lambda_opt: float = 1.0,
        lambda_pas: float = 1.2,
        weight: ArrayLike = 1.0,
        law: str = "tension_length",
    ) -> Muscle:
        """Add a muscle to some elements; several muscles may share an element.

        Args:
            name: Distinct name, used to activate the muscle.
            where: (n_elem,) bool, or a function of the centres (n_elem, 3) m that returns it.
            fibre: Direction, reference frame, any length above 0: (3,), (m, 3) for the m selected
                elements, or (n_elem, 3).
            sigma_act: Reference stress of the active tension, Pa, 0 to 1e15.
            sigma_pas: Reference stress of the passive tension, Pa; None: ``sigma_act``.
            lambda_opt: Stretch of the greatest active tension, 0.1 to 10.
            lambda_pas: Stretch where the passive tension becomes linear, 1 to 10.
            weight: Overlap fraction, 0 to 1: a number, (m,) or (n_elem,).
            law: ``"tension_length"``, ``"tension_length_printed"`` (the paper's passive law with
                its jump at ``lambda_pas``) or ``"calcium"`` (activation is the calcium level,
                ``sigma_act`` its reference stress; no passive tension).

        Returns:
            The muscle, also the last of ``muscles``.

        Raises:
            InputError: any of the above does not hold, or ``where`` selects nothing.
        """
        checked_name("muscle", name)
        if any(muscle.name == name for muscle in self.muscles):
            raise InputError(f"muscle {name!r}: the model has one already; choose another name")
        mask = self._select(where, self.centres, f"muscle {name!r}: where", "element")
        if law not in LAWS:
            raise InputError(f"muscle {name!r}: law must be one of {', '.join(LAWS)}, got {law!r}")
        if law == "calcium" and sigma_pas:
            raise InputError(
                f"muscle {name!r}: the calcium law has no passive tension; leave sigma_pas out"
            )
        if sigma_pas is None:
            sigma_pas = 0.0 if law == "calcium" else sigma_act
        shortest, longest = units.STRETCHES
        for key, value, low, high in (
            ("sigma_act", sigma_act, 0.0, units.MOST),
            ("sigma_pas", sigma_pas, 0.0, units.MOST),
            ("lambda_opt", lambda_opt, shortest, longest),
            ("lambda_pas", lambda_pas, 1.0, longest),
        ):
            number = isinstance(value, Real) and not isinstance(value, bool)
            if not number or not low <= float(value) <= high:
                unit = " Pa" if key.startswith("sigma") else ""
                raise InputError(
                    f"muscle {name!r}: {key}: got {value!r}; allowed: a number from {low:g} to "
                    f"{high:g}{unit}"
                )
        muscle = Muscle(
            name=name,
            elements=np.flatnonzero(mask),
            fibre=checked_fibre(name, fibre, mask),
            weight=checked_weight(name, weight, mask),
            sigma_act=float(sigma_act),
            sigma_pas=float(sigma_pas),
            lambda_opt=float(lambda_opt),
            lambda_pas=float(lambda_pas),
            law=law,
        )
        self.muscles.append(muscle)
        return muscle

    def save(self, path: str | Path) -> None:
        """Write the model to an HDF5 file; docs/reference/model-file.md has the layout.

        Args:
            path: The file; an existing one is replaced once the new one is complete.

        Raises:
            InputError: no such folder, it is not writable, or a condition is a callable, which no
                file can hold.
            OSError: the disk is full; an earlier file of that name stays whole.
        """
        from tledface.io.model_file import save_model

        save_model(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Read a model written by `save`, bit for bit.

        Args:
            path: The file; one of ``tledface build`` does as well.

        Raises:
            InputError: no such file, not a tledface model, an unknown version, or damaged.
        """
        from tledface.io.model_file import load_model

        return load_model(path)

    def _select(self, where: Where, positions: Floats, what: str, unit: str) -> Mask:
        mask = np.asarray(where(positions.copy()) if callable(where) else where)
        if mask.dtype != np.bool_ or mask.shape != (len(positions),):
            raise InputError(
                f"{what} must be ({len(positions)},) bool, one per {unit}, "
                f"got {mask.shape} {mask.dtype}"
            )
        if not mask.any():
            low, high = positions.min(axis=0), positions.max(axis=0)
            raise InputError(
                f"{what} selects none of the {len(positions)} {unit}s; their positions span "
                f"{show(low)} to {show(high)} m"
            )
        return mask
