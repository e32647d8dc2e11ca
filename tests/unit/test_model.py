import dataclasses

import numpy as np
import pytest
import trimesh

from tledface.constitutive import material
from tledface.errors import InputError
from tledface.model import Model
from tledface.surface import HEX_CORNERS, BoundSurface, bind, boundary_surface

SOFT = material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)
STIFF = material(
    "neo_hookean", youngs_modulus=2e6, poissons_ratio=0.3, density=1300.0, volumetric="quadratic"
)


def ragged(seed=0, shape=(7, 5, 6), share=0.4):
    rng = np.random.default_rng(seed)
    cells = np.argwhere(rng.random(shape) < share)
    return Model.from_voxels(
        (1e-3, 2e-3, 0.5e-3), (0.1, -0.2, 0.3), rng.permutation(cells), ["soft"], [SOFT],
        np.ones((len(cells), 1)),
    )  # fmt: skip


@pytest.fixture
def block():
    return Model.block(cells=(4, 3, 2), size=(0.04, 0.06, 0.02), material=SOFT)


def test_block_numbers_nodes_and_elements_with_x_fastest(block):
    assert (block.n_elements, block.n_nodes) == (24, 60)
    assert block.voxel == pytest.approx([0.01, 0.02, 0.01])
    assert block.elements[0].tolist() == [0, 1, 6, 5, 20, 21, 26, 25]
    assert block.cells[:5].tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [0, 1, 0]]
    assert block.nodes.max(axis=0) == pytest.approx([0.04, 0.06, 0.02])
    assert block.centres[0] == pytest.approx([0.005, 0.01, 0.005])


def test_ragged_voxels_have_just_the_nodes_of_their_corners():
    model = ragged()
    corners = model.cells[:, None, :] + HEX_CORNERS
    assert (model.node_ijk[model.elements] == corners).all()
    assert np.array_equal(np.unique(model.elements), np.arange(model.n_nodes))
    order = np.lexsort(model.node_ijk.T)
    assert np.array_equal(order, np.arange(model.n_nodes))
    assert len(np.unique(model.node_ijk, axis=0)) == model.n_nodes
    assert model.elements.dtype == np.int32 and model.elements.flags.c_contiguous


@pytest.mark.parametrize("name", [3, "", None, "a\0b"])
def test_a_tissue_needs_a_name(name):
    with pytest.raises(InputError, match="tissue: name must be a non-empty text"):
        Model.block((1, 1, 1), (1e-3, 1e-3, 1e-3), SOFT, tissue=name)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"voxel": (0, 1, 1)}, "voxel"),
        ({"voxel": (1, 1, np.nan)}, "voxel"),
        ({"origin": (0, 0)}, "origin"),
        ({"cells": np.zeros((2, 3), int)}, "twice"),
        ({"cells": [[0, 0, -1], [0, 0, 1]]}, "cells"),
        ({"cells": np.zeros((0, 3), int)}, "cells"),
        ({"cells": [[0.5, 0, 0], [1, 0, 0]]}, "cells"),
        ({"fractions": [[0.5], [1]]}, "element 0"),
        ({"fractions": [[1], [np.nan]]}, "element 1"),
        ({"fractions": [[1, 0], [0, 1]]}, "shape"),
        ({"tissues": ["a", "a"]}, "distinct"),
        ({"tissue_materials": []}, "materials"),
        ({"section_ratio": [1, 1]}, "together"),
        ({"section_ratio": [0.5, 1], "layer_normal": np.zeros((2, 3))}, "element 0"),
        ({"section_ratio": [0.5, -1], "layer_normal": [[0, 0, 1]] * 2}, "section_ratio"),
    ],
)
def test_bad_voxels_are_one_clear_line(change, word):
    good = {
        "voxel": (1, 1, 1), "origin": (0, 0, 0), "cells": [[0, 0, 0], [1, 0, 0]],
        "tissues": ["a"], "tissue_materials": [SOFT], "fractions": [[1], [1]],
    }  # fmt: skip
    Model.from_voxels(**good)
    with pytest.raises(InputError, match=word) as caught:
        Model.from_voxels(**(good | change))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("cells", [(0, 1, 1), (1.5, 1, 1), (1, 1)])
