"""Fibre fields: bad input, sense, invariance, curves, averages in voxels, pictures."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import muscle_shapes as shapes
from muscle_shapes import MM, angles, inner_points
from test_build import build, export, refused, tables
from tledface.errors import InputError
from tledface.fibre_kinds import make_fibre
from tledface.fibre_picture import fibre_picture
from tledface.geometry import fibre_field, make_field, mean_fibres, read_curves
from tledface.geometry.fibres import MuscleGrid, fit_volume
from tledface.model import Model

TURN = trimesh.transformations.rotation_matrix(0.9, [0.4, -0.7, 0.6], [0.01, 0.0, 0.02])


def refuses(pattern, *arguments, **options):
    with pytest.raises(InputError, match=pattern) as caught:
        fibre_field(*arguments, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["nurbs", "spindle"])
@pytest.mark.parametrize("sense", [1, -1])
def test_given_ends_set_the_sense(kind, sense):
    mesh, fibres = shapes.arc(150)
    points = inner_points(mesh, 500)
    start, end = ("+y", "-x") if sense > 0 else ("-x", "+y")
    found = fibre_field(mesh, kind, points, start=start, to=end)
    towards = np.subtract(*([[-1, 0, 0], [0, 1, 0]][::sense]))
    assert (found @ towards).mean() > 0.3
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
    assert angles(found, fibres(points))[1] == 1.0


@pytest.mark.parametrize(
    ("shape", "kind", "options"),
    [
        (shapes.arc(120), "nurbs", {}),
        (shapes.arc(120), "spindle", {}),
        (shapes.curved_sheet(), "sheet", {"to": (0.0, 0.6, 0.8)}),
        (shapes.round_ring(), "sphincter", {}),
    ],
    ids=["nurbs", "spindle", "sheet", "sphincter"],
)
def test_a_moved_muscle_has_moved_fibres_and_shuffled_faces_the_same(shape, kind, options):
    mesh, _ = shape
    points = inner_points(mesh, 800)
    found = fibre_field(mesh, kind, points, **options)
    order = np.random.default_rng(3).permutation(len(mesh.faces))
    turned = np.stack([np.roll(face, n) for n, face in enumerate(mesh.faces[order])])
    # Each row by another number of places: the winding stays.
    shuffled = trimesh.Trimesh(mesh.vertices, turned, process=False)
    np.testing.assert_array_equal(found, fibre_field(shuffled, kind, points, **options))
    moved = mesh.copy().apply_transform(TURN)
    if "to" in options:
        options = {"to": TURN[:3, :3] @ options["to"]}
    there = fibre_field(moved, kind, trimesh.transform_points(points, TURN), **options)
    off, same = angles(there @ TURN[:3, :3], found)
    assert off.mean() < 1.0 and np.percentile(off, 99) < 6.0 and same == 1.0


def test_ends_by_box_and_line_agree_with_a_direction():
    mesh, fibres = shapes.flat_sheet()
    points = inner_points(mesh, 1000)
    low = {"points": [[0.0, 0.0, 0.0], [40 * MM, 0.0, 0.0]]}
    high = {"box": [[-1.0, -1.0, 29 * MM], [1.0, 1.0, 1.0]]}
    for ends in ({"start": low, "to": high}, {"start": low, "to": "+z"}, {"to": "+z"}):
        off, same = angles(fibre_field(mesh, "sheet", points, **ends), fibres(points))
        assert off.mean() < 0.5 and np.percentile(off, 99) < 4.0 and same == 1.0
    back = fibre_field(mesh, "sheet", points, start=high, to=low)
    assert (back[:, 2] < 0.0).all()


def test_a_ring_cut_open_still_runs_round():
    mesh, fibres = shapes.arc(330, 15 * MM, 3 * MM)
    points = inner_points(mesh, 1500)
    off, same = angles(fibre_field(mesh, "sphincter", points), fibres(points))
    assert off.mean() < 2.0 and same == 1.0


def test_sphincter_needs_a_hole_on_its_axis():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5 * MM)
    points = np.zeros((1, 3))
    refuses("not a ring round the axis .*needs a hole", ball, "sphincter", points)
    mesh, _ = shapes.round_ring()
    refuses("not a ring round the axis", mesh, "sphincter", points, axis=(1.0, 0.0, 0.0))
    refuses("not a ring round the axis", mesh, "sphincter", points, centre=(15 * MM, 0.0, 0.0))
    # Beside the ring the axis has no part of it, yet the ring does not run round it.
    found = fibre_field(mesh, "sphincter", inner_points(mesh, 300), centre=(4 * MM, 0.0, 2 * MM))
    assert np.isfinite(found).all()


def test_ends_that_hold_nothing_or_everything():
    mesh, _ = shapes.rod()
    points = np.zeros((1, 3))
    far = {"box": [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]}
    tip = {"points": [[0.0, 0.0, 0.0]]}
    refuses(
        r"surface: to: the box \(1000, .*holds no part of the muscle, which spans",
        *(mesh, "nurbs", points),
        start=tip,
        to=far,
    )
    line = {"points": [[0.1, 0.0, 0.0], [0.1, 0.1, 0.0]]}
    refuses(
        "from: the line of 2 points .* mm away, holds no part",
        *(mesh, "spindle", points),
        start=line,
        to=tip,
    )
    whole = {"box": [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]}
    refuses("hold the same part", mesh, "nurbs", points, start=tip, to=whole)
    sheet, _ = shapes.flat_sheet()
    refuses("from: holds the whole muscle", sheet, "sheet", points, start=whole, to="+z")
    refuses("stands upright on this sheet", sheet, "sheet", points, to="+y")


def test_unknown_kinds_options_and_points():
    mesh, _ = shapes.rod()
    points = np.zeros((1, 3))
    refuses("kind: got 'sheat'; nearest: sheet; allowed: nurbs", mesh, "sheat", points)
    refuses("centre: not a key of 'nurbs'", mesh, "nurbs", points, centre=(0.0, 0.0, 0.0))
    refuses("to: missing; a sheet needs the end", mesh, "sheet", points)
    refuses("points: got shape", mesh, "nurbs", [1.0, 2.0, 3.0])
    refuses("points: got nan at .0, 2., which is not", mesh, "nurbs", [[1.0, 2.0, np.nan]])
    refuses("surface: got str", "rod.obj", "nurbs", points)
    refuses("kind: got .*not all 0", mesh, (0.0, 0.0, 0.0), points)
    refuses("degree: got True", mesh, "nurbs", points, degree=True)
    assert fibre_field(mesh, (0.0, 0.0, 2.0), points).tolist() == [[0.0, 0.0, 1.0]]
    assert fibre_field(mesh, "nurbs", np.zeros((0, 3))).shape == (0, 3)


def test_outside_the_muscle_fibres_go_on():
    mesh, fibres = shapes.arc(120)
    points = inner_points(mesh, 200)
    beside = points * [1.4, 1.4, 1.0]
    for kind in ("nurbs", "spindle"):
        off, same = angles(fibre_field(mesh, kind, beside), fibres(beside))
        assert off.mean() < 15.0 and same == 1.0


def test_volume_inverts_to_its_own_points():
    mesh, _ = shapes.arc(120)
    volume = fit_volume(MuscleGrid(shapes.solid_of(mesh)), make_fibre("nurbs"))
    points = inner_points(mesh, 2000)
    parameters, along, left = volume.locate(points)
    assert np.sqrt(left.max()) < 1e-9
    assert volume.residual < 0.05 * MM
    # dV/du by a difference of what the inverse itself says: a step along it raises u by as much.
    ahead, _, _ = volume.locate(points + 1e-4 * along)
    inside = (np.abs(parameters - 0.5) < 0.45).all(axis=1)
    np.testing.assert_allclose(
        (ahead - parameters)[inside], [[1e-4, 0, 0]] * inside.sum(), atol=2e-6
    )


def test_fields_do_not_depend_on_the_number_of_threads(tmp_path):
    """In other processes, as libraries read the number once."""
    code = """
