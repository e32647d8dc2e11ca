import os
import re
import struct
import time

import numpy as np
import pytest
import trimesh
from matplotlib.axes import Axes

from tledface.errors import InputError
from tledface.picture import render_surface, wrinkle_picture
from tledface.raster import rasterise, view_axes

SIZE = 0.06


def skin(n=121, height=1e-3):
    x, y = np.meshgrid(np.linspace(0, SIZE, n), np.linspace(0, SIZE, n))
    z = height * np.sin(2 * np.pi * x / 6.5e-3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1)
    lower = np.stack([corner, corner + 1, corner + n + 1], axis=1)
    upper = np.stack([corner, corner + n + 1, corner + n], axis=1)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), np.concatenate([lower, upper])


def png_size(path):
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])


@pytest.mark.parametrize(
    "options",
    [{}, {"view": "top"}, {"view": (0.3, -1, 0.5)}, {"up": (0, 1, 0), "view": (0, 0, 1)},
     {"profile": ((0, 0, 0), (SIZE, SIZE, 0)), "title": "wrinkles"}],
)  # fmt: skip
def test_pictures_of_every_view(tmp_path, options):
    rest, faces = skin(61, height=0.0)
    path = wrinkle_picture(tmp_path / "w.png", rest, skin(61)[0], faces, **options)
    width, height = png_size(path)
    assert width == 1600 and 500 < height < 1500
    assert os.listdir(tmp_path) == ["w.png"]


def test_a_body_without_folds_has_no_profile(tmp_path):
    rest, faces = skin(61, height=0.0)
    with_profile = wrinkle_picture(tmp_path / "a.png", rest, skin(61)[0], faces)
    without = wrinkle_picture(tmp_path / "b.png", rest, skin(61)[0], faces, profile=False)
    assert png_size(without)[1] < png_size(with_profile)[1] - 250


def test_a_named_view_works_with_any_up(tmp_path):
    vertices, faces = skin(31)
    for order in ([2, 0, 1], [1, 2, 0]):
        up = np.eye(3)[order.index(2)]
        image = render_surface(vertices[:, order], faces, up=up, size=(200, 200))
        assert image[..., 3].mean() > 0.4


def test_folds_are_shaded_and_flat_skin_is_even():
    for height, low, high in ((0.0, 0.0, 0.005), (1e-3, 0.04, 1.0)):
        vertices, faces = skin(height=height)
        image = render_surface(vertices, faces, view="top", size=(400, 400))
        inner = image[40:-40, 40:-40]
        assert (inner[..., 3] == 1.0).all()
        assert low <= inner[..., :3].mean(axis=2).std() <= high


def test_the_picture_is_clear_beside_the_surface():
    sphere = trimesh.creation.icosphere(3)
    image = render_surface(sphere.vertices, sphere.faces, view=(0, -1, 0), size=(300, 300))
    inner = (300 - 2 * 8) / 300
    assert image[..., 3].mean() == pytest.approx(np.pi / 4 * inner**2, rel=0.02)
    assert image[0, 0, 3] == 0.0
    upper, lower = image[60, 150, :3].mean(), image[-60, 150, :3].mean()
    assert upper > lower


def test_rasterise_matches_a_brute_force_search():
    rng = np.random.default_rng(0)
    points = rng.uniform(-5, 30, (60, 3))
    faces = rng.integers(0, 60, (40, 3))
    raster = rasterise(points, faces, (20, 25))
    best = np.full((20, 25), -np.inf)
    for a, b, c in points[faces]:
        matrix = np.array([b[:2] - a[:2], c[:2] - a[:2]]).T
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        rows, columns = np.indices(best.shape)
        s, t = np.linalg.solve(matrix, np.stack([columns.ravel() - a[0], rows.ravel() - a[1]]))
        inside = ((s >= 0) & (t >= 0) & (s + t <= 1)).reshape(best.shape)
        z = (a[2] + s * (b[2] - a[2]) + t * (c[2] - a[2])).reshape(best.shape)
        best = np.where(inside & (z > best), z, best)
    expected = np.where(np.isinf(best), np.nan, best)
    assert raster.height == pytest.approx(expected, abs=1e-6, nan_ok=True)
    seen = raster.triangle >= 0
    where = np.einsum("ij,ijk->ik", raster.barycentric[seen], points[faces[raster.triangle[seen]]])
    assert where[:, 0] == pytest.approx(np.nonzero(seen)[1], abs=1e-3)
    assert where[:, 1] == pytest.approx(np.nonzero(seen)[0], abs=1e-3)
    assert where[:, 2] == pytest.approx(raster.height[seen], abs=1e-3)