def test_bad_block(cells):
    with pytest.raises(InputError, match="block cells"):
        Model.block(cells, (1, 1, 1), SOFT)
    with pytest.raises(InputError, match="block size"):
        Model.block((1, 1, 1), (1, -1, 1), SOFT)


@pytest.mark.parametrize(
    ("cells", "word"), [((10**6,) * 3, "nodes in all"), ((1200,) * 3, "GB of memory")]
)
def test_a_block_beyond_all_memory_is_refused(cells, word, monkeypatch):
    monkeypatch.setattr("tledface.geometry.memory.available_memory", lambda: 10**9)
    with pytest.raises(InputError, match=f"block cells: got .*{word}"):
        Model.block(cells, (1, 1, 1), SOFT)


def test_set_material_adds_reuses_and_replaces(block):
    upper = block.centres[:, 2] > 0.01
    block.set_material(lambda x: x[:, 2] > 0.01, STIFF, name="film")
    assert block.tissues == ["tissue", "film"]
    assert np.array_equal(block.fractions[:, 1], upper)
    assert (block.tissue_of(0), block.tissue_of(23)) == ("tissue", "film")
    block.set_material(upper, STIFF)
    assert len(block.tissues) == 2
    with pytest.raises(InputError, match="got 5 as material; allowed"):
        block.set_material(upper, 5)
    with pytest.raises(InputError, match="another name"):
        block.set_material(block.centres[:, 0] < 0.01, SOFT, name="film")
    block.set_material(upper, SOFT, name="film")
    assert block.tissue_materials == [SOFT, SOFT]
    block.set_material(np.arange(24) == 3, dataclasses.replace(SOFT, density=900.0))
    assert block.tissues[-1] == "tissue_3"
    assert block.fractions.sum(axis=1) == pytest.approx(1.0)


def test_set_material_makes_a_layered_voxel_plain():
    model = Model.from_voxels(
        (1, 1, 1), (0, 0, 0), [[0, 0, 0], [1, 0, 0]], ["a", "b"], [SOFT, STIFF],
        [[0.9, 0.1]] * 2, section_ratio=[0.25, 0.25], layer_normal=[[0, 0.6, 0.8]] * 2,
    )  # fmt: skip
    model.set_material(np.array([True, False]), SOFT)
    p = model.element_parameters()
    assert p["bending_modulus"][0] == pytest.approx([SOFT.youngs_modulus] * 3)
    factor = [1, 1 - 0.36 * 0.75, 1 - 0.64 * 0.75]
    assert p["bending_modulus"][1] == pytest.approx(p["youngs_modulus"][1] * np.array(factor))


def test_element_parameters_are_fraction_weighted():
    model = Model.from_voxels(
        (1, 1, 1), (0, 0, 0), [[0, 0, 0], [1, 0, 0]], ["a", "b"], [SOFT, STIFF],
        [[1, 0], [0.25, 0.75]],
    )  # fmt: skip
    p = model.element_parameters()
    assert p["mu"][1] == pytest.approx(0.25 * SOFT.mu + 0.75 * STIFF.mu)
    assert p["bulk_log"] == pytest.approx([SOFT.bulk, 0.25 * SOFT.bulk])
    assert p["bulk_quadratic"] == pytest.approx([0, 0.75 * STIFF.bulk])
    assert p["bulk"] == pytest.approx(p["bulk_log"] + p["bulk_quadratic"])
    assert p["density"] == pytest.approx([1100, 1250])
    assert p["youngs_modulus"][0] == pytest.approx(34e3)
    assert p["poissons_ratio"][0] == pytest.approx(0.49)
    assert (p["bending_modulus"] == p["youngs_modulus"][:, None]).all()


