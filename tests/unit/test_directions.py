import numpy as np
import pytest

import tledface as tf
from tledface.errors import InputError

HGO = {"mu": 8e3, "k1": 5e3, "k2": 0.8, "bulk_modulus": 2e5, "density": 1000.0}
PLAIN = {"youngs_modulus": 3e4, "poissons_ratio": 0.45, "density": 1000.0}
TENSION = {"along": 2e3, "across": 500.0, "line": (1, 0, 0), "normal": (0, 0, 1)}


def fibrous(**more):
    return tf.material("holzapfel_gasser_ogden", **HGO, first=(1, 0, 0), **more)


@pytest.fixture
def model():
    """Fibrous tissue on the right of plain fat, and both in the middle."""
    cells = np.argwhere(np.ones((5, 3, 2), bool))
    share = np.clip((cells[:, 0] - 1) / 2, 0.0, 1.0)
    model = tf.Model.from_voxels(
        (1e-3, 2e-3, 1.5e-3), np.zeros(3), cells, ["fat", "skin"],
        [tf.material("neo_hookean", **PLAIN), fibrous(pretension=TENSION)],
        np.stack([1 - share, share], axis=1),
    )  # fmt: skip
    return model


def bent(c):
    """Directions that turn about y with x."""
    angle = 300 * c[:, 0]
    return np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)


def rows_of(model, law):
    ((elements, rows),) = [(e, r) for name, e, r in model.law_rows() if name == law]
    return elements, rows


@pytest.mark.parametrize("form", ["callable", "of the tissue", "of all elements"])
def test_a_field_takes_the_place_of_the_material_s_direction(model, form):
    holds = model.fractions[:, 1] > 0
    whole = bent(model.centres)
    given = {"callable": bent, "of the tissue": 3 * whole[holds], "of all elements": whole}[form]
    model.set_directions("skin", {"first": given})
    elements, rows = rows_of(model, "holzapfel_gasser_ogden")
    assert np.array_equal(elements, np.flatnonzero(holds))
    assert rows[:, 5:8] == pytest.approx(whole[holds], abs=1e-15)
    assert (rows[:, 8:] == 0).all()
    assert rows[:, 1:5] == pytest.approx(np.tile([8e3, 5e3, 0.8, 0.0], (len(rows), 1)))
    assert rows[:, 0] == pytest.approx(model.fractions[holds, 1])


def test_zero_leaves_the_material_s_own_and_a_later_call_replaces(model):
    field = bent(model.centres)
    field[model.cells[:, 0] == 4] = 0.0
    model.set_directions("skin", {"first": field})
    model.set_directions("skin", {"second": (lambda c: np.tile([0, 2, 0], (len(c), 1)))})
    elements, rows = rows_of(model, "holzapfel_gasser_ogden")
    last = model.cells[elements, 0] == 4
    assert (rows[last, 5:8] == [1, 0, 0]).all()
    assert rows[~last, 5:8] == pytest.approx(field[elements[~last]], abs=1e-15)
    assert (rows[:, 8:] == [0, 1, 0]).all()
    model.set_directions("skin", {"first": np.tile([0.0, 0, 5], (model.n_elements, 1))})
    assert (rows_of(model, "holzapfel_gasser_ogden")[1][:, 5:8] == [0, 0, 1]).all()


def test_line_and_normal_of_natural_tension_turn_together(model):
    across = np.cross([0, 1, 0], bent(model.centres))
    model.set_directions("skin", {"line": bent, "normal": across[model.fractions[:, 1] > 0]})
    elements, rows = rows_of(model, "pretension")
    assert rows[:, 3:6] == pytest.approx(bent(model.centres)[elements], abs=1e-15)
    assert rows[:, 6:9] == pytest.approx(across[elements], abs=1e-15)
    # The law beside it keeps its own.
    assert (rows_of(model, "holzapfel_gasser_ogden")[1][:, 5:8] == [1, 0, 0]).all()


