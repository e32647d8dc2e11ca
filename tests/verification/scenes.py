"""Small models and closed forms that the verification tests share."""

import numpy as np

import tledface as tf


def soft(youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0, volumetric="log"):
    return tf.material(
        "neo_hookean",
        youngs_modulus=youngs_modulus,
        poissons_ratio=poissons_ratio,
        density=density,
        volumetric=volumetric,
    )


def neo_hookean_cauchy(F, mu, bulk, volumetric="log"):
    """Cauchy stress (3, 3) Pa of the decoupled law, written from its energy."""
    J = np.linalg.det(F)
    b = F @ F.T
    slope = bulk / 2 * (J - 1 / J) if volumetric == "log" else bulk * (J - 1)
    isochoric = mu * J ** (-5 / 3) * (b - np.trace(b) / 3 * np.eye(3))
    return isochoric + slope * np.eye(3)


def uniaxial(stretch, mu, bulk, volumetric="log"):
    """(lateral stretch, axial Cauchy stress Pa) of a bar free at its sides, by bisection."""
    low, high = 0.3, 2.0
    for _ in range(200):
        middle = (low + high) / 2
        sigma = neo_hookean_cauchy(np.diag([stretch, middle, middle]), mu, bulk, volumetric)
        low, high = (middle, high) if sigma[1, 1] < 0 else (low, middle)
    return middle, sigma[0, 0]


def rotation(axis, angle):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def contracting_block():
    """A clamped block with a muscle sheet along a slanted fibre near its bottom."""
    model = tf.Model.block(cells=(20, 12, 9), size=(0.01, 0.006, 0.0045), material=soft())
    model.set_material(lambda c: c[:, 2] > 0.0025, soft(81.4e3))
    model.add_muscle(
        "sheet",
        lambda c: (c[:, 2] < 0.002) & (abs(c[:, 0] - 0.005) < 0.003),
        fibre=(1, 0.2, 0),
        sigma_act=5e6,
        sigma_pas=5e6,
    )
    model.fix(lambda X: X[:, 0] < 1e-9)
    return model


def sparse_model(seed=3):
    """A block with a third of its voxels missing, one tissue each for two sorts of voxel."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*map(np.arange, (37, 11, 8)), indexing="ij"), -1).reshape(-1, 3)
    cells = grid[rng.random(len(grid)) > 0.33].astype(np.int32)
    share = rng.random((len(cells), 1))
    return tf.Model.from_voxels(
        voxel=np.array([0.5e-3, 0.4e-3, 0.25e-3]),
        origin=np.array([1.0, -2.0, 3.0]),
        cells=cells,
        tissues=["soft", "hard"],
        tissue_materials=[soft(), soft(2e6, 0.45)],
        fractions=np.hstack([share, 1 - share]),
    )