import muscle_shapes as shapes, numpy as np, sys
from tledface.geometry import fibre_field
found = []
for (mesh, _), kind, options in (
    (shapes.arc(120), "nurbs", {}),
    (shapes.arc(120), "spindle", {}),
    (shapes.flat_sheet(), "sheet", {"to": "+z"}),
    (shapes.round_ring(), "sphincter", {}),
):
    found.append(fibre_field(mesh, kind, shapes.inner_points(mesh, 500), **options))
np.save(sys.argv[1], found)
"""
    found = []
    for threads in ("1", "2"):
        names = ("TLEDFACE_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
        path = tmp_path / f"{threads}.npy"
        subprocess.run(
            [sys.executable, "-c", code, str(path)],
            env=os.environ
            | dict.fromkeys(names, threads)
            | {"PYTHONPATH": str(Path(shapes.__file__).parent)},
            check=True,
        )
        found.append(np.load(path))
    np.testing.assert_array_equal(*found)


def write_curves(folder, ending, curves):
    path = folder / f"curves{ending}"
    if ending == ".npy":
        np.save(path, np.array(curves))
    elif ending == ".csv":
        rows = [f"{n},{x},{y},{z}" for n, c in enumerate(curves) for x, y, z in c]
        path.write_text("\n".join(["curve,x,y,z", *rows]))
    else:
        lines = [f"v {x} {y} {z}" for c in curves for x, y, z in c]
        count = len(curves[0])
        lines += [
            "l " + " ".join(str(n * count + k + 1) for k in range(count))
            for n in range(len(curves))
        ]
        path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("ending", [".obj", ".csv", ".npy"])
def test_fibres_along_curves_whatever_way_they_are_drawn(tmp_path, ending):
    mesh, fibres = shapes.arc(120)
    angle = np.radians(np.linspace(0.0, 120.0, 30))
    curves = [
        1e3 * np.stack([r * np.cos(angle), r * np.sin(angle), 0.0 * angle], axis=1)
        for r in (17 * MM, 20 * MM, 23 * MM)
    ]
    curves[1] = curves[1][::-1]
    path = write_curves(tmp_path, ending, curves)
    read = read_curves(path, unit_scale=MM)
    assert len(read) == 3
    np.testing.assert_allclose(read[1], MM * curves[1], rtol=1e-6)
    points = inner_points(mesh, 1000)
    off, same = angles(fibre_field(mesh, "curves", points, curves=read), fibres(points))
    assert off.mean() < 1.0 and off.max() < 6.0 and same == 1.0


def test_unusable_curve_files(tmp_path):
    bad = {
        "empty.obj": ("", "no curve in it"),
        "points.obj": ("v 0 0 0\nv 1 0 0\n", "no curve in it"),
        "far.obj": ("v 0 0 0\nl 1 7\n", "names a point that is not there, of 1"),
        "nan.csv": ("0,0,0\nnan,0,0\n", "curve 0 has a point that is not finite"),
        "still.csv": ("1,2,3\n1,2,3\n", "curve 0 has no length"),
        "ragged.csv": ("1,2,3\n1,2\n", r"rows of \[2, 3\] columns"),
        "words.csv": ("x,y,z\n1,2,three\n", "cannot be read as curves"),
        "noise.npy": ("not numpy", "cannot be read as curves"),
        "lines.ply": ("ply", r"ending '\.ply' is not known for curves; allowed: \.obj"),
    }
    for name, (text, message) in bad.items():
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=re.escape(name) + ".*" + message):
            read_curves(tmp_path / name)
    np.save(tmp_path / "flat.npy", np.zeros((4, 2)))
    with pytest.raises(InputError, match=r"shape \(4, 2\), need \(n, 3\)"):
        read_curves(tmp_path / "flat.npy")
    with pytest.raises(InputError, match=r"gone\.csv: no such file of curves"):
        read_curves(tmp_path / "gone.csv")


def test_mean_is_over_the_samples_in_the_muscle():
    """A ring in voxels as large as its section: the mean of the directions at samples inside."""
    mesh, _ = shapes.round_ring()
    solid = shapes.solid_of(mesh)
    field = make_field(solid, make_fibre("sphincter"))
    voxel, samples = np.array([4.0, 3.0, 5.0]) * MM, 5
    origin = mesh.bounds[0] - [1 * MM, 0.5 * MM, 2 * MM]
    cells = np.argwhere(np.ones((9, 3, 9)))
    found = mean_fibres([field], [solid], cells, origin=origin, voxel=voxel, samples=samples)
    at = np.stack(np.meshgrid(*[(np.arange(samples) + 0.5) / samples] * 3, indexing="ij"), -1)
    for row in np.flatnonzero(found.sampled)[::7]:
        points = origin + voxel * (cells[row] + at.reshape(-1, 3))
        inside = solid.closest_points(points)[3] < 0
        mean = field.directions(points[inside]).mean(axis=0)
        assert found.alignment[row] == pytest.approx(np.linalg.norm(mean), abs=1e-9)
        np.testing.assert_allclose(found.fibre[row], mean / np.linalg.norm(mean), atol=1e-9)
    assert found.alignment[found.sampled].min() < 0.995
    np.testing.assert_allclose(np.linalg.norm(found.fibre, axis=1), 1.0)


def two_muscles(folder):
    rod = trimesh.creation.cylinder(2.0, 8.0, sections=32)
    rod.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], [1, 0, 0]))
    export(rod.copy().apply_translation([5, 4, 3]), folder / "rod.obj")
    other = trimesh.creation.box(bounds=[[4, 0.5, 1], [6, 7.5, 5]])
    export(other, folder / "bar.obj")
    base = tables(folder)["muscles"][0]
    return [
        base | {"name": "rod", "surfaces": ["rod.obj"], "fibre": "nurbs"},
        base | {"name": "bar", "surfaces": ["bar.obj"], "fibre": {"kind": "spindle"}},
    ]


def test_muscles_that_cross_keep_their_own_fibres(tmp_path):
    model = build(tmp_path, muscles=two_muscles(tmp_path))
    rod, bar = model.muscles
    shared = np.intersect1d(rod.elements, bar.elements)
    assert len(shared) > 5
    assert np.abs(rod.fibre[:, 0]).min() > 0.99
    assert np.abs(bar.fibre[:, 1]).min() > 0.99
    report = model.report["fibres"]["rod"]
    assert report["kind"] == "nurbs" and report["mean_alignment"] > 0.999


def test_surfaces_of_one_muscle_do_not_cancel_where_they_meet():
    """Two halves whose own senses oppose each other share a layer of voxels."""
    boxes = ([[0, 0, 0], [8, 2.5, 2]], [[0, 2.5, 0], [8, 5, 2]])
    solids = [
        shapes.solid_of(trimesh.creation.box(bounds=np.multiply(bounds, MM))) for bounds in boxes
    ]
    fields = [make_field(solids[0], (1.0, 0.0, 0.0)), make_field(solids[1], (-0.8, 0.6, 0.0))]
    cells = np.argwhere(np.ones((8, 5, 2)))
    found = mean_fibres(fields, solids, cells, origin=[0.0] * 3, voxel=[MM] * 3, samples=4)
    shared = cells[:, 1] == 2
    expected = np.where(
        shared[:, None],
        np.array([0.9, -0.3, 0.0]) / np.hypot(0.9, 0.3),
        np.where(cells[:, 1:2] < 2, [1.0, 0.0, 0.0], [-0.8, 0.6, 0.0]),
    )
    np.testing.assert_allclose(found.fibre, expected, atol=1e-9)
    np.testing.assert_allclose(found.alignment[shared], np.hypot(0.9, 0.3))


def test_build_names_the_muscle(tmp_path):
    base = tables(tmp_path)["muscles"][0]
    refused(
        tmp_path,
        r"muscle 'band': fibre: .*muscle\.obj: not a ring round the axis",
        muscles=[base | {"fibre": "sphincter"}],
    )
    far = {"kind": "sheet", "from": {"box": [[90, 0, 0], [91, 1, 1]]}, "to": "+x"}
    refused(
        tmp_path,
        r"muscle 'band': fibre: .*muscle\.obj: from: the box \(90, .* holds no part",
        muscles=[base | {"fibre": far}],
    )


def test_picture_shows_the_muscles_asked_for(tmp_path):
    import matplotlib.image

    model = build(tmp_path, muscles=two_muscles(tmp_path))
    path = fibre_picture(tmp_path / "both.png", model, view="front")
    both = matplotlib.image.imread(path)[..., :3]
    rod = matplotlib.image.imread(fibre_picture(tmp_path / "rod.png", model, muscles=["rod"]))

    def coloured(image, channel):
        others = np.delete(image[..., :3], channel, axis=2).max(axis=2)
        return np.count_nonzero(image[80:, :, channel] - others[80:] > 0.3)

    # Seen from the front the rod runs across (red), the bar into the picture (its lines are dots).
    assert coloured(both, 0) > 2000 and coloured(rod, 0) > 2000
    assert coloured(rod, 2) == 0
    top = matplotlib.image.imread(fibre_picture(tmp_path / "top.png", model, view="top"))
    assert coloured(top, 2) > 1000  # the bar runs upwards in this view


def test_picture_refuses(tmp_path):
    model = build(tmp_path)
    for pattern, path, options in (
        (r"must end in \.png", "a.jpg", {}),
        ("no muscle 'bend'; allowed: band", "a.png", {"muscles": ["bend"]}),
        ("view 'below' is not known; allowed: front", "a.png", {"view": "below"}),
        ("there is no folder", "gone/a.png", {}),
    ):
        with pytest.raises(InputError, match=pattern):
            fibre_picture(tmp_path / path, model, **options)
    fat = model.tissue_materials[0]
    bare = Model.block((2, 2, 2), (2e-3, 2e-3, 2e-3), fat, tissue="fat")
    with pytest.raises(InputError, match="the model has no muscle"):
        fibre_picture(tmp_path / "a.png", bare)
