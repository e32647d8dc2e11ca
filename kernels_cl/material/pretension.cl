/* @law
title = "Natural tension of skin"
energy = "W = S0 : E, S0 = along d (x) d + across (I - d (x) d - n (x) n)"
source = "Warburton & Maddock 2014, section 7.3; Flynn & McCormack 2008 for natural tension"
caveats = "A dead second Piola-Kirchhoff stress: it does not relax when the tissue shortens. Given as pretension = { along, across } with any material, with its line and normal."
stage = 0
rows = 9
history = 0
vectors = [3, 6]
volumetric = "none"
modifier = "pretension"
row_values = ["along", "across", "line.x", "line.y", "line.z", "normal.x", "normal.y", "normal.z"]
*/
// S0 E = along d.Ed + across (tr E - d.Ed - n.En).
INLINE Symmetric pretension_tensor(__global const real* rows) {
  const realv w = law_row(rows, 0), across = w * law_row(rows, 2);
  const realv along = w * law_row(rows, 1) - across;
  const realv dx = law_row(rows, 3), dy = law_row(rows, 4), dz = law_row(rows, 5);
  const realv nx = law_row(rows, 6), ny = law_row(rows, 7), nz = law_row(rows, 8);
  Symmetric S;
  S.xx = along * dx * dx + across * (R(1.0) - nx * nx);
  S.yy = along * dy * dy + across * (R(1.0) - ny * ny);
  S.zz = along * dz * dz + across * (R(1.0) - nz * nz);
  S.xy = along * dx * dy - across * nx * ny;
  S.yz = along * dy * dz - across * ny * nz;
  S.xz = along * dx * dz - across * nx * nz;
  return S;
}

INLINE void pretension_stress(Kinematics k, __global const real* rows, LawState state, Tensor* P) {
  add_tensor(P, broadcast(R(1.0)), times_symmetric(k.F, pretension_tensor(rows)));
}

INLINE realv pretension_energy(Kinematics k, __global const real* rows, LawState state) {
  const Symmetric S = pretension_tensor(rows), C = right_cauchy_green(k.F);
  return R(0.5) * (S.xx * (C.xx - R(1.0)) + S.yy * (C.yy - R(1.0)) + S.zz * (C.zz - R(1.0))) +
         S.xy * C.xy + S.yz * C.yz + S.xz * C.xz;
}
