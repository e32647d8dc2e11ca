"""Muscles of a model and their tension-length relation.

Three laws: ``"tension_length"`` (the default) and ``"tension_length_printed"`` (with the jump that
the paper prints), and ``"calcium"``. For the first two the stress is
``S = J (activation sigma_act f_act + sigma_pas f_pas) d (x) d`` with ``stretch = |F d|`` (Warburton
and Maddock 2014, eq. 8-12). For the third the Cauchy stress along the deformed fibre is
``sigma_act hill(level) (1 + beta (stretch - 1))`` (Hung et al. 2009, eq. 3). The functions here are
the float64 reference that the kernels are held against.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["LAWS", "Muscle", "active_tension", "calcium_level", "calcium_stress", "passive_tension"]

LAWS = ("tension_length", "tension_length_printed", "calcium")

# Hung et al. 2009, below eq. 3: level of half activation, Hill exponent, slope over stretch. The
# paper's Ca_max is 1, so a level is Ca itself; its sigma_ref is 100 kPa.
CALCIUM_HALF, CALCIUM_EXPONENT, CALCIUM_BETA = 0.5, 3.0, 1.45

Passive = Literal["continuous", "printed"]

_LINE_SLOPE = 2.18
_LINE_OFFSET = -2.47


@dataclass(frozen=True, eq=False)
class Muscle:
    """One muscle with its own activation channel.

    Attributes:
        name: Name by which the muscle is activated.
        elements: (m,) int64, indices into the model's elements, ascending.
        fibre: (m, 3) unit fibre direction per element, reference frame.
        weight: (m,) overlap fraction of the muscle in each element, 0 to 1.
        sigma_act: Reference stress of the active tension, Pa.
        sigma_pas: Reference stress of the passive tension, Pa.
        lambda_opt: Stretch of the greatest active tension.
        lambda_pas: Stretch above which the passive tension grows linearly.
        law: One of `LAWS`.
    """

    name: str
    elements: NDArray[np.int64]
    fibre: NDArray[np.float64]
    weight: NDArray[np.float64]
    sigma_act: float
    sigma_pas: float
    lambda_opt: float = 1.0
    lambda_pas: float = 1.2
    law: str = "tension_length"

    def active_share(self, level: ArrayLike) -> NDArray[np.float64]:
        """Return the share of ``sigma_act`` at an activation level 0 to 1, any shape."""
        if self.law == "calcium":
            return calcium_level(level)
        return np.asarray(level, dtype=np.float64)


def active_tension(stretch: ArrayLike, lambda_opt: float = 1.0) -> NDArray[np.float64]:
    """Return the active tension-length factor f_act, 1 at the optimal stretch.

    Args:
        stretch: Fibre stretch, any shape.
        lambda_opt: Stretch of the greatest tension; the factor is 0 outside 0.6 to 1.4 times it.

    Returns:
        Array of the shape of ``stretch``.

    A parabola with roots at 0.6 and 1.4 ``lambda_opt`` (Warburton and Maddock 2014, eq. 10).
    """
    ratio = np.asarray(stretch, dtype=np.float64) / lambda_opt
    return np.maximum(-6.25 * ratio**2 + 12.5 * ratio - 5.25, 0.0)


def passive_tension(
    stretch: ArrayLike, lambda_pas: float = 1.2, *, form: Passive = "continuous"
) -> NDArray[np.float64]:
    """Return the passive tension-length factor f_pas, 0 for a fibre that is not stretched.

    Args:
        stretch: Fibre stretch, any shape.
        lambda_pas: Stretch at which the exponential becomes a line, at least 1.
        form: ``"continuous"`` starts the line at the end of the exponential; ``"printed"`` is
            ``2.18 stretch - 2.47`` as the paper has it, which jumps from 0.137 to 0.146 at 1.2.

    Returns:
        Array of the shape of ``stretch``.

    Warburton and Maddock 2014, eq. 11-12.
    """
    stretch = np.asarray(stretch, dtype=np.float64)
    # The exponential is cut off where the line takes over so that long fibres cannot overflow it.
    exponential = 0.05 * np.expm1(6.6 * (np.minimum(stretch, lambda_pas) - 1.0))
    if form == "continuous":
        line = exponential + _LINE_SLOPE * (stretch - lambda_pas)
    else:
        line = _LINE_SLOPE * stretch + _LINE_OFFSET
    return np.where(stretch <= 1.0, 0.0, np.where(stretch <= lambda_pas, exponential, line))


def calcium_level(level: ArrayLike) -> NDArray[np.float64]:
    """Return the share of the reference stress that a calcium level 0 to 1 activates, any shape.

    ``Ca^h / (Ca^h + Ca50^h)``, Hung et al. 2009, eq. 3: 0.854 at 0.9, 0.633 at 0.6.
    """
    power = np.asarray(level, dtype=np.float64) ** CALCIUM_EXPONENT
    return np.asarray(power / (power + CALCIUM_HALF**CALCIUM_EXPONENT))


def calcium_stress(
    level: ArrayLike, stretch: ArrayLike = 1.0, sigma_ref: float = 100e3
) -> NDArray[np.float64]:
    """Return the Cauchy stress along the fibre, Pa, at a calcium level and stretch.

    ``sigma_ref hill(level) (1 + beta (stretch - 1))``, not below 0 (Hung et al. 2009, eq. 3).
    """
    rise = 1.0 + CALCIUM_BETA * (np.asarray(stretch, dtype=np.float64) - 1.0)
    return np.asarray(sigma_ref * calcium_level(level) * np.maximum(rise, 0.0))
