"""Scene files: values in SI, and one clear line for each kind of bad input."""

import copy
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tledface.constitutive import material, materials
from tledface.errors import InputError
from tledface.fibre_kinds import AlongEnd, BoxEnd, CurveEnd, make_fibre
from tledface.scene import Scene, template_text, write_template
from tledface.schedule import Constant, Keyframes, Ramp

SURFACES = ("skin.stl", "bone.obj", "frontalis_left.obj", "frontalis_right.obj")


@pytest.fixture
def folder(tmp_path):
    for name in SURFACES:
        (tmp_path / name).touch()
    return tmp_path


@pytest.fixture
def tables():
    return tomllib.loads(template_text())


def put(tables, path, value):
    """A copy of ``tables`` with the key at ``path`` set, or removed for None."""
    tables = copy.deepcopy(tables)
    *parents, key = path
    at = tables
    for parent in parents:
        at = at[parent]
    if value is None:
        del at[key]
    else:
        at[key] = value
    return tables


def test_template_loads_in_si(folder):
    path = folder / "brow.toml"
    write_template(path)
    scene = Scene.load(path)
    assert scene.path == path
    assert scene.geometry.skin == folder / "skin.stl"
    assert scene.geometry.bones == [folder / "bone.obj"]
    assert scene.geometry.voxel == pytest.approx((5e-4, 5e-4, 5e-4))
    assert scene.geometry.unit_scale == 1e-3
    assert (scene.geometry.samples, scene.geometry.fill) == (4, 0.5)
    assert (scene.geometry.region, scene.geometry.depth, scene.geometry.outer) == (
        None,
        None,
        "all",
    )
    assert [x.name for x in scene.layers] == ["stratum corneum", "dermis", "hypodermis"]
    assert [x.thickness for x in scene.layers] == [pytest.approx(2e-5), pytest.approx(1.8e-3), None]
    assert scene.layers[1].material == material(
        "neo_hookean", youngs_modulus=81.4e3, poissons_ratio=0.49, density=1100.0
    )
    muscle = scene.muscles[0]
    assert muscle.fibre == make_fibre("sheet", {"to": "+z"})
    assert (muscle.sigma_act, muscle.sigma_pas) == (5e6, 5e6)
    assert (muscle.lambda_opt, muscle.lambda_pas) == (1.0, 1.2)
    assert muscle.activation == Ramp(0.0, 0.75, 0.05)
    assert scene.boundary.fixed[0].box == (
        pytest.approx((-0.06, -0.15, 1.48)),
        pytest.approx((0.06, 0.0, 1.5)),
    )
    assert scene.boundary.fixed[0].components == "xyz"
    assert scene.solver.duration == 0.05
    assert scene.solver.dt == "auto"
    assert scene.solver.damping == 200.0
    assert scene.solver.mass_scaling == 10.0
    assert (scene.solver.hourglass, scene.solver.hourglass_kappa) == ("physical", None)
    assert scene.solver.gravity == (0.0, 0.0, 0.0)
    assert scene.output.fps == 200.0
    assert scene.layer_bending == "section"


def test_least_scene_has_the_documented_defaults(folder, tables):
    least = {
        "schema": 1,
        "units": "mm",
        "geometry": {"skin": "skin.stl", "voxel": [0.5, 0.5, 0.25]},
        "layers": [{"name": "skin", "material": tables["layers"][2]["material"]}],
        "solver": {"duration": "50 ms"},
    }
    scene = Scene.from_dict(least, folder)
    assert scene.geometry.voxel == pytest.approx((5e-4, 5e-4, 2.5e-4))
    assert scene.geometry.bones == [] and scene.muscles == [] and scene.boundary.fixed == []
    solver = scene.solver
    assert (solver.dt, solver.damping, solver.mass_scaling) == ("auto", 0.0, 1.0)
    assert (solver.precision, solver.hourglass) == ("single", "physical")
    assert scene.path is None
    assert scene.source == least


