"""What acts on the nodes of a model: prescribed motion, body forces, surface pressure.

`Model.prescribe`, `Model.body_force` and `Model.pressure` check what they are given and keep it as
the plain records here; `Sampler` turns them into the numbers that a simulator takes each step.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface._frame import core_pose
from tledface._model_checks import numbers_of
from tledface.errors import InputError
from tledface.motion import pose_at

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["BodyForce", "Prescribed", "Pressure", "Sampler", "Values"]

Floats = NDArray[np.float64]
Nodes = NDArray[np.int64]
ScalarOfTime = Callable[[float], float]
FieldOfTime = Callable[[float, Floats], ArrayLike]


@dataclass(frozen=True)
class Prescribed:
    """One displacement component of some nodes, m.

    Attributes:
        nodes: (n,) node indices.
        component: 0, 1, 2 for x, y, z.
        value: A number, (n,) numbers, a callable of t (s), or of t and X (n, 3).
        by_node: The value is an array or takes X: one number a node.
    """

    nodes: Nodes
    component: int
    value: float | Floats | ScalarOfTime | FieldOfTime
    by_node: bool

    def without(self, nodes: Nodes) -> Prescribed | None:
        """The same less some nodes; None when nothing is left."""
        keep = ~np.isin(self.nodes, nodes)
        if keep.all():
            return self
        value = self.value[keep] if isinstance(self.value, np.ndarray) else self.value
        return replace(self, nodes=self.nodes[keep], value=value) if keep.any() else None

    def scalar(self, t: float) -> float:
        """The one value of all nodes at time ``t`` (s)."""
        value = cast(ScalarOfTime, self.value)(t) if callable(self.value) else self.value
        return _finite(value, f"prescribe: component {'xyz'[self.component]}", t)

    def field(self, t: float, X: Floats) -> Floats:
        """A value for each node, whose reference positions are ``X`` (n, 3), at ``t`` (s)."""
        if not callable(self.value):
            return cast(Floats, self.value)
        got, wrong = numbers_of(cast(FieldOfTime, self.value)(t, X.copy()), (), (len(X),))
        if wrong:
            raise InputError(
                f"prescribe: component {'xyz'[self.component]}: the callable gave {wrong}, at "
                f"t = {t:g} s; allowed: a finite number or ({len(X)},) of them"
            )
        return np.broadcast_to(got, (len(X),))


@dataclass(frozen=True)
class BodyForce:
    """A force for each volume of some elements.

    Attributes:
        elements: (m,) element indices.
        force: (3,) or (m, 3) N/m3, or a callable of t (s) that gives (3,).
    """

    elements: Nodes
    force: Floats | Callable[[float], ArrayLike]


@dataclass(frozen=True)
class Pressure:
    """A pressure on some boundary faces, along the deformed face's inward normal.

    Attributes:
        faces: (m, 4) node indices, counter-clockwise seen from outside.
        value: Pa, positive pushes inwards: a number or a callable of t (s).
    """

    faces: NDArray[np.int32]
    value: float | ScalarOfTime


def prescribed_of(
    nodes: Nodes, components: dict[str, Any], what: str = "prescribe"
) -> list[Prescribed]:
    """Records of ``{"x": value, ...}``; raises InputError for a bad key or value."""
    if not isinstance(components, dict) or not components or set(components) - set("xyz"):
        raise InputError(
            f"{what}: got components {components!r}; allowed: a dict with some of the keys "
            "'x', 'y', 'z', each a number, an array or a callable"
        )
    records = []
    for name, value in components.items():
        by_node = False
        if callable(value):
            by_node = _takes_positions(value)
        elif isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value):
            value = float(value)
        else:
            array = np.asarray(value)
            good = array.dtype.kind in "iuf" and array.shape == (len(nodes),)
            if not good or not np.isfinite(array).all():
                raise InputError(
                    f"{what}: component {name}: got {value!r}; allowed: metres as a finite "
                    f"number or ({len(nodes)},) of them, callable(t) or callable(t, X)"
                )
            value, by_node = array.astype(np.float64), True
        records.append(Prescribed(nodes, "xyz".index(name), value, by_node))
    return records


@dataclass(frozen=True)
class Values:
    """All that a schedule says of one moment: activations, values of channels, fields."""

    activations: Floats
    channels: Floats
    fields: Floats


@dataclass
class Sampler:
    """The conditions of a model as channels of a core simulator.

    Channels are ordered loads, pressures, prescribed components, poses of surfaces.
    ``weight_density`` (n_elem,) kg/m3: gravity acts as a force on this density instead of as an
    acceleration. Functions of time are called with ``time_scaling`` times the simulated time that
    the methods take.
    """

    model: Model
    weight_density: Floats | None = None
    time_scaling: float = 1.0
    core: _core.Conditions = field(init=False)

    def __post_init__(self) -> None:
        """Enter everything into the core's record."""
        model = self.model
        self.core = _core.Conditions()
        self._loads: list[tuple[Callable[[float], ArrayLike], int] | None] = []
        self._pressures = list(model.pressures)
        self._scalars = [p for p in model.prescribed if not p.by_node]
        self._fields = [p for p in model.prescribed if p.by_node]
        loads = list(model.body_forces)
        if self.weight_density is not None:
            weight = self.weight_density[:, None] * model.gravity
            loads.append(BodyForce(np.arange(model.n_elements), weight))
        for load in loads:
            self._add_body_force(load)
        for pressure in model.pressures:
            self.core.add_pressure(pressure.faces)
        for record in self._scalars:
            self.core.add_prescribed(3 * record.nodes + record.component)
        for record in self._fields:
            self.core.add_fields(3 * record.nodes + record.component)
        self._positions = [model.nodes[record.nodes] for record in self._fields]
        self._sliding = model.sliding  # the model's may be another later
        surfaces = [self._sliding.surfaces[n] for n in self._sliding.moving]
        self._motions = [(s.name, s.motion) for s in surfaces if s.motion is not None]

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to sample."""
        return not (
            self._loads or self._pressures or self._scalars or self._fields or self._motions
        )

    @property
    def has_fields(self) -> bool:
        """Whether nodes of a prescribed record have values of their own."""
        return bool(self._fields)

    @property
    def prescribes(self) -> bool:
        """Whether any component is prescribed."""
        return bool(self._scalars or self._fields)

    def loads(self, t: float) -> Floats:
        """Factors of the loads, then pressures (Pa), at time ``t`` (s)."""
        t *= self.time_scaling
        factors = []
        seen: dict[int, Floats] = {}
        for load in self._loads:
            if load is None:
                factors.append(1.0)
                continue
            force, component = load
            if id(force) not in seen:
                seen[id(force)] = _finite_vector(force(t), "body_force", t)
            factors.append(float(seen[id(force)][component]))
        for pressure in self._pressures:
            value = pressure.value(t) if callable(pressure.value) else pressure.value
            factors.append(_finite(value, "pressure", t))
        return np.array(factors, dtype=np.float64)

    def scalars(self, t: float) -> Floats:
        """Prescribed values that nodes share, m, at time ``t`` (s)."""
        t *= self.time_scaling
        return np.array([record.scalar(t) for record in self._scalars], dtype=np.float64)

    def channels(self, begin: float, end: float) -> Floats:
        """All values of a step between two times (s), or of one moment."""
        return np.asarray(self.channels_of_steps(np.array([begin, end]))[0])

    def channels_of_steps(self, times: Floats) -> Floats:
        """All values of the steps between ``times`` (n + 1,) s, (n, n_channels).

        What stands still is entered for all steps at once; functions are called for each.
        """
        n = len(times) - 1
        n_loads, n_pressures = len(self._loads), len(self._pressures)
        table = np.empty((n, n_loads + n_pressures + len(self._scalars)))
        moments = times.tolist()
        changing = any(load is not None for load in self._loads)
        if changing or any(callable(pressure.value) for pressure in self._pressures):
            for row, begin in zip(table, moments, strict=False):
                row[: n_loads + n_pressures] = self.loads(begin)
        elif n_loads + n_pressures:
            table[:, : n_loads + n_pressures] = self.loads(moments[0])
        for column, record in enumerate(self._scalars, n_loads + n_pressures):
            if callable(record.value):
                ends = moments[1:]
                table[:, column] = [record.scalar(t * self.time_scaling) for t in ends]
            else:
                table[:, column] = record.scalar(moments[-1] * self.time_scaling)
        if not self._motions:
            return table
        at = np.array([self._poses_at(t) for t in moments])  # (n + 1, surfaces, 12)
        poses = np.stack([at[:-1], at[1:]], axis=2).reshape(n, -1)
        return np.concatenate([table, poses], axis=1)

    def channels_of_rest(self) -> Floats:
        """The values where nothing acts."""
        rest = [np.eye(3, 4).ravel()] * (2 * len(self._motions))
        values = np.zeros(len(self._loads) + len(self._pressures) + len(self._scalars))
        return np.concatenate([values, *rest])

    def _poses_at(self, t: float) -> Floats:
        """Poses of the surfaces that move, in the core's frame, at time ``t`` (s)."""
        return np.array(
            [
                core_pose(self.model, pose_at(motion, t * self.time_scaling, f"motion {name!r}"))
                for name, motion in self._motions
            ]
        ).reshape(len(self._motions), 12)

    @property
    def carries(self) -> bool:
        """Whether any surface moves."""
        return bool(self._motions)

    def carried(self, x: Floats, begin: float, end: float) -> tuple[Nodes, Floats]:
        """Nodes on surfaces that move, and the ways (n, 3) m of the surface where they are.

        Args:
            x: (n_nodes, 3) m, where nodes are at ``begin``.
            begin, end: s.
        """
        sliding = self._sliding
        ways = np.zeros((len(sliding), 3))
        for index in sliding.moving:
            motion, on = sliding.surfaces[index].motion, sliding.surface == index
            assert motion is not None
            here, there = (pose_at(motion, t * self.time_scaling, "motion") for t in (begin, end))
            at = x[sliding.nodes[on]]
            material = (at - here[:, 3]) @ here[:, :3]
            ways[on] = material @ there[:, :3].T + there[:, 3] - at
        moves = np.isin(sliding.surface, sliding.moving)
        return sliding.nodes[moves], ways[moves]

    def fields(self, t: float) -> Floats:
        """Prescribed values of each node of the fields, m, at time ``t`` (s)."""
        if not self._fields:
            return np.empty(0)
        t *= self.time_scaling
        pairs = zip(self._fields, self._positions, strict=True)
        return np.concatenate([record.field(t, X) for record, X in pairs])

    def put_prescribed(self, u: Floats, core: _core.Simulator, steps: int = 1) -> None:
        """Set prescribed components of ``u`` (n_nodes, 3) to their values after so many steps."""
        time = core.time_after(steps)
        for record, value in zip(self._scalars, self.scalars(time), strict=True):
            u[record.nodes, record.component] = value
        if not self._fields:
            return
        key = core.last_key(steps) - 1
        begin, end = core.key_time(key), core.key_time(key + 1)
        share = (time - begin) / (end - begin)
        values = (1.0 - share) * self.fields(begin) + share * self.fields(end)
        first = 0
        for record in self._fields:
            count = len(record.nodes)
            u[record.nodes, record.component] = values[first : first + count]
            first += count

    def _add_body_force(self, load: BodyForce) -> None:
        model = self.model
        share = model.volumes[load.elements] / 8.0
        corners = model.elements[load.elements]
        if callable(load.force):
            weight = np.zeros(model.n_nodes)
            np.add.at(weight, corners, share[:, None])
            nodes = np.flatnonzero(weight)
            for component in range(3):
                self.core.add_load(3 * nodes + component, weight[nodes])
                self._loads.append((load.force, component))
            return
        force = np.zeros((model.n_nodes, 3))
        by_element = np.broadcast_to(load.force, (len(load.elements), 3)) * share[:, None]
        np.add.at(force, corners, by_element[:, None, :])
        dofs = np.flatnonzero(force)
        self.core.add_load(dofs, force.ravel()[dofs])
        self._loads.append(None)


def prescribed_mask(model: Model) -> NDArray[np.bool_]:
    """Which components of a model's nodes are prescribed, (n_nodes, 3)."""
    mask = np.zeros((model.n_nodes, 3), dtype=bool)
    for record in model.prescribed:
        mask[record.nodes, record.component] = True
    return mask


def is_scalar_of_time(value: object) -> bool:
    """Whether ``value`` is a callable or a finite number."""
    if callable(value):
        return True
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _takes_positions(function: Callable[..., Any]) -> bool:
    """Whether a callable takes (t, X) rather than (t): by its required arguments."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return False
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    required = [p for p in parameters if p.kind in positional and p.default is p.empty]
    return len(required) > 1


def _finite(value: object, what: str, t: float) -> float:
    number, wrong = numbers_of(value, (), (1,))
    if wrong:
        raise InputError(f"{what}: got {wrong}, at t = {t:g} s; allowed: a finite number")
    return float(number.reshape(-1)[0])


def _finite_vector(value: object, what: str, t: float) -> Floats:
    vector, wrong = numbers_of(value, (3,))
    if wrong:
        raise InputError(f"{what}: got {wrong}, at t = {t:g} s; allowed: three finite numbers")
    return vector
