"""Wrinkling of a stiff film on a soft half-space: exact onset, incompressible neo-Hookean.

Plane strain, stretch lambda along the film (x), 1/lambda across it (z), free upper face. M. A.
Biot, "Surface instability of rubber in compression", Appl. Sci. Res. A 12, 168-182 (1963), gives
the incremental equations of such a body; here they are written in the reference frame. With
W = mu/2 (I1 - 3), P = mu F - p F^-T and p = mu / lambda^2 from the free upper face, an increment
u(X), q (of p) obeys

    mu lap(u) = F^-T grad(q),    div(F^-1 u) = 0,

so that q is harmonic in the deformed coordinates. Waves cos(K X) of u_z = U(Z) have, with s in
{+-1, +-lambda^-2}, U = exp(s K Z); u_x = -sin(K X) lambda^2 U' / K (incompressibility) and

    q = mu (s^2 - 1) K^2 U / (lambda s K) cos(K X),

which is zero for s = +-1. The traction increments on Z = const are

    P_xz: mu u_x,z + p u_z,x         (the in-plane F has determinant 1)
    P_zz: mu u_z,z - lambda q + p lambda^2 u_z,z

The film has four such waves, the half-space below it the two that decay. Free top and continuity
at the interface make six equations; the first lambda < 1 at which their determinant vanishes for
some K is the onset.
"""

import numpy as np


def wave(s, stretch, mu, depth):
    """Column (u_x, u_z, P_xz, P_zz) of the wave exp(s K Z) at K Z = ``depth``; K = 1."""
    p = mu / stretch**2
    grown = np.exp(s * depth)
    u_z = 1.0
    u_x = -(stretch**2) * s
    q = mu * (s * s - 1.0) / (stretch * s)
    shear = mu * u_x * s - p * u_z
    normal = (mu + p * stretch**2) * s * u_z - stretch * q
    return grown * np.array([u_x, u_z, shear, normal])


def determinant(stretch, thickness, ratio):
    """Determinant of the six conditions; ``thickness`` is K t, ``ratio`` mu_film / mu_substrate.

    At zero strain the roots +-1 and +-lambda^-2 become one; their waves enter as one of them and
    the slope of the chord between them, which stay apart.
    """
    rho = stretch**-2
    equations = np.zeros((6, 6))
    for column, sign in ((0, 1.0), (2, -1.0)):
        for at, rows in ((0.0, slice(0, 2)), (-thickness, slice(2, 6))):
            one, other = (wave(sign * s, stretch, ratio, at) for s in (1.0, rho))
            pair = np.stack([one, (other - one) / (rho - 1.0)], axis=1)
            equations[rows, column : column + 2] = pair[2:] if at == 0.0 else pair
    one, other = (wave(s, stretch, 1.0, 0.0) for s in (1.0, rho))
    equations[2:, 4:] = -np.stack([one, (other - one) / (rho - 1.0)], axis=1)
    # Scales that keep the signs: exponentials of the film, moduli of the rows.
    equations /= abs(equations).max(axis=0)
    equations /= abs(equations).max(axis=1)[:, None]
    return np.linalg.det(equations)


def strain_at(thickness, ratio, highest=0.45):
    """Least nominal shortening at which waves of this K t are neutral; inf beyond ``highest``."""
    strains = np.geomspace(1e-3, highest, 240)
    values = np.array([determinant(1.0 - e, thickness, ratio) for e in strains])
    turns = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
    if not len(turns):
        return np.inf
    low, high = strains[turns[0]], strains[turns[0] + 1]
    sign = np.sign(values[turns[0]])
    for _ in range(60):
        middle = (low + high) / 2
        same = np.sign(determinant(1.0 - middle, thickness, ratio)) == sign
        low, high = (middle, high) if same else (low, middle)
    return (low + high) / 2


def onset(ratio):
    """(reference wavelength over film thickness, nominal shortening) at the onset of wrinkles."""
    guess = (3.0 / ratio) ** (1.0 / 3.0)  # K t of the thin-film formula
    low, high = 0.4 * guess, 1.6 * guess
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    a, b = high - golden * (high - low), low + golden * (high - low)
    at_a, at_b = strain_at(a, ratio), strain_at(b, ratio)
    while high - low > 1e-6 * high:
        if at_a < at_b:
            high, b, at_b = b, a, at_a
            a = high - golden * (high - low)
            at_a = strain_at(a, ratio)
        else:
            low, a, at_a = a, b, at_b
            b = low + golden * (high - low)
            at_b = strain_at(b, ratio)
    best = (low + high) / 2
    return 2.0 * np.pi / best, strain_at(best, ratio)


def thin_film_wavelength(ratio):
    """The common asymptotic formula: wavelength over thickness, 2 pi (E_f / 3 E_s)^(1/3)."""
    return 2.0 * np.pi * (ratio / 3.0) ** (1.0 / 3.0)
