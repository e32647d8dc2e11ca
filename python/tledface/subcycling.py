"""Subcycling: how many of the shortest steps the longest one has."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from tledface import _core
from tledface.errors import InputError

__all__ = ["SUBSTEPS", "SubcyclingWarning", "checked_subcycling", "choose_substeps"]

# Substeps that a step may have.
SUBSTEPS = (1, 2, 4, 8, 16)
# More substeps must save at least this share of the time; all of it together at least the second.
_WORTH, _WORTH_ALL = 0.03, 0.1


class SubcyclingWarning(RuntimeWarning):
    """Subcycling was asked for where everything takes the same step."""


def checked_subcycling(value: Any) -> bool | int:
    """The option as given to `Simulator`, checked; raises InputError."""
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)) and int(value) in SUBSTEPS:
        return int(value)
    allowed = ", ".join(map(str, SUBSTEPS[1:]))
    raise InputError(
        f"subcycling: got {value!r}; allowed: true, false, or how many shortest steps a step "
        f"has: {allowed}"
    )


def choose_substeps(core: _core.Simulator, subcycling: bool | int) -> int:
    """Set how many of the shortest steps a step of ``core`` has, and which blocks take which.

    Its shortest step and a limit must be known. True takes as many as pay, by what blocks of nodes
    and elements would be left out; a number is taken as it is.
    """
    if subcycling is False or (subcycling == 1 and subcycling is not True):
        return 1
    if not core.can_subcycle:
        warnings.warn(
            f"subcycling: {core.kernels} kernels take steps of one length, so it is left out; "
            "kernels='rows' (device='native', or OpenCL on a CPU) can",
            SubcyclingWarning,
            stacklevel=4,
        )
        return 1
    costs = {1: 1.0}
    for substeps in (subcycling,) if subcycling is not True else SUBSTEPS[1:]:
        core.substeps = substeps
        core.choose_levels()
        costs[substeps] = core.relative_cost()
    if subcycling is not True:
        return int(subcycling)
    least = min(costs.values())
    substeps = (
        1 if least > 1.0 - _WORTH_ALL else next(n for n in SUBSTEPS if costs[n] <= least + _WORTH)
    )
    core.substeps = substeps
    core.choose_levels()
    return substeps
