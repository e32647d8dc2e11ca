"""The simulator: a model on a device, stepped explicitly in time.

The C++ core owns the step loop; this class checks what it is given, samples the activations,
keeps the time step below its bound and gives arrays back.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface import device as device_module
from tledface.errors import InputError, SimulationError
from tledface.schedule import Constant, Schedule, as_schedule

if TYPE_CHECKING:
    import trimesh

    from tledface.model import Model

__all__ = ["Simulator"]

# Share of the bound that dt="auto" takes. The bound is below the true limit already; the rest is
# for what the fibres and the strain do to the stiffness until the next check.
_SAFETY = 0.9
# Steps between two looks at the state (finite? the bound for the strain of now?): few at first and
# while the bound is falling, then more. A look costs as much as some 20 steps.
_FIRST_CHECK, _LAST_CHECK = 32, 512
# The bound is falling when a look finds it lower than this share of the one before.
_FALLING = 0.98


class Simulator:
    """Explicit total Lagrangian simulation of a model.

    Args:
        model: The voxel model; it is copied to the device, later changes to it are not seen.
        device: ``"auto"`` (a working GPU, else native), ``"native"``, ``"opencl"``,
            ``"opencl:N"``, a `tledface.device.Device` or a ``pyopencl.Device``.
        precision: ``"single"`` or ``"double"``.
        damping: Mass-proportional damping, 1/s.
        hourglass: ``"physical"`` (bending and twisting stiffness of elasticity, nothing to tune)
            or ``"joldes"`` (kappa form, Joldes, Wittek & Miller 2008).
        hourglass_kappa: kappa of the ``"joldes"`` form.
        dt: Time step in s, or ``"auto"``: 0.9 of the bound, lowered when strain lowers the bound.
        mass_scaling: Factor on every density, at least 1; None is 1.
        kernels: ``"rows"`` (fused vector rows, CPUs), ``"gather"`` (an element a work-item, GPUs)
            or ``"auto"``.

    Raises:
        InputError: a value out of range, a ``dt`` above the bound, no such device.
    """

    def __init__(
        self,
        model: Model,
        *,
        device: Any = "auto",
        precision: str = "single",
        damping: float = 0.0,
        hourglass: str = "physical",
        hourglass_kappa: float = 0.075,
        dt: float | str = "auto",
        mass_scaling: float | None = None,
        kernels: str = "auto",
    ) -> None:
        """See the class."""
        _check_number("damping", damping, least=0.0, unit="1/s")
        _check_number("hourglass_kappa", hourglass_kappa, least=0.0, unit="no unit")
        scaling = 1.0 if mass_scaling is None else mass_scaling
        _check_number("mass_scaling", scaling, least=1.0, unit="a factor")
        self.model = model
        self._device = device_module.resolve(device)
        self._mass_scaling = scaling
        self._core = _core.Simulator(
            self._device,
            _core_model(model),
            precision=precision,
            hourglass=hourglass,
            kappa=hourglass_kappa,
            damping=damping,
            mass_scaling=scaling,
            kernels=kernels,
        )
        self._schedules: list[Schedule] = [Constant(0.0) for _ in model.muscles]
        self._rest_bound, _, self._critical_element = self._core.bound_at_rest()
        self._auto_dt = dt == "auto"
        self._core.dt = self._first_dt(dt)
        self._restart_checks()

    def __repr__(self) -> str:
        """Say what runs where."""
        return (
            f"<Simulator of {self.model.n_elements} elements on {self._device.info.name}, "
            f"t = {self.time:.6g} s, dt = {self.dt:.3g} s>"
        )

    # -- driving ---------------------------------------------------------------------------------

    def activate(self, muscle: str, activation: float | Callable[[float], float]) -> None:
        """Set a muscle's activation: a number 0..1, `tledface.ramp`, keyframes or callable(t).

        Raises:
            InputError: no muscle of that name, or a value outside 0..1.
        """
        names = [m.name for m in self.model.muscles]
        if muscle not in names:
            known = ", ".join(names) if names else "none"
            raise InputError(f"activate: got muscle {muscle!r}; this model has: {known}")
        self._schedules[names.index(muscle)] = as_schedule(activation)

    def step(self, n: int = 1) -> None:
        """Advance ``n`` steps of `dt`; the activations are those at each step's start.

        Raises:
            SimulationError: the state is no longer finite.
        """
        if not (isinstance(n, (int, np.integer)) and n >= 0):
            raise InputError(f"step: got {n!r}; allowed: a whole number of steps, 0 or more")
        left = int(n)
        while left > 0:
            batch = min(left, self._until_check)
            self._core.step(batch, self._sampled(batch))
            left -= batch
            self._until_check -= batch
            if self._until_check == 0:
                self._check_state()

    def run(
        self,
        until: float,
        on_frame: Callable[[Simulator], None] | None = None,
        fps: float | None = None,
    ) -> None:
        """Advance to time ``until`` (s), to the nearest step.

        Args:
            until: Time to reach, s.
            on_frame: Called as ``on_frame(sim)`` at each multiple of ``1/fps`` after the start,
                at the step nearest to it.
            fps: Frames a second of simulated time; needed with ``on_frame``.

        Raises:
            SimulationError: the state is no longer finite.
        """
        if not math.isfinite(until):
            raise InputError(f"run: got until = {until!r}; allowed: a finite time in seconds")
        if on_frame is not None and not (fps is not None and math.isfinite(fps) and fps > 0):
            raise InputError(f"run: got fps = {fps!r}; allowed with on_frame: a positive number")
        frame = 0 if fps is None else math.floor(self.time * fps + 1e-9) + 1
        while (left := round((until - self.time) / self.dt)) > 0:
            if on_frame is None or fps is None:
                self.step(min(left, self._until_check))
                continue
            # A check may change dt, so a frame is approached at most one check at a time.
            to_frame = round((frame / fps - self.time) / self.dt)
            self.step(max(0, min(left, to_frame, self._until_check)))
            if round((frame / fps - self.time) / self.dt) <= 0:
                self._require_finite()
                on_frame(self)
                frame = max(frame + 1, math.floor(self.time * fps + 0.5))
        self._require_finite()

    # -- state -----------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self._core.time)

    @property
    def n_steps(self) -> int:
        """Steps taken since the last given state."""
        return int(self._core.n_steps)

    @property
    def dt(self) -> float:
        """The time step of now, s; ``dt="auto"`` lowers it when strain lowers the bound."""
        return float(self._core.dt)

    @property
    def dt_crit(self) -> float:
        """Bound of the time step for the deformation of now, s.

        Per node, from the largest eigenvalue of its elements (lambda + 2 mu, fibre stiffness,
        strain), weighted by mass; below the true limit. 0 when an element is inverted.
        """
        return float(self._core.bound_now()[0])

    @property
    def dt_crit_tissue(self) -> str:
        """The tissue, or muscle, whose element sets the bound at rest."""
        return self._name_of(self._critical_element)

    @property
    def u(self) -> NDArray[np.float64]:
        """Displacement, (n_nodes, 3) m, copied on access."""
        return np.asarray(self._core.displacement())

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocity half a step ago, (n_nodes, 3) m/s."""
        return np.asarray(self._core.velocity())

    @property
    def mass(self) -> NDArray[np.float64]:
        """Lumped nodal mass, (n_nodes,) kg, mass scaling included."""
        return np.asarray(self._core.node_masses())

    @property
    def device_bytes(self) -> int:
        """Memory of the model's arrays on the device, bytes."""
        return int(self._core.device_bytes)

    def set_state(
        self, u: ArrayLike, velocity: ArrayLike | None = None, *, time: float = 0.0
    ) -> None:
        """Start again from a displacement (n_nodes, 3) m and velocity (n_nodes, 3) m/s, or rest.

        Raises:
            InputError: wrong shape or values that are not finite.
        """
        shape = (self.model.n_nodes, 3)
        given = _checked_field("u", u, shape)
        speed = np.empty(0) if velocity is None else _checked_field("velocity", velocity, shape)
        self._core.set_state(given, speed, time)
        self._restart_checks()

    def array(self, name: str) -> Any:
        """Share the device's own array: ``"u"``, (n_blocks + 1, 3, lanes), in solver order.

        On the native device a NumPy view, on OpenCL a ``pyopencl.array.Array`` over the same
        buffer. It is the displacement of now until the next step. `node_slots` tells where each
        node is; axis ``a`` of the solver is axis ``axis_order[a]`` of the model.

        Raises:
            InputError: unknown name, or pyopencl is missing.
        """
        if name != "u":
            raise InputError(f"array: got {name!r}; allowed: 'u'")
        self._core.finish()
        shape = (self._core.n_blocks + 1, 3, self._core.lanes)
        dtype = np.dtype(np.float32 if self._core.single else np.float64)
        if self._core.buffer_handle:
            queue = device_module.pyopencl_queue(self._device)
            import pyopencl
            from pyopencl import array

            buffer = pyopencl.Buffer.from_int_ptr(self._core.buffer_handle, retain=True)
            return array.Array(queue, shape, dtype, data=buffer)
        count = math.prod(shape)
        memory = _HostMemory(self._core.buffer_address, count * dtype.itemsize, self._core)
        return np.asarray(memory).view(dtype).reshape(shape)

    @property
    def node_slots(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(block, lane) of each node in ``array("u")``, each (n_nodes,)."""
        slots = np.asarray(self._core.node_slots())
        return slots // self._core.lanes, slots % self._core.lanes

    @property
    def axis_order(self) -> tuple[int, int, int]:
        """Model axis of each solver axis."""
        a, b, c = self._core.axis_order
        return a, b, c

    def surface(self, name: str) -> trimesh.Trimesh:
        """A bound surface in its deformed place, m.

        Raises:
            InputError: no surface of that name.
        """
        import trimesh

        if name not in self.model.surfaces:
            known = ", ".join(self.model.surfaces) or "none"
            raise InputError(f"surface: got {name!r}; this model has: {known}")
        bound = self.model.surfaces[name]
        return trimesh.Trimesh(bound.displaced(self.u), bound.faces, process=False)

    def deformation_gradient(self) -> NDArray[np.float64]:
        """F at every element's centre, (n_elem, 3, 3)."""
        state = self._core.element_state(self._sampled(1)[0])
        return np.asarray(state["deformation_gradient"]).reshape(-1, 3, 3)

    def stress(self) -> NDArray[np.float64]:
        """Cauchy stress at every element's centre, muscles included, (n_elem, 6) Pa.

        Components xx, yy, zz, xy, yz, xz.
        """
        return np.asarray(self._core.element_state(self._sampled(1)[0])["stress"])

    def strain_energy(self) -> NDArray[np.float64]:
        """Strain energy density of every element without muscles and hourglass, (n_elem,) J/m3."""
        return np.asarray(self._core.element_state(self._sampled(1)[0])["energy_density"])

    def hourglass_energy(self) -> NDArray[np.float64]:
        """Hourglass energy density of every element, (n_elem,) J/m3."""
        return np.asarray(self._core.element_state(self._sampled(1)[0])["hourglass_density"])

    def internal_force(self) -> NDArray[np.float64]:
        """Force of the elements on their nodes, with the device's kernels, (n_nodes, 3) N.

        The sign is that of ``f_int``: a node accelerates by ``-f_int / mass``.
        """
        return np.asarray(self._core.internal_force(self._sampled(1)[0]))

    # -- inside ----------------------------------------------------------------------------------

    def _first_dt(self, dt: float | str) -> float:
        if isinstance(dt, str):
            if dt != "auto":
                raise InputError(f"dt: got {dt!r}; allowed: 'auto' or seconds")
            if not math.isfinite(self._rest_bound):
                raise InputError("dt: every node is fixed, nothing can move; free some nodes")
            return _SAFETY * self._rest_bound
        _check_number("dt", dt, least=0.0, unit="s", exclusive=True)
        if dt > self._rest_bound:
            raise InputError(
                f"dt: got {dt:.3g} s, above the stable bound {self._rest_bound:.3g} s set by "
                f"{self.dt_crit_tissue}; take a smaller step, 'auto', or mass_scaling = "
                f"{self._mass_scaling * (dt / self._rest_bound) ** 2:.2g}"
            )
        return float(dt)

    def _sampled(self, n: int) -> NDArray[np.float64]:
        times = self.time + self.dt * np.arange(n)
        table = np.empty((n, len(self._schedules)))
        for column, schedule in enumerate(self._schedules):
            table[:, column] = schedule.sample(times)
        return table

    def _restart_checks(self) -> None:
        self._check_interval = self._until_check = _FIRST_CHECK
        self._last_bound, self._stiffest = self._rest_bound, self._critical_element

    def _check_state(self) -> None:
        self._require_finite()
        bound, _, stiffest = self._core.bound_now()
        falling = bound < _FALLING * self._last_bound
        self._check_interval = (
            max(_FIRST_CHECK, self._check_interval // 2)
            if falling
            else min(_LAST_CHECK, 2 * self._check_interval)
        )
        self._until_check = self._check_interval
        self._last_bound, self._stiffest = bound, stiffest
        if self._auto_dt and 0.0 < bound < _FALLING * self.dt / _SAFETY:
            self._core.dt = _SAFETY * bound

    def _require_finite(self) -> None:
        if self._core.first_non_finite_node() < 0:
            return
        # By now everything may be NaN; what went first is what was stiffest at the last look.
        raise SimulationError(
            f"the state is no longer finite: step {self.n_steps}, t = {self.time:.6g} s, near "
            f"element {self._stiffest} ({self._name_of(self._stiffest)}), dt = {self.dt:.3g} s, "
            f"dt_crit at the last check = {self._last_bound:.3g} s; take a smaller dt, lower the "
            "activation or raise the damping"
        )

    def _name_of(self, element: int) -> str:
        for muscle in self.model.muscles:
            if element in muscle.elements:
                return muscle.name
        return self.model.tissue_of(element)


class _HostMemory:
    """Memory of a simulator as a buffer that keeps the simulator alive."""

    def __init__(self, address: int, n_bytes: int, owner: object) -> None:
        self._owner = owner
        self.__array_interface__ = {
            "data": (address, False),
            "shape": (n_bytes,),
            "typestr": "|u1",
            "version": 3,
        }


def _core_model(model: Model) -> _core.VoxelModel:
    parameters = model.element_parameters()
    gx, gy, gz = (float(g) for g in model.gravity)
    hx, hy, hz = (float(h) for h in model.voxel)
    core = _core.VoxelModel(
        voxel=(hx, hy, hz),
        cells=model.cells,
        node_ijk=model.node_ijk,
        mu=parameters["mu"],
        bulk_log=parameters["bulk_log"],
        bulk_quadratic=parameters["bulk_quadratic"],
        density=parameters["density"],
        bending_modulus=parameters["bending_modulus"],
        fixed=model.fixed.astype(np.uint8),
        gravity=(gx, gy, gz),
    )
    for muscle in model.muscles:
        core.add_muscle(
            name=muscle.name,
            elements=muscle.elements,
            fibre=muscle.fibre,
            weight=muscle.weight,
            sigma_act=muscle.sigma_act,
            sigma_pas=muscle.sigma_pas,
            lambda_opt=muscle.lambda_opt,
            lambda_pas=muscle.lambda_pas,
        )
    return core


def _check_number(
    name: str, value: float, *, least: float, unit: str, exclusive: bool = False
) -> None:
    good = isinstance(value, (int, float, np.floating, np.integer)) and math.isfinite(value)
    if not good or value < least or (exclusive and value == least):
        bound = f"above {least:g}" if exclusive else f"{least:g} or more"
        raise InputError(f"{name}: got {value!r}; allowed: a number {bound} ({unit})")


def _checked_field(
    name: str, values: ArrayLike, shape: tuple[int, int]
) -> NDArray[np.float64]:
    field = np.asarray(values, dtype=np.float64)
    if field.shape != shape or not np.isfinite(field).all():
        raise InputError(
            f"{name}: got shape {field.shape}; allowed: finite values of shape {shape}"
        )
    return field
