"""The time step of a simulation: its limit, looked at again during the run; mass, time scaling."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tledface import _core, units
from tledface.errors import InputError
from tledface.subcycling import SUBSTEPS, choose_substeps

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = [
    "RELIEFS",
    "AddedMass",
    "StepWarning",
    "StepWatch",
    "TimeScalingWarning",
    "added_mass",
    "checked_scaling",
    "checked_time_scaling",
    "scaled_density",
    "scaling_of",
    "scaling_options",
]

Floats = NDArray[np.float64]

# Share of the limit that dt="auto" takes, and the share that it may reach before it is lowered.
# The estimate of the limit is a few percent low itself.
SAFETY, _TAUT = 0.8, 0.88
# Shares of the bound's stiffness that selective mass scaling tries, the first that does is taken.
RELIEFS = (0.5, 0.6, 0.75, 1.0)
# Shortest steps between two looks at the state (finite? the limit for the strain of now?): few at
# first and while the limit moves, up or down, then more. A look costs as much as a step or two.
_FIRST_CHECK, _LAST_CHECK = 8, 512
# Of the limit's logarithm, changes that are no more than its estimate's own.
_STEADY = 0.02
# Until the next look the limit may eat up this share of the room over dt at the pace it had; most
# of an earlier pace is kept from look to look, since tissue that buckles once does so again. Fat
# that folds in a forehead takes a third off the limit within 0.1 ms, between two rises of as much.
_ROOM, _KEPT_PACE = 0.15, 0.75
# An automatic dt is raised by no less than the first factor, up to that of rest, since each change
# costs some accuracy. The iteration that finds out is run when the nodes' bound, which moves less
# than the limit, has risen by the second.
_RAISE, _HOPE = 1.15, 1.02
# Or when the bound alone had lowered it, once looks are this far apart: of a limit that still moves
# the estimate would soon be the bound's again.
_CALM = 64
# Shortest steps from one iteration to the next, by the kind of the device. One takes 1.4 s of a
# host for 500 000 elements, in which its own kernels take some 100 steps and a GPU 30 000; the
# nodes' bound, which is there at once, asks for steps up to a third shorter. Counted, not timed:
# runs repeat bit for bit.
_PAUSE = {"native": 256, "cpu": 256, "gpu": 1 << 15, "accelerator": 1 << 15}
# Shares of a fibre's stretch that it may reach until the next look: contraction stiffens it. Far
# down after an activation has jumped.
_REACH_LOW, _JUMP_LOW, _REACH_HIGH = 0.8, 0.5, 1.1
# An activation this far above those of the last look asks for a new one.
_RISE = 0.05
# Times at which the activations until the next look are sampled.
_AHEAD = 9


class StepWarning(RuntimeWarning):
    """A given dt may be above the limit by now."""


class TimeScalingWarning(RuntimeWarning):
    """Laws with times of their own make the answer depend on time scaling."""


# Inertia a thousand times the tissue's is no longer that of tissue.
_MOST_ADVISED_SCALING = 1000.0


class StepWatch:
    """Looks at the limit every some steps and lowers an automatic dt in time, or raises it again.

    A look takes each activation at its highest until the next one; an activation that rises
    above that brings the next look forward. With subcycling it also says which blocks take which
    step. Steps are whole ones, of as many shortest steps as `substeps`.

    Args:
        core: The simulator.
        name_of: Name of an element's tissue or muscle, for messages.
        dt: "auto", or seconds.
        scaling: The mass scaling where it is one factor, for advice.
        n_muscles: Number of activations.
        subcycling: As checked.
        kind: The device's.

    Raises:
        InputError: ``dt`` is not allowed, or above the limit at rest.
    """

    def __init__(
        self,
        core: _core.Simulator,
        name_of: Callable[[int], str],
        dt: float | str,
        scaling: float | None,
        n_muscles: int,
        subcycling: bool | int = False,
        kind: str = "native",
    ) -> None:
        """See the class."""
        self._core, self._name_of = core, name_of
        self.auto = dt == "auto"
        # A given dt is not to be warned of for what is only a bound; of laws beyond the base ones
        # the bound knows nothing.
        self._pause = _PAUSE.get(kind, 0) if self.auto and not core.has_laws else 0
        rest = np.zeros(n_muscles)
        enough = math.inf if isinstance(dt, str) else float(dt)
        self.rest_limit, _, self.critical, self._rest_bound = core.limit_now(rest, enough)
        self.substeps = 1
        if subcycling is not False and core.can_subcycle and not isinstance(dt, str):
            # The fewest that let the shortest step be as short as it should, or else may.
            fixed = () if subcycling is True else (int(subcycling),)
            self.substeps = next(
                (
                    n
                    for share in (SAFETY, 1.0)
                    for n in fixed or SUBSTEPS
                    if dt <= n * share * self.rest_limit
                ),
                max(fixed or SUBSTEPS),
            )
            subcycling = self.substeps
        core.dt = self._first_dt(dt, scaling) / self.substeps
        self.substeps = choose_substeps(core, subcycling)
        self.warned = False
        self.restart(stale=False)

    @property
    def auto_dt(self) -> float:
        """The shortest step that dt="auto" takes at rest, s."""
        return SAFETY * self.rest_limit

    def restart(self, *, stale: bool = True) -> None:
        """A new state was given: look soon, and before the next step where it is not rest."""
        self._check_after(_FIRST_CHECK)
        self.stale = stale
        self.last_bound, self.stiffest = self.rest_limit, self.critical
        self.pace = 0.0  # of the limit, its logarithm a shortest step
        # The nodes' bound when an iteration last set dt, or last found it not to be worth raising;
        # 0 where the bound alone set it.
        self.bound_then = self._rest_bound
        self.expected = np.zeros(0)
        self.iterated_at = self._core.n_steps

    def admitted(self, activations: Floats) -> int:
        """How many of the next steps, activations (n, n_muscles), the last look allowed for."""
        if self.stale:
            return 0
        expected = self.expected if len(self.expected) else np.zeros(activations.shape[1])
        rising = (activations > expected + _RISE).any(axis=1)
        return int(np.argmax(rising)) if rising.any() else len(activations)

    def look(self, sample: Callable[[NDArray[np.int64]], Floats], *, early: bool = False) -> None:
        """Find the limit of now; lower or raise an automatic dt, or warn of a given one.

        Args:
            sample: The activations after some numbers of steps, (n,) -> (n, n_muscles).
            early: The look was brought forward by a rising activation.
        """
        core = self._core
        self.stale = False
        ahead = np.linspace(0, self._steps(self.check_interval), _AHEAD).astype(np.int64)
        self.expected = sample(ahead).max(axis=0, initial=0.0)
        # Of a given dt nothing is asked once it was warned of.
        enough = core.dt / _TAUT if self.auto else 0.0 if self.warned else core.dt
        low = _JUMP_LOW if early else _REACH_LOW
        waits = core.n_steps - self.iterated_at < self._pause
        iterations = core.limit_iterations
        # After a jump the node bound alone: it leaves room for the strain that comes.
        limit, _, stiffest, bound = core.limit_now(
            self.expected, 0.0 if early or waits else enough, low, _REACH_HIGH
        )
        wide = False
        hopes = bound > _HOPE * self.bound_then if self.bound_then else self.check_interval >= _CALM
        if self.auto and not early and not waits and hopes:
            limit, _, stiffest, bound = core.limit_now(self.expected, math.inf, low, _REACH_HIGH)
            self.bound_then = bound
            wide = min(SAFETY * limit, self.auto_dt) > _RAISE * core.dt
        iterated = core.limit_iterations > iterations
        if iterated:
            self.iterated_at = core.n_steps
        taut = 0.0 < limit < enough
        if self.auto and (taut or wide):
            core.dt = min(SAFETY * limit, self.auto_dt)
            # By the bound alone it may have become too short: an iteration will say.
            self.bound_then = bound if iterated else 0.0
        self._check_after(_FIRST_CHECK if early else self._next_interval(limit))
        self.last_bound, self.stiffest = limit, stiffest
        core.choose_levels()
        if taut and not self.auto and not self.warned:
            self.warned = True
            warnings.warn(
                f"dt = {self.substeps * core.dt:.3g} s may be above the stable limit of now, "
                f"{self.substeps * limit:.3g} s near "
                f"element {stiffest} ({self._name_of(stiffest)}), at t = {core.time:.6g} s; take a "
                "smaller dt, dt='auto' or mass_scaling",
                StepWarning,
                stacklevel=4,
            )

    def _next_interval(self, limit: float) -> int:
        """Shortest steps to the next look, after one that found this limit and set dt."""
        most = min(_LAST_CHECK, 2 * self.check_interval)
        if self.warned or limit == math.inf:  # nothing is to be found any more
            return most
        if not (limit > 0.0 and self.last_bound > 0.0):
            return _FIRST_CHECK
        moved = abs(math.log(limit / self.last_bound))
        moves = moved > _STEADY
        pace = moved / self.check_interval if moves else 0.0
        self.pace = max(pace, _KEPT_PACE * self.pace)
        # A given dt may be beyond all room; what it is looked at for is the warning.
        room = math.log(limit / self._core.dt) if self.auto else -math.log(SAFETY)
        if moves:
            most = self.check_interval // 2
        if self.pace * most > _ROOM * room:
            most = int(_ROOM * room / self.pace)
        return max(_FIRST_CHECK, most)

    def _steps(self, shortest: int) -> int:
        """Whole steps that have so many of the shortest."""
        return -(-shortest // self.substeps)

    def _check_after(self, shortest: int) -> None:
        self.check_interval, self.until_check = shortest, self._steps(shortest)

    def _first_dt(self, dt: float | str, scaling: float | None) -> float:
        if isinstance(dt, str):
            if dt != "auto":
                raise InputError(f"dt: got {dt!r}; allowed: 'auto' or seconds")
            if not math.isfinite(self.rest_limit):
                raise InputError("dt: every node is fixed, nothing can move; free some nodes")
            return self.auto_dt
        limit = self.substeps * self.rest_limit
        if dt > limit:
            scaled = 1.0 if scaling is None else scaling
            factor = scaled * (dt / limit) ** 2
            advice = "a smaller step or 'auto'"
            if scaling is None:
                advice += ", or more mass_scaling"
            elif factor <= _MOST_ADVISED_SCALING:
                advice += f", or mass_scaling = {factor:.2g}"
            raise InputError(
                f"dt: got {dt:.3g} s, above the stable bound {limit:.3g} s set by "
                f"{self._name_of(self.critical)}; take {advice}"
            )
        return float(dt)


@dataclass(frozen=True)
class AddedMass:
    """Mass that mass scaling added.

    Attributes:
        kg: The mass added.
        share: Over the true mass.
        elements: How many elements it went to.
    """

    kg: float
    share: float
    elements: int


def checked_scaling(scaling: Any) -> float | dict[str, float] | None:
    """Mass scaling as given to `Simulator`, checked.

    Returns:
        None; a factor of at least 1 on every density; or ``{"dt": seconds}``.

    Raises:
        InputError: anything else.
    """
    if scaling is None:
        return None
    if isinstance(scaling, Mapping) and set(scaling) == {"dt"} and _is_positive(scaling["dt"]):
        return {"dt": float(scaling["dt"])}
    if _is_positive(scaling) and 1.0 <= scaling <= units.MOST:
        return float(scaling)
    raise InputError(
        f"mass_scaling: got {scaling!r}; allowed: a factor of 1 to {units.MOST:g}, or "
        "{'dt': seconds}"
    )


def scaling_options(scaling: float | dict[str, float] | None) -> dict[str, float]:
    """Mass scaling as plain numbers, for a file; `scaling_of` reads them again."""
    if isinstance(scaling, dict):
        return {"mass_scaling_dt": scaling["dt"]}
    return {"mass_scaling": 1.0 if scaling is None else scaling}


def scaling_of(options: dict[str, Any]) -> dict[str, Any]:
    """The options with what `scaling_options` wrote as an argument of `Simulator` again."""
    rest = dict(options)
    if "mass_scaling_dt" in rest:
        rest["mass_scaling"] = {"dt": rest.pop("mass_scaling_dt")}
    return rest


def scaled_density(
    core_model: _core.VoxelModel,
    density: Floats,
    scaling: float | dict[str, float] | None,
    relief: float = 1.0,
) -> Floats:
    """Density of each element with mass scaling, kg/m3.

    Args:
        core_model: The model, for the stiffness of its elements.
        density: (n_elem,) kg/m3.
        scaling: As `checked_scaling` gives it. ``{"dt": seconds}``: elements whose own bound,
            fibres at their steepest, does not allow dt="auto" this step at rest are made as heavy
            as that needs.
        relief: Share of the stiffness that is taken for that. 1 is sure to do; the bound of an
            element is below the operator's limit, so that less may do too.
    """
    if scaling is None:
        return density
    if isinstance(scaling, dict):
        needed = _core.element_stiffness(core_model) * (scaling["dt"] / SAFETY) ** 2
        return np.maximum(density, relief * needed)
    return density * scaling


def added_mass(density: Floats, scaled: Floats, volumes: Floats) -> AddedMass:
    """What a change of density (n_elem,) kg/m3 adds to elements of these volumes, m3."""
    kg = float(((scaled - density) * volumes).sum())
    return AddedMass(
        kg=kg,
        share=kg / float((density * volumes).sum()),
        elements=int(np.count_nonzero(scaled > density)),
    )


def checked_time_scaling(factor: Any, model: Model) -> float:
    """Time scaling as given to `Simulator`, checked; warns where laws have times of their own.

    Raises:
        InputError: not a factor of at least 1.
    """
    if not _is_positive(factor) or factor < 1.0:
        raise InputError(f"time_scaling: got {factor!r}; allowed: a factor of 1 or more")
    timed = []
    for tissue, material in zip(model.tissues, model.tissue_materials, strict=True):
        if material.prony:
            timed.append(f"prony of {tissue!r}")
        start = material.parameters.get("yield_stress")
        if start != material.parameters.get("yield_stress_end", start):
            timed.append(f"falling yield stress of {tissue!r}")
    if factor > 1.0 and timed:
        warnings.warn(
            f"time_scaling = {factor:g}: times of {', '.join(timed)} are simulated ones, so the "
            f"answer depends on the factor; take 1, or give times {factor:g} times shorter",
            TimeScalingWarning,
            stacklevel=3,
        )
    return float(factor)


def _is_positive(value: Any) -> bool:
    good = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    return good and math.isfinite(value) and value > 0
