"""Onset of wrinkles in the solver's own equations: waves of every length on a strip without ends.

A strip one element across (plane strain: y held) is shortened uniformly; film and substrate have
the same Poisson's ratio, so that uniform strain is an equilibrium. The forces that the nodes of one
column cause on the columns beside it are measured by central differences; summed with the phases
exp(i K X) they are the stiffness against a wave of that length. The onset is the least shortening
at which it is singular: the discrete counterpart of `film_theory`, without growth, noise or ends.
"""

import numpy as np

import tledface as tf
from bodies import simulator
from equilibrium import hold
from film_theory import onset
from scenes import soft

NU = 0.49
SUBSTRATE = 10e3  # Pa; only the ratio of moduli matters


def film_strip(ratio, layers=1, aspect=1.0, columns=4, waves_deep=1.5):
    """A film 1 mm thick, ``layers`` elements of length/height ``aspect``, on a substrate."""
    height = 1e-3 / layers
    depth = waves_deep * onset(ratio)[0] * 1e-3
    n = layers + int(np.ceil(depth / height))
    model = tf.Model.block(
        cells=(columns, 1, n),
        size=(columns * aspect * height, height, n * height),
        material=soft(SUBSTRATE, NU),
    )
    top = n * height - 1e-3
    model.set_material(lambda c: c[:, 2] > top, soft(ratio * SUBSTRATE, NU))
    return held(model)


def layered_strip(voxel, ratio=1000.0, film=0.02e-3, section=True, columns=4, waves_deep=1.5):
    """A film far thinner than a voxel, blended into the top row of cubic voxels (m)."""
    depth = waves_deep * max(onset(ratio)[0] * film, 12.0 * voxel)
    n = 1 + int(np.ceil(depth / voxel))
    grid = np.stack(np.meshgrid(range(columns), [0], range(n), indexing="ij"), -1).reshape(-1, 3)
    top = grid[:, 2] == n - 1
    share = np.where(top, film / voxel, 0.0)
    # Moments over the voxel of the stiffness, in units of the substrate's, z from the middle.
    low, high = 0.5 - film / voxel, 0.5
    mean = 1.0 + (ratio - 1.0) * (high - low)
    first = (ratio - 1.0) * (high**2 - low**2) / 2
    second = 1.0 / 12 + (ratio - 1.0) * (high**3 - low**3) / 3
    bending = 12.0 * (second - first**2 / mean)
    layers = {}
    if section:
        layers = {
            "section_ratio": np.where(top, bending / mean, 1.0),
            "layer_normal": np.tile([0.0, 0.0, 1.0], (len(grid), 1)),
        }
    model = tf.Model.from_voxels(
        voxel=np.full(3, voxel),
        origin=np.zeros(3),
        cells=grid.astype(np.int32),
        tissues=["film", "substrate"],
        tissue_materials=[soft(ratio * SUBSTRATE, NU), soft(SUBSTRATE, NU)],
        fractions=np.stack([share, 1.0 - share], axis=1),
        **layers,
    )
    return held(model)


def held(model):
    """Plane strain on a bottom that slides."""
    model.fix(lambda X: X[:, 0] > -1.0, "y")
    model.fix(lambda X: X[:, 2] < 1e-9, "z")
    return model


def thickening(strain, poissons_ratio=NU):
    """Stretch across a plane-strain body shortened by ``strain`` with its faces free."""
    mu = 1.0 / (2 * (1 + poissons_ratio))
    bulk = 1.0 / (3 * (1 - 2 * poissons_ratio))
    low, high = 0.9, 3.0
    for _ in range(100):
        middle = (low + high) / 2
        F = np.array([1.0 - strain, 1.0, middle])
        J = F.prod()
        sigma = mu * J ** (-5 / 3) * (F[2] ** 2 - (F**2).sum() / 3) + bulk / 2 * (J - 1 / J)
        low, high = (middle, high) if sigma < 0 else (low, middle)
    return middle


