// Hourglass forces of a box from its Walsh-Hadamard modes (docs/explanation/hourglass.md).
// Physical form: q = F^-1 s in each mode; the energy is that of the bending and twisting of a box
// of linear elasticity, so the one-point element has the exact bending stiffness without a tunable
// constant. kappa form: k s (Joldes, Wittek & Miller 2008; Warburton & Maddock 2014, eq. 6-7).

// The four hourglass modes; each a vector over components.
typedef struct { Vec xy, yz, zx, xyz; } Hourglass;

INLINE Vec scaled_sum(Vec a, realv p, Vec b, realv q, Vec c, realv r) {
  Vec v;
  v.x = a.x * p + b.x * q + c.x * r;
  v.y = a.y * p + b.y * q + c.y * r;
  v.z = a.z * p + b.z * q + c.z * r;
  return v;
}

INLINE Vec pulled_back(Vec inverse_x, Vec inverse_y, Vec inverse_z, Vec s) {
  Vec q;
  q.x = dot_product(inverse_x, s);
  q.y = dot_product(inverse_y, s);
  q.z = dot_product(inverse_z, s);
  return q;
}

INLINE void subtract_product(Tensor* P, Vec f, Vec q) {
  P->xx -= f.x * q.x;
  P->xy -= f.x * q.y;
  P->xz -= f.x * q.z;
  P->yx -= f.y * q.x;
  P->yy -= f.y * q.y;
  P->yz -= f.y * q.z;
  P->zx -= f.z * q.x;
  P->zy -= f.z * q.y;
  P->zz -= f.z * q.z;
}

// h_x/h_y and so on, of the element's box.
typedef struct { realv xy, yx, yz, zy, zx, xz; } BoxRatios;

// What the hourglass modes of a box are worth: MATERIAL_NU and on.
typedef struct { realv nu, bend_x, bend_y, bend_z, twist, odd; } BoxModuli;

INLINE BoxModuli box_moduli(__global const real* parameters) {
  BoxModuli m;
  m.nu = load_lanes(parameters + MATERIAL_NU * TLED_LANES);
  m.bend_x = load_lanes(parameters + MATERIAL_BEND_X * TLED_LANES);
  m.bend_y = load_lanes(parameters + MATERIAL_BEND_Y * TLED_LANES);
  m.bend_z = load_lanes(parameters + MATERIAL_BEND_Z * TLED_LANES);
  m.twist = load_lanes(parameters + MATERIAL_TWIST * TLED_LANES);
  m.odd = load_lanes(parameters + MATERIAL_XYZ * TLED_LANES);
  return m;
}

// dW/dq of a box (N m over m): what its pulled-back modes q are worth. q is along the box's axes d
// over 4 h_d, hence the factor 16 in the coefficients.
INLINE Hourglass hourglass_moments(BoxModuli m, BoxRatios ratio, Hourglass q) {
  const realv nu = m.nu, bend_x = m.bend_x, bend_y = m.bend_y, bend_z = m.bend_z, twist = m.twist,
              odd = m.odd;
  const realv xy = ratio.xy, yx = ratio.yx, yz = ratio.yz, zy = ratio.zy, zx = ratio.zx,
              xz = ratio.xz;

  const realv twist_z = twist * (xy * q.yz.x + yx * q.zx.y);
  const realv twist_x = twist * (yz * q.zx.y + zy * q.xy.z);
  const realv twist_y = twist * (xz * q.yz.x + zx * q.xy.z);

  Hourglass g;
  g.xy.x = bend_y * (q.xy.x + nu * q.yz.z);
  g.xy.y = bend_x * (q.xy.y + nu * q.zx.z);
  g.xy.z = zy * twist_x + zx * twist_y;
  g.yz.x = xy * twist_z + xz * twist_y;
  g.yz.y = bend_z * (q.yz.y + nu * q.zx.x);
  g.yz.z = bend_y * (q.yz.z + nu * q.xy.x);
  g.zx.x = bend_z * (q.zx.x + nu * q.yz.y);
  g.zx.y = yx * twist_z + yz * twist_x;
  g.zx.z = bend_x * (q.zx.z + nu * q.xy.y);
  g.xyz.x = odd * q.xyz.x;
  g.xyz.y = odd * q.xyz.y;
  g.xyz.z = odd * q.xyz.z;
  return g;
}

