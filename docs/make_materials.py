"""Write docs/reference/materials.md from the headers of the law files: run it after a change."""

from pathlib import Path

import tledface as tf
from tledface.laws import Law

PAGE = Path(__file__).parent / "reference" / "materials.md"

INTRODUCTION = """\
# Constitutive laws

Made by `docs/make_materials.py` from `kernels_cl/material/*.cl`; `tf.materials()` gives the same.
A scene writes a law as `{ model = "<name>", ... }`, Python as `tf.material("<name>", ...)`. In a
scene every stiffness and time carries its unit; numbers in Python are SI. Laws with the option
`volumetric` share the volumetric energy `U(J)`: `"log"` (default) is K/4 (J² − 1 − 2 ln J), which
no element can invert against, `"quadratic"` is K/2 (J − 1)².
"""
HEAD = ["| parameter | unit | bounds | default | meaning |", "|---|---|---|---|---|"]
# What goes with another law is no list of numbers, so its header names none.
MODIFIERS = {
    "prony": [
        "| `g` | – | > 0, their sum < 1 | required | share of the stress that relaxes |",
        "| `tau` | s | > 0 | required | its time |",
    ],
    "pretension": [
        "| `along` | Pa | | required | stress along the line |",
        "| `across` | Pa | | `0.0` | stress across it, in the skin |",
        "| `line` | direction | not 0 | required | the line, as a Langer line |",
        "| `normal` | direction | not 0, at right angles to it | required | the skin's normal |",
    ],
}


def page() -> str:
    """The whole page."""
    laws = tf.materials().values()
    parts = [INTRODUCTION]
    parts += [section(law) for law in laws if law.modifier is None]
    parts.append("## With another law\n")
    parts += [section(law) for law in laws if law.modifier is not None]
    return "\n".join(parts)


def section(law: Law) -> str:
    """One law."""
    lines = [
        f"{'###' if law.modifier else '##'} {law.modifier or law.name}",
        "",
        f"{law.title}. `{law.energy}`",
        "",
        f"Source: {law.source}. {law.caveats}",
        "",
    ]
    if law.parameters:
        lines += HEAD
    if law.modifier:
        lines += [*HEAD, *MODIFIERS[law.modifier]]
    for p in law.parameters:
        default = "required" if p.default is None else f"`{p.default}`"
        lines.append(f"| `{p.name}` | {p.unit or '–'} | {p.bounds} | {default} | {p.meaning} |")
    for d in law.directions:
        default = "none" if d.optional else "required"
        lines.append(f"| `{d.name}` | direction | not 0 | {default} | {d.meaning} |")
    for option, choices in law.options.items():
        allowed = ", ".join(f"`{choice}`" for choice in choices)
        lines.append(f"| `{option}` | – | {allowed} | `{choices[0]}` | form of U(J) |")
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
