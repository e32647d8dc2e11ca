/* @law
title = "Neo-Hookean, coupled"
energy = "W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2"
source = "Bonet & Wood 2008, eq. 6.27"
caveats = "Shear and volume change are coupled: the stress of an isochoric stretch has a pressure part."
stage = 0
rows = 3
history = 0
volumetric = "own"
shear_modulus = "youngs_modulus / (2 * (1 + poissons_ratio))"
bulk_modulus = "youngs_modulus / (3 * (1 - 2 * poissons_ratio))"
row_values = ["mu", "bulk - 2 * mu / 3"]
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
// P = mu (F - F^-T) + lambda ln J F^-T.
INLINE void neo_hookean_coupled_stress(Kinematics k, __global const real* rows, LawState state,
                                       Tensor* P) {
  const realv w = law_row(rows, 0), mu = law_row(rows, 1), lmbda = law_row(rows, 2);
  add_scaled(P, w * mu, k.F, w * (lmbda * natural_log(k.J) - mu) * k.inverse_J, k.cof);
}

INLINE realv neo_hookean_coupled_energy(Kinematics k, __global const real* rows, LawState state) {
  const realv mu = law_row(rows, 1), lmbda = law_row(rows, 2), log_J = natural_log(k.J);
  return law_row(rows, 0) *
         (R(0.5) * mu * (k.I1 - R(3.0)) - mu * log_J + R(0.5) * lmbda * log_J * log_J);
}