def test_optional_keys(folder, tables):
    tables = put(tables, ["geometry", "depth"], 6)
    tables = put(tables, ["geometry", "region"], [[0, 0, 0], ["1 cm", 20, 30]])
    tables = put(tables, ["geometry", "outer"], [[[0, 0, 4], [60, 60, 5]]])
    tables = put(tables, ["solver", "dt"], "2 us")
    tables = put(tables, ["solver", "gravity"], [0, 0, "-9.81 m/s^2"])
    tables = put(tables, ["solver", "hourglass"], "joldes")
    tables = put(tables, ["solver", "hourglass_kappa"], 0.075)
    tables = put(tables, ["boundary", "fixed", 0, "components"], "zx")
    scene = Scene.from_dict(tables, folder)
    assert scene.geometry.depth == pytest.approx(6e-3)
    assert scene.geometry.region == ((0.0, 0.0, 0.0), pytest.approx((0.01, 0.02, 0.03)))
    assert scene.geometry.outer == [
        (pytest.approx((0, 0, 4e-3)), pytest.approx((6e-2, 6e-2, 5e-3)))
    ]
    assert scene.solver.dt == pytest.approx(2e-6)
    assert scene.solver.gravity == (0.0, 0.0, -9.81)
    assert scene.solver.hourglass_kappa == 0.075
    assert scene.boundary.fixed[0].components == "xz"


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (["muscles", 0, "activation"], Constant(0.25)),
        (["muscles", 0, "activation"], Ramp(0.0, 0.7, 1 / 3e4, -0.1, "cosine")),
        (["muscles", 0, "activation"], Keyframes((-1e-7, 0.1 / 3), (0.0, 1.0))),
        (["muscles", 0, "fibre"], make_fibre("nurbs", {"degree": 2})),
        (["muscles", 0, "fibre"], make_fibre("sheet", {"to": "+z"})),
        (
            ["muscles", 0, "fibre"],
            make_fibre(
                "spindle",
                {
                    "from": {"box": [[0, 0, 0], [0.01, 0.1 / 3, 1]]},
                    "to": {"points": [[0, 0, 1e-5]], "reach": 1e-3},
                },
            ),
        ),
        (
            ["muscles", 0, "fibre"],
            make_fibre("sphincter", {"axis": [0, 1, 0], "centre": [1, 2, 3]}),
        ),
        (["muscles", 0, "fibre"], make_fibre("curves", {"curves": ["/x/fibres.obj"]})),
        (
            ["layers", 1, "material"],
            material(
                "holzapfel_gasser_ogden",
                mu=1e3 / 3,
                k1=1e3,
                k2=1.0,
                bulk_modulus=1e5,
                density=1e3,
                first=(0, 3, 4),
                prony=[(0.2, 0.01)],
                pretension={"along": 1e3, "line": (1, 0, 0), "normal": (0, 0, 2)},
            ),
        ),
    ],
)
def test_objects_are_kept_as_a_file_would_hold_them(folder, tables, path, value):
    scene = Scene.from_dict(put(tables, path, value), folder)
    source = json.loads(json.dumps(scene.source))
    assert source == scene.source
    again = Scene.from_dict(source, folder, check_files=False)
    kind, number, key = path
    assert getattr(getattr(again, kind)[number], key) == value
    assert again.muscles == scene.muscles
    assert again.layers == scene.layers


def test_every_law_is_kept_as_a_file_would_hold_it(folder, tables):
    for name, law in materials().items():
        if law.modifier is None:
            numbers = {p.name: 0.3 if p.kind == "number" else 1e3 for p in law.parameters}
            numbers |= {"density": 1e3, "bulk_modulus": 1e5}
            given = {key: value for key, value in numbers.items() if key in law_keys(law)}
            directions = {d.name: (0.0, 0.0, 1.0) for d in law.directions}
            made = material(name, **given, **directions)
            scene = Scene.from_dict(put(tables, ["layers", 1, "material"], made), folder)
            again = Scene.from_dict(json.loads(json.dumps(scene.source)), folder)
            assert again.layers[1].material == made, name


def law_keys(law):
    return [parameter.name for parameter in law.parameters]


