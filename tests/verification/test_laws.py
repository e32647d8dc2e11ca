"""Every constitutive law: stress as the energy's derivative, objectivity, closed forms, references.

Each voxel of the models here stands alone, so that every one has its own deformation gradient.
"""

import json

import numpy as np
import pytest

import tledface as tf
from scenes import rotation

BULK = {"bulk_modulus": 2e5, "density": 1000.0}
MATERIALS = {
    "neo_hookean": {"youngs_modulus": 3e4, "poissons_ratio": 0.45, "density": 1000.0},
    "neo_hookean quadratic": {
        "youngs_modulus": 3e4,
        "poissons_ratio": 0.45,
        "density": 1000.0,
        "volumetric": "quadratic",
    },
    "neo_hookean_coupled": {"youngs_modulus": 3e4, "poissons_ratio": 0.45, "density": 1000.0},
    "mooney_rivlin": {"c10": 9.4e3, "c01": 2e3, "c11": 8.2e3, "c20": 1.5e3, "c30": 700.0, **BULK},
    "ogden": {
        "mu1": 6.3e3,
        "alpha1": 1.3,
        "mu2": 12.0,
        "alpha2": 5.0,
        "mu3": -100.0,
        "alpha3": -2.0,
        **BULK,
    },
    "holzapfel_gasser_ogden": {
        "mu": 8e3,
        "k1": 5e3,
        "k2": 0.8,
        "dispersion": 0.1,
        "first": (1.0, 0.5, 0.2),
        "second": (0.3, -1.0, 0.4),
        **BULK,
    },
    "j2_plastic": {"mu": 1e4, "yield_stress": 1e9, **BULK},
    "neo_hookean pretension": {
        "youngs_modulus": 3e4,
        "poissons_ratio": 0.45,
        "density": 1000.0,
        "pretension": {"along": 2e3, "across": 700.0, "line": (1, 1, 0), "normal": (1, -1, 1)},
    },
}


def make(name):
    return tf.material(name.split()[0], **MATERIALS[name])


def lone_voxels(material, count, voxel=(1e-3, 0.8e-3, 1.3e-3)):
    cells = np.zeros((count, 3), np.int32)
    cells[:, 0] = 2 * np.arange(count)
    return tf.Model.from_voxels(
        voxel=voxel,
        origin=np.zeros(3),
        cells=cells,
        tissues=["t"],
        tissue_materials=[material],
        fractions=np.ones((count, 1)),
    )


def displacement(model, F):
    """u that gives voxel e the gradient F[e] about its centre."""
    u = np.empty((model.n_nodes, 3))
    for element, nodes in enumerate(model.elements):
        X = (model.node_ijk[nodes] - model.node_ijk[nodes].mean(axis=0)) * model.voxel
        u[nodes] = X @ (F[element] - np.eye(3)).T
    return u


def first_piola(sim, F):
    sim.set_state(displacement(sim.model, F))
    s = sim.stress()
    sigma = s[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
    J = np.linalg.det(F)
    return J[:, None, None] * sigma @ np.linalg.inv(F).transpose(0, 2, 1)


def random_gradients(count, low=0.5, high=2.0, seed=0):
    rng = np.random.default_rng(seed)
    F = np.empty((count, 3, 3))
    for one in F:
        Q, R = (rotation(rng.standard_normal(3), rng.uniform(0, np.pi)) for _ in range(2))
        one[:] = Q @ np.diag(np.exp(rng.uniform(np.log(low), np.log(high), 3))) @ R
    return F


@pytest.mark.parametrize("name", MATERIALS)
def test_stress_is_the_derivative_of_the_energy(name, figure):
    """S = dW/dE by central differences, float64, principal stretches 0.5 to 2."""
    count = 40
    F = random_gradients(count)
    model = lone_voxels(make(name), count)
    sim = tf.Simulator(model, device="native", precision="double")
    S = np.linalg.inv(F) @ first_piola(sim, F)
    assert abs(S - S.transpose(0, 2, 1)).max() <= 1e-9 * abs(S).max()

    def energy(E):
        # Any F with F^T F = I + 2 E will do: the law is objective (tested below).
        C = np.eye(3) + 2 * E
        sim.set_state(displacement(model, np.linalg.cholesky(C).transpose(0, 2, 1)))
        return sim.strain_energy()

    E = (F.transpose(0, 2, 1) @ F - np.eye(3)) / 2
    step = 1e-5
    worst = 0.0
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)):
        d = np.zeros((3, 3))
        d[i, j] += step / 2
        d[j, i] += step / 2
        # Fourth order: stretches of 0.5 make the third derivative large.
        slope = (8 * (energy(E + d) - energy(E - d)) - (energy(E + 2 * d) - energy(E - 2 * d))) / (
            12 * step
        )
        worst = max(worst, (abs(slope - S[:, i, j]) / abs(S).max(axis=(1, 2))).max())
    figure("worst S - dW/dE over largest S", worst, at_most=1e-6)


