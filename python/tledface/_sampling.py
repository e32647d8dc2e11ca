"""The part of `Simulator` that samples activations and conditions for the steps to come."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tledface import _core
from tledface.conditions import Sampler, Values

if TYPE_CHECKING:
    from tledface.model import Model
    from tledface.muscle import Muscle
    from tledface.schedule import Schedule

__all__ = ["Sampling"]

Floats = NDArray[np.float64]


class Sampling:
    """Activations and values of conditions, by the clock of the core."""

    model: Model
    _core: _core.Simulator
    _conditions: Sampler
    _schedules: list[Schedule]
    _muscles: tuple[Muscle, ...]
    _time_scaling: float

    if TYPE_CHECKING:

        @property
        def time(self) -> float: ...
        @property
        def substeps(self) -> int: ...

    def _sampled(self, steps: NDArray[np.int64]) -> Floats:
        """Activations at the starts of later steps, counted in shortest ones: (n, n_muscles)."""
        times = self._core.times_after(steps)
        times *= self._time_scaling
        table = np.empty((len(times), len(self._schedules)))
        for column, schedule in enumerate(self._schedules):
            table[:, column] = self._muscles[column].active_share(schedule.sample(times))
        return table

    def _activations_after(self, steps: NDArray[np.int64]) -> Floats:
        """The same, counted in whole steps."""
        return self._sampled(steps * self.substeps)

    def _activations_now(self) -> Floats:
        return np.asarray(self._sampled(np.zeros(1, dtype=np.int64))[0])

    def _conditions_of_steps(self, n: int) -> tuple[Floats, Floats]:
        """Channels of the next ``n`` shortest steps, and keys of the fields."""
        sampler, core = self._conditions, self._core
        if sampler.is_empty:
            return np.empty((n, 0)), np.empty(0)
        channels = sampler.channels_of_steps(core.times_after(np.arange(n + 1)))
        if not sampler.has_fields:
            return channels, np.empty(0)
        span = range(core.first_key(), core.last_key(n) + 1)
        return channels, np.concatenate([sampler.fields(core.key_time(k)) for k in span])

    def _values_now(self) -> Values:
        sampler, now = self._conditions, self.time
        return Values(
            self._activations_now(),
            sampler.channels(now, now),
            sampler.fields(now),
        )

    def _values_of_rest(self) -> Values:
        now = self._values_now()
        return Values(
            np.zeros_like(now.activations),
            self._conditions.channels_of_rest(),
            np.zeros_like(now.fields),
        )