def test_an_object_no_file_could_hold_is_refused(folder, tables, monkeypatch):
    monkeypatch.setattr("tledface.scene.source.Constant", int)
    with pytest.raises(
        InputError, match=r"^scene: muscles\[0\]\.activation: got Constant.*allowed"
    ):
        Scene.from_dict(put(tables, ["muscles", 0, "activation"], Constant(0.5)), folder)


def test_numbers_and_arrays_of_numpy_are_taken(folder, tables):
    plain = Scene.from_dict(put(tables, ["geometry", "samples"], 4), folder)
    given = put(tables, ["geometry", "samples"], np.int32(4))
    given = put(given, ["geometry", "voxel"], np.full(3, 0.5))
    given = put(given, ["output", "fps"], np.int64(tables["output"]["fps"]))
    given = put(given, ["solver", "subcycling"], np.False_)
    scene = Scene.from_dict(given, folder)
    assert (scene.geometry, scene.output, scene.solver) == (
        plain.geometry,
        plain.output,
        plain.solver,
    )
    assert json.loads(json.dumps(scene.source)) == scene.source


def test_last_layer_takes_the_rest_even_with_a_thickness(folder, tables):
    scene = Scene.from_dict(put(tables, ["layers", 2, "thickness"], 3.0), folder)
    assert scene.layers[-1].thickness is None


@pytest.mark.parametrize(
    ("activation", "expected"),
    [
        (0.5, Constant(0.5)),
        (None, Constant(0.0)),
        ({"ramp": [0.0, 1.0], "over": "20 ms", "begin": "5 ms"}, Ramp(0.0, 1.0, 0.02, 0.005)),
        (
            {"ramp": [0.0, 1.0], "over": "20 ms", "shape": "cosine"},
            Ramp(0.0, 1.0, 0.02, shape="cosine"),
        ),
        (
            {"keyframes": [["0 ms", 0.0], ["20 ms", 1.0]]},
            Keyframes((0.0, 0.02), (0.0, 1.0)),
        ),
    ],
)
def test_activations(folder, tables, activation, expected):
    scene = Scene.from_dict(put(tables, ["muscles", 0, "activation"], activation), folder)
    assert scene.muscles[0].activation == expected


def test_fibre_is_normalised_and_passive_stress_follows_active(folder, tables):
    tables = put(tables, ["muscles", 0, "fibre"], [0, 3, 4])
    tables = put(tables, ["muscles", 0, "sigma_pas"], None)
    tables = put(tables, ["muscles", 0, "sigma_act"], "2 MPa")
    muscle = Scene.from_dict(tables, folder).muscles[0]
    assert muscle.fibre == pytest.approx((0, 0.6, 0.8))
    assert muscle.sigma_pas == 2e6
    tables = put(tables, ["muscles", 0, "fibre"], "long-axis")
    assert Scene.from_dict(tables, folder).muscles[0].fibre == "long-axis"


def test_fibre_kinds_and_their_lengths_in_scene_units(folder, tables):
    def read(value):
        return Scene.from_dict(put(tables, ["muscles", 0, "fibre"], value), folder).muscles[0].fibre

    assert read("nurbs") == make_fibre("nurbs")
    assert read({"kind": "sheet", "to": "+z"}).end == AlongEnd((0.0, 0.0, 1.0))
    assert read({"kind": "spindle", "from": [0, 3, 4], "to": "-x"}).start == AlongEnd(
        (0.0, 0.6, 0.8)
    )
    table = {
        "kind": "nurbs",
        "from": {"box": [[0, 0, 0], [10, "1 cm", 1]]},
        "to": {"points": [[0, 0, 40], [60, 0, 40]], "reach": "2 mm"},
        "degree": 2,
    }
    fibre = read(table)
    assert fibre.start == BoxEnd((0.0, 0.0, 0.0), pytest.approx((0.01, 0.01, 0.001)))
    assert fibre.end == CurveEnd(((0.0, 0.0, 0.04), (0.06, 0.0, 0.04)), 0.002)
    assert fibre.degree == 2
    ring = read({"kind": "sphincter", "axis": [0, -2, 0], "centre": [30, 0, "4 cm"]})
    assert ring.axis == (0.0, -1.0, 0.0) and ring.centre == pytest.approx((0.03, 0.0, 0.04))
    (folder / "fibres.csv").write_text("0,0,0\n1,0,0\n")
    assert read({"curves": "fibres.csv"}).curves == (folder / "fibres.csv",)