@pytest.mark.parametrize("name", MATERIALS)
def test_stress_is_objective(name, figure):
    """P(Q F) = Q P(F) to 1e-10."""
    count = 40
    F = random_gradients(count, seed=1)
    Q = random_gradients(count, 1.0, 1.0, seed=2)
    sim = tf.Simulator(lone_voxels(make(name), count), device="native", precision="double")
    P = first_piola(sim, F)
    turned = first_piola(sim, Q @ F)
    error = abs(turned - Q @ P).max() / abs(P).max()
    figure("worst P(Q F) - Q P(F) over largest P", error, at_most=1e-10)
    assert abs(first_piola(sim, Q)).max() <= 1e-10 * abs(P).max() or "pretension" in name


@pytest.mark.parametrize("name", MATERIALS)
def test_forces_of_every_executor_carry_the_stress(executor, name):
    """Nodal forces f_a = V P dN_a/dX of the device's kernels, against the float64 stress."""
    count = 12
    F = random_gradients(count, 0.7, 1.4, seed=3)
    model = lone_voxels(make(name), count)
    for precision, tolerance in (("double", 1e-12), ("single", 2e-5)):
        sim = tf.Simulator(model, precision=precision, **executor.kwargs)
        P = first_piola(sim, F)
        force = sim.internal_force()
        signs = np.array(
            [
                [-1, 1, 1, -1, -1, 1, 1, -1],
                [-1, -1, 1, 1, -1, -1, 1, 1],
                [-1, -1, -1, -1, 1, 1, 1, 1],
            ]
        )
        expected = np.prod(model.voxel) * P @ (signs / (4 * model.voxel[:, None]))
        for element, nodes in enumerate(model.elements):
            error = abs(force[nodes] - expected[element].T).max()
            assert error <= tolerance * (abs(expected).max() + 2e5 * 1e-6)


def sheared_volume_changes(J):
    """F of det J with F_xy the only shear: P_xy of the decoupled law is mu J^(-2/3) F_xy."""
    F = np.eye(3) * np.cbrt(J)[:, None, None]
    F[:, 0, 1] = 0.3 * np.cbrt(J)
    return F


def test_cube_root_over_its_range():
    """The kernels' own J^(-1/3), read off a pure volume change under the coupled-free law."""
    J = np.geomspace(0.04, 30.0, 200)
    F = sheared_volume_changes(J)
    material = make("neo_hookean")
    sim = tf.Simulator(lone_voxels(material, 200), device="native", precision="double")
    shear = first_piola(sim, F)[:, 0, 1] * np.cbrt(J)
    # P_xy of mu J^(-2/3) (F - I1/3 F^-T) + p F^-T, with F^-T_xy = 0: mu J^(-2/3) F_xy.
    assert np.allclose(shear, material.mu * 0.3, rtol=1e-13)


def test_cube_root_in_single_precision(executor):
    """As above, off the nodal forces of the device, near 1, where a polynomial gives it."""
    J = np.linspace(0.7, 1.3, 181)
    F = sheared_volume_changes(J)
    material = make("neo_hookean")
    model = lone_voxels(material, len(J))
    sim = tf.Simulator(model, precision="single", **executor.kwargs)
    first_piola(sim, F)
    along_x = sim.internal_force()[model.elements, 0]
    sign_y = np.array([-1, -1, 1, 1, -1, -1, 1, 1])
    shear = along_x @ sign_y * model.voxel[1] / (2 * np.prod(model.voxel)) * np.cbrt(J)
    # Rounding of what the pressure's forces leave of those of the shear, and of F.
    assert abs(shear / (0.3 * material.mu) - 1.0).max() <= 1e-6