def couplings(sim, strain):
    """Forces on columns -1, 0, 1 from moving the nodes of column 0, each (dofs, dofs)."""
    model = sim.model
    base = np.zeros((model.n_nodes, 3))
    base[:, 0] = -strain * model.nodes[:, 0]
    base[:, 2] = (thickening(strain) - 1.0) * model.nodes[:, 2]
    middle = 2
    ijk = model.node_ijk
    heights = ijk[:, 2].max() + 1
    blocks = np.zeros((3, heights, 2, heights, 2))
    step = 1e-6 * float(model.voxel.min())
    for group in range(3):  # heights three apart share no element
        for c, component in enumerate((0, 2)):
            moving = (ijk[:, 0] == middle) & (ijk[:, 2] % 3 == group)
            if component == 2:
                moving &= ijk[:, 2] > 0
            forces = []
            for sign in (1.0, -1.0):
                u = base.copy()
                u[moving, component] += sign * step
                hold(sim, u)
                forces.append(sim.internal_force())
            slope = (forces[0] - forces[1]) / (2 * step)
            for k in np.unique(ijk[moving, 2]):
                near = (abs(ijk[:, 0] - middle) <= 1) & (abs(ijk[:, 2] - k) <= 1)
                for node in np.flatnonzero(near):
                    blocks[ijk[node, 0] - middle + 1, ijk[node, 2], :, k, c] += slope[node, ::2]
    # The bottom's z is held: drop that row and column.
    keep = np.ones(2 * heights, bool)
    keep[1] = False
    return blocks.reshape(3, 2 * heights, 2 * heights)[:, keep][:, :, keep]


def least_stiffness(blocks, phase):
    """Smallest eigenvalue of the stiffness against a wave of this phase a column."""
    before, at, after = blocks
    matrix = at + np.exp(1j * phase) * after + np.exp(-1j * phase) * before
    return np.linalg.eigvalsh((matrix + matrix.conj().T) / 2)[0]


def softest(blocks, around):
    """(least stiffness, phase) over all phases, those near ``around`` looked at closely."""
    close = around * np.linspace(0.7, 1.3, 13)
    phases = np.concatenate([np.geomspace(around / 4, np.pi, 40), close])
    phases = np.sort(phases[phases <= np.pi])
    values = np.array([least_stiffness(blocks, phase) for phase in phases])
    best = int(np.argmin(values))
    low, high = phases[max(best - 1, 0)], phases[min(best + 1, len(phases) - 1)]
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    while high - low > 1e-4 * high:
        a, b = high - golden * (high - low), low + golden * (high - low)
        if least_stiffness(blocks, a) < least_stiffness(blocks, b):
            high = b
        else:
            low = a
    phase = (low + high) / 2
    return least_stiffness(blocks, phase), phase


def discrete_onset(model, guess_strain, guess_wavelength, **options):
    """(reference wavelength in m, shortening) at which the strip first has a neutral wave."""
    sim = simulator(model, **options)
    around = 2 * np.pi * float(model.voxel[0]) / guess_wavelength
    seen = {}

    def stiffness(strain):
        seen[strain] = softest(couplings(sim, strain), min(around, 0.9 * np.pi))
        return seen[strain][0]

    low, high = 0.0, guess_strain
    while stiffness(high) > 0.0:
        low, high = high, high * 1.3
        if high > 0.45:
            return np.nan, np.inf
    if low == 0.0:
        while stiffness(low := high / 1.3) < 0.0:
            high = low
            if high < 1e-5:
                return np.nan, 0.0
    while high - low > 1e-4 * high:
        # Regula falsi with bisection as its guard.
        share = seen[low][0] / (seen[low][0] - seen[high][0])
        middle = low + np.clip(share, 0.05, 0.95) * (high - low)
        if stiffness(middle) > 0.0:
            low = middle
        else:
            high = middle
    phase = seen[high][1]
    return 2 * np.pi * float(model.voxel[0]) / phase, (low + high) / 2


def film_onset(ratio, layers=1, aspect=1.0, **options):
    """Wavelength and shortening of `film_strip` over the exact ones."""
    wavelength, strain = onset(ratio)
    model = film_strip(ratio, layers, aspect)
    found, shortening = discrete_onset(model, strain, wavelength * 1e-3, **options)
    return found / (wavelength * 1e-3), shortening / strain


def layered_onset(voxel, section, ratio=1000.0, film=0.02e-3, **options):
    """Wavelength (m) and shortening of `layered_strip`."""
    wavelength, strain = onset(ratio)
    # Coarse voxels give waves of some eight of them.
    guess = max(wavelength * film, 8.0 * voxel)
    model = layered_strip(voxel, ratio, film, section)
    return discrete_onset(model, strain * 2, guess, **options)
