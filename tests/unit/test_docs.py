"""What the documentation says is true: its code runs, its names exist, its links resolve."""

import contextlib
import copy
import inspect
import io
import re
import shutil
import tomllib
from dataclasses import is_dataclass
from pathlib import Path

import pytest
import typer

import tledface as tf
from tledface import doctor, units
from tledface.cli import app
from tledface.constitutive import materials
from tledface.examples import flat_block
from tledface.fibre_kinds import KINDS
from tledface.folds import Folds
from tledface.run_result import RunResult
from tledface.scene import Scene

REPOSITORY = Path(__file__).parents[2]
PAGES = [
    *(REPOSITORY / name for name in ("README.md", "CHANGELOG.md", "bench/README.md")),
    *sorted((REPOSITORY / "docs").rglob("*.md")),
]
README, SCENE_FILE = REPOSITORY / "README.md", REPOSITORY / "docs/how-to/scene-file.md"
TUTORIAL = REPOSITORY / "docs/tutorial.md"
MATERIAL = {
    "model": "neo_hookean",
    "youngs_modulus": "1 kPa",
    "poissons_ratio": 0.4,
    "density": "1000 kg/m^3",
}
# One scene with every table, to put values into.
TABLES = {
    "schema": 1,
    "units": "m",
    "geometry": {
        "skin": "skin.stl",
        "voxel": 1.0,
        "depth_in": [{"box": [[0, 0, 0], [1, 1, 1]], "depth": 1.0}],
        "labels": {"file": "labels.nii"},
    },
    "layers": [{"name": "skin", "thickness": 1.0, "material": MATERIAL}],
    "muscles": [
        {
            "name": "m",
            "surfaces": ["m.stl"],
            "fibre": [1, 0, 0],
            "sigma_act": "1 Pa",
            "material": MATERIAL,
        }
    ],
    "volumes": [{"name": "galea", "surfaces": ["galea.ply"], "material": MATERIAL}],
    "surfaces": [{"name": "face", "file": "face.obj"}],
    "boundary": {
        "fixed": [{"box": [[0, 0, 0], [1, 1, 1]]}],
        "cuts": [{"side": "x+", "at": 1}],
        "attachments": [{"muscle": "m", "reach": 1}],
        "ligaments": [{"name": "l", "points": [[0, 0, 0]], "radius": 1}],
        "symmetry": [{"axis": "x"}],
        "sliding": {"on": ["bones"]},
        "motions": [{"bone": "jaw"}],
    },
    "solver": {"duration": "1 s", "hourglass": "joldes"},
    "output": {},
}
# Headings of the scene page: the table in the schema and where it lies in TABLES.
SECTIONS = {
    "Top of the file": (None, ()),
    "`[geometry]`": ("Geometry", ("geometry",)),
    "depth_in": ("DepthIn", ("geometry", "depth_in", 0)),
    "`[geometry.labels]`": ("Labels", ("geometry", "labels")),
    "`[[layers]]`": ("Layer", ("layers", 0)),
    "`[[muscles]]`": ("MuscleSpec", ("muscles", 0)),
    "`[[volumes]]`": ("VolumeSpec", ("volumes", 0)),
    "`[boundary]`": ("Boundary", ("boundary",)),
    "fixed": ("FixedSpec", ("boundary", "fixed", 0)),
    "cuts": ("CutSpec", ("boundary", "cuts", 0)),
    "attachments": ("AttachmentSpec", ("boundary", "attachments", 0)),
    "ligaments": ("LigamentSpec", ("boundary", "ligaments", 0)),
    "symmetry": ("SymmetrySpec", ("boundary", "symmetry", 0)),
    "sliding": ("SlidingSpec", ("boundary", "sliding")),
    "motions": ("MotionSpec", ("boundary", "motions", 0)),
    "`[[surfaces]]`": ("SurfaceSpec", ("surfaces", 0)),
    "`[solver]`": ("Solver", ("solver",)),
    "`[output]`": ("Output", ("output",)),
}


