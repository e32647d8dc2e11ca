import time

import numpy as np
import pytest

from tledface.errors import InputError
from tledface.metrics import detail, height_map, line_profile, wrinkles

SPACING = 2.5e-4
X = np.arange(241) * SPACING
LENGTH = X[-1]


def waves(wavelength, height=1e-3, phase=0.0):
    return 0.5 * height * np.cos(2 * np.pi * (X - phase) / wavelength)


@pytest.mark.parametrize(
    ("wavelength", "spacing_error", "height_error"),
    [(3e-3, 0.02, 0.05), (5e-3, 0.02, 0.05), (6.5e-3, 0.02, 0.05), (8e-3, 0.02, 0.05),
     (12e-3, 0.03, 0.2)],
)  # fmt: skip
@pytest.mark.parametrize("phase", [0.0, 0.3, 0.5, 0.9])
def test_a_sine_gives_its_wavelength_and_height(wavelength, spacing_error, height_error, phase):
    found = wrinkles(waves(wavelength, 2e-3, phase=phase * wavelength), SPACING)
    assert found.wavelength == pytest.approx(wavelength, rel=spacing_error)
    assert found.amplitude == pytest.approx(2e-3, rel=height_error)
    assert found.count == pytest.approx(LENGTH / wavelength, abs=1)


def test_trend_dome_and_noise_change_nothing():
    rng = np.random.default_rng(1)
    plain = wrinkles(waves(6.5e-3), SPACING)
    rough = waves(6.5e-3) + 0.1 * X + 6e-3 * np.sin(np.pi * X / LENGTH) + rng.normal(0, 2e-5, 241)
    found = wrinkles(rough, SPACING)
    assert found.count == plain.count
    assert found.wavelength == pytest.approx(plain.wavelength, rel=0.02)
    assert found.amplitude == pytest.approx(plain.amplitude, rel=0.05)


def test_two_waves_count_the_higher_one():
    found = wrinkles(waves(7e-3, 2e-3) + waves(1.5e-3, 2e-4), SPACING)
    assert found.wavelength == pytest.approx(7e-3, rel=0.05)


@pytest.mark.parametrize(
    "heights",
    [
        np.zeros(241),
        0.3 * X,
        4e-3 * np.sin(np.pi * X / LENGTH),
        4e-3 * np.sin(np.pi * X / LENGTH) ** 2,
        2e-3 * np.exp(-X / 4e-3),
        waves(6.5e-3, height=2e-5),
    ],
    ids=["flat", "slope", "dome", "bulge", "raised end", "too low"],
)
def test_no_folds(heights):
    found = wrinkles(heights, SPACING)
    assert (found.count, found.amplitude) == (0, 0.0)
    assert np.isnan(found.wavelength)


def test_a_single_fold_has_no_wavelength():
    found = wrinkles(1e-3 * np.exp(-(((X - 0.025) / 2e-3) ** 2)) + 0.02 * X, SPACING)
    assert found.count == 1
    assert np.isnan(found.wavelength)
    assert found.positions[0] == pytest.approx([0.025], abs=1e-4)
    assert found.amplitude == pytest.approx(1e-3, rel=0.15)


def test_heights_are_above_the_chord_of_valleys_of_unlike_depth():
    """Every second valley lower: ridges lie midway, so the lower one alone would give 1.3 mm."""
    uneven = waves(5e-3, 1e-3) + 0.3e-3 * np.sin(2 * np.pi * X / 10e-3)
    found = wrinkles(uneven, SPACING)
    assert found.amplitude == pytest.approx(1e-3, rel=0.06)


@pytest.mark.parametrize("phase", [0.6e-4, 1.2e-4, 1.9e-4])
def test_ridges_are_found_between_samples(phase):
    found = wrinkles(waves(6.5e-3, phase=phase), SPACING).positions[0]
    exact = phase + 6.5e-3 * np.round((found - phase) / 6.5e-3)
    assert len(found) >= 8
    # To the nearest sample two of the three phases would be off by 0.24 of the spacing or more; the
    # fit of the shape, which is one-sided at the ends, moves a ridge by 0.08.
    assert found[1:-1] == pytest.approx(exact[1:-1], abs=0.12 * SPACING)


def test_the_ends_of_a_line_are_no_ridges():
    found = wrinkles(waves(12e-3), SPACING)
    assert len(found.positions[0]) == 4
    assert found.positions[0].min() > 6e-3 and found.positions[0].max() < LENGTH - 6e-3