@pytest.mark.parametrize("name", ["neo_hookean", "mooney_rivlin", "ogden"])
def test_moduli_at_rest_are_those_of_the_law(name):
    material = make(name)
    count = 2
    small = 1e-6
    F = np.stack([np.eye(3), np.eye(3)])
    F[0, 0, 1] = small
    F[1] *= 1 + small
    sim = tf.Simulator(lone_voxels(material, count), device="native", precision="double")
    P = first_piola(sim, F)
    assert P[0, 0, 1] / small == pytest.approx(material.mu, rel=1e-5)
    assert P[1, 0, 0] / (3 * small) == pytest.approx(material.bulk, rel=1e-5)


def test_several_laws_in_one_voxel_add_up_by_their_fractions():
    F = random_gradients(6, seed=4)
    names = ["neo_hookean", "mooney_rivlin", "ogden"]
    fractions = np.random.default_rng(5).dirichlet([1, 1, 1], size=6)
    parts = [
        first_piola(tf.Simulator(lone_voxels(make(n), 6), device="native", precision="double"), F)
        for n in names
    ]
    mixed = lone_voxels(make("neo_hookean"), 6)
    mixed = tf.Model.from_voxels(
        voxel=mixed.voxel,
        origin=mixed.origin,
        cells=mixed.cells,
        tissues=names,
        tissue_materials=[make(n) for n in names],
        fractions=fractions,
    )
    P = first_piola(tf.Simulator(mixed, device="native", precision="double"), F)
    expected = sum(fractions[:, i, None, None] * part for i, part in enumerate(parts))
    assert abs(P - expected).max() <= 1e-12 * abs(expected).max()


def test_homogeneous_deformations_of_the_references(shared_refs, figure):
    """Uniaxial, biaxial, confined, shear and volumetric states of independent software."""
    cases = json.loads((shared_refs / "homogeneous.json").read_text())["cases"]
    seen = set()
    for case in cases:
        p = case["params"]
        if case["model"] == "neo_hookean_decoupled":
            values = {"youngs_modulus": p["E"], "poissons_ratio": p["nu"]}
            law = ("neo_hookean", {**values, "volumetric": "quadratic"})
        elif case["model"] == "neo_hookean_coupled":
            law = ("neo_hookean_coupled", {"youngs_modulus": p["E"], "poissons_ratio": p["nu"]})
        else:
            terms = {k: p[k.upper()] for k in ("c10", "c01", "c11", "c20", "c30")}
            values = {**terms, "bulk_modulus": p["K"], "volumetric": "quadratic"}
            law = ("mooney_rivlin", values)
        seen.add(law[0])
        material = tf.material(law[0], density=1000.0, **law[1])
        F = np.array([row["F"] for row in case["rows"]])
        expected = np.array([row["PK1"] for row in case["rows"]])
        model = lone_voxels(material, len(F))
        got = first_piola(tf.Simulator(model, device="native", precision="double"), F)
        scale = abs(expected).max(axis=(1, 2)) + material.bulk * 1e-3
        worst = (abs(got - expected).max(axis=(1, 2)) / scale).max()
        figure(f"{law[0]}, K {material.bulk:.4g} Pa: worst PK1 error", worst, at_most=1e-9)
    assert seen == {"neo_hookean", "neo_hookean_coupled", "mooney_rivlin"}


def held(material, F, dt, executor=None):
    """Voxels held at given gradients from t = 0 on; steps of dt change only their history."""
    model = lone_voxels(material, len(F))
    model.fix(np.ones(model.n_nodes, bool))
    options = executor.kwargs if executor else {"device": "native"}
    sim = tf.Simulator(model, dt=dt, precision="double", **options)
    sim.set_state(displacement(model, F))
    return sim


def shear_stress(sim):
    return sim.stress()[:, 3]


