"""A moment of a simulation, on its way from the device while the simulation goes on."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tledface.simulator import Simulator

__all__ = ["Snapshot", "von_mises_of"]

Floats = NDArray[np.float64]


class Snapshot:
    """The state of a simulator at one moment; later steps leave it as it is.

    `Simulator.snapshot` gives it at once, also where the device has yet to compute that far;
    reading `u` or a stress waits. May be read in another thread than the simulator's, by one at a
    time.

    Attributes:
        time, playback_time: s, as of `Simulator`.
        n_steps: Steps since the last given state.
        dt: The time step, s.
    """

    def __init__(self, sim: Simulator) -> None:
        """Take the state of now."""
        self.time, self.playback_time = sim.time, sim.playback_time
        self.n_steps, self.dt = sim.n_steps, sim.dt
        self._sim = sim
        self._core = sim._core.snapshot(sim._activations_now())

    @cached_property
    def u(self) -> Floats:
        """Displacement, (n_nodes, 3) m.

        Raises:
            SimulationError: it is not finite.
        """
        u = np.asarray(self._core.displacement())
        if not np.isfinite(u).all():
            raise self._sim._not_finite(u, self.n_steps, self.time, self.dt)
        return u

    def stress(self) -> Floats:
        """Cauchy stress at every element's centre, (n_elem, 6) Pa, as `Simulator.stress`."""
        return np.asarray(self._core.element_state()["stress"])

    def von_mises(self) -> Floats:
        """Von Mises stress of `stress`, (n_elem,) Pa."""
        return von_mises_of(self.stress())


def von_mises_of(stress: Floats) -> Floats:
    """Von Mises stress of stresses (n, 6), xx yy zz xy yz xz, (n,)."""
    xx, yy, zz, xy, yz, xz = stress.T
    direct = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    squared: Floats = 0.5 * direct + 3.0 * (xy**2 + yz**2 + xz**2)
    return np.sqrt(squared)
