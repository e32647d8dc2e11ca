"""How the benchmarks give their figures: as files, as JSON, or as a table."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import Any

from tledface.io._atomic import atomic_path

__all__ = ["report"]


def report(
    result: dict[str, Any], text: str, *, output: Path | None, json: bool, quiet: bool
) -> None:
    """Write ``result`` to ``output`` and ``text`` beside it as ``.md``; print one of them.

    Args:
        result: The figures.
        text: The same as a Markdown table.
        output: The JSON file, or none.
        json: Print the figures rather than the table.
        quiet: Print no table.
    """
    figures = json_module.dumps(result, indent=1)
    if output is not None:
        for path, content in ((output, figures), (output.with_suffix(".md"), text)):
            with atomic_path(path, "benchmark") as part:
                part.write_text(content + "\n", encoding="utf-8")
    if json:
        print(figures)
    elif not quiet:
        print(text)
