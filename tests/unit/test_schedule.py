"""Activation schedules."""

import numpy as np
import pytest

from tledface.errors import InputError
from tledface.schedule import Constant, Function, Keyframes, as_schedule, ramp

TIMES = np.linspace(-0.01, 0.1, 23)


def test_ramp_levels_and_middle():
    r = ramp(0, 0.75, 0.05)
    assert r(-1.0) == 0.0
    assert r(0.025) == pytest.approx(0.375)
    assert r(0.05) == r(1.0) == 0.75
    assert ramp(0.2, 0.9, 0.05)(7.0) == 0.9


def test_ramp_with_begin_and_downwards():
    r = ramp(1.0, 0.0, 0.01, begin=0.02)
    assert r(0.019) == 1.0
    assert r(0.0225) == pytest.approx(0.75)
    assert r(0.03) == pytest.approx(0.0, abs=1e-12)
    assert r(0.031) == 0.0


def test_cosine_ramp_has_no_speed_at_its_ends():
    r = ramp(0, 1, 1.0, shape="cosine")
    assert r(0.5) == pytest.approx(0.5)
    assert r(1e-4) < 1e-7
    assert 1.0 - r(1 - 1e-4) < 1e-7


@pytest.mark.parametrize(
    "schedule",
    [
        ramp(0, 0.75, 0.05),
        ramp(1, 0, 0.02, 0.01, shape="cosine"),
        Constant(0.3),
        Keyframes((0.0, 0.02, 0.05), (0.0, 1.0, 0.25)),
        Function(lambda t: 0.5 + 0.5 * np.sin(100 * t)),
    ],
)
def test_sample_agrees_with_single_calls(schedule):
    sampled = schedule.sample(TIMES)
    assert sampled.shape == TIMES.shape
    assert sampled.dtype == np.float64
    np.testing.assert_array_equal(sampled, [schedule(float(t)) for t in TIMES])
    assert schedule.sample(TIMES.reshape(1, -1)).shape == (1, len(TIMES))


def test_keyframes():
    k = Keyframes((0.0, 0.02, 0.05), (0.1, 1.0, 0.25))
    assert k(-1) == 0.1
    assert k(0.01) == pytest.approx(0.55)
    assert k(9) == 0.25


def test_keyframes_of_lists_and_arrays_are_those_of_tuples():
    plain = Keyframes((0.0, 0.02, 0.05), (0.1, 1.0, 0.25))
    for make in (list, np.array):
        given = Keyframes(make(plain.times), make(plain.values))
        assert given == plain and hash(given) == hash(plain)


def test_as_schedule():
    assert as_schedule(0.5)(3.0) == 0.5
    assert as_schedule(np.float32(0.5))(3.0) == 0.5
    assert as_schedule(lambda t: 2 * t)(0.25) == 0.5
    r = ramp(0, 1, 1)
    assert as_schedule(r) is r


def test_round_off_of_a_callable_is_clipped_but_not_more():
    assert Function(lambda t: 1.0 + 1e-12)(0.0) == 1.0
    assert Function(lambda t: -1e-12)(0.0) == 0.0
    for wrong in (1.01, -0.01, float("nan"), None, "high"):
        with pytest.raises(InputError, match=r"callable gave .* at t = 0\.5 s; allowed"):
            Function(lambda t, wrong=wrong: wrong).sample([0.5])


@pytest.mark.parametrize(
    "make",
    [
        lambda: ramp(0, 1.5, 1),
        lambda: ramp(-0.1, 1, 1),
        lambda: ramp(0, 1, 0),
        lambda: ramp(0, 1, -1),
        lambda: ramp(0, 1, float("nan")),
        lambda: ramp(0, 1, 1, shape="cubic"),
        lambda: Keyframes((), ()),
        lambda: Keyframes((0.0, 0.0), (0.0, 1.0)),
        lambda: Keyframes((0.0, 1.0), (0.0,)),
        lambda: Keyframes((0.0,), (2.0,)),
        lambda: as_schedule(2),
        lambda: as_schedule(True),
        lambda: as_schedule("half"),
    ],
)
def test_bad_schedules_are_refused(make):
    with pytest.raises(InputError, match="allowed"):
        make()
