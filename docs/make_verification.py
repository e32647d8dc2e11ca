"""Write docs/reference/verification.md from the figures of a test run.

pytest tests/verification --run-slow --figures figures.json
python docs/make_verification.py figures.json

With --part the run was one of some tests only: their rows are replaced or added, others stay.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from tledface import doctor

PAGE = Path(__file__).parent / "reference" / "verification.md"

INTRODUCTION = """\
# Verification: what was expected, what came out

Made by running the tests (`docs/make_verification.py` says how); every row is an assertion that
passed. Float64 figures come from the native device; where a case names an executor, its own
kernels gave the figure, in float32 unless the case says double. The longer studies (cantilever,
bonded cube, torsion, roll-up, frequencies, films) have their figures in
[bench/verification](../../bench/verification/results/verification.md).
"""
HEAD = ["| test | case | figure | expected | got | tolerance |", "|---|---|---|---|---|---|"]

# Rows of the table by section.
Page = dict[str, list[str]]


def row(figure: dict[str, Any]) -> str:
    """A figure's row."""
    expected = "–" if figure["expected"] is None else f"{figure['expected']:.5g}"
    test = figure["test"].removeprefix("test_").replace("_", " ")
    return (
        f"| {test} | {figure['case'] or '–'} | {figure['what']} | {expected} | "
        f"{figure['got']:.5g} | {figure['tolerance']} |"
    )


def of_figures(figures: list[dict[str, Any]]) -> Page:
    """The page that a run's figures make."""
    page: Page = {}
    for figure in figures:
        section = figure["page"].replace("_", " ").capitalize()
        page.setdefault(section, []).append(row(figure))
    return page


def read(text: str) -> Page:
    """The page of a file."""
    page: Page = {}
    for part in text.split("\n## ")[1:]:
        section, *lines = part.splitlines()
        page[section] = [line for line in lines if line.startswith("| ") and line not in HEAD]
    return page


def named(line: str) -> list[str]:
    """What a row is about: test, case, figure."""
    return line.removeprefix("| ").split(" | ")[:3]


def updated(old: list[str], new: list[str]) -> list[str]:
    """A section's rows with those of a later run: in place of their like, or behind their test."""
    rows = list(old)
    fresh = [False] * len(rows)  # a test may give one figure several times
    for line in new:
        like = [n for n, other in enumerate(rows) if named(other) == named(line) and not fresh[n]]
        if like:
            rows[like[0]], fresh[like[0]] = line, True
            continue
        same = [n for n, other in enumerate(rows) if named(other)[0] == named(line)[0]]
        at = same[-1] + 1 if same else len(rows)
        rows.insert(at, line)
        fresh.insert(at, True)
    return rows


def main() -> None:
    """Write the page from the figures of the file that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("figures", type=Path)
    parser.add_argument("--part", action="store_true", help="rows of other tests stay")
    given = parser.parse_args()
    page = of_figures(json.loads(given.figures.read_text(encoding="utf-8")))
    if given.part:
        old = read(PAGE.read_text(encoding="utf-8"))
        sections = sorted({*old, *page})
        page = {name: updated(old.get(name, []), page.get(name, [])) for name in sections}
    devices = [d["name"] for d in doctor.report()["devices"] if d["works"]]
    parts = [INTRODUCTION, "Devices of this run: " + "; ".join(devices) + ".\n"]
    for section, rows in page.items():
        parts += [f"## {section}\n", *HEAD, *rows, ""]
    PAGE.write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
