"""When the watch looks at the limit again, on a limit that moves by script."""

import math

import numpy as np
import pytest

from tledface.time_step import SAFETY, StepWarning, StepWatch

# Time, ms, and limit, us, of a forehead whose fat folds under the lower edge of frontalis while the
# brow rises (`tledface demo forehead`, 539 727 elements).
FOLDING = np.array(
    [
        (0.0, 4.96), (1.086, 4.94), (2.171, 4.49), (2.630, 4.29), (3.320, 3.87), (3.617, 3.50),
        (3.745, 2.91), (4.017, 3.00), (4.191, 2.50), (4.321, 3.10), (4.581, 2.56), (4.775, 2.20),
        (4.988, 2.09), (5.397, 1.88), (5.679, 1.57), (5.840, 1.66), (5.920, 1.45), (6.047, 1.45),
        (6.157, 1.91), (6.186, 1.90), (6.273, 1.68), (6.324, 1.53), (6.401, 1.72), (6.461, 1.40),
        (6.477, 1.54), (6.496, 1.39), (6.519, 1.48), (6.547, 1.22), (6.564, 1.15), (6.587, 1.20),
        (6.693, 1.27), (6.764, 1.06), (6.817, 1.06), (6.885, 1.44), (6.916, 1.75), (6.929, 1.87),
        (6.942, 2.16), (6.954, 2.36), (6.969, 2.63), (6.984, 2.29), (7.014, 2.30), (7.109, 2.58),
        (7.173, 2.39), (7.315, 2.58), (7.475, 1.89), (7.512, 1.77), (7.589, 1.95), (7.689, 1.95),
        (7.822, 2.22), (7.919, 1.88), (8.010, 1.76), (8.110, 1.69), (8.904, 1.59), (9.246, 1.63),
        (9.930, 2.39), (12.0, 2.40),
    ]
)  # fmt: skip


class ScriptedCore:
    """What the watch needs of a simulator: its limit is a function of time, and estimated as
    csrc/sim/step_limit does, by iteration or from the last one by how a bound has grown since.
    """

    has_laws, can_subcycle = False, False

    def __init__(self, limit, bound):
        self.limit, self.bound, self.dt, self.time = limit, bound, 0.0, 0.0
        self.n_steps = self.limit_iterations = self.n_looks = 0
        self.last = None

    def limit_now(self, activations, enough, low=1.0, high=1.0):
        self.n_looks += 1
        bound = self.bound * self.limit(self.time)
        estimate = self.estimate(bound)
        if estimate < enough:
            self.limit_iterations += 1
            self.last = self.limit(self.time), bound
            estimate = self.estimate(bound)
        return estimate, 0, 7, bound

    def estimate(self, bound):
        growth = (self.last[1] / bound) ** 2 if self.last else math.inf
        return bound if growth > 1.05 else max(bound, self.last[0] * growth**-1.25)

    def choose_levels(self):
        pass


def run(limit, until, bound=0.87, dt="auto"):
    """Take steps as `Simulator` does; the core and the largest share of the limit that dt had."""
    core, most = ScriptedCore(limit, bound), 0.0
    watch = StepWatch(core, str, dt, None, 0)
    while core.time < until:
        most = max(most, core.dt / limit(core.time))
        core.time += core.dt
        core.n_steps += 1
        watch.until_check -= 1
        if watch.until_check == 0:
            watch.look(lambda steps: np.zeros((len(steps), 0)))
    return core, most


def fewest_steps(limit, until):
    """Of those that always take the share of the limit that dt="auto" aims at."""
    times = np.linspace(0, until, 200_001)
    return np.mean([1 / (SAFETY * limit(t)) for t in times]) * until


def test_a_limit_that_falls_and_jumps_is_kept_up_with():
    """Looks that only halve their interval while it falls let dt come to 0.98 of these limits, and
    above what lies between them.
    """
    limit = lambda t: 1e-6 * np.interp(1e3 * t, *FOLDING.T)  # noqa: E731
    core, most = run(limit, 12e-3)
    assert most < 0.93
    # It costs some looks, and rises are not left unused.
    assert core.n_looks < 0.065 * core.n_steps
    assert core.limit_iterations < core.n_steps / 256
    assert core.n_steps < 1.2 * fewest_steps(limit, 12e-3)


@pytest.mark.parametrize(("rate", "looks"), [(0.0, 20), (0.1e3, 70), (1e3, 1000)])
def test_looks_are_as_rare_as_the_limit_moves_slowly(rate, looks):
    """A limit that stays, or halves in some 1700 and 170 steps of rest."""
    limit = lambda t: 1e-6 * math.exp(-rate * t)  # noqa: E731
    core, most = run(limit, 5e-3)
    assert most < 0.92
    assert core.n_looks < looks
    assert core.n_steps < 1.1 * fewest_steps(limit, 5e-3)


@pytest.mark.parametrize("bound", [0.7, 0.87])
def test_dt_that_the_bound_alone_lowered_rises_again(bound):
    """A limit that falls by 30 % in some 500 steps and stays: between iterations the nodes' bound
    lowers dt, which lies below what the limit allows.
    """
    limit = lambda t: 1e-6 * np.interp(t, [0.1e-3, 0.5e-3], [1.0, 0.7])  # noqa: E731
    core, most = run(limit, 3e-3, bound)
    assert most < 0.93
    assert core.dt > 0.69 * core.limit(core.time)
    assert core.limit_iterations < 8


def test_dt_does_not_rise_past_that_of_rest():
    """A limit that falls, and rises to half above what it was."""
    limit = lambda t: 1e-6 * np.interp(t, [0.1e-3, 0.5e-3, 1e-3], [1.0, 0.6, 1.5])  # noqa: E731
    core, most = run(limit, 4e-3)
    assert most < 0.93
    assert core.dt == pytest.approx(SAFETY * 1e-6)


def test_a_given_dt_that_was_warned_of_costs_no_more_looks():
    limit = lambda t: 1e-6 * np.interp(1e3 * t, *FOLDING.T)  # noqa: E731
    with pytest.warns(StepWarning):
        core, _ = run(limit, 12e-3, dt=2.2e-6)
    assert core.n_looks < 90 and core.limit_iterations < 10
