"""Thick bodies in equilibrium: a hanging cantilever, a bonded cube, a twisted column.

Each is brought to rest by the simulator's own relaxation and read by its own reactions. ``n`` is
the number of elements over an edge.
"""

import json
import os
from pathlib import Path

import numpy as np

import tledface as tf
from scenes import soft

GRAVITY = 9.81
# Far below the figures that are compared.
TOLERANCE, MOST_STEPS = 1e-5, 200_000

# Torque of `twisted_column` at 60 degrees, over mu a^3: extrapolated from n = 20 and 30 (error as
# 1/n^2). The kappa form, extrapolated alike, comes to 0.0501.
COLUMN_TORQUE = 0.05005


def reference_structures():
    """The independent finite-element results, or None where this machine has them not."""
    root = Path(os.environ.get("TLEDFACE_SHARED", Path(__file__).parents[3] / "shared"))
    path = root / "refs" / "structures.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def simulator(model, **options):
    return tf.Simulator(model, **{"device": "native", "precision": "double", **options})


def relaxed(model, tolerance=TOLERANCE, **options):
    sim = simulator(model, **options)
    info = sim.relax(tolerance, MOST_STEPS)
    assert info.converged, info
    return sim


def cantilever(n, g_fraction, **options):
    """Displacement (x, z) in mm of the end face's centre, hanging under a fraction of gravity."""
    L, b = 0.1, 0.02
    material = soft(3e3, 0.45, 1000.0, "quadratic")
    model = tf.Model.block(cells=(5 * n, n, n), size=(L, b, b), material=material)
    model.fix(lambda X: X[:, 0] < 1e-9)
    model.gravity = (0.0, 0.0, -GRAVITY * g_fraction)
    sim = relaxed(model, **options)
    # Of an odd number of elements the four nodes about the centre.
    end = abs(model.nodes - (L, b / 2, b / 2)).max(axis=1) < 0.51 * b / n
    return sim.u[end].mean(axis=0)[[0, 2]] * 1e3


def bonded_cube(n, poissons_ratio, strain, volumetric="quadratic", **options):
    """(force / (E L^2), sideways motion of a side's centre / L) of a cube with bonded ends."""
    E, L = 1e4, 1.0
    material = soft(E, poissons_ratio, 1000.0, volumetric)
    model = tf.Model.block(cells=(n, n, n), size=(L, L, L), material=material)
    top = model.nodes[:, 2] > L - 1e-9
    model.fix(lambda X: X[:, 2] < 1e-9)
    model.prescribe(top, {"x": 0.0, "y": 0.0, "z": strain * L})
    sim = relaxed(model, **options)
    side = abs(model.nodes - (L, L / 2, L / 2)).max(axis=1) < 0.51 * L / n
    return sim.reaction(top)[2] / (E * L**2), sim.u[side, 0].mean() / L


def twisted_column(n, degrees=60.0, poissons_ratio=0.49, **options):
    """Torque / (mu a^3) of a column a x a x 3 a with bonded ends, one turned about the axis."""
    a, length = 1.0, 3.0
    material = soft(1e4, poissons_ratio, 1000.0)
    model = tf.Model.block(cells=(n, n, 3 * n), size=(a, a, length), material=material)
    top = model.nodes[:, 2] > length - 1e-9
    model.fix(lambda X: X[:, 2] < 1e-9)
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    arm = model.nodes[top, :2] - a / 2
    model.prescribe(
        top,
        {
            "x": arm @ (cosine - 1.0, -sine),
            "y": arm @ (sine, cosine - 1.0),
            "z": 0.0,
        },
    )
    sim = relaxed(model, **options)
    place = (model.nodes + sim.u)[top] - (a / 2, a / 2, length)
    return np.cross(place, sim.internal_force()[top]).sum(axis=0)[2] / (material.mu * a**3)
