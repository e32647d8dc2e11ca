"""The frame of the core: positions count from a point of the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["core_pose", "frame_origin"]


def frame_origin(model: Model) -> NDArray[np.float64]:
    """Where the core's positions count from, (3,) m: bodies may lie metres from their origin."""
    if model.is_conforming:
        return np.asarray(0.5 * (model.nodes.min(axis=0) + model.nodes.max(axis=0)))
    return model.origin


def core_pose(model: Model, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """A pose (3, 4) of the model's frame in the core's."""
    origin = frame_origin(model)
    moved = pose.copy()
    moved[:, 3] += pose[:, :3] @ origin - origin
    return moved