def test_add_muscle_takes_every_form_of_fibre_and_weight(block):
    where = block.centres[:, 0] < 0.02
    m = int(where.sum())
    one = block.add_muscle("one", where, (2, 0, 0), sigma_act=5e6)
    assert one.elements.tolist() == np.flatnonzero(where).tolist()
    assert one.fibre.tolist() == [[1, 0, 0]] * m
    assert (one.sigma_pas, one.lambda_opt, one.lambda_pas) == (5e6, 1.0, 1.2)
    assert one.weight.tolist() == [1.0] * m
    weight = np.linspace(0, 1, 24)
    two = block.add_muscle(
        "two", where, np.tile([0, 3, 4], (24, 1)), sigma_act=1, sigma_pas=0, weight=weight
    )
    assert two.fibre[0] == pytest.approx([0, 0.6, 0.8])
    assert two.weight == pytest.approx(weight[where])
    block.add_muscle("three", where, np.tile([0, 0, -1], (m, 1)), sigma_act=1, weight=[0.5] * m)
    assert [muscle.name for muscle in block.muscles] == ["one", "two", "three"]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"name": "taken"}, "already"),
        ({"name": ""}, "name"),
        ({"where": lambda x: x[:, 0] > 9}, "selects none"),
        ({"where": np.ones(5, bool)}, r"\(24,\) bool"),
        ({"name": "a\0b"}, "without NUL"),
        ({"where": np.ones(24)}, "float64"),
        ({"where": lambda x: None}, "object"),
        ({"fibre": (0, 0, 0)}, "non-zero"),
        ({"fibre": (1, np.nan, 0)}, "finite"),
        ({"fibre": np.ones((5, 3))}, "shape"),
        ({"fibre": "long-axis"}, "numbers"),
        ({"sigma_act": -1.0}, "sigma_act"),
        ({"sigma_act": "5 MPa"}, "sigma_act"),
        ({"sigma_act": True}, "sigma_act: got True"),
        ({"sigma_pas": np.inf}, "sigma_pas"),
        ({"sigma_act": 1e300}, r"sigma_act: got 1e\+300; allowed: a number from 0 to 1e\+15 Pa"),
        ({"sigma_pas": 1e16}, r"sigma_pas: got 1e\+16; allowed: .* 1e\+15 Pa"),
        ({"lambda_opt": 0.0}, r"lambda_opt: got 0\.0; allowed: a number from 0\.1 to 10"),
        ({"lambda_opt": 1e-50}, "lambda_opt: got 1e-50"),
        ({"lambda_pas": 1e300}, r"lambda_pas: got 1e\+300; allowed: a number from 1 to 10"),
        ({"lambda_pas": 0.9}, "lambda_pas"),
        ({"weight": 1.5}, "weight"),
        ({"weight": [0.5] * 3}, "weight"),
    ],
)
def test_bad_muscles_are_one_clear_line_and_leave_no_trace(block, change, word):
    where = np.ones(24, bool)
    block.add_muscle("taken", where, (1, 0, 0), sigma_act=1.0)
    call = {"name": "new", "where": where, "fibre": (1, 0, 0), "sigma_act": 1.0} | change
    with pytest.raises(InputError, match=word) as caught:
        block.add_muscle(**call)
    assert "\n" not in str(caught.value)
    assert len(block.muscles) == 1


def test_fix_adds_up_and_checks(block):
    block.fix(lambda x: x[:, 2] == 0.0)
    block.fix(block.nodes[:, 0] == 0.0, components="x")
    assert block.fixed[:, 2].sum() == 20
    assert block.fixed[:, 0].sum() == 20 + 4 * 2
    for components in ("", "xw", 3):
        with pytest.raises(InputError, match="components"):
            block.fix(np.ones(60, bool), components)
    with pytest.raises(InputError, match=r"selects none of the 60 nodes.*span"):
        block.fix(lambda x: x[:, 2] > 1.0)
    with pytest.raises(InputError, match="one per node"):
        block.fix(np.ones(24, bool))


def test_a_callable_cannot_change_the_model(block):
    def greedy(x):
        x[:] = 0
        return np.ones(len(x), bool)

    block.fix(greedy)
    assert block.nodes.max() > 0


