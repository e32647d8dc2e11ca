"""The table of the architecture page is true: what it names exists, imports point up it only."""

import ast
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
PACKAGE = REPOSITORY / "python/tledface"
PAGE = (REPOSITORY / "docs/explanation/architecture.md").read_text()
# (where, what, knows) of each row, in order.
ROWS = re.findall(r"^\| (`.*?) \| (.*) \| (.*?) \|$", PAGE, re.M)
# For both sides, as the page says, beside the package itself and its compiled module.
HELPERS = {"io._atomic", "_frame", "subcycling", "_core", ""}


def words(text):
    return set(re.findall(r"`([\w/.]+)`", text))


def modules():
    """Module -> the row that it is of: by its own name, or that of its folder."""
    rows = {}
    for number, (where, what, _) in enumerate(ROWS):
        if where.startswith(("`csrc/", "`kernels_cl/")):
            continue
        for word in words(where + what):
            name = word.removesuffix(".py").rstrip("/").replace("/", ".")
            if (PACKAGE / f"{name}.py").is_file() or (PACKAGE / name).is_dir():
                rows[name] = number
    return rows


def imported(file):
    """Modules of the package that a module imports when it is loaded itself."""
    late = set()
    tree = ast.parse(file.read_text())
    for node in ast.walk(tree):
        checking = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if checking or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            late |= {id(inner) for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and id(node) not in late and node.module:
            if node.module == "tledface":
                yield from (alias.name for alias in node.names)
            elif node.module.startswith("tledface."):
                yield node.module.removeprefix("tledface.")


def includes(folder):
    """Folders of the core that the files of one include."""
    text = "".join(file.read_text() for file in (REPOSITORY / "csrc" / folder).rglob("*.[ch]pp"))
    found = set(re.findall(r'#include "(\w+)/', text)) - {folder}
    return {name for name in found if (REPOSITORY / "csrc" / name).is_dir()}


def row_of(module, rows):
    while module not in rows and "." in module:
        module = module.rpartition(".")[0]
    return rows.get(module)


def test_every_module_and_kernel_file_is_in_the_table():
    known = set().union(*(words(where + what) for where, what, _ in ROWS))
    for folder in REPOSITORY.glob("csrc/*/"):
        assert f"csrc/{folder.name}/" in known
    for file in REPOSITORY.glob("kernels_cl/*.cl"):
        assert file.name in known
    rows = modules()
    for file in PACKAGE.glob("*.py"):
        assert file.stem in {*rows, *HELPERS, "__init__"}, file.name


def test_imports_point_up_the_table():
    rows = modules()
    checked = 0
    for file in PACKAGE.rglob("*.py"):
        module = ".".join(file.relative_to(PACKAGE).with_suffix("").parts)
        own = row_of(module.removesuffix(".__init__"), rows)
        for name in imported(file):
            if own is None or name in HELPERS:
                continue
            other = row_of(name, rows)
            assert other is not None and other <= own, f"{module} imports {name}"
            checked += 1
    assert checked > 200


@pytest.mark.parametrize("row", [row for row in ROWS if row[0].startswith("`csrc/")])
def test_the_core_knows_what_the_table_says(row):
    """What a folder includes is in its row, or known to what is in its row."""
    knows = {
        where.removeprefix("`csrc/").split("/")[0]: set(re.findall(r"\w+", listed)) - {"nothing"}
        for where, _, listed in ROWS
        if where.startswith("`csrc/")
    }
    folder = row[0].removeprefix("`csrc/").split("/")[0]
    if "all of the above" in row[2]:
        return
    reached, more = set(), knows[folder]
    while more - reached:
        reached |= more
        more = set().union(*(knows[name] for name in more if name in knows))
    assert includes(folder) <= reached