def test_a_flat_top_counts_once_in_its_middle():
    heights = np.where(np.abs(X - 0.03) < 2e-3, 1e-3, 0.0)
    found = wrinkles(np.round(heights, 6), SPACING)
    assert found.count == 1
    assert found.positions[0] == pytest.approx([0.03], abs=2e-3)


def test_thresholds_are_absolute_and_relative():
    two = np.exp(-(((X - 0.02) / 1.5e-3) ** 2)) + 0.1 * np.exp(-(((X - 0.04) / 1.5e-3) ** 2))
    heights = 1e-3 * two
    assert wrinkles(heights, SPACING, relative_prominence=0.2).count == 1
    assert wrinkles(heights, SPACING, relative_prominence=0.02, min_prominence=5e-5).count == 2
    assert wrinkles(heights, SPACING, min_prominence=2e-3).count == 0


def test_a_patch_is_measured_line_by_line():
    patch = np.tile(waves(6.5e-3, 2e-3), (5, 1))
    patch[0] = 0.0
    patch[1, :30] = np.nan
    found = wrinkles(patch, SPACING)
    assert found.counts.tolist() == [0, 8, 9, 9, 9]
    assert found.count == 9
    assert found.wavelength == pytest.approx(6.5e-3, rel=0.02)
    assert found.positions[1] == pytest.approx(found.positions[2][1:], abs=2e-4)


def test_detail_keeps_the_form_and_the_folds():
    heights = waves(6.5e-3) + 3.0 + 0.1 * X
    heights[:10] = np.nan
    kept = detail(heights, SPACING)
    assert kept.shape == heights.shape and np.isnan(kept[:10]).all()
    assert np.ptp(kept[40:-40]) == pytest.approx(1e-3, rel=0.05)


@pytest.mark.parametrize(
    ("heights", "options"),
    [
        (np.zeros(3), {}),
        (np.zeros((2, 2, 9)), {}),
        (np.zeros(9), {"spacing": 0.0}),
        (np.zeros(9), {"shape_wavelength": -1.0}),
        (np.zeros((0, 9)), {}),
        (np.zeros(90), {"spacing": 0.5}),  # heights and spacing in mm
        (np.zeros(90), {"shape_wavelength": 1e-5}),
        (np.zeros(90), {"shape_wavelength": "6 mm"}),
        (np.zeros(90), {"spacing": "0.1 mm"}),
        (np.zeros(90), {"spacing": None}),
        (np.zeros(90), {"spacing": np.array([1e-4])}),
        (np.zeros(90), {"min_prominence": -1.0}),
        (np.zeros(90), {"min_prominence": np.nan}),
        (np.zeros(90), {"min_prominence": "50 um"}),
        (np.zeros(90), {"relative_prominence": 2.0}),
        (np.zeros(90), {"relative_prominence": None}),
        ((0.0 for _ in range(90)), {}),
        ([[0.0] * 8, [0.0] * 9], {}),
        ("heights", {}),
    ],
)
def test_bad_heights(heights, options):
    with pytest.raises(InputError, match="wrinkles"):
        wrinkles(heights, **({"spacing": SPACING} | options))


def test_a_long_line_takes_little_time_and_memory():
    """The fit of each sample's own window: as exact as by hand, without a table of all pairs."""
    n = 20_000
    heights = np.random.default_rng(4).normal(0.0, 1e-5, n) + 1e-4 * np.sin(np.arange(n) / 30)
    found = detail(heights, 1e-4, shape_wavelength=0.01)
    for at in (0, 7, 5_000, n - 1):
        t = (np.arange(n) - at) / (0.368 * 0.01 / 1e-4)
        fit = np.polynomial.polynomial.polyfit(t, heights, 4, w=np.exp(-0.25 * t**2))
        assert found[at] == pytest.approx(heights[at] - fit[0], abs=1e-12)
    began = time.process_time()
    assert wrinkles(heights, 1e-4, shape_wavelength=0.011).count > 60
    assert time.process_time() - began < 5.0  # 20 000^2 doubles are 3.2 GB, and took a minute