def test_gravity_is_checked(block):
    block.gravity = (0, 0, -9.81)
    assert block.gravity.tolist() == [0, 0, -9.81]
    with pytest.raises(InputError, match="gravity"):
        block.gravity = (0, 0)
    with pytest.raises(InputError, match=r"gravity: got \(0, 0, -1e\+300\) m/s2; allowed: up to"):
        block.gravity = (0, 0, -1e300)
    with pytest.raises(InputError, match=r"pressure: got 1e\+300; allowed: Pa as a number up to"):
        block.pressure(lambda c, n: n[:, 2] > 0.5, 1e300)
    with pytest.raises(InputError, match=r"body_force: got 1e\+300 N/m3; allowed: up to 1e\+15"):
        block.body_force(lambda c: c[:, 0] > 0, (0, 0, -1e300))
    assert (block.gravity[2], block.pressures, block.body_forces) == (-9.81, [], [])


def test_voxels_that_single_precision_does_not_hold_are_refused(block):
    for size in (1e-300, 1e30):
        with pytest.raises(InputError, match=r"voxel: got .* m; allowed: edges of 1e-09 to 1e"):
            Model.block((2, 2, 2), (size,) * 3, block.tissue_materials[0])


def test_block_surface_is_closed_and_points_outwards(block):
    surface = block.surfaces["surface"]
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(0.04 * 0.06 * 0.02)
    assert len(surface.faces) == 2 * 2 * (12 + 8 + 6)


def test_ragged_boundary_encloses_the_voxels():
    model = ragged()
    surface = boundary_surface(model)
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.volume == pytest.approx(model.n_elements * model.voxel.prod())
    moved = surface.displaced(model.nodes)
    assert moved == pytest.approx(2 * surface.vertices, abs=1e-15)


def test_bind_finds_the_nearest_element_at_any_distance():
    model = ragged(3)
    rng = np.random.default_rng(1)
    low, high = model.nodes.min(axis=0), model.nodes.max(axis=0)
    near = rng.uniform(low - 2e-3, high + 2e-3, (400, 3))
    points = np.concatenate([near, low + rng.normal(0, 0.5, (50, 3)), model.nodes])
    element, local, distance = bind(points, model)
    corner = model.origin + model.cells * model.voxel
    outside = np.maximum(corner - points[:, None], points[:, None] - corner - model.voxel)
    every = np.linalg.norm(np.maximum(outside, 0), axis=2)
    assert distance == pytest.approx(every.min(axis=1), abs=1e-15)
    assert every[np.arange(len(points)), element] == pytest.approx(distance, abs=1e-15)
    back = model.origin + (model.cells[element] + local) * model.voxel
    assert back == pytest.approx(points, abs=1e-14)
    again = bind(points, model)[0]
    assert np.array_equal(again, element)


def test_bind_to_a_single_voxel():
    model = Model.block((1, 1, 1), (1, 1, 1), SOFT)
    element, local, distance = bind([[0.5, 0.5, 3.0]], model)
    assert (element[0], distance[0]) == (0, 2.0)
    assert local[0] == pytest.approx([0.5, 0.5, 3.0])


def test_bound_surface_rests_and_follows_affine_motion():
    model = ragged(5)
    rng = np.random.default_rng(2)
    low, high = model.nodes.min(axis=0), model.nodes.max(axis=0)
    points = rng.uniform(low, high, (500, 3))
    surface = BoundSurface.on(model, points, np.zeros((0, 3), int))
    assert (surface.displaced(np.zeros_like(model.nodes)) == points).all()
    gradient = 0.25 * rng.normal(size=(3, 3))
    near = bind(points, model)[2] < 0.9 * model.voxel.min()
    assert 0.2 * near.sum() < (surface.distance(model.voxel)[near] > 0).sum()
    expected = points + points @ gradient.T
    assert surface.displaced(model.nodes @ gradient.T)[near] == pytest.approx(expected[near])
    # Any rotation as well, however far it is from none.
    turn = trimesh.transformations.rotation_matrix(2.9, [1, 2, -1])[:3, :3]
    expected = points @ turn.T
    moved = surface.displaced(model.nodes @ (turn - np.eye(3)).T)
    assert moved[near] == pytest.approx(expected[near])