def page_id(page):
    return page.relative_to(REPOSITORY).as_posix()


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)


def anchors(page):
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def key_rows(heading):
    """The rows of the table of keys under a heading of the scene page, by key."""
    text = SCENE_FILE.read_text()
    section = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", text, re.M | re.S)
    assert section, f"scene-file.md has no section '{heading}'"
    rows = {}
    for line in section[1].splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| `"):
            assert len(cells) == 5, line
            rows[cells[0].strip("`")] = dict(
                zip(("kind", "default", "bounds", "meaning"), cells[1:], strict=True)
            )
    return rows


def test_pages_are_found():
    assert len(PAGES) > 10


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_relative_links_resolve(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in anchors(linked), f"{page.name}: {target}"


# -- commands ------------------------------------------------------------------------------------


def verbs():
    return typer.main.get_command(app).commands


def test_readme_commands_are_one_line_each():
    demo, test = (block.strip() for block in blocks(README, "sh")[:2])
    assert demo.endswith("&& pip install . && tledface demo") and "\n" not in demo
    assert test.endswith('&& pip install ".[test]" && pytest') and "\n" not in test
    for line in (demo, test):
        assert line.startswith("python3 -m venv .venv && . .venv/bin/activate && ")
    text = README.read_text()
    between = text.split("<!-- test-command -->")[1].split("<!-- /test-command -->")[0]
    assert between.strip() == f"```sh\n{test}\n```"


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_verbs_and_options_exist(page):
    text = page.read_text()
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    lines += re.findall(r"`(tledface [^`\n]+)`", text)
    for line in lines:
        for verb, rest in re.findall(r"(?:^|&& )tledface ([a-z]+)([^&]*)", line):
            assert verb in verbs(), line
            known = {name for p in verbs()[verb].params for name in p.opts}
            assert set(re.findall(r"(?<!\S)\[?(--?[a-z]+)", rest)) <= known | {"--help"}, line


def test_every_verb_and_shared_option_is_documented():
    text = (REPOSITORY / "docs/reference/command-line.md").read_text()
    assert set(re.findall(r"^\| `tledface ([a-z]+)", text, re.M)) == set(verbs())
    params = [p for v in verbs().values() for p in v.params if not getattr(p, "hidden", False)]
    known = {name for p in params for name in p.opts if name.startswith("--")}
    assert {name for name in known if f"`{name}" not in text} == set()


def test_environment_variables_are_documented():
    text = (REPOSITORY / "docs/how-to/devices.md").read_text()
    mine = {name for name in doctor._VARIABLES if name.startswith("TLEDFACE_")}
    assert set(re.findall(r"^\| `(\w+)` \|", text, re.M)) >= mine | {"TLEDFACE_REQUIRE_OPENCL"}


# -- code ----------------------------------------------------------------------------------------


@pytest.fixture
def shipped_scene(tmp_path, monkeypatch):
    """The folder that `tledface demo` leaves, with coarse voxels; it becomes the current one."""
    monkeypatch.chdir(tmp_path)
    flat_block.write("tledface-flat-block/scene", voxel=1.5, triangle=1.5)
    return Path("tledface-flat-block/scene")


@pytest.fixture
def tutorial_scene(shipped_scene):
    Path("first").mkdir()
    for name in ("skin.stl", "frontalis.stl"):
        shutil.copy(shipped_scene / name, "first")
    (text,) = blocks(TUTORIAL, "toml")
    Path("first/scene.toml").write_text(text)


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=page_id)
def test_python_blocks_run(page, tutorial_scene):
    printed = io.StringIO()
    namespace = {"__name__": "__docs__"}
    with contextlib.redirect_stdout(printed):
        exec(compile("\n".join(blocks(page, "python")), page_id(page), "exec"), namespace)
    if page == README:
        assert Path("wrinkles.png").stat().st_size > 10_000
        assert float(re.search(r"displacement ([\d.]+) mm", printed.getvalue())[1]) > 1.0


