"""Slender bodies against beam theory, free vibration, and the order of the time integration.

In float64 and without chance: tolerances are what beam theory and elements differ by, and half of
that more.
"""

from itertools import pairwise

import pytest

import beams


@pytest.mark.parametrize("poissons_ratio", [0.3, 0.45, 0.49])
@pytest.mark.parametrize(("layers", "tolerance"), [(1, 0.006), (2, 0.003)])
def test_cantilever_tip(layers, tolerance, poissons_ratio, figure):
    """10:1 under an end load against Timoshenko's beam, one and two elements thick."""
    found = beams.tip_over_timoshenko(layers, poissons_ratio)
    figure("deflection over Timoshenko's", found, 1.0, rel=tolerance)


def test_kappa_form_locks_in_bending():
    """What the default form is there for: a tenth of the deflection at nu 0.49."""
    assert beams.tip_over_timoshenko(1, 0.49, hourglass="joldes") < 0.15


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("poissons_ratio", [0.3, 0.45, 0.49])
@pytest.mark.parametrize("plane_strain", [True, False], ids=["wide", "narrow"])
def test_strip_rolled_up_by_180_degrees(aspect, poissons_ratio, plane_strain, figure):
    """End moment over E I / R; boxes of 2:1 show what cubes hide."""
    moment = beams.rolled_moment(aspect, poissons_ratio, plane_strain)
    figure("moment over E I / R", moment, 1.0, rel=0.015)


def test_first_frequency_of_a_bar(figure):
    figure("frequency over c / 4 L", beams.bar_frequency(), 1.0, rel=0.0005)


def test_first_frequency_of_a_cantilever(figure):
    figure("frequency over Euler-Bernoulli", beams.cantilever_frequency(), 1.0, rel=0.003)


def test_second_order_in_the_time_step(figure):
    """Halving the step quarters the error, the start with a speed included."""
    errors = beams.step_errors()
    ratios = [coarse / fine for coarse, fine in pairwise(errors)]
    assert errors[0] < 0.1
    for ratio in ratios:
        figure("error at a step over that at half of it", ratio, 4.0, rel=0.02)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_energy_of_an_undamped_body(precision, figure):
    """100 000 steps of a block that swings freely: no more and no less energy at the end."""
    figure("drift", beams.energy_drift(precision=precision), at_most=0.01)
