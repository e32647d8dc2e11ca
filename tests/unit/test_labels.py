"""Labelled images as volumes: placing, exact fractions, surfaces, scenes, refusals."""

import sys

import numpy as np
import pytest

from conftest import required
from tledface.errors import InputError
from tledface.geometry import LabelVolume, read_labels, voxelise
from tledface.scene import Scene

MATERIAL = {
    "model": "neo_hookean",
    "youngs_modulus": "50 kPa",
    "poissons_ratio": 0.49,
    "density": "1000 kg/m^3",
}
STEP = np.array([0.5e-3, 0.5e-3, 0.25e-3])


def random_labels(shape=(12, 10, 16), seed=0):
    """Skin 1, muscle 5, bone 9 in blobs; nothing on the lowest x face."""
    labels = np.random.default_rng(seed).choice([1, 5, 9], size=shape, p=[0.6, 0.3, 0.1])
    labels[0] = 0
    return labels.astype(np.int16)


def saved(folder, labels, name="labels.npy"):
    np.save(folder / name, labels)
    return folder / name


def of(image, labels, what="tissue"):
    return LabelVolume.of(image, labels, what, smooth=False)


def block_means(mask, factor):
    n = np.array(mask.shape) // factor
    return mask.reshape(n[0], factor, n[1], factor, n[2], factor).mean(axis=(1, 3, 5))


@pytest.mark.parametrize("factor", [1, 2])
def test_fractions_are_exact_where_the_grids_meet(tmp_path, factor):
    labels = random_labels((13, 10, 16))
    image = read_labels(saved(tmp_path, labels), spacing=STEP, origin=(1e-3, 2e-3, 3e-3))
    voxels = voxelise(
        of(image, None, "skin"),
        voxel=factor * STEP,
        bones=[of(image, [9])],
        muscles=[of(image, [5])],
        samples=3,
        fill=1e-9,
        clean=False,
        outer="all",
    )
    assert voxels.report["samples"] == (3 if factor == 1 else 4)
    np.testing.assert_allclose(voxels.origin, [1.25e-3, 1.75e-3, 2.875e-3], rtol=1e-12)
    inner = labels[1:]
    for column, value in enumerate((1, 5)):
        expected = block_means(inner == value, factor)
        found = np.zeros(expected.shape)
        found[tuple(voxels.cells.T)] = voxels.fractions[:, column] * voxels.fill
        # Depth is cut at the surface exactly too: every layer sample lies below it.
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_voxels_finer_than_the_image(tmp_path):
    labels = random_labels((5, 4, 4))
    image = read_labels(saved(tmp_path, labels), spacing=(1e-3,) * 3)
    voxels = voxelise(
        of(image, [1, 5, 9]), voxel=0.5e-3, muscles=[of(image, [5])], samples=2, clean=False
    )
    fine = np.repeat(np.repeat(np.repeat(labels[1:], 2, 0), 2, 1), 2, 2)
    assert len(voxels.cells) == fine.size
    np.testing.assert_allclose(voxels.fractions[:, 1], fine[tuple(voxels.cells.T)] == 5)


def test_a_grid_of_its_own_is_sampled(tmp_path):
    labels = random_labels((21, 20, 20))
    image = read_labels(saved(tmp_path, labels), spacing=(1e-3,) * 3)
    skin, muscle = of(image, None, "skin"), of(image, [5])
    voxels = voxelise(skin, voxel=1.37e-3, muscles=[muscle], samples=8, fill=1e-9, clean=False)
    assert voxels.report["samples"] == 8
    own = (voxels.fractions * voxels.fill[:, None]).sum(axis=0) * 1.37e-3**3
    assert own[1] == pytest.approx((labels == 5).sum() * 1e-9, rel=0.02)


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, 1.0, 1.0]),
        np.diag([-1.0, 1.0, 2.0]),
        np.array([[0, 0, 1.0], [-1, 0, 0], [0, 1, 0]]),
        turned(0.4),
        np.array([[1, 0.3, 0], [0, 1, 0], [0, 0, 1.0]]),
    ],
    ids=["plain", "mirrored", "axes swapped", "turned", "sheared"],
)
def test_nifti_affine_is_honoured(tmp_path, matrix):
    nibabel = required("nibabel")
    labels = np.zeros((24, 20, 16), dtype=np.uint8)
    labels[4:20, 5:15, 4:12] = 3
    labels[4:8, 5:15, 4:12] = 7  # at the low end of the first index
    affine = np.eye(4)
    affine[:3, :3] = matrix * 0.5
    affine[:3, 3] = (10, -20, 30)
    image = nibabel.Nifti1Image(labels, affine)
    image.header.set_xyzt_units("mm")
    nibabel.save(image, tmp_path / "head.nii.gz")
    read = read_labels(tmp_path / "head.nii.gz", unit_scale=17.0)
    skin, muscle = of(read, None, "skin"), of(read, [7])
    voxels = voxelise(skin, voxel=0.5e-3, muscles=[muscle], samples=8, fill=1e-9, clean=False)
    unit = abs(np.linalg.det(affine[:3, :3])) * 1e-9
    own = (voxels.fractions * voxels.fill[:, None]).sum(axis=0) * 0.5e-3**3
    assert voxels.report["volumes"]["skin"]["volume"] == pytest.approx(1280 * unit, rel=5e-3)
    # Cut in depth along a surface of steps, which takes a little off its edges.
    assert own[1] == pytest.approx(320 * unit, rel=1e-2)
    centres = voxels.origin + (voxels.cells + 0.5) * voxels.voxel
    middle = np.average(centres, axis=0, weights=voxels.fractions[:, 1] * voxels.fill)
    expected = affine @ [5.5, 9.5, 7.5, 1]
    np.testing.assert_allclose(1e3 * middle, expected[:3], atol=0.02)
    # The surface of the labels lies where they do, wound outwards.
    assert muscle.surface.solid.volume == pytest.approx(320 * unit, rel=1e-9)
    assert muscle.surface.solid.report["flipped_faces"] == 0


