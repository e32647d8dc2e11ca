"""Slender bodies against theory: tip stiffness, a strip rolled up, free vibration."""

import numpy as np

import tledface as tf
from bodies import simulator
from equilibrium import hold, newton, tangent
from scenes import soft

E, DENSITY = 50e3, 1100.0


def tip_over_timoshenko(layers, poissons_ratio, **options):
    """Tip deflection of a 10:1 square cantilever under an end load, over Timoshenko's."""
    L, b = 0.1, 0.01
    model = tf.Model.block(
        cells=(10 * layers, layers, layers), size=(L, b, b), material=soft(E, poissons_ratio)
    )
    # Held flat at the root but free to swell and narrow there, as the theory has it; nodes on the
    # middle line, or the lower edge of a single element, carry the shear.
    height = b / 2 if layers % 2 == 0 else 0.0
    root = model.nodes[:, 0] < 1e-9
    level = root & (abs(model.nodes[:, 2] - height) < 1e-9)
    side = np.minimum(model.nodes[:, 1], b - model.nodes[:, 1]) < 1e-9
    model.fix(root, "x")
    model.fix(level & side, "z")
    model.fix(level & (model.nodes[:, 1] < 1e-9), "y")
    sim = simulator(model, **options)
    share = np.where(model.nodes[:, 0] > L - 1e-9, 1.0, 0.0)
    for axis in (1, 2):
        edge = np.minimum(model.nodes[:, axis], b - model.nodes[:, axis]) < 1e-9
        share *= np.where(edge, 0.5, 1.0)
    share /= share.sum()
    load = np.zeros((model.n_nodes, 3))
    load[:, 2] = share
    free = ~model.fixed.ravel()
    u = np.linalg.solve(tangent(sim)[np.ix_(free, free)], load.ravel()[free])
    tip = u @ load.ravel()[free]
    shear = E / (2 * (1 + poissons_ratio))
    factor = 10 * (1 + poissons_ratio) / (12 + 11 * poissons_ratio)  # Cowper's, square section
    return tip / (L**3 / (3 * E * b**4 / 12) + L / (factor * shear * b**2))


def rolled_moment(aspect, poissons_ratio, plane_strain=True, cells=40, **options):
    """End moment of a strip one element thick rolled up by 180 degrees, over E I pi / L.

    ``aspect`` is element length over thickness; in plane strain E is E / (1 - nu^2). The ends stay
    flat and are held on the arc of the middle line.
    """
    h = 1e-3
    n = round(cells / aspect)
    L = cells * h
    model = tf.Model.block(cells=(n, 1, 1), size=(L, h, h), material=soft(E, poissons_ratio))
    model.fix(lambda X: (X[:, 0] < 1e-9) | (X[:, 0] > L - 1e-9), "xz")
    model.fix(lambda X: (X[:, 0] < 1e-9) | bool(plane_strain), "y")
    sim = simulator(model, **options)
    # Rolled up by steps, from the arc that each would be.
    angle = np.pi * (model.nodes[:, 0] / L - 0.5)
    z = model.nodes[:, 2] - h / 2
    R = L / np.pi
    arc = np.stack([(R - z) * np.sin(angle), model.nodes[:, 1], R - (R - z) * np.cos(angle)], 1)
    u = newton(sim, arc - model.nodes)
    hold(sim, u)
    end = model.nodes[:, 0] > L - 1e-9
    place = (model.nodes + u)[end]
    moment = np.cross(place - place.mean(axis=0), sim.internal_force()[end]).sum(axis=0)[1]
    modulus = E / (1 - poissons_ratio**2) if plane_strain else E
    return abs(moment) / (modulus * h**4 / 12 / R)


def bar_frequency(**options):
    """First axial frequency of a bar held at one end, over c / 4 L with c^2 = E / rho."""
    L, b = 0.04, 0.002
    model = tf.Model.block(cells=(40, 2, 2), size=(L, b, b), material=soft(E, 0.3, DENSITY))
    model.fix(lambda X: X[:, 0] < 1e-9, "x")
    model.fix(lambda X: (X[:, 0] < 1e-9) & (abs(X[:, 1] - b / 2) < 1e-9), "y")
    model.fix(lambda X: (X[:, 0] < 1e-9) & (abs(X[:, 2] - b / 2) < 1e-9), "z")
    shape = np.zeros((model.n_nodes, 3))
    x = model.nodes[:, 0]
    shape[:, 0] = np.sin(np.pi * x / (2 * L))
    slope = np.pi / (2 * L) * np.cos(np.pi * x / (2 * L))
    for axis in (1, 2):
        shape[:, axis] = -0.3 * slope * (model.nodes[:, axis] - b / 2)
    theory = np.sqrt(E / DENSITY) / (4 * L)
    return frequency(simulator(model, **options), 1e-5 * shape, theory) / theory


