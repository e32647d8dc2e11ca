/* @law
title = "Viscoelasticity: Prony series of up to three terms on the isochoric stress"
energy = "S(t) = (1 - sum g) S0(t) + sum H_p, dH_p/dt + H_p/tau_p = g_p dS0/dt, S0 the isochoric stress of the other laws"
source = "Simo & Hughes 1998, section 10.3; Taylor et al. 2009 for explicit dynamics"
caveats = "The other laws' moduli are the instantaneous ones. Given as prony = [[g, tau], ...] with any material whose volumetric part is separate. It acts on the second Piola-Kirchhoff stress: in tissue far from incompressible (nu 0.3 or less) held at a stretch of 1.8 it was seen to feed waves slowly instead of damping them, at any time step."
stage = 1
rows = 7
history = 24
modifier = "prony"
row_values = ["g1", "tau1", "g2", "tau2", "g3", "tau3"]
*/
// History: isochoric S0 of the last step (6 rows), then H of each term (6 rows each).
// H+ = e^(-dt/tau) H + g e^(-dt/(2 tau)) (S0+ - S0): second order in dt, exact for a step in strain.
INLINE realv prony_term(realv g, realv decay, realv half_decay, realv change, realv now,
                        LawState state, int row) {
  const realv H = load_lanes(state.before + row * TLED_LANES) * decay + g * half_decay * change;
  if (state.store) store_lanes(H, state.after + row * TLED_LANES);
  return H - g * now;
}

INLINE realv prony_component(__global const real* rows, realv now, LawState state, int component) {
  const realv change = now - load_lanes(state.before + component * TLED_LANES);
  if (state.store) store_lanes(now, state.after + component * TLED_LANES);
  realv extra = broadcast(R(0.0));
  for (int term = 0; term < 3; ++term) {
    const realv g = law_row(rows, 1 + 2 * term), tau = law_row(rows, 2 + 2 * term);
    const realv safe = tau > R(0.0) ? tau : broadcast(R(1.0));
    const realv half_decay = natural_exp(R(-0.5) * state.dt / safe);
    extra += prony_term(g, half_decay * half_decay, half_decay, change, now, state,
                        6 + 6 * term + component);
  }
  return extra;
}

INLINE void prony_stress(Kinematics k, __global const real* rows, LawState state, Tensor* P) {
  const Symmetric S = second_piola_kirchhoff(k.cof, k.inverse_J, *P);
  Symmetric extra;
  extra.xx = prony_component(rows, S.xx, state, 0);
  extra.yy = prony_component(rows, S.yy, state, 1);
  extra.zz = prony_component(rows, S.zz, state, 2);
  extra.xy = prony_component(rows, S.xy, state, 3);
  extra.yz = prony_component(rows, S.yz, state, 4);
  extra.xz = prony_component(rows, S.xz, state, 5);
  add_tensor(P, law_row(rows, 0), times_symmetric(k.F, extra));
}

// The stored part of a relaxing material's energy has no closed form here: counted as 0.
INLINE realv prony_energy(Kinematics k, __global const real* rows, LawState state) {
  return broadcast(R(0.0));
}
