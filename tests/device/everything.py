"""A body that uses everything at once, for tests of executors.

As a program it is stepped under whatever OpenCL library the environment names, see
test_oclgrind.py: ``everything.py KERNELS PRECISION HOURGLASS LAWS``.
"""

import sys

import numpy as np
import trimesh

import tledface as tf


def body_of_everything(cells=(20, 9, 7), *, laws=True):
    """A body with holes: several materials, laws with a past, muscles, loads, a bone to slide on.

    Its tissues change within blocks of lanes; one voxel in six is missing, and all in a slot
    across x that is wider than a tile's halo.
    """
    rng = np.random.default_rng(7)
    grid = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), -1).reshape(-1, 3)
    kept = (rng.random(len(grid)) > 1 / 6) & ~np.isin(grid[:, 0], (7, 8, 9)) | (grid[:, 2] < 2)
    grid = grid[kept].astype(np.int32)
    moduli = {"bulk_modulus": 4e5, "density": 1100.0}
    plain = tf.material("neo_hookean", youngs_modulus=6e4, poissons_ratio=0.45, density=1100.0)
    materials = [
        plain,
        tf.material("neo_hookean", youngs_modulus=2e5, poissons_ratio=0.4, density=1000.0),
    ]
    if laws:
        materials += [
            tf.material(
                "mooney_rivlin", c10=8e3, c01=2e3, **moduli, prony=[(0.5, 2e-4), (0.3, 1e-3)]
            ),
            tf.material("j2_plastic", mu=2e4, yield_stress=30.0, **moduli),
        ]
    fractions = rng.random((len(grid), len(materials)))
    fractions[rng.random(fractions.shape) < 0.5] = 0.0
    fractions[:, 0] += 1e-3
    h = 1e-3
    model = tf.Model.from_voxels(
        voxel=np.array([h, 0.8 * h, 1.1 * h]),
        origin=np.zeros(3),
        cells=grid,
        tissues=[f"tissue {i}" for i in range(len(materials))],
        tissue_materials=materials,
        fractions=fractions / fractions.sum(axis=1, keepdims=True),
    )
    for name, low, fibre in (("along", 0.0, (1, 0.2, 0)), ("across", 1.5e-3, (0.3, 1, 0.1))):
        model.add_muscle(
            name,
            lambda c, low=low: (c[:, 2] > low) & (c[:, 2] < low + 3e-3),
            fibre=fibre,
            sigma_act=3e4,
            sigma_pas=3e4,
        )
    top = model.nodes[:, 2].max()
    model.fix(lambda X: X[:, 0] < 0.5 * h)
    model.prescribe(lambda X: X[:, 0] > cells[0] * h - 0.5 * h, {"x": lambda t: 20.0 * t * h})
    bone = trimesh.creation.box((0.1, 0.1, 0.02))
    bone.apply_translation((0.01, 0.0, -0.01 - 0.5 * h))
    model.slide(
        lambda X: (X[:, 2] < 0.1 * h) & (X[:, 0] > 0.5 * h) & (X[:, 0] < (cells[0] - 1) * h),
        bone,
        friction=0.1,
    )
    model.body_force(lambda c: c[:, 1] < 3e-3, (0.0, 0.0, 2e4))
    model.pressure(lambda c, n: (c[:, 2] > top - 0.1 * h) & (n[:, 2] > 0.5), 50.0)
    model.gravity = (1.0, -9.81, 3.0)
    return model


def contracted(model, **options):
    """A simulator of it whose muscles contract."""
    sim = tf.Simulator(model, **options)
    for muscle in model.muscles:
        sim.activate(muscle.name, tf.ramp(0.0, 0.6, 1e-3))
    return sim


def main(kernels, precision, hourglass, laws):
    """Two steps, a snapshot between them, forces and a look, on OpenCL's first device."""
    sim = contracted(
        body_of_everything((18, 9, 3), laws=laws == "laws"),
        device="opencl:0",
        kernels=kernels,
        precision=precision,
        hourglass=hourglass,
        dt=2e-6,
    )
    sim.step(1)
    first, u = sim.snapshot(), sim.u
    sim.step(1)
    force = sim.internal_force()
    sim._core.first_non_finite_node()
    sim._core.limit_now(np.full(len(sim.model.muscles), 0.1), 0.0, 0.8, 1.1)
    sim._core.dt = 0.9 * sim.dt
    moved = abs(sim.u - u).max() > 0 and np.array_equal(first.u, u)
    print(sim._device.info.name, sim._core.kernels, moved, np.isfinite(force).all())


if __name__ == "__main__":
    main(*sys.argv[1:])
