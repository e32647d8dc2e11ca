"""Thick bodies at rest against independent finite elements, converging as the mesh is refined."""

import pytest

import bodies


@pytest.fixture(scope="module")
def refs():
    found = bodies.reference_structures()
    if found is None:
        pytest.skip("the independent reference results are not on this machine")
    return found


def cube_case(refs, poissons_ratio, strain):
    key = {-0.2: "-0.2", 1.0: "+1.0"}[strain]
    return refs["bonded_cube"]["nh1"][f"nu{poissons_ratio}"][key]


@pytest.mark.parametrize("poissons_ratio", [0.45, 0.49])
@pytest.mark.parametrize(("strain", "tolerance"), [(-0.2, 0.04), (1.0, 0.015)])
def test_bonded_cube(refs, poissons_ratio, strain, tolerance, figure):
    """Force at 20 elements an edge; the error falls with every refinement."""
    force, bulge, uncertainty = cube_case(refs, poissons_ratio, strain)
    found = {n: bodies.bonded_cube(n, poissons_ratio, strain) for n in (5, 10, 20)}
    figure("force / E L^2 at 20 elements an edge", found[20][0], force, rel=tolerance)
    errors = {n: abs(found[n][0] / force - 1) for n in found}
    # The reference's own uncertainty is no part of what is allowed.
    assert abs(uncertainty / force) < 0.25 * max(tolerance, 0.01) + 0.0025
    figure("its error at 10 over that at 5", errors[10] / errors[5], at_most=0.75)
    figure("its error at 20 over that at 10", errors[20] / errors[10], at_most=0.75)
    figure("sideways motion / L at 20", found[20][1], bulge, rel=0.03)


def test_bonded_cube_on_every_device(executor, figure):
    """Single precision, every executor: the double result of ten elements within 0.1 %."""
    exact = bodies.bonded_cube(10, 0.49, -0.2)
    sim_options = {"precision": "single", **executor.kwargs}
    found = bodies.bonded_cube(10, 0.49, -0.2, tolerance=1e-4, **sim_options)
    figure("force / E L^2", found[0], exact[0], rel=1e-3)
    figure("sideways motion / L", found[1], exact[1], rel=1e-3)


@pytest.mark.parametrize("g_fraction", [0.01, 0.1])
def test_cantilever_converges(refs, g_fraction, figure):
    reference = refs["cantilever"][f"g_fraction_{g_fraction}"]["tip"]
    errors = [abs(bodies.cantilever(n, g_fraction)[1] / reference[1] - 1) for n in (5, 10)]
    figure("error of the tip's fall at 5 elements", errors[0], at_most=0.02)
    figure("error of the tip's fall at 10 elements", errors[1], at_most=0.01)
    assert errors[1] < 0.55 * errors[0]


@pytest.mark.slow
@pytest.mark.parametrize("g_fraction", [0.01, 0.1])
def test_cantilever_at_twenty_elements(refs, g_fraction, figure):
    """The whole tip vector within 1 % of its length."""
    reference = refs["cantilever"][f"g_fraction_{g_fraction}"]["tip"]
    found = bodies.cantilever(20, g_fraction)
    length = (reference[0] ** 2 + reference[1] ** 2) ** 0.5
    figure("tip along x, mm", found[0], reference[0], absolute=0.01 * length)
    figure("tip along z, mm", found[1], reference[1], rel=0.01)


@pytest.mark.parametrize(
    ("n", "most"), [(4, 0.06), (10, 0.012), pytest.param(20, 0.004, marks=pytest.mark.slow)]
)
def test_torsion_of_a_column(n, most, figure):
    """60 degrees, nu 0.49: the physical form is near at any n, the kappa form locks."""
    torque = bodies.twisted_column(n)
    figure(f"torque / mu a^3 at {n} elements", torque, bodies.COLUMN_TORQUE, rel=most)
    error = torque / bodies.COLUMN_TORQUE - 1
    assert error > 0
    kappa = bodies.twisted_column(n, hourglass="joldes") / bodies.COLUMN_TORQUE - 1
    assert kappa > 10 * error
