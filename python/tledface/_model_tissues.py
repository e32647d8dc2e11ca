"""The methods of `Model` about what its elements are made of, and what the solver takes of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tledface._model_checks import Floats, Mask, checked_material, checked_name
from tledface.constitutive import Material
from tledface.errors import InputError

if TYPE_CHECKING:
    from tledface.model import Where


class TissuesMixin:
    """Tissues of a model, their shares in each element, and the means over them."""

    tissues: list[str]
    tissue_materials: list[Material]
    fractions: Floats
    section_ratio: Floats | None
    layer_normal: Floats | None
    directions: dict[str, dict[str, Floats]]

    if TYPE_CHECKING:
        fill: Floats | None

        @property
        def centres(self) -> Floats: ...
        @property
        def n_elements(self) -> int: ...
        def _select(self, where: Where, positions: Floats, what: str, unit: str) -> Mask: ...

    def set_material(self, where: Where, material: Material, *, name: str | None = None) -> None:
        """Fill elements with one material.

        Args:
            where: (n_elem,) bool, or a function of the centres (n_elem, 3) that returns it.
            material: The new material.
            name: Tissue name. A name that no other element uses takes the new material; without
                a name the tissue that has this material is used, or a new one is added.

        Raises:
            InputError: ``where`` is no such mask or selects nothing, or other elements use the
                tissue ``name`` with another material.
        """
        mask = self._select(where, self.centres, "set_material: where", "element")
        checked_material("set_material", material)
        if name is not None:
            checked_name("set_material", name)
        if name is None:
            same = [t for t, m in enumerate(self.tissue_materials) if m == material]
            column = same[0] if same else len(self.tissues)
            name = self.tissues[column] if same else self._unused_tissue_name()
        elif name in self.tissues:
            column = self.tissues.index(name)
            if material != self.tissue_materials[column]:
                if self.fractions[~mask, column].any():
                    raise InputError(
                        f"set_material: tissue {name!r} already has another material in "
                        f"{np.count_nonzero(self.fractions[~mask, column])} other elements; "
                        "choose another name"
                    )
                self.tissue_materials[column] = material
                self.directions.pop(name, None)
        else:
            column = len(self.tissues)
        if column == len(self.tissues):
            self.tissues.append(name)
            self.tissue_materials.append(material)
            self.fractions = np.hstack([self.fractions, np.zeros((self.n_elements, 1))])
        self.fractions[mask] = 0.0
        self.fractions[mask, column] = 1.0
        if self.section_ratio is not None:
            self.section_ratio[mask] = 1.0

    def element_parameters(self) -> dict[str, Floats]:
        """Return the overlap-averaged parameters that the solver takes.

        Returns:
            ``mu``, ``bulk`` (at rest, all laws), ``mu_base`` (the neo-Hookean share of ``mu``),
            ``bulk_log`` and ``bulk_quadratic`` (the share of ``bulk`` in each volumetric form),
            ``youngs_modulus`` (all Pa), ``poissons_ratio``, ``density``
            (kg/m3), each (n_elem,); ``bending_modulus`` (n_elem, 3) Pa, for bending that
            stretches along x, y, z.

        Moduli and density are means weighted by the tissue fractions, times ``fill``; Young's
        modulus and Poisson's ratio follow from the mean mu and bulk. A layered voxel bends with
        the modulus of its section about its own neutral axis,
        ``E (1 - n_a^2 (1 - section_ratio))`` along
        axis ``a`` of the layer normal ``n``.
        """
        materials = self.tissue_materials

        def mean(values: Sequence[float]) -> Floats:
            mean = self.fractions @ np.asarray(values, dtype=np.float64)
            return mean if self.fill is None else self.fill * mean

        base = [m.mu if m.model == "neo_hookean" else 0.0 for m in materials]
        log = mean([m.bulk if m.volumetric == "log" else 0.0 for m in materials])
        quadratic = mean([m.bulk if m.volumetric == "quadratic" else 0.0 for m in materials])
        mu, bulk = mean([m.mu for m in materials]), mean([m.bulk for m in materials])
        youngs_modulus = 9.0 * bulk * mu / (3.0 * bulk + mu)
        bending = np.repeat(youngs_modulus[:, None], 3, axis=1)
        if self.section_ratio is not None and self.layer_normal is not None:
            bending *= 1.0 - self.layer_normal**2 * (1.0 - self.section_ratio[:, None])
        return {
            "mu": mu,
            "mu_base": mean(base),
            "bulk": bulk,
            "bulk_log": log,
            "bulk_quadratic": quadratic,
            "youngs_modulus": youngs_modulus,
            "poissons_ratio": (3.0 * bulk - 2.0 * mu) / (2.0 * (3.0 * bulk + mu)),
            "density": mean([m.density for m in materials]),
            "bending_modulus": bending,
        }

    def tissue_of(self, element: int) -> str:
        """Return the name of the tissue with the largest fraction in an element."""
        return self.tissues[int(np.argmax(self.fractions[element]))]

    def _unused_tissue_name(self) -> str:
        number = len(self.tissues) + 1
        while f"tissue_{number}" in self.tissues:
            number += 1
        return f"tissue_{number}"
