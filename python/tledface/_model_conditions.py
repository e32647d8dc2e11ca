"""The methods of `Model` that say what acts on its nodes and faces from outside."""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Real
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core, units
from tledface._model_checks import Floats, Mask, floats, show, unlike
from tledface.conditions import (
    BodyForce,
    Prescribed,
    Pressure,
    is_scalar_of_time,
    prescribed_mask,
    prescribed_of,
)
from tledface.errors import InputError
from tledface.motion import Motion, checked_motion
from tledface.sliding import NodeGroup, Sliding, SlidingSurface

if TYPE_CHECKING:
    import trimesh

    from tledface.model import Model, Where

WhereFaces = NDArray[np.bool_] | Callable[[Floats, Floats], NDArray[np.bool_]]

# A node nearer than this (m) to the surface that it may leave lies on it, on the outer side.
_ON_SURFACE = 1e-9
# Cosine between a surface's normal and the way to it, below which it is not known from which side.
_BESIDE = 1e-3
# Of a voxel's shortest edge: how far leaving slivers out may move the rim of a surface.
_SLIVER = 1e-4


class ConditionsMixin:
    """Held, prescribed and sliding nodes, body forces, pressures of a model."""

    fixed: Mask
    sliding: Sliding
    groups: list[NodeGroup]
    prescribed: list[Prescribed]
    body_forces: list[BodyForce]
    pressures: list[Pressure]

    if TYPE_CHECKING:
        nodes: Floats
        elements: NDArray[np.int32]

        @property
        def centres(self) -> Floats: ...
        @property
        def shortest_edge(self) -> float: ...
        @property
        def n_elements(self) -> int: ...
        def _select(self, where: Where, positions: Floats, what: str, unit: str) -> Mask: ...

    def _init_conditions(self) -> None:
        self.prescribed, self.body_forces, self.pressures = [], [], []
        self.sliding, self.groups = Sliding(), []

    def fix(self, where: Where, components: str = "xyz") -> None:
        """Hold nodes at the displacement they start with; repeated calls add up.

        That is zero, or what `Simulator.set_state` gives.

        A component that was prescribed is held from now on; a node held or prescribed in all
        three slides no longer.

        Args:
            where: (n_nodes,) bool, or a function of the nodes (n_nodes, 3) that returns it.
            components: Which components to hold, letters of "xyz".

        Raises:
            InputError: ``where`` is no such mask or selects nothing, or an unknown component.
        """
        if not isinstance(components, str) or not components or set(components) - set("xyz"):
            raise InputError(f"fix: components must be letters of 'xyz', got {components!r}")
        mask = self._select(where, self.nodes, "fix: where", "node")
        for component in map("xyz".index, set(components)):
            self._release(np.flatnonzero(mask), component)
            self.fixed[mask, component] = True
        self._end_sliding()

    def prescribe(self, where: Where, components: dict[str, Any]) -> None:
        """Move components of nodes as given; components left out stay as they were.

        Where nodes were fixed or prescribed in a component before, the last call holds.

        Args:
            where: (n_nodes,) bool, or a function of the nodes (n_nodes, 3) that returns it.
            components: Displacement in m by component, such as ``{"x": 1e-3}``: a number, an
                array (n,) for the n selected nodes in rising order, ``callable(t)`` that gives a
                number, or ``callable(t, X)`` that gives a number or (n,), X (n, 3) being the
                selected nodes' reference positions. A callable with two required arguments
                counts as the latter. Values of ``callable(t)`` are exact at every step; those of
                ``callable(t, X)`` are linear between keys eight steps apart.

        Raises:
            InputError: ``where`` is no such mask or selects nothing, or an unknown component or
                value.

        A simulator starts with these components at their values of its first moment.

        Example:
            ``model.prescribe(lambda X: X[:, 2] > 0.99e-2, {"z": lambda t: -1e-3 * t})``
        """
        mask = self._select(where, self.nodes, "prescribe: where", "node")
        for record in prescribed_of(np.flatnonzero(mask), components):
            self._release(record.nodes, record.component)
            self.fixed[mask, record.component] = False
            self.prescribed.append(record)
        self._end_sliding()

    def slide(
        self,
        where: Where,
        surface: trimesh.Trimesh,
        name: str | None = None,
        *,
        friction: float = 0.0,
        release: bool = False,
    ) -> NDArray[np.float64]:
        """Let nodes slide on a surface at the distance that each has now.

        Args:
            where: (n_nodes,) bool, or a function of the nodes (n_nodes, 3) that returns it.
            surface: Triangles in m and the model's frame, open or closed; equal vertices are
                merged, and slivers at an open rim left out (`SlidingSurface.without_slivers`).
            name: Name of the surface in `sliding`; None: "surface 1" and so on.
            friction: Coulomb's coefficient, with the force that keeps the distance as the normal
                one, pull or push.
            release: Whether the nodes may leave the surface (no retaining ligament): they are
                kept from coming nearer than now, and from nothing else. Those on it are on its
                outer side.

        Returns:
            (n,) m, the distances of the selected nodes in rising order, negative behind the
            surface.

        Raises:
            InputError: ``where`` is no such mask or selects nothing, no such surface, another
                one has that name, a friction below 0, or nodes beyond the surface's open rim that
                are on neither side of it: in its plane, or seen from both sides by parts of it
                that are as near.

        Components held or prescribed stay so (a symmetry plane that meets a bone), but a node of
        which all three are is released from them: the last call holds. Nodes that slide elsewhere
        change over.

        Example: ``model.slide(lambda X: X[:, 2] < 1e-6, trimesh.load("bone.stl"))``
        """
        mask = self._select(where, self.nodes, "slide: where", "node")
        if name is None:
            taken = {known.name for known in self.sliding.surfaces}
            number = len(taken) + 1
            while (name := f"surface {number}") in taken:
                number += 1
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"slide: name must be a non-empty text, got {name!r}")
        if not (isinstance(friction, Real) and math.isfinite(friction) and friction >= 0.0):
            raise InputError(f"slide: friction: got {friction!r}; allowed: a number, 0 or more")
        if not isinstance(release, (bool, np.bool_)):
            raise InputError(f"slide: release: got {release!r}; allowed: True or False")
        nodes = np.flatnonzero(mask)
        X = self.nodes[nodes]
        ground = SlidingSurface.of(name, surface).without_slivers(
            (X.min(axis=0) + X.max(axis=0)) / 2, _SLIVER * self.shortest_edge
        )
        found = _core.nearest_surfaces([(ground.vertices, ground.faces)], X, 0.0)
        beside = np.flatnonzero(_is_beside(ground, X, found))
        if len(beside):
            raise InputError(
                f"slide: {len(beside)} of {len(nodes)} nodes, such as that at "
                f"{show(X[beside[0]])} m, lie beyond the open rim of {name!r} on neither side "
                "of what is nearest there; allowed: nodes above or below it; select others, or "
                "give a surface that reaches further, without small flaps at its rim"
            )
        self._slide(nodes, found["distance"], ground, friction=float(friction), release=release)
        return found["distance"]

    def move_surface(self, name: str, motion: Motion) -> None:
        """Move a surface that nodes slide on, such as a jaw, as a rigid body.

        Args:
            name: The surface's name in `sliding`.
            motion: `tledface.RigidMotion`, or ``callable(t)`` that gives the pose at t (s), (3, 4)
                or (4, 4): x = rotation . X + translation, m. The identity at t = 0.

        Raises:
            InputError: no surface of that name, or no such motion.

        Example: ``model.move_surface("jaw", tf.RigidMotion(hinge, (1, 0, 0), 0.2, share=opening))``
        """
        motion = checked_motion(motion, f"move_surface {name!r}")
        self.sliding = self.sliding.with_motion(name, motion)

    def _slide(
        self,
        nodes: NDArray[np.int64],
        distance: Floats,
        ground: SlidingSurface,
        *,
        friction: float = 0.0,
        release: bool = False,
    ) -> None:
        if release:
            # Of a node on its surface rounding must not say from which side it is kept.
            distance = np.where(np.abs(distance) < _ON_SURFACE, 0.0, distance)
        self.sliding = self.sliding.having(
            nodes, distance, ground, friction=friction, release=bool(release)
        )
        held = self.fixed | prescribed_mask(cast("Model", self))
        rigid = nodes[held[nodes].all(axis=1)]
        for component in range(3):
            self._release(rigid, component)
        self.fixed[rigid] = False

    def _end_sliding(self) -> None:
        if len(self.sliding):
            held = self.fixed | prescribed_mask(cast("Model", self))
            self.sliding = self.sliding.without(np.flatnonzero(held.all(axis=1)))

    def body_force(self, where: Where, force: ArrayLike | Callable[[float], ArrayLike]) -> None:
        """Add a force in the volume of some elements; repeated calls add up.

        Args:
            where: (n_elem,) bool, or a function of the centres (n_elem, 3) that returns it.
            force: N/m3 of reference volume: (3,), (m, 3) for the m selected elements,
                (n_elem, 3), or ``callable(t)`` that gives (3,).

        Raises:
            InputError: ``where`` is no such mask or selects nothing, or another shape.
        """
        mask = self._select(where, self.centres, "body_force: where", "element")
        elements = np.flatnonzero(mask)
        if callable(force):
            self.body_forces.append(BodyForce(elements, force))
            return
        values = floats("body_force: force", force)
        if values.shape == (self.n_elements, 3):
            values = values[mask]
        fits = values.shape in ((3,), (len(elements), 3))
        if not fits or not np.isfinite(values).all():
            raise InputError(
                f"body_force: got {unlike(values, shape_fits=fits)}; allowed: finite N/m3, (3,) "
                f"for all of the {len(elements)} selected elements, ({len(elements)}, 3) for each, "
                f"or ({self.n_elements}, 3) for each of the model"
            )
        if np.abs(values).max() > units.MOST:
            raise InputError(
                f"body_force: got {np.abs(values).max():g} N/m3; allowed: up to {units.MOST:g} N/m3"
            )
        self.body_forces.append(BodyForce(elements, values))

    def boundary(self) -> tuple[NDArray[np.int32], Floats, Floats]:
        """The exposed faces of the voxels: what `pressure` selects from.

        Returns:
            nodes (n, 4), counter-clockwise seen from outside; centres (n, 3) m; outward unit
            normals (n, 3). The reference state.
        """
        from tledface.surface import boundary_faces

        faces = boundary_faces(cast("Model", self))
        corner = self.nodes[faces]
        area = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
        return faces, corner.mean(axis=1), area / np.linalg.norm(area, axis=1)[:, None]

    def pressure(self, where: WhereFaces, value: float | Callable[[float], float]) -> None:
        """Add a pressure on boundary faces; repeated calls add up.

        The pressure follows the body: its force is along the normal of the deformed face and in
        proportion to its deformed area.

        Args:
            where: (n,) bool over the faces of `boundary`, or a function of their centres (n, 3)
                and outward normals (n, 3) that returns it.
            value: Pa, positive pushes inwards: a number or ``callable(t)``.

        Raises:
            InputError: ``where`` is no such mask or selects nothing, or another value.
        """
        faces, centres, normals = self.boundary()
        mask = np.asarray(where(centres, normals) if callable(where) else where)
        if mask.dtype != np.bool_ or mask.shape != (len(faces),):
            raise InputError(
                f"pressure: where must be ({len(faces)},) bool, one per boundary face, "
                f"got {mask.shape} {mask.dtype}"
            )
        if not mask.any():
            raise InputError(
                f"pressure: where selects none of the {len(faces)} boundary faces; their centres "
                f"span {show(centres.min(axis=0))} to {show(centres.max(axis=0))} m"
            )
        if not is_scalar_of_time(value) or (isinstance(value, Real) and abs(value) > units.MOST):
            raise InputError(
                f"pressure: got {value!r}; allowed: Pa as a number up to {units.MOST:g}, or "
                "callable(t)"
            )
        self.pressures.append(Pressure(faces[mask], value))

    def _release(self, nodes: NDArray[np.int64], component: int) -> None:
        kept = [r.without(nodes) if r.component == component else r for r in self.prescribed]
        self.prescribed = [record for record in kept if record is not None]


def _is_beside(
    ground: SlidingSurface, X: Floats, found: _core._NearestSurfaces
) -> NDArray[np.bool_]:
    """Which nodes (n, 3) are on neither side of a surface, beyond its open rim.

    They are in the plane of what is nearest there; or a shift of ``_BESIDE`` of the way to it makes
    another part the nearest, which sees them from its other side.
    """
    distance = found["distance"]
    reach = np.abs(distance)
    above = np.einsum("ij,ij->i", X - found["point"], found["normal"])
    beside = np.asarray(np.abs(above) < _BESIDE * reach)
    if ground.is_open:
        shifts = np.concatenate([np.eye(3), -np.eye(3)])[:, None] * _BESIDE * reach[:, None]
        there = _core.nearest_surfaces(
            [(ground.vertices, ground.faces)], (X + shifts).reshape(-1, 3), 0.0
        )
        sides = there["distance"].reshape(6, -1) < 0.0
        beside |= (sides != (distance < 0.0)).any(axis=0)
    return beside & (reach > _ON_SURFACE)
