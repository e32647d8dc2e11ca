"""The simulator: a model on a device, stepped explicitly in time.

The C++ core owns the step loop; this class checks what it is given, samples the activations,
keeps the time step below its bound and gives arrays back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core, units
from tledface import device as device_module
from tledface._core_model import (
    checked_field,
    core_model,
    core_sliding,
)
from tledface._model_checks import check_number, is_number
from tledface._results import Results
from tledface._serial import serial
from tledface.autotune import tune, tune_recording
from tledface.conditions import Sampler, Values, prescribed_mask
from tledface.energy import EnergyLedger, energy_interval, ledger_of
from tledface.errors import InputError, SimulationError
from tledface.relaxation import Equilibrium, relax
from tledface.schedule import Constant, as_schedule
from tledface.snapshot import Snapshot
from tledface.subcycling import SUBSTEPS, checked_subcycling
from tledface.time_step import (
    RELIEFS,
    AddedMass,
    StepWatch,
    added_mass,
    checked_scaling,
    checked_time_scaling,
    scaled_density,
    scaling_options,
)

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["Simulator"]

# Of the "joldes" form, where it is not given.
_KAPPA = 0.075


class Simulator(Results):
    """Explicit total Lagrangian simulation of a model.

    Central differences with lumped mass and mass-proportional damping, one integration point an
    element; equations and sources are in docs/explanation/solver.md (Warburton & Maddock 2014,
    section 5; hourglass control: docs/explanation/hourglass.md).

    Args:
        model: The model; it is copied to the device, later changes to it are not seen.
        device: ``"auto"`` (a working GPU, else native), ``"native"``, ``"opencl"``,
            ``"opencl:N"``, a `tledface.device.Device` or a ``pyopencl.Device``.
        precision: ``"single"`` or ``"double"``.
        damping: Mass-proportional damping, 1/s.
        hourglass: ``"physical"`` (bending and twisting stiffness of elasticity, nothing to tune)
            or ``"joldes"`` (kappa form, Joldes, Wittek & Miller 2008).
        hourglass_kappa: kappa of the ``"joldes"`` form, 0.075 if not given; the physical form has
            none.
        dt: Time step in s, or ``"auto"``: 0.8 of the estimated limit, lowered when strain or
            activation lowers the limit.
        mass_scaling: Factor on every density, at least 1; or ``{"dt": seconds}``, which makes only
            those elements heavier that do not allow this step; None is neither. `added_mass` says
            what it added; weight stays that of the true mass.
        time_scaling: Play the conditions this many times faster, at least 1: activations,
            prescribed motions, body forces and pressures that are functions of time get
            `playback_time`, this factor times the simulated time. Everything else is in simulated
            time: `time`, ``dt``, damping, gravity, and the times of materials, of which a
            `tledface.time_step.TimeScalingWarning` tells.
        subcycling: Let each part of the body take the step that its own tissue allows, in powers of
            two: ``dt`` is then the longest step, and stiff parts take up to 16 shorter ones in it,
            `substeps`. True chooses how many, a number (2, 4, 8, 16) fixes it. Pays where little
            of the body is stiff; row kernels only (a `tledface.subcycling.SubcyclingWarning` says
            so elsewhere), see `docs/explanation/subcycling.md`.
        energy_every: Enter the energies in the ledger every so many steps, see `energies`; None
            keeps none. An entry costs as much as some 50 steps.
        kernels: ``"rows"`` (fused vector rows, CPUs), ``"tile"`` (a work-group a tile of columns,
            GPUs), ``"gather"`` (an element a work-item, GPUs), or ``"auto"``, which times the last
            two on a GPU it does not know, see `tledface.autotune`.

    Raises:
        InputError: a value out of range, a ``dt`` above the bound, no such device.

    Sliding nodes keep their distances to their surfaces in every step; `Model.slide` says which rub
    and which may leave.
    """

    def __init__(
        self,
        model: Model,
        *,
        device: Any = "auto",
        precision: str = "single",
        damping: float = 0.0,
        hourglass: str = "physical",
        hourglass_kappa: float | None = None,
        dt: float | str = "auto",
        mass_scaling: float | Mapping[str, float] | None = None,
        time_scaling: float = 1.0,
        subcycling: bool | int = False,
        energy_every: int | None = None,
        kernels: str = "auto",
    ) -> None:
        """See the class."""
        from tledface.model import Model

        if not isinstance(model, Model):
            raise InputError(
                f"Simulator: got {model!r} as model; allowed: a tledface.Model, as "
                "tf.Scene.load(...).build() gives"
            )
        # The core says what is allowed of them, which it takes as text only.
        precision, hourglass, kernels = str(precision), str(hourglass), str(kernels)
        check_number("damping", damping, least=0.0, unit="1/s", most=units.MOST)
        if hourglass_kappa is None:
            kappa = _KAPPA
        elif hourglass == "physical":
            raise InputError(
                f'hourglass_kappa: got {hourglass_kappa!r} with hourglass = "physical", which has '
                'none; allowed: leave it out, or hourglass = "joldes"'
            )
        else:
            check_number(
                "hourglass_kappa", hourglass_kappa, least=0.0, unit="no unit", most=units.MOST
            )
            kappa = float(hourglass_kappa)
        if not isinstance(dt, str):
            check_number("dt", dt, least=0.0, unit="s", exclusive=True)
        scaling = checked_scaling(mass_scaling)
        self._time_scaling = checked_time_scaling(time_scaling, model)
        subcycling = checked_subcycling(subcycling)
        self.model = model
        # What is read again later, as it is now; records, surfaces and muscles never change.
        self._muscles = tuple(model.muscles)
        self._prescribed = prescribed_mask(model)
        self._held = model.fixed | self._prescribed
        self._sliding = model.sliding
        self._options: dict[str, Any] = {
            "precision": precision,
            "damping": float(damping),
            "hourglass": hourglass,
            "hourglass_kappa": kappa,
            "dt": dt if isinstance(dt, str) else float(dt),
            **scaling_options(scaling),
            "kernels": kernels,
        }
        if self._time_scaling != 1.0:
            self._options["time_scaling"] = self._time_scaling
        self._energy_every = energy_interval(energy_every)
        if self._energy_every is not None:
            self._options["energy_every"] = self._energy_every
        self._device = device_module.resolve(device)
        if kernels == "auto" and not model.is_conforming:
            tune(self._device, precision=precision, hourglass=hourglass)
        tune_recording(self._device)
        density = model.element_parameters()["density"]
        self._schedules = [Constant(0.0) for _ in model.muscles]
        surfaces = core_sliding(model)

        def make(relief: float, sliding: _core.SlidingNodes | None) -> NDArray[np.float64]:
            scaled = scaled_density(core_model(model), density, scaling, relief)
            # Weight must not grow with the mass: it goes in as a force where masses are changed.
            heavier = bool((scaled > density).any() and model.gravity.any())
            self._conditions = Sampler(
                model, density if heavier else None, time_scaling=self._time_scaling
            )
            core = _core.Simulator(
                self._device,
                core_model(model, density=scaled, weightless=heavier),
                precision=precision,
                hourglass=hourglass,
                kappa=kappa,
                damping=damping,
                kernels=kernels,
                conditions=self._conditions.core,
                sliding=sliding,
            )
            self._core = serial(core)
            return scaled

        def watch() -> StepWatch:
            return StepWatch(
                self._core,
                self._name_of,
                dt,
                None if isinstance(scaling, dict) else scaling or 1.0,
                len(model.muscles),
                subcycling,
                self._device.info.kind,
            )

        relief = 1.0
        if isinstance(scaling, dict):
            # Tried without sliding nodes, of which the limit knows nothing: what is known of a
            # large surface takes longer to be made ready than all else.
            for relief in RELIEFS[:-1]:
                make(relief, None)
                try:
                    enough = watch().auto_dt >= scaling["dt"]
                except InputError:
                    enough = False
                # Two would not fit a device that one fits.
                del self._core
                if enough:
                    break
            else:
                relief = RELIEFS[-1]
        scaled = make(relief, surfaces)
        self._watch = watch()
        if subcycling is not False:
            self._options["subcycling"] = self.substeps
        self._added_mass = added_mass(density, scaled, model.volumes)
        # What the device's state answers to: nothing before the first step or relaxation.
        self._applied = self._values_of_rest()
        self._start_prescribed()
        self._energies: dict[str, float] | None = None
        self._ledger = (
            None
            if self._energy_every is None
            else ledger_of(
                self._core, model, scaled, self._options, self._conditions.carried, self._name_of
            )
        )
        self._until_entry = 0

    def __repr__(self) -> str:
        """Say what runs where."""
        return (
            f"<Simulator of {self.model.n_elements} elements on {self._device.info.name}, "
            f"t = {self.time:.6g} s, dt = {self.dt:.3g} s>"
        )

    # -- driving ---------------------------------------------------------------------------------

    def activate(self, muscle: str, activation: float | Callable[[float], float]) -> None:
        """Set a muscle's activation from now on; it is 0 until then.

        Args:
            muscle: Its name.
            activation: A number 0..1, `tledface.ramp`, ``tledface.schedule.Keyframes``, or a
                callable of the time in s (`playback_time`) that gives 0..1.

        Raises:
            InputError: no muscle of that name, or a value outside 0..1.
        """
        names = [m.name for m in self._muscles]
        if muscle not in names:
            known = ", ".join(names) if names else "none"
            raise InputError(f"activate: got muscle {muscle!r}; this model has: {known}")
        self._schedules[names.index(muscle)] = as_schedule(activation)

    def step(self, n: int = 1) -> None:
        """Advance ``n`` steps of `dt`; the activations are those at each step's start.

        Args:
            n: Number of steps, 0 or more.

        Raises:
            InputError: ``n`` is no such number, or a callable gave what is not allowed.
            SimulationError: the state is no longer finite.
        """
        if not (isinstance(n, (int, np.integer)) and n >= 0):
            raise InputError(f"step: got {n!r}; allowed: a whole number of steps, 0 or more")
        left = int(n)
        watch = self._watch
        while left > 0:
            batch = min(left, watch.until_check)
            if self._ledger is not None:
                if self._until_entry == 0:
                    self._enter_energies(self._ledger)
                batch = min(batch, self._until_entry)
            activations = self._sampled(np.arange(batch * self.substeps))
            allowed = watch.admitted(activations[:: self.substeps])
            if allowed > 0:
                self._step(activations[: allowed * self.substeps])
                left -= allowed
                self._until_entry -= allowed
                watch.until_check -= allowed
            if allowed < batch or watch.until_check == 0:
                self._require_finite()
                watch.look(self._activations_after, early=allowed < batch)
        if self._ledger is not None and self._until_entry == 0:
            self._enter_energies(self._ledger)

    def run(
        self,
        until: float,
        on_frame: Callable[[Simulator], None] | None = None,
        fps: float | None = None,
        *,
        wait: bool = True,
    ) -> None:
        """Advance to time ``until`` (s), to the nearest step.

        Args:
            until: Simulated time to reach, s.
            on_frame: Called as ``on_frame(sim)`` at each multiple of ``1/fps`` after the start,
                at the step nearest to it; once a step at most.
            fps: Frames a second of simulated time; needed with ``on_frame``.
            wait: Before each ``on_frame``, wait for the device and make sure that the state is
                finite. False: it is called while steps may still be going on, for what needs no
                state or takes a `snapshot`, which makes sure itself.

        Raises:
            InputError: a time that is past, ``on_frame`` without ``fps`` or not to be called.
            SimulationError: the state is no longer finite.
        """
        if not is_number(until):
            raise InputError(f"run: got until = {until!r}; allowed: a finite time in seconds")
        # The nearest step may lie half a step behind the time asked for, of any dt up to now.
        step = self.substeps * self._watch.auto_dt if self._watch.auto else self.dt
        if until < self.time - 0.501 * step:
            raise InputError(
                f"run: got until = {until!r} s; allowed: {self.time:.6g} s, which is now, or "
                "later; set_state starts again"
            )
        if on_frame is not None and not callable(on_frame):
            raise InputError(
                f"run: got on_frame = {on_frame!r}; allowed: a function, called as on_frame(sim)"
            )
        if not (fps is None and on_frame is None) and not (is_number(fps) and fps > 0):
            raise InputError(f"run: got fps = {fps!r}; allowed with on_frame: a positive number")
        frame = 0 if fps is None else math.floor(self.time * fps + 1e-9) + 1
        while (left := round((until - self.time) / self.dt)) > 0:
            if on_frame is None or fps is None:
                self.step(min(left, self._watch.until_check))
                continue
            # A check may change dt, so a frame is approached at most one check at a time.
            to_frame = round((frame / fps - self.time) / self.dt)
            self.step(max(0, min(left, to_frame, self._watch.until_check)))
            if round((frame / fps - self.time) / self.dt) <= 0:
                if wait:
                    self._require_finite()
                on_frame(self)
                # The first that a later step is nearest to: one call a step.
                frame = max(frame, math.floor((self.time + 0.5 * self.dt) * fps)) + 1
        self._require_finite()

    def relax(self, tolerance: float = 1e-4, max_steps: int = 50_000) -> Equilibrium:
        """Find the equilibrium at the activations and conditions of now; time stands still.

        Dynamic relaxation: pseudo-steps with masses that let every node move at its own limit,
        damped critically for the lowest frequency at work. Activations, loads and prescribed
        values go from what acted before to those of now over the first steps. Afterwards the body
        is at rest.

        Args:
            tolerance: Stop when the residual and the displacement still to come are both below
                this share, see `Equilibrium`. Where rounding keeps ``precision="single"`` from it,
                the rest is done in float64, with a second copy of the model on the device.
            max_steps: Give up after so many pseudo-steps; the state reached is kept.

        Returns:
            `Equilibrium`: converged, residual, steps and more. It says so when it gave up.

        Raises:
            InputError: ``tolerance`` or ``max_steps`` out of range.
            SimulationError: the state is no longer finite.
        """
        check_number("tolerance", tolerance, least=0.0, unit="no unit", exclusive=True)
        if not (isinstance(max_steps, (int, np.integer)) and max_steps >= 1):
            raise InputError(f"max_steps: got {max_steps!r}; allowed: a whole number, 1 or more")
        target = self._values_now()
        start = self._applied
        if start.fields.shape != target.fields.shape:
            start = replace(start, fields=target.fields)
        info = relax(
            self._core,
            held=self._held,
            prescribed=self._prescribed,
            sliding=self._sliding,
            edge=self.model.shortest_edge,
            extent=float(np.ptp(self.model.nodes, axis=0).max()),
            start=start,
            target=target,
            tolerance=float(tolerance),
            max_steps=int(max_steps),
        )
        self._applied = target
        self._restart()
        self._require_finite()
        return info

    # -- state -----------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self._core.time)

    @property
    def playback_time(self) -> float:
        """The time that activations and conditions are at, s: `time` times ``time_scaling``."""
        return self.time * self._time_scaling

    @property
    def n_steps(self) -> int:
        """Steps taken since the last given state."""
        return int(self._core.n_steps) // self.substeps

    @property
    def dt(self) -> float:
        """The time step of now, s; ``dt="auto"`` lowers it when strain lowers the bound."""
        return float(self._core.dt) * self.substeps

    @property
    def substeps(self) -> int:
        """How many of the shortest steps a step has; 1 without subcycling."""
        return self._watch.substeps

    @property
    def dt_crit(self) -> float:
        """Estimate of the limit of the (shortest) time step for the state of now, s.

        The largest frequency of the assembled operator by a Lanczos iteration, with a margin: a
        few percent below the true limit; never below the bound of the stiffest node, which is
        all there is while an element is inverted (0 then).
        """
        return float(self._core.measured_limit(self._activations_now())[0])

    @property
    def added_mass(self) -> AddedMass:
        """What mass scaling added: kg, share of the true mass, elements."""
        return self._added_mass

    @property
    def dt_crit_tissue(self) -> str:
        """The tissue, or muscle, whose element sets the bound at rest."""
        return self._name_of(self._watch.critical)

    @property
    def energies(self) -> dict[str, float]:
        """The ledger's last entry, J: at most ``energy_every`` steps old.

        ``kinetic``, ``strain`` (without muscles) and ``hourglass`` are what the body holds;
        ``muscle_work`` (active and passive tension), ``external`` (loads, gravity, supports and
        surfaces that move) what was done on it since the ledger began, ``damping`` and
        ``friction`` what was lost. ``error`` = change of what it holds - external - muscle_work +
        damping + friction. The ledger begins anew with `set_state` and `relax`.

        Raises:
            InputError: there is no ledger.
        """
        if self._ledger is None:
            raise InputError("energies: no ledger is kept; take Simulator(..., energy_every=100)")
        if self._energies is None:
            self._enter_energies(self._ledger)
        assert self._energies is not None
        return dict(self._energies)

    @property
    def device_bytes(self) -> int:
        """Memory of the model's arrays on the device, bytes."""
        return int(self._core.device_bytes)

    def set_state(
        self, u: ArrayLike, velocity: ArrayLike | None = None, *, time: float = 0.0
    ) -> None:
        """Start again from a given state.

        Args:
            u: (n_nodes, 3) m, displacement. Fixed components keep what it gives.
            velocity: (n_nodes, 3) m/s, of this moment; None: rest.
            time: Simulated time of the state, s.

        What laws and sliding nodes keep of their past is forgotten, the ledger begins anew.

        Raises:
            InputError: wrong shape, values or a time that are not finite numbers.
        """
        if not is_number(time):
            raise InputError(f"set_state: got time = {time!r}; allowed: a finite time in seconds")
        shape = (self.model.n_nodes, 3)
        given = checked_field("u", u, shape)
        speed = np.empty(0) if velocity is None else checked_field("velocity", velocity, shape)
        self._core.set_state(given, speed, float(time))
        self._start_prescribed()
        self._applied = self._values_now()
        self._restart()

    def snapshot(self) -> Snapshot:
        """Take the state of now without waiting for the device; the steps may go on at once.

        Returns:
            `tledface.snapshot.Snapshot`: time, displacement and stress of this moment. Keep few:
            each has its own copy of the displacement on the device and on the host.

        Example: ``snap = sim.snapshot(); sim.step(100); snap.u``.
        """
        return Snapshot(self)

    def checkpoint(self, path: str | Path) -> None:
        """Write model, options, schedules and state to an HDF5 file, for `restore`.

        A callable activation is named in the file, not stored. The model must be the one that was
        simulated: leave it alone after making the simulator. docs/reference/checkpoint-file.md has
        the layout.

        Args:
            path: The file; an existing one is replaced once the new one is complete and on disk.

        Raises:
            InputError: no such folder, it is not writable, or the model has a callable that no file
                can hold (`Model.prescribe`, `Model.body_force`, `Model.pressure`,
                `Model.move_surface`).
            OSError: the disk is full; an earlier file of that name stays whole.

        Example: ``sim.checkpoint("c.h5"); sim = tf.Simulator.restore("c.h5")``.
        """
        from tledface import checkpoint

        checkpoint.save(self, path)

    @classmethod
    def restore(
        cls,
        path: str | Path,
        *,
        device: Any = None,
        activations: Mapping[str, float | Callable[[float], float]] | None = None,
    ) -> Simulator:
        """Go on from a `checkpoint`: bit for bit on the same device.

        Args:
            path: The file.
            device: As for the class; None is the device the checkpoint was made on. Another one
                is allowed, with a warning: the same solution, not the same bits.
            activations: Activations by muscle, in place of those in the file; needed for
                callables, which no file can hold.

        Raises:
            InputError: not a checkpoint, damaged, a callable that is not given again, no such
                device.
        """
        from tledface import checkpoint

        return checkpoint.restore(path, device=device, activations=activations)

    # -- inside ----------------------------------------------------------------------------------

    def _step(self, activations: NDArray[np.float64]) -> None:
        """Take as many shortest steps as there are rows of activations."""
        channels, keys = self._conditions_of_steps(len(activations))
        self._core.step(len(activations), activations, channels, keys)
        # Fields are sampled again when they are asked for.
        self._applied = Values(activations[-1], channels[-1], np.empty(0))

    def _restart(self) -> None:
        self._watch.restart()
        self._energies, self._until_entry = None, 0
        if self._ledger is not None:
            self._ledger.restart()

    def _enter_energies(self, ledger: EnergyLedger) -> None:
        sampler, model, core = self._conditions, self.model, self._core
        next_u = np.zeros((model.n_nodes, 3))
        nodes, ways = np.empty(0, dtype=np.int64), np.empty((0, 3))
        node_steps = np.asarray(core.node_steps())
        # Each node's own step ends at its own time.
        for steps in (n for n in SUBSTEPS if n <= self.substeps):
            of_step = node_steps == steps
            if not of_step.any():
                continue
            after = np.zeros_like(next_u)
            sampler.put_prescribed(after, core, steps)
            next_u[of_step] = after[of_step]
            if sampler.carries:
                end = float(core.time_after(steps))
                nodes, after_ways = sampler.carried(model.nodes + self.u, self.time, end)
                ways = ways if len(ways) else np.zeros_like(after_ways)
                ways[of_step[nodes]] = after_ways[of_step[nodes]]
        self._energies = ledger.enter(self._values_now(), next_u, (nodes, ways))
        self._until_entry = self._energy_every or 0

    def _start_prescribed(self) -> None:
        sampler = self._conditions
        if sampler.prescribes:
            self._core.set_prescribed(sampler.scalars(self.time), sampler.fields(self.time))

    def _require_finite(self) -> None:
        if self._core.first_non_finite_node() >= 0:
            raise self._not_finite(self.u, self.n_steps, self.time, self.dt)

    def _not_finite(
        self, u: NDArray[np.float64], n_steps: int, time: float, dt: float
    ) -> SimulationError:
        """The error of a state (n_nodes, 3) seen at a step."""
        lost = np.flatnonzero(~np.isfinite(u).all(axis=1))
        # While few nodes are lost, one of them tells where it began; once the loss has spread, what
        # was stiffest at the last look does.
        element = self._watch.stiffest
        if len(lost) < max(8, self.model.n_nodes // 100):
            element = int(np.flatnonzero((self.model.elements == lost[0]).any(axis=1))[0])
        return SimulationError(
            f"the state is no longer finite: seen at step {n_steps}, t = {time:.6g} s, "
            f"near element {element} ({self._name_of(element)}), dt = {dt:.3g} s, "
            f"dt_crit at the last check = {self._watch.last_bound:.3g} s; take a smaller dt, lower "
            "the activation or raise the damping"
        )

    def _name_of(self, element: int) -> str:
        for muscle in self._muscles:
            if element in muscle.elements:
                return muscle.name
        return self.model.tissue_of(element)