def test_readme_code_is_ten_lines_with_the_demo_s_settings(shipped_scene):
    (code,) = blocks(README, "python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    scene = Scene.load(shipped_scene / "flat-block.toml")
    (muscle,) = scene.muscles
    ramp = muscle.activation
    assert f"damping={scene.solver.damping}, mass_scaling={scene.solver.mass_scaling}" in code
    assert f'"{muscle.name}", tf.ramp({ramp.start}, {ramp.end}, {ramp.over})' in code
    assert f"until={scene.solver.duration}" in code


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "toml")], ids=page_id)
def test_scenes_are_valid(page):
    for block in blocks(page, "toml"):
        Scene.from_dict(tomllib.loads(block), check_files=False)


def test_python_names_exist_and_are_documented():
    text = (REPOSITORY / "docs/reference/python.md").read_text()
    named = set(re.findall(r"\btf\.(\w+)", text))
    assert named == set(tf.__all__) - {"__version__"}
    for rows, owner in (("Model", tf.Model), ("Simulator", tf.Simulator)):
        table = re.search(rf"^\| \w+ of `{rows}` .*?\n\n", text, re.M | re.S)[0]
        names = set(re.findall(r"`(\w+)[`(]", "".join(re.findall(r"^\| (`.*?) \|", table, re.M))))
        model = tf.Model.block((1, 1, 1), (1.0, 1.0, 1.0), tf.material(**MATERIAL))
        thing = model if owner is tf.Model else tf.Simulator(model, device="native")
        assert all(hasattr(thing, name) for name in names - {"Simulator"}), names


def public_functions():
    """Functions and methods behind the names of the package, with the docstring they are under."""
    for name in set(tf.__all__) - {"__version__"}:
        thing = getattr(tf, name)
        if inspect.isfunction(thing):
            yield pytest.param(thing, inspect.getdoc(thing), id=name)
        if inspect.ismodule(thing):
            for inner in map(vars(thing).get, thing.__all__):
                if inspect.isfunction(inner):
                    yield pytest.param(inner, inspect.getdoc(inner), id=f"{name}.{inner.__name__}")
        if not inspect.isclass(thing):
            continue
        for owner in thing.__mro__:
            for key, value in vars(owner).items():
                function = getattr(value, "__func__", value)
                own = owner.__module__.startswith("tledface") and inspect.isfunction(function)
                if own and key == "__init__" and owner is thing and not is_dataclass(thing):
                    yield pytest.param(function, inspect.getdoc(thing), id=name)
                elif own and not key.startswith("_"):
                    yield pytest.param(function, inspect.getdoc(function), id=f"{name}.{key}")


@pytest.mark.parametrize(("function", "text"), [*public_functions()])
def test_public_docstrings_name_their_arguments(function, text):
    assert text
    source = inspect.getsource(function)
    if "raise InputError" in source:
        assert "InputError" in text
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in ("self", "cls") and parameter.kind is not parameter.VAR_KEYWORD:
            assert re.search(rf"\b{name}\b", text), name


def test_public_names_have_docstrings_of_their_own():
    for name in set(tf.__all__) - {"__version__"}:
        thing = getattr(tf, name)
        assert thing.__doc__, name
        if inspect.isclass(thing):
            assert thing.__doc__ not in {base.__doc__ for base in thing.__mro__[1:]}, name


def test_figures_of_a_run_are_documented():
    text = (REPOSITORY / "docs/reference/run-folder.md").read_text()
    for part, made in ((0, RunResult), (1, Folds)):
        keys = re.findall(r'^ +"(\w+)":', inspect.getsource(made.to_dict), re.M)
        rows = re.findall(r"^\| (`.*)", text.split("| key of `result` |")[1], re.M)
        found = {key for row in rows for key in re.findall(r"`(\w+)`", row.split(" | ")[part])}
        assert len(keys) > 5 and set(keys) <= found, set(keys) - found


