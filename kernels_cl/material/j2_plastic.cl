/* @law
title = "Neo-Hookean with J2 plasticity and a yield stress that may fall"
energy = "W = mu/2 (tr b_e_iso - 3) + U(J); |dev tau| <= sqrt(2/3) sigma_y(t)"
source = "Simo 1988, multiplicative J2 flow with radial return; Simo & Hughes 1998, box 9.1"
caveats = "Ageing lines: sigma_y falls from yield_stress to yield_stress_end between fall_begin and fall_end; no hardening."
stage = 0
rows = 6
history = 6
volumetric = "common"
shear_modulus = "mu"
bulk_modulus = "bulk_modulus"
row_values = ["mu", "yield_stress", "yield_stress_end", "fall_begin", "fall_end"]
[parameters.mu]
kind = "pressure"
above = 0.0
meaning = "shear modulus"
[parameters.bulk_modulus]
kind = "pressure"
above = 0.0
meaning = "of U(J)"
[parameters.yield_stress]
kind = "pressure"
above = 0.0
meaning = "uniaxial Kirchhoff stress at which flow begins"
[parameters.yield_stress_end]
kind = "pressure"
above = 0.0
default = "yield_stress"
meaning = "the same after the fall"
[parameters.fall_begin]
kind = "time"
default = 0.0
meaning = "begin of the fall"
[parameters.fall_end]
kind = "time"
default = 1.0
meaning = "end of the fall"
*/
// History: inverse plastic right Cauchy-Green tensor less the identity, 6 rows.
INLINE Symmetric plastic_inverse(LawState state) {
  Symmetric G;
  G.xx = R(1.0) + load_lanes(state.before);
  G.yy = R(1.0) + load_lanes(state.before + TLED_LANES);
  G.zz = R(1.0) + load_lanes(state.before + 2 * TLED_LANES);
  G.xy = load_lanes(state.before + 3 * TLED_LANES);
  G.yz = load_lanes(state.before + 4 * TLED_LANES);
  G.xz = load_lanes(state.before + 5 * TLED_LANES);
  return G;
}

// A G A^T for symmetric G.
INLINE Symmetric congruence(Tensor A, Symmetric G) {
  const Tensor T = times_symmetric(A, G);
  Symmetric B;
  B.xx = T.xx * A.xx + T.xy * A.xy + T.xz * A.xz;
  B.yy = T.yx * A.yx + T.yy * A.yy + T.yz * A.yz;
  B.zz = T.zx * A.zx + T.zy * A.zy + T.zz * A.zz;
  B.xy = T.xx * A.yx + T.xy * A.yy + T.xz * A.yz;
  B.yz = T.yx * A.zx + T.yy * A.zy + T.yz * A.zz;
  B.xz = T.xx * A.zx + T.xy * A.zy + T.xz * A.zz;
  return B;
}

INLINE void j2_plastic_stress(Kinematics k, __global const real* rows, LawState state, Tensor* P) {
  const realv mu = law_row(rows, 1), zero = broadcast(R(0.0)), one = broadcast(R(1.0));
  const realv iso = k.cube_root * k.cube_root;
  const Symmetric b = congruence(k.F, plastic_inverse(state));
  const realv mean = (b.xx + b.yy + b.zz) * R(1.0 / 3.0);
  Symmetric s;  // trial dev tau / mu
  s.xx = iso * (b.xx - mean);
  s.yy = iso * (b.yy - mean);
  s.zz = iso * (b.zz - mean);
  s.xy = iso * b.xy;
  s.yz = iso * b.yz;
  s.xz = iso * b.xz;
  const realv norm = mu * square_root(s.xx * s.xx + s.yy * s.yy + s.zz * s.zz +
                                      R(2.0) * (s.xy * s.xy + s.yz * s.yz + s.xz * s.xz));
  const realv begin = law_row(rows, 4), span = law_row(rows, 5) - begin;
  realv share = (state.time - begin) / (span > R(0.0) ? span : one);
  share = share > R(0.0) ? (share < R(1.0) ? share : one) : zero;
  const realv yield = R(0.816496580927726) *
                      (law_row(rows, 2) + share * (law_row(rows, 3) - law_row(rows, 2)));
  const realv limit = state.dt < R(0.0) ? broadcast(R(1e30)) : yield;
  const realv keep = norm > limit ? limit / norm : one;
  s.xx *= keep;
  s.yy *= keep;
  s.zz *= keep;
  s.xy *= keep;
  s.yz *= keep;
  s.xz *= keep;
  // P = dev tau F^-T = dev tau cof F / J.
  add_tensor(P, law_row(rows, 0) * mu * k.inverse_J, times_symmetric_left(s, k.cof));
  if (state.store) {
    // b_e = (s + mean trace) / iso, pulled back: F^-1 b_e F^-T, F^-1 = cof F^T / J.
    const realv back = one / iso, spherical = mean;
    s.xx = s.xx * back + spherical;
    s.yy = s.yy * back + spherical;
    s.zz = s.zz * back + spherical;
    s.xy *= back;
    s.yz *= back;
    s.xz *= back;
    Tensor inverse;
    inverse.xx = k.cof.xx * k.inverse_J;
    inverse.xy = k.cof.yx * k.inverse_J;
    inverse.xz = k.cof.zx * k.inverse_J;
    inverse.yx = k.cof.xy * k.inverse_J;
    inverse.yy = k.cof.yy * k.inverse_J;
    inverse.yz = k.cof.zy * k.inverse_J;
    inverse.zx = k.cof.xz * k.inverse_J;
    inverse.zy = k.cof.yz * k.inverse_J;
    inverse.zz = k.cof.zz * k.inverse_J;
    const Symmetric G = congruence(inverse, s);
    // Only flow changes the history: round-off of elastic steps would add up.
    const Symmetric old = plastic_inverse(state);
    store_lanes((norm > limit ? G.xx : old.xx) - R(1.0), state.after);
    store_lanes((norm > limit ? G.yy : old.yy) - R(1.0), state.after + TLED_LANES);
    store_lanes((norm > limit ? G.zz : old.zz) - R(1.0), state.after + 2 * TLED_LANES);
    store_lanes(norm > limit ? G.xy : old.xy, state.after + 3 * TLED_LANES);
    store_lanes(norm > limit ? G.yz : old.yz, state.after + 4 * TLED_LANES);
    store_lanes(norm > limit ? G.xz : old.xz, state.after + 5 * TLED_LANES);
  }
}

INLINE realv j2_plastic_energy(Kinematics k, __global const real* rows, LawState state) {
  const Symmetric b = congruence(k.F, plastic_inverse(state));
  return law_row(rows, 0) *
         (R(0.5) * law_row(rows, 1) * (k.cube_root * k.cube_root * (b.xx + b.yy + b.zz) - R(3.0)));
}
