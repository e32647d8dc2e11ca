"""The energy ledger: where the energy of a run is and what did work on it.

With the velocities v- and v+ half a step before and after u, the kinetic energy is v- M v+ / 2:
with it, kinetic plus strain energy of an undamped linear body is the same at every step of central
difference, to round-off. Works are integrated from entry to entry by the trapezoidal rule, forces
times the change of displacement. Forces and energies are float64 on the host whatever device runs
the steps.

Constitutive laws with a past (Prony, plasticity): what they dissipate shows in ``error``.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tledface import _core
from tledface import device as device_module
from tledface._contact import on_surfaces
from tledface._core_model import core_model
from tledface.conditions import Values, prescribed_mask
from tledface.errors import InputError
from tledface.sliding import Sliding, tangential

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["EnergyLedger", "EnergyWarning", "energy_interval", "ledger_of"]

Floats = NDArray[np.float64]
# Nodes (n,) and ways (n, 3), m.
Carried = tuple[NDArray[np.int64], Floats]

# A run is suspect when hourglass energy is above this share of the strain energy with it (at the
# bending of thin films it may be most of it: see the limit below), or the balance is off by more
# than this share of the energy that has passed through.
_HOURGLASS_LIMIT, _ERROR_LIMIT = 0.5, 0.05
# Shares of next to nothing say nothing: both limits count once this share of the largest kinetic
# plus strain energy so far is reached.
_WORTH = 1e-3
# The first entries of a start from rest are small differences of small numbers.
_FIRST_ENTRIES = 5
_WORST = 3
_ARRAYS = ("u", "external", "muscle", "contact")


class EnergyWarning(RuntimeWarning):
    """The hourglass share or the balance error of a run passed its limit."""


@dataclass(frozen=True)
class _Entry:
    """Energies (J) and forces (N) of one moment."""

    kinetic: float
    strain: float
    hourglass: float
    u: Floats
    external: Floats
    muscle: Floats
    contact: Floats  # (n, 3) of surfaces that move on their nodes
    damping_power: float
    hourglass_by_element: Floats


class EnergyLedger:
    """Energies of a core simulator, entered every some steps.

    Args:
        core: The simulator.
        host: A float64 simulator of the same model on the host, for forces.
        passive: The same without muscles; None where there are none.
        past: The model has laws with a past: their forces come from ``core``, which knows it.
        damping: 1/s.
        held: (n_nodes, 3), fixed or prescribed components.
        sliding: Nodes that slide: surfaces that stand still do no work but by friction.
        nodes: (n_nodes, 3) m, at rest.
        ways: Of surfaces that move, `Sampler.carried`.
        name_of: Name of an element's tissue or muscle.
        volume: (n_elem,) m3.
    """

    def __init__(
        self,
        core: _core.Simulator,
        host: _core.Simulator,
        passive: _core.Simulator | None,
        *,
        past: bool,
        damping: float,
        held: NDArray[np.bool_],
        sliding: Sliding,
        nodes: Floats,
        ways: Callable[[Floats, float, float], Carried],
        name_of: Callable[[int], str],
        volume: Floats,
    ) -> None:
        """See the class."""
        self._core, self._host, self._passive, self._past = core, host, passive, past
        self._damping, self._held, self._sliding = damping, held, sliding
        # Those whose surfaces do more than to take the force along their normals.
        plain = (sliding.friction == 0.0) & ~sliding.release
        plain &= ~np.isin(sliding.surface, sliding.moving)
        self._ruled = sliding.without(sliding.nodes[plain])
        self._nodes, self._ways = nodes, ways
        self._name_of, self._volume = name_of, volume
        self._mass = np.asarray(core.node_masses())[:, None]
        self.restart()

    def restart(self) -> None:
        """Begin anew with the next entry."""
        self._last: _Entry | None = None
        self._start = self._muscle = self._external = self._dissipated = 0.0
        # The core counts from when it was made.
        self._rubbed, self._rubbed_before = 0.0, self._rubbed_in_core()
        self._turnover = self._largest = 0.0
        self._entries = 0
        self._warned: set[str] = set()
        self._last_time = math.nan

    def enter(self, now: Values, prescribed_next: Floats, carried: Carried) -> dict[str, float]:
        """Enter the state of now and return the energies, J.

        Args:
            now: Activations and channels of this moment.
            prescribed_next: (n_nodes, 3) displacement of held components after the next step;
                other components are not read.
            carried: (n,) nodes on surfaces that move, (n, 3) the surface's ways in the next step.
        """
        entry = self._evaluate(now, prescribed_next, carried)
        time = float(self._core.time)
        total = entry.kinetic + entry.strain + entry.hourglass
        if self._last is None:
            self._start = total
        else:
            moved = entry.u - self._last.u
            self._external += _work(self._last.external, entry.external, moved)
            self._external += self._work_of_surfaces(self._last, entry, time)
            self._muscle += _work(self._last.muscle, entry.muscle, moved)
            power = 0.5 * (self._last.damping_power + entry.damping_power)
            self._dissipated += power * (time - self._last_time)
            stored = self._last.kinetic + self._last.strain + self._last.hourglass
            self._turnover += abs(total - stored)
        self._last, self._last_time = entry, time
        in_core = self._rubbed_in_core()
        self._rubbed += in_core - self._rubbed_before
        self._rubbed_before = in_core
        error = total - self._start - self._external - self._muscle + self._dissipated
        error += self._rubbed
        self._largest = max(self._largest, abs(total), abs(self._external), abs(self._muscle))
        self._watch(entry, error)
        return {
            "kinetic": entry.kinetic,
            "strain": entry.strain,
            "hourglass": entry.hourglass,
            "muscle_work": self._muscle,
            "damping": self._dissipated,
            "friction": self._rubbed,
            "external": self._external,
            "error": error,
        }

    def state(self) -> dict[str, Any]:
        """What a restart needs besides the core's state, as numbers and arrays."""
        sums = np.array(
            [
                self._start,
                self._muscle,
                self._external,
                self._dissipated,
                self._turnover,
                self._largest,
                self._last_time,
                self._rubbed,
                self._rubbed_before,
                self._rubbed_in_core(),
            ]
        )
        if self._last is None:
            return {"sums": sums}
        arrays = {key: getattr(self._last, key) for key in _ARRAYS}
        stored = [
            self._last.kinetic,
            self._last.strain,
            self._last.hourglass,
            self._last.damping_power,
        ]
        return {"sums": sums, "stored": np.array(stored), **arrays}

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on from what `state` gave; the core has its state already."""
        (
            self._start,
            self._muscle,
            self._external,
            self._dissipated,
            self._turnover,
            self._largest,
            self._last_time,
            *rubbed,
        ) = map(float, state["sums"])
        # Files of before there was friction have none, later ones no counter.
        self._rubbed = rubbed[0] if rubbed else 0.0
        in_core = self._rubbed_in_core()
        before, counter = rubbed[1:] if len(rubbed) > 1 else (in_core, in_core)
        # A core that could not take its counter over counts from 0: what was rubbed since the last
        # entry is owed still.
        self._rubbed_before = before + (in_core - counter)
        if "stored" in state:
            kinetic, strain, hourglass, power = map(float, state["stored"])
            # Files of before surfaces rubbed while they moved have their forces in `external`.
            none = np.zeros((int(np.isin(self._ruled.surface, self._ruled.moving).sum()), 3))
            arrays = {key: np.asarray(state.get(key, none)) for key in _ARRAYS}
            self._last = _Entry(
                kinetic,
                strain,
                hourglass,
                damping_power=power,
                hourglass_by_element=np.empty(0),
                **arrays,
            )

    def _work_of_surfaces(self, last: _Entry, entry: _Entry, time: float) -> float:
        """Force on each node times the way of the place of the surface that it is on.

        What a node has moved along its surface meanwhile is friction's.
        """
        if not len(entry.contact):
            return 0.0
        _, there = self._ways(self._nodes + last.u, self._last_time, time)
        _, back = self._ways(self._nodes + entry.u, time, self._last_time)
        return 0.5 * float((last.contact * there - entry.contact * back).sum())

    def _rubbed_in_core(self) -> float:
        losses = np.asarray(self._core.friction_losses())
        return float((losses * self._mass[self._sliding.nodes, 0]).sum()) if len(losses) else 0.0

    def _evaluate(self, now: Values, prescribed_next: Floats, carried: Carried) -> _Entry:
        core = self._core
        node_steps = np.asarray(core.node_steps())[:, None]
        dt = float(core.dt) * node_steps
        subcycles = bool((node_steps != node_steps[0]).any())
        u = np.asarray(core.displacement())
        self._host.set_state(u, np.empty(0), 0.0)
        internal = np.asarray(self._host.internal_force(now.activations))
        muscle = np.zeros_like(u)
        if self._passive is not None:
            self._passive.set_state(u, np.empty(0), 0.0)
            muscle = np.asarray(self._passive.internal_force(np.empty(0))) - internal
        if self._past:
            internal = np.asarray(core.internal_force(now.activations))
        loads = np.asarray(core.external_force(now.channels))
        before = np.asarray(core.velocity())
        # Where steps differ, elements of longer ones give their nodes the impulse of all of theirs.
        pushing = internal
        if subcycles:
            pushing = np.asarray(core.weighted_force(now.activations)) / node_steps
        normals = np.asarray(core.sliding_normals())
        acting = tangential(loads - pushing, self._sliding, normals)
        ruled = self._ruled.nodes
        acting[ruled] = (loads - pushing)[ruled]
        half = self._damping * dt / 2
        # `before` of a start is the velocity of this moment: half a step to either side of it.
        gain = dt / 2 if core.starts else dt / (1 + half)
        loss = 1 - half if core.starts else (1 - half) / (1 + half)
        after = before * loss + acting / self._mass * gain
        after = np.where(self._held, (prescribed_next - u) / dt, after)
        contact = np.zeros((len(ruled), 3))
        if len(ruled):
            surface = np.zeros_like(u)
            surface[carried[0]] = carried[1]
            ways, changes = on_surfaces(
                after[ruled] * dt[ruled],
                before[ruled] * dt[ruled],
                surface[ruled],
                normals[np.searchsorted(self._sliding.nodes, ruled)],
                self._ruled,
                self._held[ruled],
            )
            after[ruled] = ways / dt[ruled]
            contact = changes * self._mass[ruled] / (gain * dt)[ruled]
        if core.starts:
            before = 2 * before - after
            before[self._held] = 0.0
        # Supports give held components the motion they have: their force from its equation.
        mean = 0.5 * (before + after)
        inertia = self._mass * ((after - before) / dt + self._damping * mean)
        external = np.where(self._held, inertia + internal, loads)
        state = core.element_state(now.activations)
        hourglass = np.asarray(state["hourglass_density"]) * self._volume
        return _Entry(
            kinetic=0.5 * float((self._mass * before * after).sum()),
            strain=float((np.asarray(state["energy_density"]) * self._volume).sum()),
            hourglass=float(hourglass.sum()),
            u=u,
            external=external,
            muscle=muscle,
            contact=contact[np.isin(ruled, carried[0])],
            damping_power=self._damping * float((self._mass * mean**2).sum()),
            hourglass_by_element=hourglass,
        )

    def _watch(self, entry: _Entry, error: float) -> None:
        deformation = entry.strain + entry.hourglass
        worth = _WORTH * self._largest
        if deformation > worth and entry.hourglass > _HOURGLASS_LIMIT * deformation:
            worst = np.argsort(entry.hourglass_by_element)[::-1][:_WORST]
            places = ", ".join(f"{e} ({self._name_of(int(e))})" for e in worst)
            self._warn(
                "hourglass",
                f"hourglass energy is {entry.hourglass / deformation:.0%} of the strain energy, "
                f"most in elements {places}; take smaller voxels there",
            )
        passed = max(self._largest, self._turnover)
        self._entries += 1
        if self._entries > _FIRST_ENTRIES and abs(error) > _ERROR_LIMIT * passed > 0.0:
            self._warn(
                "error",
                f"the energy balance is off by {abs(error) / passed:.0%} of {passed:.3g} J; take a "
                "smaller dt or enter the energies more often (energy_every)",
            )

    def _warn(self, key: str, message: str) -> None:
        if key not in self._warned:
            self._warned.add(key)
            where = f"t = {float(self._core.time):.6g} s: "
            warnings.warn(where + message, EnergyWarning, stacklevel=5)


def ledger_of(
    core: _core.Simulator,
    model: Model,
    density: Floats,
    options: Mapping[str, Any],
    ways: Callable[[Floats, float, float], Carried],
    name_of: Callable[[int], str],
) -> EnergyLedger:
    """The ledger of a simulator.

    Args:
        core: The simulator.
        model: Its model.
        density: (n_elem,) kg/m3, with mass scaling.
        options: `Simulator`'s; ``hourglass``, ``hourglass_kappa`` and ``damping`` are read.
        ways: Of surfaces that move, `Sampler.carried`.
        name_of: Name of an element's tissue or muscle.
    """
    native = device_module.resolve("native")

    def host(*, muscles: bool) -> _core.Simulator:
        made = _core.Simulator(
            native,
            core_model(model, density=density, weightless=True, muscles=muscles),
            precision="double",
            hourglass=options["hourglass"],
            kappa=options["hourglass_kappa"],
            damping=0.0,
        )
        made.dt = core.dt
        return made

    return EnergyLedger(
        core,
        host(muscles=True),
        host(muscles=False) if model.muscles else None,
        past=bool(model.law_rows()),
        damping=options["damping"],
        held=model.fixed | prescribed_mask(model),
        sliding=model.sliding,
        nodes=model.nodes,
        ways=ways,
        name_of=name_of,
        volume=model.volumes,
    )


def energy_interval(value: Any) -> int | None:
    """The checked number of steps between entries, or None; raises InputError."""
    if value is None:
        return None
    good = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not good or value < 1:
        raise InputError(f"energy_every: got {value!r}; allowed: None, or 1 or more steps")
    return int(value)


def _work(force_before: Floats, force_now: Floats, moved: Floats) -> float:
    return 0.5 * float(((force_before + force_now) * moved).sum())
