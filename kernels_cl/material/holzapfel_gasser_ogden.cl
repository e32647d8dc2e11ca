/* @law
title = "Holzapfel-Gasser-Ogden, one or two fibre families"
energy = "W = mu/2 (I1_iso - 3) + sum k1/(2 k2) (exp(k2 E^2) - 1), E = dispersion (I1_iso - 3) + (1 - 3 dispersion) (I4_iso - 1) where positive, + U(J)"
source = "Gasser, Ogden & Holzapfel 2006, eq. 4.6-4.9"
caveats = "Fibres carry tension only (E > 0). Langer lines: one family along the lines, or two at +- angle to them. The exponential sets the time step at large stretch."
stage = 0
rows = 11
history = 0
vectors = [5, 8]
volumetric = "common"
shear_modulus = "mu"
bulk_modulus = "bulk_modulus"
fibre_modulus = "4 * k1 * (1 - 2 * dispersion)**2"
row_values = ["mu", "k1", "k2", "dispersion", "first.x", "first.y", "first.z", "second.x", "second.y", "second.z"]
[parameters.mu]
kind = "pressure"
above = 0.0
meaning = "shear modulus of the ground substance"
[parameters.k1]
kind = "pressure"
at_least = 0.0
meaning = "stiffness of the fibres"
[parameters.k2]
kind = "number"
above = 0.0
meaning = "how fast they stiffen"
[parameters.dispersion]
kind = "number"
at_least = 0.0
below = 0.3334
default = 0.0
meaning = "0: fibres parallel, 1/3: isotropic"
[parameters.bulk_modulus]
kind = "pressure"
above = 0.0
meaning = "of U(J)"
[directions.first]
meaning = "first family"
[directions.second]
optional = true
meaning = "second family; left out: none"
*/
// A fibre family: its direction d, F d, and the strain E that its energy is of, 0 where the family
// is pressed or absent (direction 0).
typedef struct { realv dx, dy, dz, vx, vy, vz, I4, E; } Family;

INLINE Family fibre_family(Kinematics k, __global const real* rows, int first) {
  const realv zero = broadcast(R(0.0)), spread = law_row(rows, 4);
  const realv iso = k.cube_root * k.cube_root;
  Family f;
  f.dx = law_row(rows, first);
  f.dy = law_row(rows, first + 1);
  f.dz = law_row(rows, first + 2);
  f.vx = k.F.xx * f.dx + k.F.xy * f.dy + k.F.xz * f.dz;
  f.vy = k.F.yx * f.dx + k.F.yy * f.dy + k.F.yz * f.dz;
  f.vz = k.F.zx * f.dx + k.F.zy * f.dy + k.F.zz * f.dz;
  f.I4 = f.vx * f.vx + f.vy * f.vy + f.vz * f.vz;
  f.E = spread * (iso * k.I1 - R(3.0)) + (R(1.0) - R(3.0) * spread) * (iso * f.I4 - R(1.0));
  f.E = f.E > R(0.0) ? f.E : zero;
  f.E = f.I4 > R(0.0) ? f.E : zero;
  return f;
}

// S of a family: 2 k1 E exp(k2 E^2) J^(-2/3) [dispersion (I - I1/3 C^-1) + (1 - 3 dispersion)
// (d (x) d - I4/3 C^-1)].
INLINE void add_family(Kinematics k, __global const real* rows, int first, Tensor* P) {
  const Family f = fibre_family(k, rows, first);
  const realv spread = law_row(rows, 4), along = R(1.0) - R(3.0) * spread;
  const realv slope = R(2.0) * law_row(rows, 0) * law_row(rows, 2) * f.E *
                      natural_exp(law_row(rows, 3) * f.E * f.E) * k.cube_root * k.cube_root;
  add_scaled(P, slope * spread, k.F,
             slope * (spread * k.I1 + along * f.I4) * (k.inverse_J * R(-1.0 / 3.0)), k.cof);
  const realv s = slope * along;
  P->xx += s * f.vx * f.dx;
  P->xy += s * f.vx * f.dy;
  P->xz += s * f.vx * f.dz;
  P->yx += s * f.vy * f.dx;
  P->yy += s * f.vy * f.dy;
  P->yz += s * f.vy * f.dz;
  P->zx += s * f.vz * f.dx;
  P->zy += s * f.vz * f.dy;
  P->zz += s * f.vz * f.dz;
}

INLINE realv family_energy(Kinematics k, __global const real* rows, int first) {
  const Family f = fibre_family(k, rows, first);
  const realv k2 = law_row(rows, 3);
  const realv safe = k2 > R(0.0) ? k2 : broadcast(R(1.0));
  return R(0.5) * law_row(rows, 2) / safe * (natural_exp(k2 * f.E * f.E) - R(1.0));
}

INLINE void holzapfel_gasser_ogden_stress(Kinematics k, __global const real* rows, LawState state,
                                          Tensor* P) {
  const IsotropicStress s = isochoric_neo_hookean(law_row(rows, 0) * law_row(rows, 1), k);
  add_scaled(P, s.along_F, k.F, s.along_cof, k.cof);
  add_family(k, rows, 5, P);
  add_family(k, rows, 8, P);
}

INLINE realv holzapfel_gasser_ogden_energy(Kinematics k, __global const real* rows,
                                           LawState state) {
  return law_row(rows, 0) *
         (R(0.5) * law_row(rows, 1) * (k.cube_root * k.cube_root * k.I1 - R(3.0)) +
          family_energy(k, rows, 5) + family_energy(k, rows, 8));
}
