// The part that every element has: volumetric stress, and neo-Hookean shear where a voxel's tissues
// use that law (mu 0 else). W = mu/2 (J^(-2/3) I1 - 3) + U(J), with U = K/4 (J^2 - 1 - 2 ln J)
// and/or U = K/2 (J - 1)^2 (Simo & Miehe 1992; Bonet & Wood 2008); linear in its parameters, so
// a mix of tissues is one set of means and costs no loop. P = along_F F + along_cof cof F.
typedef struct { realv along_F, along_cof; } IsotropicStress;

INLINE IsotropicStress isochoric_neo_hookean(realv mu, Kinematics k) {
  IsotropicStress s;
  s.along_F = mu * k.cube_root * k.cube_root;
  s.along_cof = s.along_F * (k.I1 * k.inverse_J * R(-1.0 / 3.0));
  return s;
}

// Pa.
typedef struct { realv mu, bulk_log_half, bulk_quadratic; } BaseModuli;

INLINE BaseModuli base_moduli(__global const real* parameters) {
  BaseModuli m;
  m.mu = load_lanes(parameters + MATERIAL_MU * TLED_LANES);
  m.bulk_log_half = load_lanes(parameters + MATERIAL_BULK_LOG_HALF * TLED_LANES);
  m.bulk_quadratic = load_lanes(parameters + MATERIAL_BULK_QUADRATIC * TLED_LANES);
  return m;
}

// dU/dJ, Pa.
INLINE realv volumetric_stress(BaseModuli m, Kinematics k) {
  return m.bulk_log_half * (k.J - k.inverse_J) + m.bulk_quadratic * (k.J - R(1.0));
}

INLINE realv base_energy(__global const real* parameters, Kinematics k) {
  const realv mu = load_lanes(parameters + MATERIAL_MU * TLED_LANES);
  const realv bulk_log_half = load_lanes(parameters + MATERIAL_BULK_LOG_HALF * TLED_LANES);
  const realv bulk_quadratic = load_lanes(parameters + MATERIAL_BULK_QUADRATIC * TLED_LANES);
  return R(0.5) * mu * (k.cube_root * k.cube_root * k.I1 - R(3.0)) +
         R(0.5) * bulk_log_half * (k.J * k.J - R(1.0) - R(2.0) * natural_log(k.J)) +
         R(0.5) * bulk_quadratic * (k.J - R(1.0)) * (k.J - R(1.0));
}
