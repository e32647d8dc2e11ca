"""Tangents of small models, and Newton's method, from nothing but the solver's forces."""

import numpy as np


def residual(sim):
    """Out-of-balance force at the free components, (n_nodes, 3) N."""
    force = sim.mass[:, None] * sim.model.gravity - sim.internal_force()
    force[sim.model.fixed] = 0.0
    return force


def hold(sim, u):
    """Set a displacement, at rest; held nodes keep what it says of them."""
    sim.set_state(u, time=sim.time)


def tangent(sim, step=None):
    """Stiffness -d residual / d u at the state of now, (3 n_nodes, 3 n_nodes) N/m, dense.

    Nodes three cells apart share no element, so 27 groups of nodes move at a time.
    """
    model = sim.model
    n = model.n_nodes
    step = 1e-6 * float(model.voxel.min()) if step is None else step
    base = sim.u
    index = {tuple(ijk): node for node, ijk in enumerate(model.node_ijk.tolist())}
    offsets = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
    beside = np.array(
        [
            [index.get((i + a, j + b, k + c), -1) for a, b, c in offsets]
            for i, j, k in model.node_ijk.tolist()
        ]
    )
    colour = model.node_ijk % 3 @ (1, 3, 9)
    stiffness = np.zeros((n, 3, n, 3))
    for group in range(27):
        moving = np.flatnonzero(colour == group)
        if not len(moving):
            continue
        near = beside[moving]
        source = np.repeat(moving, 27)[near.ravel() >= 0]
        target = near.ravel()[near.ravel() >= 0]
        for component in range(3):
            forces = []
            for sign in (1.0, -1.0):
                u = base.copy()
                u[moving, component] += sign * step
                hold(sim, u)
                forces.append(sim.internal_force())
            slope = (forces[0] - forces[1]) / (2.0 * step)
            stiffness[target, :, source, component] = slope[target]
    hold(sim, base)
    return stiffness.reshape(3 * n, 3 * n)


def newton(sim, u, tolerance=1e-9, most=40):
    """Bring the free components of ``u`` into equilibrium; returns the displacement."""
    free = ~sim.model.fixed.ravel()
    hold(sim, u)
    for _ in range(most):
        force = residual(sim)
        if abs(force).max() <= tolerance * abs(sim.internal_force()).max():
            return sim.u
        stiffness = tangent(sim)[np.ix_(free, free)]
        change = np.zeros(free.size)
        change[free] = np.linalg.solve(stiffness, force.ravel()[free])
        # A step that turns elements over is halved until the residual is a number that falls.
        base, size = sim.u, 1.0
        while size > 1e-3:
            hold(sim, base + size * change.reshape(-1, 3))
            tried = abs(residual(sim)).max()
            if np.isfinite(tried) and tried < 10.0 * abs(force).max():
                break
            size /= 2
    raise AssertionError("Newton's method found no equilibrium")
