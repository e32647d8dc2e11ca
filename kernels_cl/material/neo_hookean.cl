/* @law
title = "Neo-Hookean, decoupled"
energy = "W = mu/2 (J^(-2/3) I1 - 3) + U(J)"
source = "Simo & Miehe 1992; Warburton & Maddock 2014, section 5"
caveats = "Fits skin at moderate strain only: it does not stiffen."
stage = 0
rows = 2
history = 0
volumetric = "common"
shear_modulus = "youngs_modulus / (2 * (1 + poissons_ratio))"
bulk_modulus = "youngs_modulus / (3 * (1 - 2 * poissons_ratio))"
row_values = ["mu"]
[parameters.youngs_modulus]
kind = "pressure"
above = 0.0
meaning = "stiffness at small strain"
[parameters.poissons_ratio]
kind = "number"
at_least = 0.0
below = 0.5
meaning = "0.5 is incompressible"
*/
// Voxels take the same law from base.cl, where it is linear in mu and fused; this form serves tests
// of the law interface and voxels that measure what that is worth.
INLINE void neo_hookean_stress(Kinematics k, __global const real* rows, LawState state, Tensor* P) {
  const IsotropicStress s = isochoric_neo_hookean(law_row(rows, 0) * law_row(rows, 1), k);
  add_scaled(P, s.along_F, k.F, s.along_cof, k.cof);
}

INLINE realv neo_hookean_energy(Kinematics k, __global const real* rows, LawState state) {
  return law_row(rows, 0) * law_row(rows, 1) *
         (R(0.5) * (k.cube_root * k.cube_root * k.I1 - R(3.0)));
}