INLINE Vec pushed_forward(Vec inverse_x, Vec inverse_y, Vec inverse_z, Vec g) {
  return scaled_sum(inverse_x, g.x, inverse_y, g.y, inverse_z, g.z);
}

// s: modes of the displacement (un-normalised sums, m); ix, iy, iz: rows of F^-1 along the box's axes
// d over 4 h_d. Returns mode forces (N); subtracts the centre term from P_scaled, whose column d is
// along axis d and carries the factor V/(4 h_d).
INLINE Hourglass hourglass_of_box(__global const real* parameters, BoxRatios ratio, Hourglass s,
                                  Vec ix, Vec iy, Vec iz, Tensor* P_scaled) {
  Hourglass q;
  q.xy = pulled_back(ix, iy, iz, s.xy);
  q.yz = pulled_back(ix, iy, iz, s.yz);
  q.zx = pulled_back(ix, iy, iz, s.zx);
  q.xyz = pulled_back(ix, iy, iz, s.xyz);
  const Hourglass g = hourglass_moments(box_moduli(parameters), ratio, q);
  Hourglass f;
  f.xy = pushed_forward(ix, iy, iz, g.xy);
  subtract_product(P_scaled, f.xy, q.xy);
  f.yz = pushed_forward(ix, iy, iz, g.yz);
  subtract_product(P_scaled, f.yz, q.yz);
  f.zx = pushed_forward(ix, iy, iz, g.zx);
  subtract_product(P_scaled, f.zx, q.zx);
  f.xyz = pushed_forward(ix, iy, iz, g.xyz);
  subtract_product(P_scaled, f.xyz, q.xyz);
  return f;
}

// Rows of F^-1 along a voxel's axes d, over 4 h_d.
INLINE void inverse_rows(Axes gradient, Tensor cof, realv inverse_J, Vec* ix, Vec* iy, Vec* iz) {
  const realv jx = inverse_J * gradient.x, jy = inverse_J * gradient.y, jz = inverse_J * gradient.z;
  ix->x = cof.xx * jx;
  ix->y = cof.yx * jx;
  ix->z = cof.zx * jx;
  iy->x = cof.xy * jy;
  iy->y = cof.yy * jy;
  iy->z = cof.zy * jy;
  iz->x = cof.xz * jz;
  iz->y = cof.yz * jz;
  iz->z = cof.zz * jz;
}

INLINE BoxRatios voxel_ratios(__global const real* shape, const int cube) {
  BoxRatios ratio;
  if (cube) {  // products with a constant 1 are left out by every compiler
    ratio.xy = ratio.yx = ratio.yz = ratio.zy = ratio.zx = ratio.xz = broadcast(R(1.0));
    return ratio;
  }
  ratio.xy = broadcast(shape[SHAPE_RATIO_XY]);
  ratio.yx = broadcast(shape[SHAPE_RATIO_YX]);
  ratio.yz = broadcast(shape[SHAPE_RATIO_YZ]);
  ratio.zy = broadcast(shape[SHAPE_RATIO_ZY]);
  ratio.zx = broadcast(shape[SHAPE_RATIO_ZX]);
  ratio.xz = broadcast(shape[SHAPE_RATIO_XZ]);
  return ratio;
}

// Of a voxel; cof, inverse_J: of the centre's F.
INLINE Hourglass physical_hourglass(__global const real* parameters, __global const real* shape,
                                    Hourglass s, Tensor cof, realv inverse_J, Tensor* P_scaled) {
  Vec ix, iy, iz;
  inverse_rows(voxel_gradient(shape, 0), cof, inverse_J, &ix, &iy, &iz);
  return hourglass_of_box(parameters, voxel_ratios(shape, 0), s, ix, iy, iz, P_scaled);
}

INLINE Vec scaled(Vec a, realv k) {
  Vec v;
  v.x = a.x * k;
  v.y = a.y * k;
  v.z = a.z * k;
  return v;
}

INLINE Hourglass kappa_hourglass(__global const real* parameters, Hourglass s) {
  const realv k = load_lanes(parameters + MATERIAL_KAPPA * TLED_LANES);
  Hourglass f;
  f.xy = scaled(s.xy, k);
  f.yz = scaled(s.yz, k);
  f.zx = scaled(s.zx, k);
  f.xyz = scaled(s.xyz, k);
  return f;
}