def test_a_vertex_outside_a_voxel_is_not_drawn_out_with_it():
    """Ten times sheared at a free edge; the skin beside it turns and stretches, within bounds."""
    model = Model.block((1, 1, 1), (1, 1, 1), SOFT)
    points = np.array([[0.5, -0.5, -0.5], [0.5, -0.5, 0.5], [0.5, 0.5, 0.5], [0.5, -3.0, -9.0]])
    surface = BoundSurface.on(model, points, np.zeros((0, 3), int))
    shear = np.zeros((3, 3))
    shear[2, 1] = 10.0
    moved = surface.displaced(model.nodes @ shear.T)
    assert moved[2] == pytest.approx([0.5, 0.5, 0.5 + 5.0])
    edge = np.array([0.5, 0.0, 0.0])  # the nearest place in the voxel, which stays where it is
    for k, nearest in ((0, edge), (1, np.array([0.5, 0.0, 0.5]))):
        way, was = np.linalg.norm(moved[k] - nearest), np.linalg.norm(points[k] - nearest)
        assert 0.5 * was < way < 2.0 * was
    assert np.abs(moved[3] - points[3]).max() < 4.0
    # As much as it does without a limit where there is little strain.
    little = surface.displaced(model.nodes @ (0.05 * shear).T)
    assert little[:3] == pytest.approx(points[:3] + points[:3] @ (0.05 * shear).T)


def test_far_from_its_voxel_a_vertex_moves_as_the_place_a_voxel_away_does():
    model = Model.block((3, 1, 1), (0.03, 0.02, 0.01), SOFT)
    away = np.array([0.0, 0.4, 1.0, 1.4, 6.0])  # voxels beyond the end
    points = np.stack([0.03 + 0.01 * away, 0 * away + 0.004, 0 * away + 0.007], axis=1)
    surface = BoundSurface.on(model, points, np.zeros((0, 3), int))
    moved = surface.displaced(0.1 * model.nodes) - points
    expected = 0.1 * np.where(away[:, None] > 1.0, points[2], points)
    assert moved == pytest.approx(expected, abs=1e-15)


def test_a_voxel_that_is_not_finite_harms_only_the_skin_on_it():
    model = Model.block((3, 1, 1), (3, 1, 1), SOFT)
    points = np.random.default_rng(0).uniform([0, -0.5, -0.5], [3, 1.5, 1.5], (300, 3))
    surface = BoundSurface.on(model, points, np.zeros((0, 3), int))
    u = np.random.default_rng(1).normal(0, 2.0, model.nodes.shape)
    good = surface.displaced(u)
    assert np.isfinite(good).all()
    for bad in (np.nan, np.inf):
        with np.errstate(invalid="ignore"):
            moved = surface.displaced(np.where(model.nodes[:, :1] > 2.5, bad, u))
        harmed = surface.element == 2
        assert 50 < harmed.sum() < 250
        assert not np.isfinite(moved[harmed]).any()
        assert np.array_equal(moved[~harmed], good[~harmed])


def test_a_far_vertex_is_not_thrown_away_by_extrapolation():
    model = Model.block((2, 2, 2), (2, 2, 2), SOFT)
    surface = BoundSurface.on(model, [[1.0, 1.0, 100.0]], np.zeros((0, 3), int))
    u = np.random.default_rng(0).normal(0, 1e-2, model.nodes.shape)
    assert np.abs(surface.displaced(u) - surface.vertices).max() < 0.5


def test_bad_surfaces_are_one_clear_line(block):
    good = np.zeros((3, 3))
    for vertices, faces, word in (
        (np.zeros((3, 2)), [[0, 1, 2]], "shape"),
        (np.diag([np.nan, 0, 0]), [[0, 1, 2]], "vertex 0"),
        (good, [[0, 1, 3]], "allowed: 0 to 2"),
        (good, [[0, 1, 2, 2]], "triangulate"),
    ):
        with pytest.raises(InputError, match=word):
            BoundSurface.on(block, vertices, faces)
    with pytest.raises(InputError, match="nodal field"):
        block.surfaces["surface"].displaced(np.zeros((5, 3)))
