"""Are there resonances of subcycling? Eigenvalues of the map of one longest step.

Scalar waves in bodies of 4 x 4 x 9 trilinear elements whose stiffness differs from layer to layer
or at random, levels chosen as the solver does. A map of modulus 1 keeps energy; what is above it
grows by the figure printed, in every shortest step.

python bench/verification/subcycling_resonance.py
"""

from __future__ import annotations

from itertools import product

import numpy as np

CELLS = (4, 4, 9)
SUBSTEPS = (2, 4, 8, 16)
# Share of the limit that the shortest step takes, and of its bound that a node's may.
SAFETY, ROOMY = 0.8, 0.92
CORNERS = np.array(list(product((0, 1), repeat=3)))


def element_matrix():
    """Stiffness of a unit cube with unit modulus, by 2 x 2 x 2 Gauss points."""
    sign = 2 * CORNERS - 1
    matrix = np.zeros((8, 8))
    for point in product((-(3**-0.5), 3**-0.5), repeat=3):
        factors = 1 + sign * np.array(point)
        gradient = np.stack(
            [sign[:, d] * np.delete(factors, d, axis=1).prod(axis=1) / 4 for d in range(3)], axis=1
        )
        matrix += gradient @ gradient.T / 8
    return matrix


def growth(stiffness, substeps):
    """(elements on each level, ln of the spectral radius per shortest step)."""
    shape = np.array(CELLS) + 1
    cells = np.array(list(product(*map(range, CELLS))))
    elements = np.stack(
        [np.ravel_multi_index((cells + corner).T, shape) for corner in CORNERS], axis=1
    )
    n, K0 = int(shape.prod()), element_matrix()
    mass, bound = np.zeros(n), np.zeros(n)
    K = np.zeros((n, n))
    for nodes, modulus in zip(elements, stiffness, strict=True):
        mass[nodes] += 1 / 8
        bound[nodes] += modulus * abs(K0).sum(axis=1)
        K[np.ix_(nodes, nodes)] += modulus * K0
    step = SAFETY * 2 / np.sqrt(np.linalg.eigvals(K / mass[:, None]).real.max())
    most = int(np.log2(substeps))
    level = np.floor(np.log2(ROOMY * 2 / np.sqrt(bound / mass) / step)).clip(0, most).astype(int)
    of_element = level[elements].min(axis=1)
    by_level = np.zeros((most + 1, n, n))
    for nodes, modulus, own in zip(elements, stiffness, of_element, strict=True):
        by_level[own][np.ix_(nodes, nodes)] += modulus * K0
    one, none = np.eye(n), np.zeros((n, n))
    drift = np.block([[one, step * one], [none, one]])
    kicks = []
    for highest in range(most + 1):
        weights = 2.0 ** np.arange(highest + 1)
        push = np.tensordot(weights, by_level[: highest + 1], axes=1) * step / mass[:, None]
        kicks.append(np.block([[one, none], [-push, one]]))
    whole = np.eye(2 * n)
    for i in range(substeps):
        highest = most if i == 0 else (i & -i).bit_length() - 1
        whole = drift @ kicks[highest] @ whole
    radius = abs(np.linalg.eigvals(whole)).max()
    return np.bincount(of_element, minlength=most + 1), np.log(radius) / substeps


def main():
    """Print a table of bodies and substeps."""
    random = np.random.default_rng(0)
    layers = {
        "film": [1] * 8 + [400],
        "sheet inside": [1] * 4 + [100] + [1] * 4,
        "graded": [1, 1, 2, 4, 40, 400, 40, 4, 1],
        "two sheets": [300, 30, 1, 1, 1, 3, 3, 30, 300],
    }
    bodies = {name: np.tile(values, CELLS[0] * CELLS[1]) for name, values in layers.items()}
    bodies["at random"] = np.exp(random.uniform(0, 6, int(np.prod(CELLS))))
    print(
        "| body | substeps | elements on each level | growth a shortest step |\n|---|---|---|---|"
    )
    for name, stiffness in bodies.items():
        for substeps in SUBSTEPS:
            count, rate = growth(np.asarray(stiffness, float), substeps)
            print(
                f"| {name} | {substeps} | {', '.join(map(str, count))} | {rate:.1e} |", flush=True
            )


if __name__ == "__main__":
    main()