def cantilever_frequency(**options):
    """First bending frequency of a 20:1 cantilever, over 3.516 / (2 pi) sqrt(EI / rho A L^4)."""
    L, b = 0.04, 0.002
    model = tf.Model.block(cells=(40, 2, 2), size=(L, b, b), material=soft(E, 0.3, DENSITY))
    model.fix(lambda X: X[:, 0] < 1e-9)
    shape = np.zeros((model.n_nodes, 3))
    k, x = 1.8751041 / L, model.nodes[:, 0]
    ratio = 0.7340955
    shape[:, 2] = np.cosh(k * x) - np.cos(k * x) - ratio * (np.sinh(k * x) - np.sin(k * x))
    slope = k * (np.sinh(k * x) + np.sin(k * x) - ratio * (np.cosh(k * x) - np.cos(k * x)))
    shape[:, 0] = -slope * (model.nodes[:, 2] - b / 2)
    theory = 3.5160153 / (2 * np.pi) * np.sqrt(E * b**2 / 12 / DENSITY) / L**2
    return frequency(simulator(model, **options), 1e-5 * shape, theory) / theory


def frequency(sim, shape, expected):
    """Hz, from the times at which the motion along ``shape`` passes through zero, undamped."""
    hold(sim, shape)
    weight = sim.mass[:, None] * shape
    every = max(1, round(1 / (expected * sim.dt * 100)))
    times, heights = [], []
    while sim.time < 2.6 / expected:
        times.append(sim.time)
        heights.append(float((weight * sim.u).sum()))
        sim.step(every)
    turns = np.flatnonzero(np.diff(np.sign(heights)))
    zeros = [
        times[i] - heights[i] * (times[i + 1] - times[i]) / (heights[i + 1] - heights[i])
        for i in turns
    ]
    return 0.5 * (len(zeros) - 1) / (zeros[-1] - zeros[0])


def step_errors(fractions=(0.25, 0.125, 0.0625, 0.03125), **options):
    """Largest error of u after a fixed time for steps of these fractions of h / c.

    At half of h / c the fast waves are not yet followed: its error over the next is 3.5, not 4.
    """
    model = tf.Model.block(cells=(8, 3, 4), size=(8e-3, 3e-3, 4e-3), material=soft(E, 0.45))
    model.fix(lambda X: X[:, 0] < 1e-9)
    X = model.nodes
    u = 0.02 * np.stack([X[:, 0], 0.2 * X[:, 0] * X[:, 1] / 3e-3, X[:, 0] ** 2 / 8e-3], axis=1)
    material = model.tissue_materials[0]
    crossing = 1e-3 / np.sqrt((material.bulk + 4 / 3 * material.mu) / material.density)
    ends = []
    for fraction in (*fractions, min(fractions) / 8):
        steps = round(5 / fraction)
        sim = simulator(model, dt=5 * crossing / steps, **options)
        sim.set_state(u, velocity=500.0 * u)  # 1/s, about the slowest frequency
        sim.step(steps)
        ends.append(sim.u)
    return [float(abs(end - ends[-1]).max() / abs(u).max()) for end in ends[:-1]]


def energy_drift(steps=100_000, windows=10, **options):
    """Largest change of the mean energy of an undamped, vibrating block, relative to its start.

    Means over tenths of the run. The block is bent and stretched by 5 % without regard to its modes
    and steps as dt = "auto" has it, so that fast waves take part and energy spreads among them: at
    one moment it is known to some per cent only, for a step that long. The step must stay below
    0.866 of the true limit: there the fastest waves feed on the others (omega dt = sqrt 3, a
    third-order resonance: Schlick, Mandziuk, Skeel & Srinivas, J. Comput. Phys. 140, 1-29, 1998).
    """
    model = tf.Model.block(cells=(8, 3, 4), size=(8e-3, 3e-3, 4e-3), material=soft(E, 0.45))
    model.fix(lambda X: X[:, 0] < 1e-9)
    X = model.nodes / 8e-3
    u = 4e-4 * np.stack([X[:, 0], X[:, 0] * X[:, 2], X[:, 0] ** 2], axis=1)
    sim = simulator(model, **options)
    sim.set_state(u)
    volume = float(np.prod(model.voxel))
    samples = 40
    energy = np.empty((windows, samples))
    for window, sample in np.ndindex(energy.shape):
        sim.step(steps // windows // samples - 1)
        elastic = (sim.strain_energy() + sim.hourglass_energy()).sum() * volume
        before = sim.velocity
        sim.step(1)
        # Speeds are known half a step away on either side.
        speed = (before + sim.velocity) / 2
        energy[window, sample] = elastic + 0.5 * sim.mass @ (speed**2).sum(axis=1)
    mean = energy.mean(axis=1)
    return float(abs(mean / mean[0] - 1.0).max())
