/* @law
title = "Ogden, up to three terms"
energy = "W = sum mu_p/alpha_p (l1^alpha_p + l2^alpha_p + l3^alpha_p - 3) of the isochoric principal stretches, + U(J)"
source = "Ogden 1972; Holzapfel 2000, eq. 6.139"
caveats = "Each term needs mu_p alpha_p > 0. Costs several times a neo-Hookean voxel (eigenvectors, powers)."
stage = 0
rows = 7
history = 0
volumetric = "common"
shear_modulus = "(mu1 * alpha1 + mu2 * alpha2 + mu3 * alpha3) / 2"
bulk_modulus = "bulk_modulus"
row_values = ["mu1", "alpha1", "mu2", "alpha2", "mu3", "alpha3"]
[parameters.mu1]
kind = "pressure"
meaning = "first term"
[parameters.alpha1]
kind = "number"
meaning = "exponent of the first term, not 0"
[parameters.mu2]
kind = "pressure"
default = 0.0
meaning = "second term"
[parameters.alpha2]
kind = "number"
default = 2.0
meaning = "exponent of the second term, not 0"
[parameters.mu3]
kind = "pressure"
default = 0.0
meaning = "third term"
[parameters.alpha3]
kind = "number"
default = 2.0
meaning = "exponent of the third term, not 0"
[parameters.bulk_modulus]
kind = "pressure"
above = 0.0
meaning = "of U(J)"
*/
// Principal stretches and directions of C by cyclic Jacobi rotations, branch-free for lanes.
typedef struct { realv a, b, c; Tensor directions; } Principal;  // columns: directions

INLINE void jacobi_rotation(realv app, realv aqq, realv apq, realv* cosine, realv* sine, realv* t) {
  const realv d = aqq - app, zero = broadcast(R(0.0));
  const realv root = square_root(d * d + R(4.0) * apq * apq);
  const realv signed_root = d < zero ? -root : root;
  const realv bottom = d + signed_root;
#if TLED_DOUBLE
  const realv tiny = broadcast(R(1e-200));
#else
  const realv tiny = broadcast(R(1e-30));
#endif
  // Equal values and nothing to turn: t = 0. The sum has the sign of d and its size is the root's at least.
  *t = absolute(bottom) > tiny ? R(2.0) * apq / (absolute(bottom) > tiny ? bottom : tiny)
                               : (absolute(apq) > tiny ? broadcast(R(1.0)) : zero);
  *cosine = R(1.0) / square_root(R(1.0) + *t * *t);
  *sine = *t * *cosine;
}

INLINE void turn(realv* p, realv* q, realv cosine, realv sine) {
  const realv a = *p, b = *q;
  *p = cosine * a - sine * b;
  *q = sine * a + cosine * b;
}

INLINE Principal principal_values(Symmetric C) {
  const realv one = broadcast(R(1.0)), zero = broadcast(R(0.0));
  Tensor V = {one, zero, zero, zero, one, zero, zero, zero, one};
#if TLED_DOUBLE
  const int sweeps = 6;
#else
  const int sweeps = 4;
#endif
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    realv c, s, t;
    jacobi_rotation(C.xx, C.yy, C.xy, &c, &s, &t);
    C.xx -= t * C.xy;
    C.yy += t * C.xy;
    C.xy = zero;
    turn(&C.xz, &C.yz, c, s);
    turn(&V.xx, &V.xy, c, s);
    turn(&V.yx, &V.yy, c, s);
    turn(&V.zx, &V.zy, c, s);
    jacobi_rotation(C.xx, C.zz, C.xz, &c, &s, &t);
    C.xx -= t * C.xz;
    C.zz += t * C.xz;
    C.xz = zero;
    turn(&C.xy, &C.yz, c, s);
    turn(&V.xx, &V.xz, c, s);
    turn(&V.yx, &V.yz, c, s);
    turn(&V.zx, &V.zz, c, s);
    jacobi_rotation(C.yy, C.zz, C.yz, &c, &s, &t);
    C.yy -= t * C.yz;
    C.zz += t * C.yz;
    C.yz = zero;
    turn(&C.xy, &C.xz, c, s);
    turn(&V.xy, &V.xz, c, s);
    turn(&V.yy, &V.yz, c, s);
    turn(&V.zy, &V.zz, c, s);
  }
  Principal p;
  p.a = C.xx;
  p.b = C.yy;
  p.c = C.zz;
  p.directions = V;
  return p;
}

// x^exponent for x > 0.
INLINE realv power(realv x, realv exponent) { return natural_exp(exponent * natural_log(x)); }

// beta_a = l_a dW/dl_a less the mean of the three: S = sum beta_a / l_a^2 N_a (x) N_a.
INLINE void ogden_stress(Kinematics k, __global const real* rows, LawState state, Tensor* P) {
  const Principal p = principal_values(right_cauchy_green(k.F));
  const realv iso = k.cube_root * k.cube_root, one_half = broadcast(R(0.5));
  const realv la = p.a * iso, lb = p.b * iso, lc = p.c * iso;  // squared isochoric stretches
  realv sa = broadcast(R(0.0)), sb = sa, sc = sa;
  for (int term = 0; term < 3; ++term) {
    const realv mu = law_row(rows, 1 + 2 * term), exponent = one_half * law_row(rows, 2 + 2 * term);
    const realv a = power(la, exponent), b = power(lb, exponent), c = power(lc, exponent);
    const realv mean = (a + b + c) * R(1.0 / 3.0);
    sa += mu * (a - mean);
    sb += mu * (b - mean);
    sc += mu * (c - mean);
  }
  const realv w = law_row(rows, 0);
  const Tensor V = p.directions;
  sa *= w / p.a;
  sb *= w / p.b;
  sc *= w / p.c;
  Symmetric S;
  S.xx = sa * V.xx * V.xx + sb * V.xy * V.xy + sc * V.xz * V.xz;
  S.yy = sa * V.yx * V.yx + sb * V.yy * V.yy + sc * V.yz * V.yz;
  S.zz = sa * V.zx * V.zx + sb * V.zy * V.zy + sc * V.zz * V.zz;
  S.xy = sa * V.xx * V.yx + sb * V.xy * V.yy + sc * V.xz * V.yz;
  S.yz = sa * V.yx * V.zx + sb * V.yy * V.zy + sc * V.yz * V.zz;
  S.xz = sa * V.xx * V.zx + sb * V.xy * V.zy + sc * V.xz * V.zz;
  add_tensor(P, broadcast(R(1.0)), times_symmetric(k.F, S));
}

INLINE realv ogden_energy(Kinematics k, __global const real* rows, LawState state) {
  const Principal p = principal_values(right_cauchy_green(k.F));
  const realv iso = k.cube_root * k.cube_root, one_half = broadcast(R(0.5));
  realv W = broadcast(R(0.0));
  for (int term = 0; term < 3; ++term) {
    const realv alpha = law_row(rows, 2 + 2 * term), exponent = one_half * alpha;
    const realv nonzero = absolute(alpha) > R(0.0) ? alpha : broadcast(R(1.0));
    W += law_row(rows, 1 + 2 * term) / nonzero *
         (power(p.a * iso, exponent) + power(p.b * iso, exponent) + power(p.c * iso, exponent) -
          R(3.0));
  }
  return law_row(rows, 0) * W;
}
