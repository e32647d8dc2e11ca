"""Materials: registry, checks, moduli."""

import pytest

from tledface.constitutive import material, materials, parse_material
from tledface.errors import InputError

SOFT = {"youngs_modulus": 34e3, "poissons_ratio": 0.49, "density": 1100.0}


def test_neo_hookean_in_si():
    m = material("neo_hookean", **SOFT)
    assert m.model == "neo_hookean"
    assert m.parameters == {"youngs_modulus": 34e3, "poissons_ratio": 0.49}
    assert m.density == 1100.0
    assert m.volumetric == "log"
    assert m.mu == pytest.approx(34e3 / (2 * 1.49))
    assert m.bulk == pytest.approx(34e3 / (3 * 0.02))
    # E and nu come back from mu and bulk.
    assert 9 * m.bulk * m.mu / (3 * m.bulk + m.mu) == pytest.approx(34e3)
    assert material("neo_hookean", **SOFT, volumetric="quadratic").volumetric == "quadratic"


def test_equal_materials_are_equal_and_hash_alike():
    assert material("neo_hookean", **SOFT) == material("neo_hookean", **SOFT)
    assert len({material("neo_hookean", **SOFT), material("neo_hookean", **SOFT)}) == 1


def test_registry_describes_each_law():
    for name, law in materials().items():
        assert law.name == name
        assert law.energy and law.source and law.caveats
        assert all(p.meaning for p in law.parameters)
    law = materials()["neo_hookean"]
    assert [p.name for p in law.parameters] == ["youngs_modulus", "poissons_ratio", "density"]
    assert law.parameters[0].unit == "Pa"


def test_scene_table_needs_units_for_stiffness_but_not_for_density():
    table = {"model": "neo_hookean", **SOFT, "youngs_modulus": "34 kPa", "density": 1100}
    assert parse_material(table) == material("neo_hookean", **SOFT)
    assert parse_material({**table, "density": "1.1 g/cm^3"}) == material("neo_hookean", **SOFT)
    with pytest.raises(InputError, match="youngs_modulus: unit missing: got 34000"):
        parse_material({**table, "youngs_modulus": 34000})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model": "neohookean"}, "unknown law 'neohookean'; nearest: neo_hookean"),
        ({"model": 3}, "unknown law 3"),
        ({"young_modulus": 1.0}, "young_modulus: unknown .*; nearest: youngs_modulus"),
        ({"youngs_modulus": -1.0}, "youngs_modulus: got -1.0; allowed: greater than 0"),
        ({"youngs_modulus": "3 s"}, "youngs_modulus: .* s is the unit of a time"),
        (
            {"youngs_modulus": "1e300 GPa"},
            "youngs_modulus: got '1e300 GPa'; allowed: up to 1e.15 Pa",
        ),
        ({"youngs_modulus": 1e-300}, "shear modulus: got .* Pa for neo_hookean; allowed: 1e-15 to"),
        ({"density": 1e300}, "density: got 1e.300 kg/m.3 for neo_hookean; allowed: 1e-15 to"),
        ({"poissons_ratio": 0.5}, "poissons_ratio: got 0.5; allowed: .* less than 0.5"),
        ({"poissons_ratio": -0.1}, "at least 0"),
        ({"density": 0.0}, "density: got 0.0"),
        ({"volumetric": "cubic"}, 'volumetric: got \'cubic\'; allowed: "log", "quadratic"'),
    ],
)
def test_bad_parameters_are_named(changes, message):
    with pytest.raises(InputError, match=message):
        material(**{"model": "neo_hookean", **SOFT, **changes})


def test_missing_parameter_is_named():
    with pytest.raises(InputError, match="density missing: neo_hookean needs a density, > 0 kg/m"):
        material("neo_hookean", youngs_modulus=1e3, poissons_ratio=0.4)
    with pytest.raises(InputError, match="model missing"):
        parse_material({"density": 1})


def test_public_names_are_functions_whatever_was_imported_first():
    import tledface as tf

    assert tf.material("neo_hookean", **SOFT).mu > 0.0
    assert "neo_hookean" in tf.materials()


def test_law_files_and_registry_are_the_same():
    """Python finds the laws by their files, the core by its generated table."""
    from tledface import _core

    for name in materials():
        _core.VoxelModel(**EMPTY).add_law(name=name, elements=[], rows=[])
    with pytest.raises(InputError, match=r"there are .*ogden"):
        _core.VoxelModel(**EMPTY).add_law(name="jelly", elements=[], rows=[])


EMPTY = {
    "voxel": (1.0, 1.0, 1.0),
    "gravity": (0.0, 0.0, 0.0),
    **{
        key: []
        for key in (
            "cells", "node_ijk", "mu", "bulk_log", "bulk_quadratic", "density", "shear_modulus",
            "bulk_modulus", "bending_modulus", "fixed",
        )
    },
}  # fmt: skip


def test_parameters_with_defaults_directions_and_modifiers():
    m = material("mooney_rivlin", c10=1e3, bulk_modulus=1e5, density=1e3)
    assert m.parameters["c30"] == 0.0
    assert m.mu == 2e3
    hgo, again = (
        material(
            "holzapfel_gasser_ogden", mu=1e3, k1=1e3, k2=1.0, bulk_modulus=1e5, density=1e3,
            first=(0, 3, 4), prony=[(0.2, 0.01)],
            pretension={"along": 1e3, "line": (1, 0, 0), "normal": (0, 0, 2)},
        )
        for _ in range(2)
    )  # fmt: skip
    assert hgo.directions == {"first": (0.0, 0.6, 0.8)}
    assert [name for name, _ in hgo.rows()] == ["holzapfel_gasser_ogden", "prony", "pretension"]
    assert hgo == again and hash(hgo) == hash(again)
    j2 = material("j2_plastic", mu=1e3, bulk_modulus=1e5, density=1e3, yield_stress=70.0)
    assert j2.parameters["yield_stress_end"] == 70.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"prony": [(0.5, 0.1), (0.6, 1.0)]}, "prony: the shares add up"),
        ({"prony": [(0.5, -0.1)]}, r"prony: got -0\.1; allowed: at least 1e-15 s"),
        ({"prony": [(0.5, 1e-300)]}, "prony: got 1e-300; allowed: at least 1e-15 s"),
        ({"prony": [(1.5, 0.1)]}, r"prony: got 1\.5; allowed: greater than 0 and less than 1"),
        ({"pretension": {"along": 1e300}}, r"pretension: got 1e\+300; .* at most 1e\+15 Pa"),
        ({"pretension": {"along": 0.0, "across": 1e16}}, r"pretension: got 1e\+16; .*1e\+15 Pa"),
        ({"prony": [0.5]}, "prony: got 0.5; allowed: pairs"),
        ({"pretension": {"across": 1.0}}, "pretension: got"),
        ({"pretension": {"along": 1.0, "line": (1, 0, 0)}}, "line and normal missing"),
        (
            {"pretension": {"along": 1.0, "line": (1, 0, 0), "normal": (1, 0, 0)}},
            "at right angles",
        ),
    ],
)
def test_bad_modifiers_are_named(changes, message):
    with pytest.raises(InputError, match=message):
        material("neo_hookean", **SOFT, **changes)
    with pytest.raises(InputError, match="no separate isochoric part"):
        material("neo_hookean_coupled", **SOFT, prony=[(0.5, 0.1)])
    with pytest.raises(InputError, match="first missing"):
        material("holzapfel_gasser_ogden", mu=1e3, k1=1e3, k2=1.0, bulk_modulus=1e5, density=1e3)
