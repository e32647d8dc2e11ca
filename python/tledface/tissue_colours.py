"""Colours of tissues and of boundary nodes in pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["INK", "NODE_COLOURS", "node_kinds", "tissue_colours"]

INK = "#2b2626"

# From the outer skin inwards: skin tones to the yellow of fat.
_LAYERS = ("#b9714f", "#eab497", "#f4dfa0", "#d8c7a9", "#cfd8c0", "#b9c6cf")
_MUSCLES = ("#a8322d", "#6c3c8f", "#1f7a80", "#c9730f", "#3d5fa8", "#7d8a1f", "#b03a7c", "#5b4636")

NODE_COLOURS = {
    "held": "#3a3533",
    "attachment": "#b3261e",
    "ligament": "#8e44ad",
    "sliding": "#1f77b4",
    "symmetry": "#2e9d4f",
    "partly held": "#e08a1e",
}


def tissue_colours(model: Model) -> dict[str, str]:
    """A colour for each tissue: muscles apart from the others, both in their order."""
    muscles = {muscle.name for muscle in model.muscles}
    colours: dict[str, str] = {}
    counts = [0, 0]
    for name in model.tissues:
        is_muscle = name in muscles
        palette = _MUSCLES if is_muscle else _LAYERS
        colours[name] = palette[counts[is_muscle] % len(palette)]
        counts[is_muscle] += 1
    return colours


def node_kinds(model: Model) -> dict[str, NDArray[np.bool_]]:
    """Which nodes are bound how, (n_nodes,) each; kinds without nodes are left out.

    A node is of the first kind that it is of: rigid as a muscle's attachment, a ligament, or
    otherwise; sliding; on a plane of symmetry; held in some components.
    """

    def members(kind: str) -> NDArray[np.bool_]:
        where = np.zeros(model.n_nodes, dtype=bool)
        for group in model.groups:
            if group.kind == kind:
                where[group.nodes] = True
        return where

    rigid = model.fixed.all(axis=1)
    boxed = members("fixed") | members("cut")
    sliding = np.zeros(model.n_nodes, dtype=bool)
    sliding[model.sliding.nodes] = True
    kinds = {
        "attachment": rigid & members("attachment") & ~boxed,
        "ligament": rigid & members("ligament") & ~boxed,
        "held": rigid,
        "sliding": sliding,
        "symmetry": members("symmetry"),
        "partly held": model.fixed.any(axis=1),
    }
    taken = np.zeros(model.n_nodes, dtype=bool)
    found = {}
    for name, where in kinds.items():
        left = where & ~taken
        taken |= where
        if left.any():
            found[name] = left
    return found
