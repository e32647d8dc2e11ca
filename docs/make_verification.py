"""Write docs/reference/verification.md from the figures of a test run.

pytest tests/verification --run-slow --figures figures.json
python docs/make_verification.py figures.json
"""

import json
import sys
from itertools import groupby
from pathlib import Path

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


def main(path: str) -> None:
    """Write the page from the figures in ``path``."""
    figures = json.loads(Path(path).read_text(encoding="utf-8"))
    devices = [d["name"] for d in doctor.report()["devices"] if d["works"]]
    parts = [INTRODUCTION, "Devices of this run: " + "; ".join(devices) + ".\n"]
    for page, rows in groupby(figures, key=lambda row: row["page"]):
        parts.append(f"## {page.replace('_', ' ').capitalize()}\n")
        parts.append("| test | case | figure | expected | got | tolerance |")
        parts.append("|---|---|---|---|---|---|")
        for row in rows:
            expected = "–" if row["expected"] is None else f"{row['expected']:.5g}"
            test = row["test"].removeprefix("test_").replace("_", " ")
            parts.append(
                f"| {test} | {row['case'] or '–'} | {row['what']} | {expected} | "
                f"{row['got']:.5g} | {row['tolerance']} |"
            )
        parts.append("")
    PAGE.write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