def test_prony_relaxation(executor, figure):
    """Isochoric stress after a step in strain: S0 (1 - sum g + sum g e^(-t/tau)).

    The recurrence of a step is exact where the strain stands still.
    """
    F = np.repeat(np.eye(3)[None], 2, axis=0)
    F[0, 0, 1] = 0.3
    F[1, 0, 1] = -0.5
    plain = {"youngs_modulus": 3e4, "poissons_ratio": 0.45, "density": 1000.0}
    instant = held(tf.material("neo_hookean", **plain), F, 1e-4)
    S0 = shear_stress(instant)
    terms = [(0.3, 5e-3), (0.2, 40e-3), (0.1, 0.3)]
    sim = held(tf.material("neo_hookean", **plain, prony=terms), F, 1e-4, executor)
    for until in (1e-3, 5e-3, 20e-3, 60e-3):
        sim.run(until=until)
        expected = S0 * (0.4 + sum(g * np.exp(-sim.time / tau) for g, tau in terms))
        figure(f"shear stress at {until:g} s, Pa", shear_stress(sim)[0], expected[0], rel=1e-9)
        figure(f"the other shear at {until:g} s", shear_stress(sim)[1], expected[1], rel=1e-9)
        # The device's forces carry it too.
        nodes = sim.model.elements[0]
        top = sim.model.node_ijk[nodes][:, 1] == 1
        pull = sim.internal_force()[nodes][top, 0].sum()
        area = sim.model.voxel[0] * sim.model.voxel[2]
        assert pull == pytest.approx(shear_stress(sim)[0] * area, rel=1e-6)


def test_prony_acts_on_any_isochoric_law_and_leaves_the_volume_alone():
    F = np.eye(3)[None] * np.array([1.1, 0.9])[:, None, None]
    terms = [(0.5, 1e-3)]
    material = tf.material("mooney_rivlin", **MATERIALS["mooney_rivlin"], prony=terms)
    sim = held(material, F, 1e-4)
    before = sim.stress()
    sim.step(200)
    assert abs(sim.stress() - before).max() <= 1e-9 * abs(before).max()
    shear = np.eye(3)[None] + 0.4 * np.eye(3)[:, [1, 0, 2]] * np.array([1.0, 0.0, 0.0])[:, None]
    sheared = held(material, shear, 1e-4)
    start = shear_stress(sheared)[0]
    sheared.step(200)
    assert shear_stress(sheared)[0] == pytest.approx(0.5 * start, rel=1e-6)


def test_holzapfel_gasser_ogden_closed_form_and_anisotropy(figure):
    """Equibiaxial-free extension of an isochoric state along and across the fibres."""
    k1, k2, mu = 5e3, 0.8, 8e3
    material = tf.material(
        "holzapfel_gasser_ogden", mu=mu, k1=k1, k2=k2, first=(1.0, 0.0, 0.0), **BULK
    )
    stretches = np.array([1.05, 1.2, 1.5, 0.8])
    along, across = np.zeros((4, 3, 3)), np.zeros((4, 3, 3))
    for i, s in enumerate(stretches):
        along[i] = np.diag([s, s**-0.5, s**-0.5])
        across[i] = np.diag([s**-0.5, s, s**-0.5])
    sim = tf.Simulator(lone_voxels(material, 4), device="native", precision="double")

    def difference(F, a, b):
        sim.set_state(displacement(sim.model, F))
        return sim.stress()[:, a] - sim.stress()[:, b]

    E = np.maximum(stretches**2 - 1, 0)
    fibre = 2 * k1 * E * np.exp(k2 * E**2) * stretches**2
    matrix = mu * (stretches**2 - 1 / stretches)
    for stretch, got, wanted in zip(
        stretches, difference(along, 0, 2), matrix + fibre, strict=True
    ):
        figure(f"stress along the fibre at {stretch:g}, Pa", got, wanted, rel=1e-9)
    # Across, the fibres shorten and carry nothing; a shortened sample along them stretches none.
    expected = matrix.copy()
    E_side = np.maximum(1 / stretches - 1, 0)
    got = difference(across, 1, 2)
    assert np.allclose(got, expected, rtol=1e-9)
    assert (E_side[:3] == 0).all()
    assert (difference(along, 0, 2)[:3] > 1.1 * got[:3]).all()