# -- the scene file ------------------------------------------------------------------------------


def schema_of(table):
    schema = Scene.json_schema()
    return schema if table is None else schema["$defs"][table]


@pytest.mark.parametrize("heading", SECTIONS)
def test_every_key_is_documented_with_its_default(heading):
    schema, rows = schema_of(SECTIONS[heading][0]), key_rows(heading)
    assert set(rows) == set(schema["properties"])
    for key, row in rows.items():
        if key in schema.get("required", []):
            assert row["default"] == "required", key
            continue
        default = schema["properties"][key].get("default")
        if isinstance(default, dict) and set(default) == {"value"}:
            default = default["value"]
        text = "none" if default is None else f"`{default!r}`".replace("'", '"')
        if isinstance(default, bool):
            text = text.lower()
        assert row["default"] == text, key


def test_laws_page_is_up_to_date():
    """docs/make_materials.py writes it from the law files."""
    import runpy

    made = runpy.run_path(str(REPOSITORY / "docs" / "make_materials.py"))["page"]()
    assert (REPOSITORY / "docs" / "reference" / "materials.md").read_text() == made
    for law in materials().values():
        assert f"# {law.modifier or law.name}" in made
        assert all(f"`{p.name}`" in made for p in law.parameters)


def test_fibre_kinds_and_keys_are_documented():
    text = SCENE_FILE.read_text().split("## fibre\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`.+?) \| (.+?) \|", text, re.MULTILINE)
    documented = {}
    for keys, kinds in rows:
        for key in re.findall(r"`(\w+)`", keys):
            documented[key] = set(re.findall(r"`(\w+)`", kinds))
    assert documented.pop("kind") == set()  # of all
    expected = {}
    for kind, keys in KINDS.items():
        for key in keys:
            expected.setdefault(key, set()).add(kind)
    assert documented == expected


def test_activation_keys_are_documented():
    kinds = schema_of("MuscleSpec")["properties"]["activation"]["anyOf"]
    keys = {key for kind in kinds for key in kind.get("properties", {})}
    assert set(key_rows("activation")) == keys


def test_units_are_documented():
    rows = re.findall(r"^\| (\w+) \| (.+) \|$", SCENE_FILE.read_text(), re.M)
    assert {kind: listed.split(", ") for kind, listed in rows if kind in units.KINDS} == {
        kind: list(known.units) for kind, known in units.KINDS.items() if kind != "number"
    }


def bounded_keys():
    for heading, (_, place) in SECTIONS.items():
        for key, row in key_rows(heading).items():
            for sign, limit in re.findall(r"([>≥<≤]) ([\d.e]+)", row["bounds"]):
                yield pytest.param(place, key, row["kind"], sign, float(limit), id=f"{key}{sign}")


@pytest.mark.parametrize(("place", "key", "kind", "sign", "limit"), [*bounded_keys()])
def test_bounds_are_those_of_the_scene(place, key, kind, sign, limit):
    unit = {"pressure": " Pa", "time": " s", "rate": " 1/s"}.get(kind.split()[0], "")
    step = 1 if kind == "whole number" else 0.125

    def load(value):
        tables = copy.deepcopy(TABLES)
        table = tables
        for part in place:
            table = table[part]
        number = int(value) if step == 1 else value
        table[key] = f"{number}{unit}" if unit else number
        if place[:1] == ("layers",):
            tables["layers"].append({"name": "last", "material": MATERIAL})
        Scene.from_dict(tables, check_files=False)

    out, inside = {
        ">": (limit, limit + step),
        "≥": (limit - step, limit),
        "<": (limit, limit - step),
        "≤": (limit + step, limit),
    }[sign]
    load(inside)
    with pytest.raises(tf.InputError, match=key):
        load(out)
