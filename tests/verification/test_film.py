"""A stiff film on a soft substrate: the solver's wrinkles against Biot's exact theory."""

import numpy as np
import pytest

import film_theory
import film_waves
from tledface.examples import film

# Modulus ratio: wavelength over thickness, critical shortening (as tabulated independently, the
# wavelengths there from a search on a grid: the strain is flat about its least value).
TABLE = {
    10.0: (11.465, 0.10522),
    24.57: (14.135, 0.05893),
    100.0: (21.205, 0.02364),
    300.0: (29.797, 0.01148),
    1000.0: (44.120, 0.00517),
}


@pytest.mark.parametrize("ratio", TABLE)
def test_theory_gives_the_table(ratio, figure):
    wavelength, strain = TABLE[ratio]
    found, least = film_theory.onset(ratio)
    figure("critical strain", least, strain, absolute=5.01e-6)
    figure("wavelength / t", found, wavelength, rel=0.005)
    # The table's own wave is critical at the same shortening, to the last digit of any use.
    at_table = film_theory.strain_at(2 * np.pi / wavelength, ratio)
    assert least <= at_table <= least * (1 + 5e-5)
    # The thin-film formula falls short, ever less so for stiffer films.
    short = 1 - film_theory.thin_film_wavelength(ratio) / found
    assert 0.009 < short < 0.19


def test_theory_without_a_film_is_biot_s_surface_instability():
    """A half-space of rubber wrinkles at lambda 0.5437, for every wavelength (Biot 1963)."""
    for thickness in (0.3, 1.0, 3.0):
        assert film_theory.strain_at(thickness, 1.0, highest=0.6) == pytest.approx(0.4563, abs=1e-4)


def test_the_example_quotes_the_theory():
    for ratio, (wavelength, strain) in film.EXACT.items():
        found, least = film_theory.onset(ratio)
        assert wavelength == pytest.approx(found, rel=1e-4)
        assert strain == pytest.approx(least, rel=1e-4)


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("ratio", "layers", "aspect", "tolerance"),
    [
        (10.0, 1, 1.0, 0.05),
        (24.57, 1, 1.0, 0.05),
        (100.0, 1, 1.0, 0.05),
        (10.0, 1, 2.0, 0.12),
        (24.57, 1, 2.0, 0.12),
        (100.0, 1, 2.0, 0.12),
        (10.0, 1, 0.5, 0.05),
        (10.0, 4, 1.0, 0.02),
        pytest.param(24.57, 4, 1.0, 0.02, marks=SLOW),
        pytest.param(100.0, 4, 1.0, 0.02, marks=SLOW),
    ],
)
def test_onset_of_waves(ratio, layers, aspect, tolerance, figure):
    """Neutral waves of the discrete equations: no noise, no ends, no growth to wait for."""
    wavelength, strain = film_waves.film_onset(ratio, layers, aspect)
    figure("wavelength over the exact one", wavelength, 1.0, rel=tolerance)
    figure("critical strain over the exact one", strain, 1.0, rel=0.07)


def test_kappa_makes_the_wavelength():
    """The wavelength of the kappa form follows the cube root of kappa: an input, not a result."""
    one, _ = film_waves.film_onset(24.57, hourglass="joldes", hourglass_kappa=0.075)
    eighth, _ = film_waves.film_onset(24.57, hourglass="joldes", hourglass_kappa=0.075 / 8)
    assert one > 1.8
    assert one / eighth == pytest.approx(2, rel=0.1)


@pytest.mark.parametrize(
    ("voxel", "section", "blended"), [(0.25, 2.2, 4.0), (0.125, 1.3, 2.5), (0.0625, 1.0, 1.5)]
)
def test_corneum_thinner_than_a_voxel(voxel, section, blended, figure):
    """0.02 mm at ratio 1000: towards 0.88 mm with the section modulus, far off when blended."""
    found, _ = film_waves.layered_onset(voxel * 1e-3, section=True)
    figure("wavelength in mm with the section modulus", found * 1e3, at_most=section)
    assert found > 0.88e-3
    mixed, _ = film_waves.layered_onset(voxel * 1e-3, section=False)
    figure("exact wavelength over the blended one", 0.88e-3 / mixed, at_most=0.88 / blended)


def shortened(ratio, layers=1, aspect=1.0, step=1 / 50, device="native"):
    wavelength, strain = film.EXACT[ratio]
    wavelength *= film.THICKNESS
    run = film.shorten(
        film.strip(ratio, wavelength, layers=layers, aspect=aspect),
        wavelength,
        1.3 * strain,
        step=step * strain,
        device=device,
        stop_after_onset=True,
    )
    return run.wavelength / wavelength, run.onset / strain


@pytest.mark.parametrize(
    ("ratio", "layers", "aspect", "tolerance"),
    [
        (24.57, 1, 1.0, 0.05),
        pytest.param(10.0, 1, 1.0, 0.05, marks=SLOW),
        pytest.param(10.0, 1, 2.0, 0.12, marks=SLOW),
        pytest.param(100.0, 1, 1.0, 0.05, marks=SLOW),
        pytest.param(100.0, 1, 2.0, 0.12, marks=SLOW),
        pytest.param(10.0, 4, 1.0, 0.02, marks=SLOW),
    ],
)
def test_shortening_a_film(ratio, layers, aspect, tolerance, figure):
    """The example itself: eight waves long, wrinkles that grow out of noise."""
    wavelength, strain = shortened(ratio, layers, aspect)
    figure("wavelength over the exact one", wavelength, 1.0, rel=tolerance)
    figure("critical strain over the exact one", strain, 1.0, rel=0.07)


def test_the_study_draws_both_forms(tmp_path):
    result = film.study(tmp_path, ratio=10.0, waves=4, resolution=25, device="native", quiet=True)
    assert result.files["picture"].stat().st_size > 10_000
    assert result.onset["joldes"] > 1.4 * result.exact_onset
    assert "exact" in result.text() and "physical" in result.text()
    assert result.to_dict()["onset"]["physical"] == result.onset["physical"]


def test_the_study_refuses_a_ratio_without_an_exact_answer(tmp_path):
    with pytest.raises(ValueError, match=r"film ratio: got 12; allowed.*24.57"):
        film.study(tmp_path, ratio=12)
