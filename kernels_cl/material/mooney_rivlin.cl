/* @law
title = "Mooney-Rivlin, five terms"
energy = "W = sum c_ij (I1_iso - 3)^i (I2_iso - 3)^j over 10, 01, 11, 20, 30, + U(J)"
source = "Hung et al. 2009, eq. 2; Rivlin & Saunders 1951"
caveats = "Hung's exact incompressibility is replaced by a bulk modulus: check that the answer does not move when it doubles. Negative terms can make the law unstable at large strain."
stage = 0
rows = 6
history = 0
volumetric = "common"
shear_modulus = "2 * (c10 + c01)"
bulk_modulus = "bulk_modulus"
row_values = ["c10", "c01", "c11", "c20", "c30"]
[parameters.c10]
kind = "pressure"
above = 0.0
meaning = "of I1 - 3"
[parameters.c01]
kind = "pressure"
at_least = 0.0
default = 0.0
meaning = "of I2 - 3"
[parameters.c11]
kind = "pressure"
default = 0.0
meaning = "of (I1 - 3) (I2 - 3)"
[parameters.c20]
kind = "pressure"
default = 0.0
meaning = "of (I1 - 3)^2"
[parameters.c30]
kind = "pressure"
default = 0.0
meaning = "of (I1 - 3)^3"
[parameters.bulk_modulus]
kind = "pressure"
above = 0.0
meaning = "of U(J)"
*/
// S = 2 W1 J^(-2/3) (I - I1/3 C^-1) + 2 W2 J^(-4/3) (I1 I - C - 2 I2/3 C^-1), P = F S.
INLINE void mooney_rivlin_stress(Kinematics k, __global const real* rows, LawState state,
                                 Tensor* P) {
  const realv w = law_row(rows, 0), c11 = law_row(rows, 3);
  const realv a = k.cube_root * k.cube_root, b = a * a;
  const Symmetric C = right_cauchy_green(k.F);
  const realv I2 = second_invariant(C);
  const realv e1 = a * k.I1 - R(3.0), e2 = b * I2 - R(3.0);
  const realv W1 = R(2.0) * w * a * (law_row(rows, 1) + c11 * e2 +
                   e1 * (R(2.0) * law_row(rows, 4) + R(3.0) * law_row(rows, 5) * e1));
  const realv W2 = R(2.0) * w * b * (law_row(rows, 2) + c11 * e1);
  add_scaled(P, W1 + W2 * k.I1, k.F,
             (W1 * k.I1 + R(2.0) * W2 * I2) * (k.inverse_J * R(-1.0 / 3.0)), k.cof);
  add_tensor(P, -W2, times_symmetric(k.F, C));
}

INLINE realv mooney_rivlin_energy(Kinematics k, __global const real* rows, LawState state) {
  const realv a = k.cube_root * k.cube_root;
  const Symmetric C = right_cauchy_green(k.F);
  const realv I2 = second_invariant(C);
  const realv e1 = a * k.I1 - R(3.0), e2 = a * a * I2 - R(3.0);
  return law_row(rows, 0) * (law_row(rows, 1) * e1 + law_row(rows, 2) * e2 + law_row(rows, 3) * e1 * e2 +
                             law_row(rows, 4) * e1 * e1 + law_row(rows, 5) * e1 * e1 * e1);
}