def test_smooth_surface_of_a_ball_and_of_a_sheet(tmp_path):
    required("skimage")
    grid = np.stack(np.meshgrid(*[np.arange(40)] * 3, indexing="ij"), axis=-1) - 19.5
    labels = (np.linalg.norm(grid, axis=-1) < 15).astype(np.uint8)
    labels[2:38, 2:38, 1] = 2  # one voxel thin
    image = read_labels(saved(tmp_path, labels), spacing=(1e-3,) * 3)
    ball = LabelVolume.of(image, [1], "ball")
    radii = np.linalg.norm(ball.surface.vertices - 19.5e-3, axis=1)
    assert radii.mean() == pytest.approx(15e-3, rel=0.01)
    assert radii.std() < 0.3e-3  # steps of the voxels would give 0.3 mm and more
    assert ball.surface.solid.report["flipped_faces"] == 0
    sheet = LabelVolume.of(image, [2], "sheet")
    assert sheet.surface.solid.volume == pytest.approx(36 * 36e-9, rel=0.1)
    voxels = voxelise(ball, voxel=1e-3, boundaries=(2e-3,), samples=4, fill=1e-9, clean=False)
    layer = (voxels.fractions[:, 0] * voxels.fill).sum() * 1e-9
    shell = 4 / 3 * np.pi * ((15e-3) ** 3 - (13e-3) ** 3)
    assert layer == pytest.approx(shell, rel=0.05)
    centres = voxels.origin + (voxels.cells + 0.5) * voxels.voxel - 19.5e-3
    outer = np.linalg.norm(centres, axis=1) > 11e-3
    inward = -centres[outer] / np.linalg.norm(centres[outer], axis=1)[:, None]
    assert ((voxels.normal[outer] * inward).sum(axis=1) > 0.9).all()


def scene_tables(**labels):
    return {
        "schema": 1,
        "units": "mm",
        "geometry": {
            "voxel": 1.0,
            "labels": {"file": "labels.npy", "spacing": [1, 1, 1], "surface": "voxels"} | labels,
        },
        "layers": [
            {"name": "dermis", "thickness": 1.5, "material": MATERIAL},
            {"name": "fat", "material": MATERIAL},
            {"name": "cartilage", "material": MATERIAL},
        ],
        "muscles": [
            {
                "name": "band",
                "surfaces": [],
                "fibre": "long-axis",
                "sigma_act": "1 kPa",
                "material": MATERIAL,
            }
        ],
        "solver": {"duration": "1 ms"},
    }


@pytest.fixture
def head(tmp_path):
    """10 x 8 x 6 voxels of skin (1) with bone below (2), a muscle (3) and cartilage (4)."""
    labels = np.ones((10, 8, 6), dtype=np.uint8)
    labels[:, :, :2] = 2
    labels[1:9, 3:5, 2] = 3
    labels[4:6, 6:8, 4:] = 4
    np.save(tmp_path / "labels.npy", np.pad(labels, 1))
    return tmp_path


def test_scene_from_labels(head):
    tables = scene_tables(bones=[2], muscles={"band": 3}, layers={"cartilage": [4]})
    tables["geometry"]["outer"] = [[[-1, -1, 6.4], [99, 99, 99]]]
    model = Scene.from_dict(tables, head).build()
    assert model.tissues == ["dermis", "fat", "cartilage", "band"]
    assert model.n_elements == 10 * 8 * 4
    np.testing.assert_allclose(model.origin, [0.5e-3, 0.5e-3, 0.5e-3])
    volumes = model.fractions.sum(axis=0)
    np.testing.assert_allclose(volumes, [80 * 1.5 - 4 * 1.5, 80 * 2.5 - 16 - 2, 8, 16], rtol=1e-9)
    (band,) = model.muscles
    np.testing.assert_allclose(np.abs(band.fibre), np.tile([1.0, 0, 0], (16, 1)), atol=1e-9)
    skin = model.surfaces["skin"]
    np.testing.assert_allclose(np.ptp(skin.vertices, axis=0), [0.01, 0.008, 0.006], rtol=0.4)
    assert model.report["left_out"]["loose"]["voxels"] == 0