def test_another_material_takes_the_fields_away(model):
    model.set_directions("skin", {"first": bent})
    model.set_material(model.fractions[:, 1] > 0, fibrous(), name="skin")
    assert model.directions == {}
    assert (rows_of(model, "holzapfel_gasser_ogden")[1][:, 5:8] == [1, 0, 0]).all()


def upright_somewhere(c):
    field = bent(c)
    field[3] = np.nan
    return field


@pytest.mark.parametrize(
    ("tissue", "fields", "word"),
    [
        ("bone", {"first": bent}, "got tissue 'bone'; allowed: fat, skin"),
        ("fat", {"first": bent}, "'fat' is neo_hookean, which has no direction"),
        ("skin", {"fibre": bent}, "allowed: a dict with some of the keys first, second, line, no"),
        ("skin", {}, "allowed: a dict"),
        ("skin", [1, 0, 0], "allowed: a dict"),
        ("skin", {"first": (1, 0, 0)}, r"first: got shape \(3,\)"),
        ("skin", {"first": np.ones((4, 3))}, r"allowed: \(18, 3\) .* or \(30, 3\)"),
        ("skin", {"first": np.zeros((18, 3))}, "zero in all 18 elements"),
        ("skin", {"first": upright_somewhere}, r"element 15 has \(nan, nan, nan\)"),
        ("skin", {"first": lambda c: "along"}, "must be numbers"),
        ("skin", {"line": bent}, r"not at right angles in element \d+ \(18 in all\)"),
    ],
)
def test_bad_directions_are_one_clear_line_and_leave_no_trace(model, tissue, fields, word):
    with pytest.raises(InputError, match=word) as caught:
        model.set_directions(tissue, fields)
    assert "\n" not in str(caught.value)
    assert model.directions == {}


def cylinder():
    """A shell of voxels about the y axis with normals of the skin outwards."""
    cells = np.argwhere(np.ones((20, 2, 20), bool)).astype(np.int32)
    from_axis = np.linalg.norm(cells[:, [0, 2]] - 9.5, axis=1)
    cells = cells[(from_axis > 7) & (from_axis < 9) & (cells[:, 2] > 12)]
    normal = (cells - 9.5) * [1, 0, 1]
    normal = normal / np.linalg.norm(normal, axis=1)[:, None]
    skin = tf.material("neo_hookean", **PLAIN, pretension=TENSION)
    return tf.Model.from_voxels(
        (1e-3, 1e-3, 1e-3), np.zeros(3), cells, ["skin"], [skin], np.ones((len(cells), 1)),
        section_ratio=np.ones(len(cells)), layer_normal=normal,
    )  # fmt: skip


