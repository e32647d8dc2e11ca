// Neo-Hookean, decoupled: W = mu/2 (J^(-2/3) I1 - 3) + U(J), I1 = tr F^T F, with
// U = K/4 (J^2 - 1 - 2 ln J) and/or U = K/2 (J - 1)^2 (Simo & Miehe 1992; Bonet & Wood 2008).
// P = mu J^(-2/3) (F - I1/3 F^-T) + J U'(J) F^-T, given as P = along_F F + along_cof cof F.
typedef struct { realv along_F, along_cof; } IsotropicStress;

INLINE IsotropicStress neo_hookean_stress(__global const real* parameters, realv J,
                                                 realv inverse_J, realv cube_root_J, realv I1) {
  const realv mu = load_lanes(parameters + MATERIAL_MU * TLED_LANES);
  const realv bulk_log_half = load_lanes(parameters + MATERIAL_BULK_LOG_HALF * TLED_LANES);
  const realv bulk_quadratic = load_lanes(parameters + MATERIAL_BULK_QUADRATIC * TLED_LANES);
  IsotropicStress s;
  s.along_F = mu * cube_root_J * cube_root_J;
  s.along_cof = bulk_log_half * (J - inverse_J) + bulk_quadratic * (J - R(1.0)) -
                s.along_F * (I1 * inverse_J * R(1.0 / 3.0));
  return s;
}

INLINE realv neo_hookean_energy(__global const real* parameters, realv J, realv cube_root_J,
                                       realv I1) {
  const realv mu = load_lanes(parameters + MATERIAL_MU * TLED_LANES);
  const realv bulk_log_half = load_lanes(parameters + MATERIAL_BULK_LOG_HALF * TLED_LANES);
  const realv bulk_quadratic = load_lanes(parameters + MATERIAL_BULK_QUADRATIC * TLED_LANES);
  return R(0.5) * mu * (cube_root_J * cube_root_J * I1 - R(3.0)) +
         R(0.5) * bulk_log_half * (J * J - R(1.0) - R(2.0) * natural_log(J)) +
         R(0.5) * bulk_quadratic * (J - R(1.0)) * (J - R(1.0));
}