def test_skin_surface_with_labels_inside(head):
    import trimesh

    trimesh.creation.box(bounds=[[0.5, 0.5, 0.5], [10.5, 8.5, 6.5]]).export(head / "skin.stl")
    tables = scene_tables(bones=[2], muscles={"band": 3}, layers={"cartilage": [4]})
    tables["geometry"]["skin"] = "skin.stl"
    model = Scene.from_dict(tables, head).build()
    assert model.n_elements == 10 * 8 * 4
    assert model.fractions[:, 3].sum() == pytest.approx(16)


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ({"bones": [77]}, r"labels\.npy: bone 0: no voxel has label 77; labels there: 0, 1, 2"),
        ({"muscles": {"bond": 3}}, r"geometry\.labels\.muscles: got 'bond'; allowed: .* band"),
        (
            {"layers": {"cartilage": 4, "skin": 3}},
            r"geometry\.labels\.layers: got 'skin'; allowed: .*dermis",
        ),
        ({"skin": []}, r"geometry\.labels\.skin: got \[\]; allowed: a label"),
        ({"skin": "all"}, r"geometry\.labels\.skin: got 'all'"),
        ({"spacing": [1, 0, 1]}, r"geometry\.labels\.spacing: got \[1, 0, 1\]"),
        ({"spacing": None}, "says no voxel size; give spacing"),
        ({}, r"muscles\[0\]\.surfaces: got \[\]; allowed: at least one surface file"),
        ({"file": "gone.npy"}, r"geometry\.labels\.file: file not found: "),
    ],
)
def test_scene_refusals(head, labels, message):
    base = {"bones": [2], "layers": {"cartilage": 4}}
    tables = scene_tables(**(base | ({"muscles": {"band": 3}} | labels if labels else {})))
    if tables["geometry"]["labels"].get("spacing", 0) is None:
        del tables["geometry"]["labels"]["spacing"]
    with pytest.raises(InputError, match=message) as caught:
        Scene.from_dict(tables, head).build()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("values", [(-5, 0, 7), (0, 3, 10**7), (2, 3, 4.0), (10**12, 10**12 + 1)])
def test_labels_of_any_value_and_type(tmp_path, values):
    data = np.random.default_rng(0).choice(values, size=(4, 5, 6))
    image = read_labels(saved(tmp_path, data), spacing=STEP)
    assert image.values.tolist() == sorted(values)
    np.testing.assert_array_equal(image.values[image.labels], data)
    small = read_labels(saved(tmp_path, np.array([[[-128, 127]]], np.int8)), spacing=STEP)
    assert small.values[small.labels].tolist() == [[[-128, 127]]]
    volume = of(image, [int(values[1])])
    assert volume.members == [1]


def test_unusable_images(tmp_path):
    good = np.ones((3, 3, 3), dtype=np.uint8)
    for name, data, message in (
        ("grey.npy", good * 0.5, "values that are not whole numbers"),
        ("flat.npy", good[0], r"has shape \(3, 3\)"),
        ("nan.npy", np.full((2, 2, 2), np.nan), "not whole numbers"),
        ("text.npy", np.full((2, 2, 2), "a"), "holds <U1"),
        ("huge.npy", np.full((2, 2, 2), 2**64 - 1, dtype=np.uint64), "allowed: up to 2"),
    ):
        np.save(tmp_path / name, data)
        with pytest.raises(InputError, match=rf"{name}: .*{message}"):
            read_labels(tmp_path / name, spacing=(1, 1, 1))
    (tmp_path / "broken.nii").write_bytes(b"not an image")
    (tmp_path / "broken.npy").write_bytes(b"not an image")
    (tmp_path / "image.png").write_bytes(b"")
    np.savez(tmp_path / "other.npz", data=good)
    required("nibabel")
    for name, message in (
        ("broken.nii", "cannot be read as nii"),
        ("broken.npy", "cannot be read as npy"),
        ("image.png", r"allowed: \.nii, \.nii\.gz, \.npy, \.npz"),
        ("other.npz", "holds data; an array named labels is needed"),
        ("gone.nii", "no such label image"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            read_labels(tmp_path / name)
        assert "\n" not in str(caught.value)
    np.savez(tmp_path / "own.npz", labels=good, spacing=[1, 2, 3], origin=[4, 5, 6])
    image = read_labels(tmp_path / "own.npz", unit_scale=1e-3)
    np.testing.assert_allclose(image.affine[:3, :3], np.diag([1e-3, 2e-3, 3e-3]))
    np.testing.assert_allclose(image.affine[:3, 3], [4e-3, 5e-3, 6e-3])


@pytest.mark.parametrize("missing", ["nibabel", "skimage.measure"])
def test_a_missing_library_says_what_brings_it(tmp_path, monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    (tmp_path / "head.nii").write_bytes(b"")
    with pytest.raises(InputError, match=r'pip install "tledface\[volumes\]"'):
        if missing == "nibabel":
            read_labels(tmp_path / "head.nii")
        image = read_labels(saved(tmp_path, random_labels()), spacing=STEP)
        LabelVolume.of(image, [1], "tissue")
