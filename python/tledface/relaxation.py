"""Equilibrium by dynamic relaxation.

Pseudo-steps of central difference with a step of 1 and nodal masses that put every node's bound
there, so that high and low frequencies lie as close together as a diagonal mass can bring them.
Damping is critical for the lowest frequency that moves, by the Rayleigh quotient of the change
between two looks (Underwood 1983, "Dynamic relaxation"): omega^2 = du.df / du.M du.

In float32 rounding makes forces of its own. F = 1 + grad u has a relative error of 2^-24, which the
bulk modulus turns into force; under small loads, and in slender bodies, whose load is small beside
their stiffness, that is more than the load. Steps shorter than u's last bit are lost besides. So
where rounding is as large as what is out of balance, the relaxation goes on in float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tledface import _core
from tledface.conditions import Values
from tledface.errors import SimulationError
from tledface.sliding import Sliding, tangential

__all__ = ["Equilibrium", "relax"]

Floats = NDArray[np.float64]

# Pseudo-masses over those that the bound asks for; a look renews them when less than _THIN is left.
_SPARE, _THIN = 1.25, 1.05
# Steps between two looks: few while the load grows, more later. A look costs as much as 10 steps.
_FIRST_LOOK, _LAST_LOOK = 16, 64
# A prescribed node moves at most this share of an edge a step, so that waves run ahead of it.
_RAMP_SPEED = 0.02
_SHORTEST_RAMP = 64
# Rounding counts as what is out of balance when its estimate reaches this share of it. By float32
# forces, exact equilibria (cubes, cantilevers, nu 0.3 to 0.49, loads over three decades) are out of
# balance by 0.5 to 2 times the estimate: the last bits of F and u times stiffness and _ROUNDING.
_ROUNDING, _NOISY = 0.1, 0.25
_LAST_BIT = 2.0**-24
# Without progress for so many periods of the slowest mode, the precision is used up.
_PATIENCE = 6.0


@dataclass(frozen=True)
class Equilibrium:
    """How a relaxation ended.

    Attributes:
        converged: ``residual`` and ``displacement_error`` are at most the tolerance, in the
            precision in which it ended.
        residual: Norm of f_int - f_ext over the free components, over ``reference``.
        displacement_error: Displacement still to come over the displacement, by the decay of the
            slowest mode at critical damping (norms weighted by pseudo-mass).
        steps: Pseudo-steps taken.
        reference: N; the largest of the norms of the external forces on free components, of the
            muscles' active forces, and of the forces on prescribed components. Where there are
            none of these, the imbalance at the start.
        precision: "single" or "double", in which it ended: a simulator of single precision goes
            on in double where rounding is as large as what is out of balance.
        kept_residual: Residual of the state that the simulator keeps, by its own forces: in
            single precision what rounding makes of ``residual``. The displacement is as exact
            as ``displacement_error`` says; the simulator trembles on by this much.
    """

    converged: bool
    residual: float
    displacement_error: float
    steps: int
    reference: float
    precision: str
    kept_residual: float


class _Balance:
    """Forces of one state: what is out of balance on free components, and the reference."""

    def __init__(
        self,
        core: _core.Simulator,
        target: Values,
        free: NDArray[np.bool_],
        moved: NDArray[np.bool_],
        sliding: Sliding,
    ) -> None:
        self.u = np.asarray(core.displacement())
        internal = np.asarray(core.internal_force(target.activations))
        external = np.asarray(core.external_force(target.channels))
        # What surfaces take from sliding nodes is in balance.
        self.imbalance = tangential(
            np.where(free, external - internal, 0.0), sliding, np.asarray(core.sliding_normals())
        )
        norms = [_norm(external[free]), _norm((internal - external)[moved])]
        if target.activations.any():
            passive = core.internal_force(np.zeros_like(target.activations))
            norms.append(_norm((internal - passive)[free]))
        self.reference = max(norms)

    def residual(self, reference: float) -> float:
        """The imbalance over a reference force."""
        return _norm(self.imbalance) / reference if reference else 0.0


def relax(
    core: _core.Simulator,
    held: NDArray[np.bool_],
    prescribed: NDArray[np.bool_],
    sliding: Sliding,
    edge: float,
    extent: float,
    start: Values,
    target: Values,
    tolerance: float,
    max_steps: int,
) -> Equilibrium:
    """Bring a core simulator to rest in equilibrium at ``target``.

    Args:
        core: The simulator.
        held: (n_nodes, 3), components that are fixed or prescribed.
        prescribed: (n_nodes, 3), those that are prescribed.
        sliding: Nodes that slide.
        edge: Smallest edge of a voxel, m.
        start: What the state answers to so far; conditions go from there to ``target``.
        target: Activations, channels and fields of the equilibrium.
        tolerance: For `Equilibrium`'s residual and displacement error.
        max_steps: Most pseudo-steps.

    Raises:
        SimulationError: the state is no longer finite.
    """
    n_shared = core.n_prescribed
    behind = len(target.channels) - core.n_pose_values
    shared = slice(behind - n_shared, behind)
    ramp = _ramp_steps(start, target, shared, slice(behind, None), edge, extent)
    if n_shared or len(target.fields):
        core.set_prescribed(start.channels[shared], start.fields)
    mass = _SPARE * np.asarray(core.relaxation_masses())
    free = ~held
    keys = np.concatenate([start.fields, target.fields])
    omega = 0.02
    steps, look = 0, _FIRST_LOOK
    last, best, best_step, first = None, math.inf, 0, 0.0
    core.begin_relaxation(mass)
    work = core
    try:
        while True:
            n = min(look, max_steps - steps)
            share = np.minimum((steps + 1 + np.arange(n)) / ramp, 1.0) if ramp else np.ones(n)
            motion = np.empty((n, 3))
            motion[:, 0] = (1.0 - omega) / (1.0 + omega)
            motion[:, 1] = 1.0 / (1.0 + omega)
            motion[:, 2] = share
            work.relax(
                motion,
                _between(start.activations, target.activations, share),
                _between(start.channels, target.channels, share),
                keys,
            )
            steps += n
            now = _Balance(work, target, free, prescribed, sliding)
            if not np.isfinite(now.u).all():
                raise SimulationError(
                    f"relax: the state is no longer finite after {steps} pseudo-steps; apply the "
                    "load in parts, or run it in time with damping"
                )
            first = max(first, _norm(now.imbalance)) if now.reference == 0.0 else first
            reference = now.reference or first
            residual = now.residual(reference)
            error = math.inf
            if last is not None and steps >= ramp + _FIRST_LOOK:
                moved = now.u - last.u
                omega = _lowest_frequency(moved, now.imbalance - last.imbalance, mass, omega, free)
                size = _weighted(now.u, mass)
                error = _weighted(moved, mass) / size / math.expm1(omega * n) if size else 0.0
            converged = residual <= tolerance and error <= tolerance
            if max(residual, error) < 0.98 * best:
                best, best_step = max(residual, error), steps
            stuck = (steps - best_step) * omega > 2.0 * math.pi * _PATIENCE
            needed = np.asarray(work.relaxation_masses())
            noisy = (
                work.single
                and steps >= ramp
                and _norm(now.imbalance) * _NOISY
                <= _norm(np.where(free, _rounding(now.u, needed, edge), 0.0))
            )
            ends = converged or steps >= max_steps
            if not ends and work.single and (stuck or noisy):
                work = core.in_double()
                core.end_relaxation()
                mass = _SPARE * needed
                work.begin_relaxation(mass)
                last, best, best_step = None, math.inf, steps
                continue
            if ends or stuck:
                break
            last = now
            if (needed * _THIN > mass).any():
                mass = _SPARE * needed
                work.begin_relaxation(mass)
                last = None
            if steps >= ramp:
                look = min(_LAST_LOOK, 2 * look)
    finally:
        work.end_relaxation()
    ended, kept = "single" if work.single else "double", residual
    if work is not core:
        core.take_state(work)
        kept = _Balance(core, target, free, prescribed, sliding).residual(reference)
    return Equilibrium(converged, residual, error, steps, reference, ended, kept)


def _ramp_steps(
    start: Values, target: Values, shared: slice, posed: slice, edge: float, extent: float
) -> int:
    """Pseudo-steps over which the conditions change."""
    turned = (target.channels[posed] - start.channels[posed]).reshape(-1, 4)
    moves = np.concatenate(
        [
            target.channels[shared] - start.channels[shared],
            target.fields - start.fields,
            turned[:, 3],
            extent * abs(turned[:, :3]).sum(axis=1),
        ]
    )
    changes = [target.activations - start.activations, target.channels - start.channels, moves]
    if not any(change.any() for change in changes):
        return 0
    longest = float(abs(moves).max(initial=0.0))
    return max(_SHORTEST_RAMP, math.ceil(longest / (_RAMP_SPEED * edge)))


def _between(start: Floats, target: Floats, share: Floats) -> Floats:
    rows: Floats = start + share[:, None] * (target - start)
    return rows


def _lowest_frequency(
    moved: Floats, change: Floats, mass: Floats, before: float, free: NDArray[np.bool_]
) -> float:
    """The Rayleigh quotient's frequency, 1/step, kept in what the pseudo-masses allow."""
    moved = np.where(free, moved, 0.0)
    weight = _weighted(moved, mass) ** 2
    if weight == 0.0:
        return before
    square = -float((moved * change).sum()) / weight
    # Negative on the way through an instability: little damping lets it pass.
    if square <= 0.0:
        return max(0.5 * before, 1e-4)
    return min(max(math.sqrt(square), 1e-5), 1.0)


def _rounding(u: Floats, mass: Floats, edge: float) -> Floats:
    """Estimate of the nodal forces that float32 makes of its rounding, N (masses: omega = 2)."""
    bits = np.hypot(np.spacing(abs(u).astype(np.float32)) / math.sqrt(12.0), edge * _LAST_BIT)
    forces: Floats = _ROUNDING * 4.0 * mass[:, None] * bits
    return forces


def _norm(values: Floats) -> float:
    return float(np.linalg.norm(values))


def _weighted(values: Floats, mass: Floats) -> float:
    return math.sqrt(float((mass[:, None] * values**2).sum()))
