"""Layer thickness by vertex: properties, files, paint, and the way to the checked volume."""

import numpy as np
import pytest
import trimesh

from tledface.errors import InputError
from tledface.geometry import read_surface
from tledface.geometry.vertex_fields import on_solid, painted, values_of_file, vertex_property
from tledface.scene import Scene

MATERIAL = {
    "model": "neo_hookean",
    "youngs_modulus": "50 kPa",
    "poissons_ratio": 0.49,
    "density": "1000 kg/m^3",
}


def ply(path, vertices, faces, colours=None, **properties):
    """A PLY file with vertex properties, in the order given."""
    names = [f"property double {name}\n" for name in properties]
    rgb = [f"property uchar {c}\n" for c in ("red", "green", "blue")] if colours is not None else []
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty double x\n"
        f"property double y\nproperty double z\n{''.join(names + rgb)}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    columns = [vertices, *(np.asarray(v)[:, None] for v in properties.values())]
    rows = [" ".join(f"{x:.17g}" for x in row) for row in np.hstack(columns)]
    if colours is not None:
        rows = [f"{row} {r} {g} {b}" for row, (r, g, b) in zip(rows, colours, strict=True)]
    rows += [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text(head + "\n".join(rows) + "\n")
    return path


@pytest.fixture
def block():
    """10 x 8 x 6 mm, faces of about 1 mm."""
    mesh = trimesh.creation.box(bounds=[[0, 0, 0], [10, 8, 6]])
    for _ in range(3):
        mesh = mesh.subdivide()
    return mesh


def test_values_reach_the_solid_through_welding_and_reordering(tmp_path, block):
    rng = np.random.default_rng(0)
    order = rng.permutation(len(block.faces))
    vertices = block.vertices[block.faces[order]].reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    noise = rng.uniform(-0.1, 0.1, len(vertices))
    value = vertices @ [1.0, 2.0, 3.0]
    surface = read_surface(ply(tmp_path / "s.ply", vertices, faces, depth=value), unit_scale=1e-3)
    read = vertex_property(surface, "depth")
    np.testing.assert_array_equal(read, value)
    np.testing.assert_allclose(on_solid(surface, read), surface.solid.vertices @ [1e3, 2e3, 3e3])
    # Values that differ at one place give their mean.
    mean = on_solid(surface, noise)
    where = np.linalg.norm(surface.vertices - surface.solid.vertices[5], axis=1) == 0
    assert where.sum() > 1 and mean[5] == pytest.approx(noise[where].mean())


def test_what_fills_a_hole_takes_the_mean_of_its_neighbours(tmp_path, block):
    v = int(np.argmin(np.linalg.norm(block.vertices - [5, 4, 6], axis=1)))
    faces = block.faces[(block.faces != v).all(axis=1)]
    path = ply(tmp_path / "s.ply", block.vertices, faces, depth=block.vertices[:, 0])
    surface = read_surface(path, close_holes=True)
    values = on_solid(surface, vertex_property(surface, "depth"))
    np.testing.assert_allclose(values, surface.solid.vertices[:, 0], atol=0.3)


def test_files_and_paint(tmp_path, block):
    n = len(block.vertices)
    level = np.round(block.vertices[:, 0] / 10 * 255).astype(int)
    colours = np.stack([level, np.full(n, 51), np.zeros(n, int)], axis=1)
    surface = read_surface(ply(tmp_path / "s.ply", block.vertices, block.faces, colours))
    np.testing.assert_allclose(painted(surface, "red"), level / 255)
    np.testing.assert_allclose(painted(surface, "green"), 0.2)
    np.testing.assert_allclose(painted(surface, "grey"), (level + 51) / 765)
    np.save(tmp_path / "v.npy", np.arange(n))
    (tmp_path / "v.csv").write_text(",".join(map(str, range(n))))
    for name in ("v.npy", "v.csv"):
        np.testing.assert_array_equal(values_of_file(surface, tmp_path / name), np.arange(n))


def scene(folder, thickness, skin="s.ply"):
    return Scene.from_dict(
        {
            "schema": 1,
            "units": "mm",
            "geometry": {"skin": skin, "voxel": 1.0, "outer": [[[-1, -1, 5.9], [99, 99, 6.1]]]},
            "layers": [
                {"name": "dermis", "thickness": thickness, "material": MATERIAL},
                {"name": "fat", "material": MATERIAL},
            ],
            "solver": {"duration": "1 ms"},
        },
        folder,
    )


def test_scene_with_each_kind_of_thickness(tmp_path, block):
    x = block.vertices[:, 0]
    level = np.round(x / 10 * 255).astype(int)
    colours = np.stack([level] * 3, axis=1)
    ply(tmp_path / "s.ply", block.vertices, block.faces, colours, dermis=0.01 + 0.02 * x)
    np.save(tmp_path / "t.npy", 0.01 + 0.02 * x)
    expected = 0.01 + 0.02 * (np.arange(10) + 0.5)
    for thickness, tolerance in (
        ({"vertex": "dermis"}, 1e-9),
        ({"file": "t.npy"}, 1e-9),
        ({"painted": [0.01, 0.21]}, 5e-4),
        ({"painted": [0.01, "210 um"], "channel": "blue"}, 5e-4),
    ):
        model = scene(tmp_path, thickness).build()
        top = model.cells[:, 2] == 5
        assert top.sum() == 80
        np.testing.assert_allclose(
            model.fractions[top, 0], expected[model.cells[top, 0]], atol=tolerance
        )


@pytest.mark.parametrize(
    ("thickness", "message"),
    [
        ({"vertex": "fat"}, r"s\.ply: no vertex property 'fat'; it has x, y, z, dermis"),
        ({"file": "short.csv"}, r"short\.csv: 3 values, .*s\.ply has \d+ vertices"),
        ({"file": "words.txt"}, r"words\.txt: cannot be read as numbers"),
        ({"file": "gone.npy"}, r"layers\[0\]\.thickness: file not found"),
        ({"painted": [0, 1]}, "has no vertex colours"),
        ({"painted": [0, 0]}, r"layers\[0\]\.thickness\.painted: got \[0, 0\]"),
        ({"painted": [0, 1], "channel": "pink"}, r"channel: got 'pink'; allowed: grey, red"),
        ({"vertx": "dermis"}, r"vertx: unknown key; nearest: vertex"),
        ({"vertex": "dermis", "file": "t.npy"}, r"allowed: a length greater than 0, \{ vertex"),
        ({"vertex": "negative"}, r"layer 'dermis': thickness from -1 to 1 mm; allowed: at least 0"),
        ({"vertex": "nothing"}, r"layer 'dermis': thickness from 0 to 0 mm"),
    ],
)
def test_refusals(tmp_path, block, thickness, message):
    n = len(block.vertices)
    fields = {
        "dermis": np.ones(n),
        "negative": np.linspace(-1, 1, n),
        "nothing": np.zeros(n),
    }
    ply(tmp_path / "s.ply", block.vertices, block.faces, **fields)
    (tmp_path / "short.csv").write_text("1, 2\n3\n")
    (tmp_path / "words.txt").write_text("one two three")
    with pytest.raises(InputError, match=message) as caught:
        scene(tmp_path, thickness).build()
    assert "\n" not in str(caught.value)


def test_stl_has_no_vertices_to_speak_of(tmp_path, block):
    block.export(tmp_path / "s.stl")
    np.save(tmp_path / "t.npy", np.ones(3))
    with pytest.raises(InputError, match=r"3 values, .*STL files have no vertices of their own"):
        scene(tmp_path, {"file": "t.npy"}, "s.stl").build()
    with pytest.raises(InputError, match=r"s\.stl: only PLY files have vertex properties"):
        scene(tmp_path, {"vertex": "dermis"}, "s.stl").build()
