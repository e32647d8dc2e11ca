"""The direction in which a muscle is longest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tledface import _core

__all__ = ["long_axes"]


def long_axes(solids: Sequence[_core.Surface]) -> NDArray[np.float64]:
    """Return the direction in which each volume is longest, (n, 3) unit vectors.

    The axis of greatest second moment of the enclosed volume. The first axis has its largest
    component positive, the others point to its side, so that surfaces of one muscle agree.
    """
    axes = np.empty((len(solids), 3))
    for row, solid in enumerate(solids):
        xx, yy, zz, xy, yz, xz = solid.covariance
        _, vectors = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        axis = vectors[:, -1]
        reference = axes[0] if row else np.eye(3)[np.argmax(np.abs(axis))]
        axes[row] = -axis if axis @ reference < 0.0 else axis
    return axes