BAD = [
    (["layers", 1, "thickness"], -1.8, r"layers\[1\]\.thickness: got -1\.8; allowed: greater"),
    (["layers", 1, "thickness"], "1.8 kPa", r"layers\[1\]\.thickness: .*kPa is the unit of a pre"),
    (["layers", 1, "thickness"], None, r"layers\[1\]\.thickness: missing on 'dermis'"),
    (["layers", 1, "thicknes"], 1.8, r"layers\[1\]\.thicknes: unknown key; nearest: thickness"),
    (["layers"], [], r"layers: got \[\]; allowed: at least one"),
    (["layers", 1, "name"], "", r"layers\[1\]\.name: got ''"),
    (["layers", 1, "name"], "frontalis", r"'frontalis' is used twice"),
    (["layers", 1, "material"], "x", r"layers\[1\]\.material: got 'x'; allowed: a table"),
    (
        ["layers", 1, "material", "youngs_modulus"],
        81.4,
        r'layers\[1\]\.material\.youngs_modulus: unit missing: got 81\.4; .*"81\.4 kPa"',
    ),
    (
        ["layers", 1, "material", "poisson_ratio"],
        0.4,
        r"layers\[1\]\.material\.poisson_ratio: unknown parameter .*nearest: poissons_ratio",
    ),
    (
        ["geometry", "skin"],
        "skn.stl",
        r"geometry\.skin: file not found: .*nearest there: skin\.stl",
    ),
    (["geometry", "bones"], "bone.obj", r"geometry\.bones: got 'bone\.obj'; allowed: a list"),
    (["geometry", "bones"], ["no.obj"], r"geometry\.bones: file not found"),
    (["geometry", "voxel"], None, r"geometry\.voxel: key missing; give it, as voxel = 0\.5"),
    (["geometry", "voxel"], [1, 2], r"geometry\.voxel: got \[1, 2\]"),
    (["geometry", "voxel"], 0, r"geometry\.voxel: got 0; allowed: greater than 0"),
    (["geometry", "samples"], 0, r"geometry\.samples: got 0; allowed: greater"),
    (["geometry", "samples"], 2.5, r"geometry\.samples: got 2\.5"),
    (["geometry", "fill"], 1.5, r"geometry\.fill: got 1\.5"),
    (["geometry", "region"], [[1, 0, 0], [0, 1, 1]], r"geometry\.region: .*low corner"),
    (["geometry", "outer"], "top", r"geometry\.outer: got 'top'; allowed: \"all\""),
    (["muscles", 0, "fibre"], "felt", r"muscles\[0\]\.fibre: got 'felt'.*\"long-axis\""),
    (["muscles", 0, "fibre"], "sheet", r"muscles\[0\]\.fibre\.to: missing; a sheet needs"),
    (["muscles", 0, "fibre"], {"to": "+z"}, r"muscles\[0\]\.fibre\.kind: missing; allowed: nurbs"),
    (["muscles", 0, "fibre"], {"kind": "sheets"}, r"fibre\.kind: got 'sheets'; nearest: sheet"),
    (["muscles", 0, "fibre"], {"kind": "sheet", "too": "+z"}, r"fibre\.too: .* nearest: to"),
    (
        ["muscles", 0, "fibre"],
        {"kind": "sheet", "to": "up"},
        r"fibre\.to: got 'up'; allowed: \"\+z",
    ),
    (["muscles", 0, "fibre"], {"kind": "sheet", "to": [0, 0, 0]}, r"fibre\.to: .* no direction"),
    (
        ["muscles", 0, "fibre"],
        {"kind": "nurbs", "from": "+z"},
        r"fibre\.to: missing; allowed: both",
    ),
    (["muscles", 0, "fibre"], {"kind": "nurbs", "degree": 9}, r"fibre\.degree: got 9; .*1 to 5"),
    (["muscles", 0, "fibre"], {"kind": "nurbs", "axis": [0, 0, 1]}, r"fibre\.axis: not a key of"),
    (
        ["muscles", 0, "fibre"],
        {"kind": "sheet", "from": "+z", "to": "+z"},
        r"fibre\.to: points the same way as from",
    ),
    (
        ["muscles", 0, "fibre"],
        {"kind": "sheet", "to": {"box": [[0, 0, 1], [0, 0, 0]]}},
        r"fibre\.to: got .*a low corner not above",
    ),
    (
        ["muscles", 0, "fibre"],
        {"kind": "sheet", "from": "-z", "to": {"points": [[0, 0, 0]], "reach": -1}},
        r"fibre\.to: reach: got -0\.001; allowed: a length greater than 0",
    ),
    (["muscles", 0, "fibre"], {"kind": "sphincter", "axis": [0, 1]}, r"fibre\.axis: got \[0, 1\]"),
    (["muscles", 0, "fibre"], {"curves": "gone.obj"}, r"fibre: file not found: .*gone\.obj"),
    (["muscles", 0, "fibre"], {"curves": []}, r"fibre\.curves: missing; give a file of curves"),
    (["muscles", 0, "fibre"], [0, 0, 0], r"muscles\[0\]\.fibre: .*no direction"),
    (["muscles", 0, "surfaces"], [], r"muscles\[0\]\.surfaces: got \[\]"),
    (["muscles", 0, "sigma_act"], 5, r"muscles\[0\]\.sigma_act: unit missing"),
    (["muscles", 0, "sigma_act"], "1e300 Pa", r"sigma_act: got '1e300 Pa'; .* most 1e\+15 Pa"),
    (["muscles", 0, "sigma_pas"], "1e10 MPa", r"sigma_pas: got '1e10 MPa'; .* most 1e\+15 Pa"),
    (["muscles", 0, "lambda_opt"], 1e-50, r"lambda_opt: got 1e-50; allowed: at least 0\.1 and at"),
    (["muscles", 0, "lambda_pas"], 11, r"lambda_pas: got 11; allowed: at least 1 and at most 10"),
    (["muscles", 0, "activation"], 1.5, r"muscles\[0\]\.activation: got 1\.5"),
    (["muscles", 0, "activation"], {"au": {"AU1": 1}}, r"muscles\[0\]\.activation: got .*ramp"),
    (["muscles", 0, "activation", "ovr"], "5 ms", r"activation\.ovr: unknown key; nearest: over"),
    (["muscles", 0, "activation", "over"], 5, r"activation\.over: unit missing: got 5"),
    (["muscles", 0, "activation", "ramp"], [0, 2], r"ramp end: got 2"),
    (["boundary", "slidin"], ["bones"], r"boundary\.slidin: unknown key; nearest: sliding"),
    (["boundary", "fixed", 0, "components"], "xw", r"fixed\[0\]\.components: got 'xw'"),
    (["boundary", "fixed", 0, "box"], [[0, 0, 0]], r"fixed\[0\]\.box: got"),
    (
        ["solver", "duration"],
        None,
        r'solver\.duration: key missing; give it, as duration = "50 ms"',
    ),
    (["solver", "duration"], 50, r'solver\.duration: unit missing: got 50; .*"50 ms"'),
    (["solver", "dt"], "automatic", r'solver\.dt: got \'automatic\'; allowed: "auto"'),
    (["solver", "dt"], "0 s", r"solver\.dt: got '0 s'; allowed: greater than 0"),
    (["solver", "damping"], 200, r"solver\.damping: unit missing"),
    (["solver", "damping"], "-1 1/s", r"solver\.damping: got '-1 1/s'; allowed: at least 0"),
    (["solver", "hourglass"], "phys", r"solver\.hourglass: got 'phys'; allowed: \"physical\""),
    (["solver", "hourglass_kappa"], 0.1, r"solver\.hourglass_kappa: got 0\.1 with hourglass"),
    (["solver", "mass_scaling"], 0.1, r"solver\.mass_scaling: got 0\.1; allowed: at least 1"),
    (["solver", "mass_scaling"], {"dt": "0 us"}, r"mass_scaling: got '0 us'; allowed: greater"),
    (["solver", "mass_scaling"], {"dt": 3}, r"solver\.mass_scaling\.dt: unit missing: got 3"),
    (["solver", "mass_scaling"], {"step": "3 us"}, r"mass_scaling\.step: unknown key; .*dt"),
    (["solver", "gravity"], [0, 0, -9.81], r"solver\.gravity: unit missing: got -9\.81"),
    (["output", "checkpoint_every"], 10, r"output\.checkpoint_every: unit missing: got 10"),
    (["output", "checkpoint_every"], "never", r"checkpoint_every: got 'never'; allowed: \"auto\""),
    (["output", "checkpoint_every"], "0 ms", r"checkpoint_every: got '0 ms'; allowed: greater"),
    (["solvr"], {}, r"scene: solvr: unknown key; nearest: solver"),
    (["schema"], 2, r"schema: got 2; allowed: 1"),
    (["schema"], None, r"schema: key missing; give it, as schema = 1"),
    (["units"], "inch", r"units: got 'inch'; allowed: one of mm"),
    (["units"], None, r'units: key missing; give it, as units = "mm"'),
    (["geometry"], None, r"geometry: key missing; give a table \[geometry\]"),
    (["solver"], 3, r"solver: got 3; allowed: a table"),
]


