import numpy as np
import pytest

from tledface.muscle import active_tension, passive_tension


def test_active_tension_is_one_at_the_optimum_and_zero_outside_its_range():
    assert active_tension(1.0) == pytest.approx(1.0)
    assert active_tension(1.2, lambda_opt=1.2) == pytest.approx(1.0)
    assert active_tension([0.3, 0.6, 1.4, 2.0]) == pytest.approx([0, 0, 0, 0], abs=1e-14)
    stretch = np.linspace(0.6, 1.4, 50)
    printed = -25 / 4 * stretch**2 + 25 / 2 * stretch - 5.25
    assert active_tension(stretch) == pytest.approx(printed, abs=1e-14)
    scaled = -25 / (4 * 1.1**2) * stretch**2 + 25 / (2 * 1.1) * stretch - 5.25
    assert active_tension(stretch, 1.1) == pytest.approx(np.maximum(scaled, 0), abs=1e-14)


def test_printed_passive_tension_jumps_where_the_paper_does():
    below, above = passive_tension([1.2, 1.2 + 1e-12], form="printed")
    assert below == pytest.approx(0.05 * (np.exp(6.6 * 0.2) - 1))
    assert above == pytest.approx(2.18 * 1.2 - 2.47)
    assert above - below == pytest.approx(0.0088, abs=2e-4)


@pytest.mark.parametrize("lambda_pas", [1.0, 1.2, 1.5])
def test_continuous_passive_tension_has_no_jump(lambda_pas):
    stretch = np.linspace(0.5, 2.0, 150_001)
    tension = passive_tension(stretch, lambda_pas)
    slope = np.diff(tension) / np.diff(stretch)
    steepest = max(2.18, 0.05 * 6.6 * np.exp(6.6 * (lambda_pas - 1)))
    assert slope.max() <= steepest * 1.001
    assert slope[-1] == pytest.approx(2.18)
    assert (tension[stretch <= 1.0] == 0.0).all()


def test_both_forms_agree_up_to_the_line():
    stretch = np.linspace(0.2, 1.2, 30)
    assert (passive_tension(stretch) == passive_tension(stretch, form="printed")).all()


def test_a_very_long_fibre_does_not_overflow():
    assert passive_tension(1e6) == pytest.approx(2.18e6, rel=1e-3)
