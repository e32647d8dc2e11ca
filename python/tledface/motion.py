"""Rigid motion of a surface over time: the jaw under its tissue."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface._model_checks import is_number, numbers_of
from tledface.errors import InputError
from tledface.schedule import Constant, Keyframes, Ramp, Schedule, as_schedule

__all__ = ["Motion", "RigidMotion", "checked_motion", "pose_at"]

Floats = NDArray[np.float64]
# A pose (3, 4) or (4, 4) of time in s: x = rotation . X + translation, m.
Motion = Callable[[float], ArrayLike]

# How far a callable's rotation may be off one, and its first pose off none.
_ROTATION_OFF = 1e-6


@dataclass(frozen=True)
class RigidMotion:
    """A turn about an axis and a shift, both in proportion to a share between 0 and 1.

    Attributes:
        about: (3,) m, a point of the axis.
        axis: (3,) its direction, any length; the turn is right-handed about it.
        angle: rad at a share of 1.
        shift: (3,) m at a share of 1.
        share: number, `tledface.ramp`, keyframes or callable(t) that gives 0..1; 0 at first, since
            tissue is built on the surface where its mesh has it.

    Raises:
        InputError: a value of another shape, or not finite, or an axis of no length.

    Example: ``RigidMotion(about=hinge, axis=(1, 0, 0), angle=0.2, share=tf.ramp(0, 1, 0.1))``
    """

    about: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    angle: float = 0.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    share: float | Schedule | Callable[[float], float] = 0.0

    def __post_init__(self) -> None:
        """Check everything and take the share for a schedule."""
        for name in ("about", "axis", "shift"):
            try:
                value = np.asarray(getattr(self, name), dtype=np.float64)
            except (TypeError, ValueError):
                value = np.empty(0)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise InputError(
                    f"motion {name}: got {getattr(self, name)!r}; allowed: three finite numbers"
                )
            object.__setattr__(self, name, tuple(value.tolist()))
        if not any(self.axis):
            raise InputError("motion axis: got (0, 0, 0); allowed: a direction")
        if not is_number(self.angle):
            raise InputError(f"motion angle: got {self.angle!r}; allowed: finite radians")
        object.__setattr__(self, "angle", float(self.angle))
        object.__setattr__(self, "share", as_schedule(self.share))

    @property
    def can_be_stored(self) -> bool:
        """Whether a file can hold it: its share is no callable."""
        return isinstance(self.share, (Constant, Ramp, Keyframes))

    def __call__(self, t: float) -> Floats:
        """The pose (3, 4) at time ``t`` (s)."""
        share = float(as_schedule(self.share)(t))
        x, y, z = np.asarray(self.axis) / math.sqrt(sum(a * a for a in self.axis))
        angle = share * self.angle
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        # Rodrigues' formula.
        rotation = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
        about = np.asarray(self.about)
        translation = about - rotation @ about + share * np.asarray(self.shift)
        return np.column_stack([rotation, translation])


def checked_motion(motion: object, what: str) -> Motion:
    """A motion that starts with no motion; raises InputError."""
    if not callable(motion):
        raise InputError(
            f"{what}: got {motion!r}; allowed: a tledface.RigidMotion, or callable(t) that gives a "
            "pose of shape (3, 4) or (4, 4)"
        )
    start = pose_at(motion, 0.0, what)
    if abs(start - np.eye(3, 4)).max() > _ROTATION_OFF:
        raise InputError(
            f"{what}: the pose at t = 0 is not the identity; tissue is built on the surface as its "
            "mesh has it, so let the motion start there"
        )
    return motion


def pose_at(motion: Motion, t: float, what: str) -> Floats:
    """The pose (3, 4) at time ``t`` (s); raises InputError for what is no rigid motion."""
    pose, wrong = numbers_of(motion(t), (3, 4), (4, 4))
    if wrong:
        raise InputError(
            f"{what}: got {wrong}, at t = {t:g} s; allowed: a finite pose of shape (3, 4) or (4, 4)"
        )
    pose = pose[:3]
    rotation = pose[:, :3]
    if (
        abs(rotation.T @ rotation - np.eye(3)).max() > _ROTATION_OFF
        or np.linalg.det(rotation) < 0.0
    ):
        raise InputError(
            f"{what}: the pose at t = {t:g} s is not rigid; allowed: a rotation and a translation"
        )
    return pose
