"""Parts of scene files that the examples after Warburton and Maddock (2014) share."""

from __future__ import annotations

__all__ = ["layer", "neo_hookean"]


def neo_hookean(modulus: str) -> str:
    """Return the ``material`` line of Table I for a Young's modulus with its unit."""
    return (
        f'material = {{ model = "neo_hookean", youngs_modulus = "{modulus}", '
        'poissons_ratio = 0.49, density = "1100 kg/m^3" }'
    )


def layer(name: str, thickness: float | None, modulus: str) -> str:
    """Return a ``[[layers]]`` table; ``thickness`` in the scene's units, None takes the rest."""
    depth = "" if thickness is None else f"thickness = {thickness:g}\n"
    return f'[[layers]]\nname = "{name}"\n{depth}{neo_hookean(modulus)}\n'
