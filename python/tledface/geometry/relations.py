"""How the volumes of a model lie to each other: overlaps, parts outside the skin, gaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tledface import _core

__all__ = ["SKIN", "gaps", "relations"]

SKIN = "skin"


def relations(
    names: Sequence[str], tally: dict[str, NDArray[np.uint64]], sample: float
) -> dict[str, Any]:
    """Return what the sampler counted, as volumes in m3.

    Args:
        names: Of the bones and muscle surfaces; the skin comes after them.
        tally: Counts of the core.
        sample: Volume that a sample stands for, m3.

    Returns:
        ``volumes``, by name: ``volume``; ``outside_skin`` (not for the skin);
        ``covered_twice``, where a surface overlaps itself or one part lies in another;
        ``inside_out``, where it is wound inwards. All within the skin's box and the region.
        ``overlaps``: pairs of ``names`` with the ``volume`` they share, falling.
    """
    skin = len(names)
    both = tally["both"].astype(np.float64) * sample
    volumes = {}
    for index, name in enumerate([*names, SKIN]):
        row = {
            "volume": float(tally["inside"][index]) * sample,
            "covered_twice": float(tally["covered_twice"][index]) * sample,
            "inside_out": float(tally["reversed"][index]) * sample,
        }
        if index != skin:
            row["outside_skin"] = row["volume"] - float(both[index, skin])
        volumes[name] = row
    return {"volumes": volumes, "overlaps": _pairs(names, both[:skin, :skin])}


def gaps(
    names: Sequence[str],
    surfaces: Sequence[_core.Surface],
    origin: NDArray[np.float64],
    voxel: NDArray[np.float64],
    cells: NDArray[np.int32],
) -> list[dict[str, Any]]:
    """Return the gaps between surfaces that are thinner than a voxel's longest edge.

    Args:
        names: Of the bones and muscle surfaces; the skin comes after them.
        surfaces: Theirs, and the skin's.
        origin, voxel: (3,) m.
        cells: (n, 3) cells that hold tissue.

    Returns:
        Pairs of ``names`` with the ``volume`` (m3) of tissue between them, falling: between two
        bones or muscles, or one and the skin.
    """
    if not names:
        return []
    found = _core.gap_volumes(surfaces, origin.tolist(), voxel.tolist(), cells, float(voxel.max()))
    return _pairs([*names, SKIN], found)


def _pairs(names: Sequence[str], volumes: NDArray[np.float64]) -> list[dict[str, Any]]:
    rows, columns = np.nonzero(np.triu(volumes, 1))
    pairs = [
        {"names": [names[p], names[q]], "volume": float(volumes[p, q])}
        for p, q in zip(rows.tolist(), columns.tolist(), strict=True)
    ]
    return sorted(pairs, key=lambda pair: -pair["volume"])