def test_fibres_that_turn_from_element_to_element(executor, figure):
    """A direction field gives each element the stress of a material with that direction."""
    count = 24
    model = lone_voxels(make("holzapfel_gasser_ogden"), count)
    first = np.random.default_rng(7).standard_normal((count, 3))
    second = np.cross(first, [1.0, 2.0, 3.0])
    model.set_directions("t", {"first": first, "second": second})
    F = random_gradients(count, 0.8, 1.5, seed=4)
    sim = tf.Simulator(model, device="native", precision="double")
    P = first_piola(sim, F)
    values = MATERIALS["holzapfel_gasser_ogden"]
    mu, k1, k2, spread, bulk = (values[k] for k in ("mu", "k1", "k2", "dispersion", "bulk_modulus"))
    worst = 0.0
    for e in range(count):
        C = F[e].T @ F[e]
        J, inverse, I1 = np.linalg.det(F[e]), np.linalg.inv(C), np.trace(C)
        iso = J ** (-2 / 3)
        S = mu * iso * (np.eye(3) - I1 / 3 * inverse) + bulk / 2 * (J**2 - 1) * inverse
        for d in (first[e], second[e]):
            d = d / np.linalg.norm(d)
            I4 = d @ C @ d
            E = spread * (iso * I1 - 3) + (1 - 3 * spread) * (iso * I4 - 1)
            if E > 0:
                slope = spread * (np.eye(3) - I1 / 3 * inverse)
                slope += (1 - 3 * spread) * (np.outer(d, d) - I4 / 3 * inverse)
                S += 2 * k1 * E * np.exp(k2 * E**2) * iso * slope
        worst = max(worst, abs(P[e] - F[e] @ S).max() / abs(P[e]).max())
    figure("worst P - closed form over largest P", worst, at_most=1e-6)
    # The device's forces are those of this field too.
    for precision, tolerance in (("double", 1e-12), ("single", 2e-5)):
        on_device = tf.Simulator(model, precision=precision, **executor.kwargs)
        on_device.set_state(displacement(model, F))
        exact = sim.internal_force()
        error = abs(on_device.internal_force() - exact).max()
        assert error <= tolerance * (abs(exact).max() + 2e5 * 1e-6)


def test_plastic_flow_keeps_the_yield_stress_and_the_dent():
    """Beyond yield the Mises stress stays at it; on unloading the shape does not come back."""
    yield_stress = 2e3
    material = tf.material("j2_plastic", mu=1e4, yield_stress=yield_stress, **BULK)
    sheared = np.eye(3)[None].copy()
    sheared[0, 0, 1] = 0.5
    sim = held(material, sheared, 1e-4)
    sim.step(3)
    s = sim.stress()[0]
    J = np.linalg.det(sheared[0])
    deviator = s.copy()
    deviator[:3] -= s[:3].mean()
    mises = np.sqrt(1.5 * ((deviator[:3] ** 2).sum() + 2 * (deviator[3:] ** 2).sum())) * J
    assert mises == pytest.approx(yield_stress, rel=1e-6)
    # Back to the undeformed shape with the history kept: residual stress of the other sign.
    core = sim._core
    state = core.raw_state()
    state["u"], state["u_prev"] = np.zeros_like(state["u"]), np.zeros_like(state["u_prev"])
    core.set_raw_state(**state)
    sim.step(3)
    assert shear_stress(sim)[0] < -0.5 * yield_stress / np.sqrt(3)
    elastic = held(tf.material("j2_plastic", mu=1e4, yield_stress=1e9, **BULK), sheared, 1e-4)
    elastic.step(3)
    assert shear_stress(elastic)[0] == pytest.approx(1e4 * 0.5, rel=1e-9)


def test_yield_stress_falls_with_time():
    material = tf.material(
        "j2_plastic", mu=1e4, yield_stress=2e3, yield_stress_end=5e2,
        fall_begin=1e-3, fall_end=3e-3, **BULK,
    )  # fmt: skip
    sheared = np.eye(3)[None].copy()
    sheared[0, 0, 1] = 0.5
    sim = held(material, sheared, 1e-4)
    for until, level in ((0.9e-3, 2e3), (2e-3, 1250.0), (4e-3, 5e2)):
        sim.run(until=until)
        s = sim.stress()[0]
        s[:3] -= s[:3].mean()
        mises = np.sqrt(1.5 * ((s[:3] ** 2).sum() + 2 * (s[3:] ** 2).sum()))
        assert mises == pytest.approx(level, rel=0.08)
