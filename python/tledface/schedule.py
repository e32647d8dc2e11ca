"""Activation over time: alpha(t) in 0..1 for t in seconds, as ramp, keyframes, number or callable.

Every schedule is a callable t -> alpha; ``sample`` evaluates it at many times and checks that the
values are finite and within 0..1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError, shown

__all__ = ["Constant", "Function", "Keyframes", "Ramp", "Schedule", "as_schedule", "ramp"]

# A value this far outside 0..1 is round-off of a callable's arithmetic and is clipped.
_ROUND_OFF = 1e-9
_SHAPES = ("linear", "cosine")


@runtime_checkable
class Schedule(Protocol):
    """Activation over time."""

    def __call__(self, t: float) -> float:
        """The activation at time ``t`` (s)."""

    def sample(self, times: ArrayLike) -> NDArray[np.float64]:
        """The activations at ``times`` (s), same shape; raises InputError outside 0..1."""


@dataclass(frozen=True)
class Constant:
    """The same activation at all times."""

    value: float

    def __post_init__(self) -> None:
        """Check the value."""
        _check_level("activation", self.value)

    def __call__(self, t: float) -> float:
        """The activation at time ``t`` (s)."""
        return self.value

    def sample(self, times: ArrayLike) -> NDArray[np.float64]:
        """The activation for each of ``times`` (s)."""
        return np.full(np.shape(times), self.value, dtype=np.float64)


@dataclass(frozen=True)
class Ramp:
    """From ``start`` to ``end`` within ``over`` seconds from ``begin`` on; level before and after.

    ``shape`` is "linear" or "cosine" (half a cosine wave: no jump in speed at either end).
    """

    start: float
    end: float
    over: float
    begin: float = 0.0
    shape: str = "linear"

    def __post_init__(self) -> None:
        """Check levels and times."""
        _check_level("ramp start", self.start)
        _check_level("ramp end", self.end)
        if not (_is_number(self.over) and self.over > 0.0):
            raise InputError(f"ramp over: got {self.over!r}; allowed: seconds greater than 0")
        if not _is_number(self.begin):
            raise InputError(f"ramp begin: got {self.begin!r}; allowed: a finite number of seconds")
        if self.shape not in _SHAPES:
            raise InputError(f'ramp shape: got {self.shape!r}; allowed: "linear", "cosine"')

    def __call__(self, t: float) -> float:
        """The activation at time ``t`` (s)."""
        return float(self.sample(t))

    def sample(self, times: ArrayLike) -> NDArray[np.float64]:
        """The activations at ``times`` (s), same shape."""
        s = np.clip((np.asarray(times, dtype=np.float64) - self.begin) / self.over, 0.0, 1.0)
        if self.shape == "cosine":
            s = 0.5 - 0.5 * np.cos(math.pi * s)
        # Both ends come out exactly: start (1 - s) + end s, not start + (end - start) s.
        return np.asarray(self.start * (1.0 - s) + self.end * s)


@dataclass(frozen=True)
class Keyframes:
    """Straight lines between (time s, activation) keys in rising time; level outside them."""

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check that there are keys, in rising time, with levels within 0..1."""
        for name in ("times", "values"):
            # Lists and arrays would not compare or be kept as tuples are.
            object.__setattr__(self, name, _plain(getattr(self, name)))
        if len(self.times) != len(self.values) or not self.times:
            raise InputError(
                f"keyframes: got {len(self.times)} times and {len(self.values)} values; "
                "allowed: as many of each, at least one"
            )
        for value in self.values:
            _check_level("keyframes value", value)
        if not all(_is_number(t) for t in self.times) or any(
            late <= early for early, late in zip(self.times, self.times[1:], strict=False)
        ):
            raise InputError(f"keyframes: got times {self.times}; allowed: rising seconds")

    def __call__(self, t: float) -> float:
        """The activation at time ``t`` (s)."""
        return float(self.sample(t))

    def sample(self, times: ArrayLike) -> NDArray[np.float64]:
        """The activations at ``times`` (s), same shape."""
        wanted = np.asarray(times, dtype=np.float64)
        return np.asarray(np.interp(wanted, self.times, self.values), dtype=np.float64)


@dataclass(frozen=True)
class Function:
    """A plain callable t (s) -> activation, called once for each time."""

    function: Callable[[float], float]

    def __call__(self, t: float) -> float:
        """The activation at time ``t`` (s)."""
        return float(self.sample(t))

    def sample(self, times: ArrayLike) -> NDArray[np.float64]:
        """The activations at ``times`` (s), same shape; raises InputError outside 0..1."""
        wanted = np.asarray(times, dtype=np.float64)
        values = np.empty(wanted.shape)
        for index, t in np.ndenumerate(wanted):
            values[index] = self._value(float(t))
        return np.clip(values, 0.0, 1.0)

    def _value(self, t: float) -> float:
        got = self.function(t)
        try:
            value = float(got)
        except (TypeError, ValueError):
            value = math.nan
        if not -_ROUND_OFF <= value <= 1.0 + _ROUND_OFF:
            raise InputError(
                f"activation: the callable gave {shown(got)} at t = {t:g} s; "
                "allowed: a number from 0 to 1"
            )
        return value


def ramp(
    start: float, end: float, over: float, begin: float = 0.0, *, shape: str = "linear"
) -> Ramp:
    """A ramp of activation over time, level before and after.

    Args:
        start, end: Activation before and after, 0 to 1.
        over: How long the change takes, s.
        begin: When it starts, s.
        shape: ``"linear"``, or ``"cosine"``: half a cosine wave, no jump in speed at either end.

    Returns:
        `Ramp`, a callable of t in s.

    Raises:
        InputError: a level outside 0..1, ``over`` not above 0, an unknown shape.

    Example: ``ramp(0, 0.75, 0.05)(0.025)`` is 0.375.
    """
    return Ramp(start, end, over, begin, shape)


def as_schedule(value: float | Callable[[float], float] | Schedule) -> Schedule:
    """A schedule from a number, a callable of t (s), or a schedule; raises InputError else."""
    if isinstance(value, Constant | Ramp | Keyframes | Function):
        return value
    if _is_number(value):
        return Constant(float(value))  # type: ignore[arg-type]
    if isinstance(value, Schedule):
        return value
    if callable(value):
        return Function(value)
    raise InputError(
        f"activation: got {value!r}; allowed: a number from 0 to 1, tf.ramp(...), "
        "or a callable of the time in seconds"
    )


def _plain(values: Any) -> tuple[Any, ...]:
    """A tuple of Python's own numbers."""
    return tuple(values.tolist() if isinstance(values, np.ndarray) else values)


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    return math.isfinite(float(value))


def _check_level(what: str, value: object) -> None:
    if not (_is_number(value) and 0.0 <= float(value) <= 1.0):  # type: ignore[arg-type]
        raise InputError(f"{what}: got {value!r}; allowed: a number from 0 to 1")
