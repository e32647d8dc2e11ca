"""The methods of `Model` that let the directions of a tissue's law vary from element to element."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface._model_checks import Floats, floats, show
from tledface.constitutive import Material
from tledface.errors import InputError
from tledface.laws import all_laws

VectorField = ArrayLike | Callable[[Floats], ArrayLike]

# Sine of the angle to the skin's normal from which a line has a direction within the skin.
_LEAST_SINE = 1e-3
# Cosine of the angle between line and normal of natural tension that counts as a right one.
_RIGHT_ANGLE = 1e-3


class DirectionsMixin:
    """Direction fields of a model, and the rows of its laws that they go into."""

    tissues: list[str]
    tissue_materials: list[Material]
    fractions: Floats
    layer_normal: Floats | None
    directions: dict[str, dict[str, Floats]]

    if TYPE_CHECKING:
        fill: Floats | None

        @property
        def centres(self) -> Floats: ...
        @property
        def n_elements(self) -> int: ...

    def set_directions(self, tissue: str, fields: Mapping[str, VectorField]) -> None:
        """Give each element of a tissue its own directions of the law, as Langer lines need them.

        Args:
            tissue: Name of a tissue whose material has directions.
            fields: By name of the direction: those of the law (`tf.materials`), as ``first`` and
                ``second`` of holzapfel_gasser_ogden, and ``line`` and ``normal`` of natural
                tension. Each is (m, 3) for the m elements that hold the tissue, in rising order,
                (n_elem, 3), or a function of those elements' centres (m, 3) that gives (m, 3);
                reference frame, any length. A zero vector leaves the material's own direction.

        A later call replaces the fields that it names. A tissue that gets another material loses
        its fields.

        Raises:
            InputError: no such tissue or direction, another shape, values that are not finite,
                only zeros, or a line and a normal that are not at right angles.

        Example:
            ``line, normal = model.skin_directions((1, 0, 0))``, then
            ``model.set_directions("dermis", {"line": line, "normal": normal})``
        """
        if tissue not in self.tissues:
            raise InputError(
                f"set_directions: got tissue {tissue!r}; allowed: {', '.join(self.tissues)}"
            )
        column = self.tissues.index(tissue)
        material = self.tissue_materials[column]
        known = material.direction_names()
        if not known:
            raise InputError(
                f"set_directions: {tissue!r} is {material.model}, which has no direction; give it "
                "a law with fibres, or pretension"
            )
        if not isinstance(fields, Mapping) or not fields or set(fields) - set(known):
            got = list(fields) if isinstance(fields, Mapping) else fields
            raise InputError(
                f"set_directions: got {got!r} for {tissue!r}; allowed: a dict with some of the "
                f"keys {', '.join(known)}"
            )
        (elements,) = np.nonzero(self.fractions[:, column] > 0.0)
        if len(elements) == 0:
            raise InputError(f"set_directions: no element holds {tissue!r}; fill some first")
        made = {name: self._direction_field(name, v, elements) for name, v in fields.items()}
        together = {**self.directions.get(tissue, {}), **made}
        _check_right_angles(tissue, material, together, elements)
        self.directions[tissue] = together

    def skin_directions(
        self, line: VectorField, normal: VectorField | None = None
    ) -> tuple[Floats, Floats]:
        """Lay a line field into the skin: line and normal of each element, for `set_directions`.

        Args:
            line: Wanted direction, any length: (3,), (n_elem, 3), or a function of the centres
                (n_elem, 3) that gives either. Its part along the normal is taken off.
            normal: Normal of the skin, likewise; None: `layer_normal`.

        Returns:
            line (n_elem, 3), in the plane of the skin, and normal (n_elem, 3), at right angles to
            it; unit vectors, both zero where ``line`` or ``normal`` is zero. Two fibre families at
            an angle a to the line: ``cos(a) * line +- sin(a) * np.cross(normal, line)``.

        Raises:
            InputError: another shape, values that are not finite, no normals in this model, or a
                line that stands upright on the skin in some element.
        """
        if normal is None and self.layer_normal is None:
            raise InputError(
                "skin_directions: the model has no layer_normal; give normal=, or build the scene "
                'with layer_bending = "section"'
            )
        n = self._unit("skin_directions: normal", self.layer_normal if normal is None else normal)
        wanted = self._unit("skin_directions: line", line)
        flat = wanted - (wanted * n).sum(axis=1)[:, None] * n
        both = np.any(wanted, axis=1) & np.any(n, axis=1)
        size = np.linalg.norm(flat, axis=1)
        upright = both & (size < _LEAST_SINE)
        if upright.any():
            element = int(np.argmax(upright))
            raise InputError(
                f"skin_directions: the line {show(wanted[element])} stands upright on the skin in "
                f"element {element} ({np.count_nonzero(upright)} in all); give another line there, "
                "or zero to leave the material's own"
            )
        flat[both] /= size[both, None]
        flat[~both] = 0.0
        return flat, np.where(both[:, None], n, 0.0)

    def law_rows(self) -> list[tuple[str, NDArray[np.int64], Floats]]:
        """Return the laws besides the neo-Hookean base: name, elements, kernel rows.

        Returns:
            For each tissue's law and modifier the elements (m,) that hold the tissue and the rows
            (m, 1 + values): the tissue's fraction times ``fill`` as weight, then the law's values,
            with the directions of `set_directions` where there are any.
        """
        result = []
        for column, material in enumerate(self.tissue_materials):
            (elements,) = np.nonzero(self.fractions[:, column] > 0.0)
            fields = self.directions.get(self.tissues[column], {})
            for name, values in material.rows():
                if len(elements) == 0:
                    continue
                rows = np.empty((len(elements), 1 + len(values)))
                rows[:, 0] = self.fractions[elements, column]
                if self.fill is not None:
                    rows[:, 0] *= self.fill[elements]
                rows[:, 1:] = values
                for direction, first in all_laws()[name].direction_rows.items():
                    if direction in fields:
                        field = fields[direction][elements]
                        own = np.any(field, axis=1)
                        rows[own, 1 + first : 4 + first] = field[own]
                result.append((name, elements.astype(np.int64), rows))
        return result

    def _direction_field(
        self, name: str, values: VectorField, elements: NDArray[np.int64]
    ) -> Floats:
        """(n_elem, 3) unit vectors or zeros, zero in elements without the tissue."""
        what = f"set_directions: {name}"
        given = floats(what, values(self.centres[elements]) if callable(values) else values)
        m = len(elements)
        if given.shape == (self.n_elements, 3):
            given = given[elements]
        if given.shape != (m, 3):
            raise InputError(
                f"{what}: got shape {given.shape}; allowed: ({m}, 3) for the elements that hold "
                f"the tissue, or ({self.n_elements}, 3)"
            )
        field = np.zeros((self.n_elements, 3))
        field[elements] = _unit(what, given, elements)
        if not field.any():
            raise InputError(
                f"{what}: zero in all {m} elements that hold the tissue; a zero vector leaves the "
                "material's own direction"
            )
        return field

    def _unit(self, what: str, values: VectorField | None) -> Floats:
        assert values is not None
        given = floats(what, values(self.centres) if callable(values) else values)
        if given.shape not in ((3,), (self.n_elements, 3)):
            raise InputError(
                f"{what}: got shape {given.shape}; allowed: (3,) or ({self.n_elements}, 3)"
            )
        every = np.broadcast_to(given, (self.n_elements, 3))
        return _unit(what, every, np.arange(self.n_elements))


def _unit(what: str, vectors: Floats, elements: NDArray[np.int64]) -> Floats:
    """The vectors at unit length, zeros kept."""
    good = np.isfinite(vectors).all(axis=1)
    if not good.all():
        index = int(np.argmin(good))
        raise InputError(
            f"{what}: element {elements[index]} has {show(vectors[index])}; allowed: finite "
            "directions"
        )
    length = np.linalg.norm(vectors, axis=1)
    return vectors / np.where(length > 0.0, length, 1.0)[:, None]


def _check_right_angles(
    tissue: str, material: Material, fields: Mapping[str, Floats], elements: NDArray[np.int64]
) -> None:
    """Natural tension needs its line within the plane that its normal stands on."""
    if material.pretension is None:
        return
    pair = []
    for name, own in (("line", material.pretension.line), ("normal", material.pretension.normal)):
        field = fields[name][elements] if name in fields else np.zeros((len(elements), 3))
        pair.append(np.where(np.any(field, axis=1)[:, None], field, own))
    cosine = abs((pair[0] * pair[1]).sum(axis=1))
    bad = cosine > _RIGHT_ANGLE
    if bad.any():
        index = int(np.argmax(bad))
        raise InputError(
            f"set_directions: line {show(pair[0][index])} and normal {show(pair[1][index])} of "
            f"{tissue!r} are not at right angles in element {elements[index]} "
            f"({np.count_nonzero(bad)} in all); give both, as skin_directions makes them"
        )