def sheet(function, n=121, size=0.06):
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n))
    vertices = np.stack([x, y, function(x, y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1)
    lower = np.stack([corner, corner + 1, corner + n + 1], axis=1)
    upper = np.stack([corner, corner + n + 1, corner + n], axis=1)
    return vertices, np.concatenate([lower, upper])


def test_height_map_samples_a_plane_without_holes_or_seams():
    vertices, faces = sheet(lambda x, y: 0.2 * x - 0.1 * y)
    found = height_map(vertices, faces, 3.3e-4)
    assert not np.isnan(found.heights).any()
    rows, columns = np.indices(found.heights.shape)
    expected = 3.3e-4 * (0.2 * columns - 0.1 * rows)
    assert found.heights == pytest.approx(expected, abs=1e-12)


def test_height_map_takes_the_highest_and_leaves_holes():
    low, faces = sheet(lambda x, y: 0 * x, n=3)
    high = low * [0.5, 0.5, 1] + [0, 0, 0.01]
    both = np.concatenate([low, high])
    found = height_map(both, np.concatenate([faces, faces + len(low)]), 1e-3).heights
    assert found[10, 10] == pytest.approx(0.01) and found[50, 50] == pytest.approx(0.0)
    ring = height_map(low, faces[:-1], 1e-3).heights
    assert np.isnan(ring).sum() > 100


def test_height_map_along_another_direction():
    vertices, faces = sheet(lambda x, y: 1e-3 * np.sin(2 * np.pi * x / 6.5e-3))
    turned = vertices[:, [0, 2, 1]] * [1, -1, 1]
    found = height_map(turned, faces, 2.5e-4, direction=(0, -1, 0), up=(0, 0, 1))
    assert found.axes[0] == pytest.approx([1, 0, 0])
    straight = height_map(vertices, faces, 2.5e-4)
    assert found.heights == pytest.approx(straight.heights, abs=1e-12)
    assert wrinkles(found.heights, 2.5e-4).wavelength == pytest.approx(6.5e-3, rel=0.02)


def test_line_profile_is_exact_and_marks_gaps():
    vertices, faces = sheet(lambda x, y: 0.3 * x + 0.1 * y)
    distance, heights = line_profile(vertices, faces, (-0.01, 0.011, 5), (0.05, 0.041, 7), 1e-4)
    along = distance[-1] / np.hypot(0.06, 0.03)
    assert along == pytest.approx(1.0, abs=2e-3)
    x = -0.01 + distance * 0.06 / np.hypot(0.06, 0.03)
    y = 0.011 + distance * 0.03 / np.hypot(0.06, 0.03)
    inside = (x > 1e-9) & (x < 0.06)
    assert heights[inside] == pytest.approx((0.3 * x + 0.1 * y)[inside], abs=1e-12)
    assert np.isnan(heights[~inside]).all()


@pytest.mark.parametrize("spacing", ["1 mm", None, np.nan, -1.0, 0.0, 2.0, 1e-12])
def test_profiles_and_maps_need_a_spacing(spacing):
    with pytest.raises(InputError, match=r"line profile: spacing .* m on a line of 1 m; "):
        line_profile(np.eye(3), [[0, 1, 2]], (0, 0, 0), (1, 0, 0), spacing)
    if spacing != 2.0:
        with pytest.raises(InputError, match="height map: spacing "):
            height_map(np.eye(3), [[0, 1, 2]], spacing)


@pytest.mark.parametrize("name", ["start", "end", "direction"])
def test_a_line_profile_needs_points_in_space(name):
    points = {"start": (0, 0, 0), "end": (1, 0, 0), "direction": (0, 0, 1), name: (1, 0)}
    with pytest.raises(InputError, match=f"line profile: {name} must be three finite numbers"):
        line_profile(np.eye(3), [[0, 1, 2]], **points, spacing=0.1)


def test_line_profile_through_vertices_has_no_gap():
    vertices, faces = sheet(lambda x, y: 0 * x)
    heights = line_profile(vertices, faces, (0, 0.03, 0), (0.06, 0.03, 0), 1e-4)[1]
    assert (heights == 0.0).all()


def test_bad_surfaces():
    vertices, faces = sheet(lambda x, y: 0 * x, n=3)
    with pytest.raises(InputError, match="spacing"):
        height_map(vertices, faces, 0.0)
    with pytest.raises(InputError, match="samples"):
        height_map(vertices, faces, 1e-9)
    with pytest.raises(InputError, match="parallel"):
        height_map(vertices, faces, 1e-3, direction=(0, 1, 0))
    with pytest.raises(InputError, match="faces"):
        height_map(vertices, faces[:0], 1e-3)
    with pytest.raises(InputError, match="0 to 9; allowed: 0 to 8"):
        height_map(vertices, np.array([[0, 1, 9]]), 1e-3)
    with pytest.raises(InputError, match="-1 to 2"):
        height_map(vertices, np.array([[0, -1, 2]]), 1e-3)
    with pytest.raises(InputError, match="whole numbers"):
        height_map(vertices, faces + 0.5, 1e-3)
    with pytest.raises(InputError, match="length"):
        line_profile(vertices, faces, (0, 0, 0), (0, 0, 1), 1e-3)