@pytest.mark.parametrize(("path", "value", "message"), BAD)
def test_bad_input_is_one_line_with_its_key(folder, tables, path, value, message):
    with pytest.raises(InputError, match=message) as raised:
        Scene.from_dict(put(tables, path, value), folder)
    assert "\n" not in str(raised.value)
    assert str(raised.value).startswith("scene: ")


def test_several_problems_are_counted(folder, tables):
    tables = put(tables, ["solver", "duration"], 50)
    tables = put(tables, ["geometry", "voxel"], 0)
    with pytest.raises(InputError, match=r"\(and 1 more problem\)$"):
        Scene.from_dict(tables, folder)


def test_what_is_no_scene_is_refused():
    with pytest.raises(InputError, match="scene: got None; allowed: a dict"):
        Scene.from_dict(None)
    with pytest.raises(InputError, match="scene: got None; allowed: the path"):
        Scene.load(None)


def test_load_names_the_file(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: no such scene file"):
        Scene.load(tmp_path / "none.toml")
    path = tmp_path / "broken.toml"
    path.write_text("schema = 1\nunits = mm\n")
    with pytest.raises(InputError, match=r"broken\.toml: TOML syntax: .*line 2"):
        Scene.load(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"broken\.toml: cannot be read as text"):
        Scene.load(path)
    path.write_text(template_text())
    with pytest.raises(InputError, match=r"broken\.toml: geometry\.skin: file not found"):
        Scene.load(path)


def test_a_byte_order_mark_is_passed_over(folder):
    path = folder / "marked.toml"
    path.write_bytes(b"\xef\xbb\xbf" + template_text().encode())
    assert Scene.load(path).units == "mm"


def test_files_need_not_exist_where_the_model_is_built(tables):
    scene = Scene.from_dict(tables, check_files=False)
    assert scene.geometry.skin == Path("skin.stl")


def test_template_is_never_overwritten(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_template(path)
    assert path.read_text() == "mine"
    with pytest.raises(InputError, match="there is no folder"):
        write_template(tmp_path / "none" / "scene.toml")
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.toml"]


def test_json_schema_names_every_key(tables):
    schema = Scene.json_schema()
    assert schema["properties"]["schema"]["const"] == 1
    assert set(schema["required"]) == {"schema", "units", "geometry", "layers", "solver"}
    assert set(tables) <= set(schema["properties"])
    for name, table in (("Geometry", "geometry"), ("Solver", "solver"), ("Output", "output")):
        definition = schema["$defs"][name]
        assert definition["additionalProperties"] is False
        assert set(tables[table]) <= set(definition["properties"])
    assert set(tables["muscles"][0]) == set(schema["$defs"]["MuscleSpec"]["properties"])
