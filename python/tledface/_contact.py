"""What a surface that moves, rubs or lets go does to a node in a step, as the ledger counts it.

The same as the kernels do (kernels_cl/sliding.cl), with the surface's plane of the last step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tledface.sliding import Sliding

__all__ = ["on_surfaces"]

Floats = NDArray[np.float64]

# Of a node that may leave: what it comes nearer by itself is below this share of what presses it to
# the surface in the step. A node that flies comes nearer by nearly all of it.
_TOUCHES = 0.5


def on_surfaces(
    way: Floats,
    before: Floats,
    surface: Floats,
    normals: Floats,
    sliding: Sliding,
    held: NDArray[np.bool_],
) -> tuple[Floats, Floats]:
    """Ways of the n nodes of ``sliding`` in a step, and what of it the surfaces did.

    Args:
        way: (n, 3) m, ways in the step if there were no surfaces.
        before: (n, 3) m, ways in the step before.
        surface: (n, 3) m, ways of the surfaces where the nodes are.
        normals: (n, 3) unit normals, or zero where none is known yet.
        sliding: The nodes.
        held: (n, 3) components that are fixed or prescribed.

    Returns:
        The ways (n, 3), and the changes (n, 3) that stand for the surfaces' forces. Held components
        do not follow friction; there it counts for the share of the way that the core takes
        for rubbed off, so that its loss and the surface's work are the same.
    """
    relative = way - surface
    off = -(relative * normals).sum(axis=1, keepdims=True)
    nearer = abs(((before - surface) * normals).sum(axis=1, keepdims=True))
    pressed = np.where(sliding.distance[:, None] < 0.0, -off, off)
    touches = ~sliding.release[:, None] | (nearer < _TOUCHES * pressed)
    along = relative + off * normals
    off = np.where(touches, off, 0.0)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    rubbed = sliding.friction[:, None] * abs(off)
    share = np.minimum(rubbed / np.maximum(length, np.finfo(float).tiny), 1.0)
    friction = -share * along
    pushed = off * normals
    moved = way + np.where(held, 0.0, pushed + friction)
    return moved, pushed + np.where(held, (1.0 - share) * friction, friction)
