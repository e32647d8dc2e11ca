"""The nodes of a voxel model: corners of its cells, with x fastest, then y, then z."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.surface import HEX_CORNERS


def number_nodes(
    cells: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Number the corners of the cells by (k, j, i); return node_ijk and elements."""
    extent = cells.max(axis=0).astype(np.int64) + 2
    stride = np.array([1, extent[0], extent[0] * extent[1]])
    key = cells @ stride
    unique = np.sort(key)
    repeated = np.flatnonzero(unique[1:] == unique[:-1])
    if len(repeated):
        element = int(np.flatnonzero(key == unique[repeated[0]])[1])
        raise InputError(
            f"cells: cell {tuple(cells[element].tolist())} is given twice, again as element "
            f"{element}; cells must be distinct"
        )
    for axis_stride in stride:
        both = np.sort(np.concatenate([unique, unique + axis_stride]))
        unique = both[np.concatenate([[True], both[1:] != both[:-1]])]
    elements = np.empty((len(cells), 8), dtype=np.int32)
    for corner, offset in enumerate(HEX_CORNERS @ stride):
        elements[:, corner] = np.searchsorted(unique, key + offset)
    node_ijk = np.empty((len(unique), 3), dtype=np.int32)
    node_ijk[:, 0] = unique % extent[0]
    node_ijk[:, 1] = unique // extent[0] % extent[1]
    node_ijk[:, 2] = unique // stride[2]
    return node_ijk, elements