def test_skin_directions_follow_a_curved_skin():
    """A line along x, laid on a cylinder about y, runs around it: at right angles to the normal."""
    model = cylinder()
    line, normal = model.skin_directions((2, 1e-300, 0))
    n = model.layer_normal
    around = np.stack([n[:, 2], 0 * n[:, 0], -n[:, 0]], axis=1)
    assert line == pytest.approx(around, abs=1e-12)
    assert np.array_equal(normal, n / np.linalg.norm(n, axis=1)[:, None])
    along, _ = model.skin_directions(lambda c: np.tile([0.3, 0.0, 0.1], (len(c), 1)), (0, 0, 1))
    assert along == pytest.approx(np.tile([1, 0, 0], (model.n_elements, 1)))
    model.set_directions("skin", {"line": line, "normal": normal})
    # S at rest is the natural tension: 2 kPa along the line, 500 Pa across it within the skin.
    sim = tf.Simulator(model, device="native", precision="double")
    s = sim.stress()
    S = s[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
    side = np.cross(normal, line)
    for a, b, expected in ((line, line, 2e3), (side, side, 500.0), (normal, normal, 0.0)):
        assert np.einsum("ei,eij,ej->e", a, S, b) == pytest.approx(expected, abs=1e-6)
    assert np.einsum("ei,eij,ej->e", line, S, side) == pytest.approx(0, abs=1e-6)


def test_skin_directions_are_zero_where_there_is_no_line_or_normal():
    model = cylinder()
    model.layer_normal[4] = 0.0
    wanted = np.tile([1.0, 0, 0], (model.n_elements, 1))
    wanted[7] = 0.0
    line, normal = model.skin_directions(wanted)
    none = np.zeros(model.n_elements, bool)
    none[[4, 7]] = True
    for field in (line, normal):
        assert (field[none] == 0).all()
        assert np.linalg.norm(field[~none], axis=1) == pytest.approx(1)


def test_skin_directions_name_what_is_wrong():
    model = cylinder()
    with pytest.raises(InputError, match=r"stands upright on the skin in element 5 \(1 in all\)"):
        line = np.tile([0.0, 1.0, 0.0], (model.n_elements, 1))
        line[5] = model.layer_normal[5]
        model.skin_directions(line)
    with pytest.raises(InputError, match=r"line: got shape \(2,\)"):
        model.skin_directions((1, 0))
    with pytest.raises(InputError, match=r"element 0 has .*nan"):
        model.skin_directions((1, 0, np.nan))
    plain = tf.Model.block((2, 2, 2), (1e-3, 1e-3, 1e-3), fibrous())
    with pytest.raises(InputError, match="no layer_normal; give normal="):
        plain.skin_directions((1, 0, 0))


def test_directions_are_saved_bit_for_bit(model, tmp_path):
    rng = np.random.default_rng(5)
    model.save(tmp_path / "plain.h5")
    line = rng.normal(size=(model.n_elements, 3))
    line, normal = model.skin_directions(line, rng.normal(size=(model.n_elements, 3)))
    model.set_directions("skin", {"line": line, "normal": normal, "first": line})
    model.save(tmp_path / "a.h5")
    back = tf.Model.load(tmp_path / "a.h5")
    assert list(back.directions) == ["skin"]
    assert sorted(back.directions["skin"]) == ["first", "line", "normal"]
    for ours, theirs in zip(model.law_rows(), back.law_rows(), strict=True):
        assert np.array_equal(ours[2], theirs[2])
    import h5py

    # Older readers would pass over the fields, so that they must refuse the file.
    for name, version in (("plain.h5", 1), ("a.h5", 2)):
        with h5py.File(tmp_path / name) as file:
            assert file.attrs["version"] == version


def test_a_damaged_field_is_one_clear_line(model, tmp_path):
    import h5py

    model.set_directions("skin", {"first": bent})
    model.save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        group = file["tissues/1/direction_fields"]
        del group["first"]
        group["first"] = np.ones((7, 3))
    with pytest.raises(InputError, match=r"a.h5: direction 'first' of 'skin' has shape \(7, 3\)"):
        tf.Model.load(tmp_path / "a.h5")


def test_fields_of_a_tissue_that_no_element_has_any_more_are_kept(model, tmp_path):
    model.set_directions("skin", {"first": bent})
    model.set_material(np.ones(model.n_elements, bool), model.tissue_materials[0])
    model.save(tmp_path / "a.h5")
    read = tf.Model.load(tmp_path / "a.h5")
    assert np.array_equal(read.directions["skin"]["first"], model.directions["skin"]["first"])
    tf.Simulator(model, device="native").checkpoint(tmp_path / "c.h5")
    assert tf.Simulator.restore(tmp_path / "c.h5").n_steps == 0


def test_a_checkpoint_holds_the_directions(model, tmp_path):
    model.set_directions("skin", {"first": bent})
    model.fix(lambda X: X[:, 0] < 1e-9)
    model.gravity = (0, 0, -500.0)
    sims = [tf.Simulator(model, device="native")]
    sims[0].step(20)
    sims[0].checkpoint(tmp_path / "c.h5")
    sims.append(tf.Simulator.restore(tmp_path / "c.h5"))
    for sim in sims:
        sim.step(50)
    assert np.array_equal(sims[0].u, sims[1].u) and abs(sims[0].u).max() > 1e-6