def test_the_first_of_equally_high_triangles_is_seen_however_the_work_is_cut(monkeypatch):
    points = np.random.default_rng(1).uniform(0, 20, (30, 3))
    faces = np.arange(30).reshape(10, 3)
    faces = np.concatenate([faces, faces])
    whole = rasterise(points, faces, (20, 20))
    monkeypatch.setattr("tledface.raster._PIXELS_AT_ONCE", 7)
    cut = rasterise(points, faces, (20, 20))
    assert whole.triangle.max() < 10
    assert np.array_equal(whole.triangle, cut.triangle)
    assert np.array_equal(whole.height, cut.height, equal_nan=True)


def test_triangles_outside_the_image_are_left_out():
    points = np.array([[-9.0, -9, 0], [-5, -9, 0], [-7, -5, 0]])
    assert (rasterise(points, np.array([[0, 1, 2]]), (5, 5)).triangle == -1).all()


def test_view_axes_are_right_handed():
    axes = view_axes((0, -2, 0), (0, 0, 1))
    assert axes == pytest.approx(np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]))


def test_a_large_surface_is_quick(tmp_path):
    rest, faces = skin(225, height=0.0)
    begin = time.process_time()
    wrinkle_picture(tmp_path / "w.png", rest, skin(225)[0], faces)
    assert len(faces) > 100_000
    assert time.process_time() - begin < 15.0


@pytest.mark.parametrize(("least", "title"), [(5e-5, r"\d folds, .*high"), (0.1, "no folds")])
def test_the_profile_counts_what_stands_out_enough(tmp_path, monkeypatch, least, title):
    titles = []
    monkeypatch.setattr(Axes, "set_title", lambda self, text, **_: titles.append(text))
    rest, faces = skin(61, height=0.0)
    wrinkle_picture(tmp_path / "w.png", rest, skin(61)[0], faces, min_prominence=least)
    assert re.fullmatch(title, titles[-1])


def test_bad_pictures_are_one_clear_line(tmp_path):
    rest, faces = skin(11)
    broken = rest.copy()
    broken[3] = np.nan
    for name, deformed, triangles, options, word in (
        ("w.jpg", rest, faces, {}, r"end in \.png"),
        ("missing/w.png", rest, faces, {}, "no folder"),
        ("w.png", rest[1:], faces, {}, "121 at rest and 120"),
        ("w.png", broken, faces, {}, "picture vertices: vertex 3 is not finite"),
        ("w.png", rest, faces[:0], {}, r"faces: got shape \(0, 3\) of int64"),
        ("w.png", rest, faces + 1, {}, "got vertices 1 to 121; allowed: 0 to 120"),
        ("w.png", rest, faces - 1, {}, "got vertices -1 to 119; allowed: 0 to 120"),
        ("w.png", rest, 1.0 * faces, {}, r"of float64; allowed: \(m, 3\) whole numbers"),
        ("w.png", rest, faces, {"view": "side"}, "'side'"),
        ("w.png", rest, faces, {"view": (0, 0, 1)}, "parallel"),
        ("w.png", rest, faces, {"view": (0, 0, 0)}, "not all 0"),
        ("w.png", rest, faces, {"profile": ((9, 0, 0), (9, 1, 0))}, "no surface at rest along"),
    ):
        with pytest.raises(InputError, match=word) as caught:
            wrinkle_picture(tmp_path / name, rest, deformed, triangles, **options)
        assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == []
