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

// s: modes of the displacement (un-normalised sums, m); ix, iy, iz: rows of F^-1 along the box's axes
// d over 4 h_d, hence the factor 16 in the coefficients. Returns mode forces (N); subtracts the
// centre term from P_scaled, whose column d is along axis d and carries the factor V/(4 h_d).
INLINE Hourglass hourglass_of_box(__global const real* parameters, BoxRatios ratio, Hourglass s,
                                  Vec ix, Vec iy, Vec iz, Tensor* P_scaled) {
  const Vec q_xy = pulled_back(ix, iy, iz, s.xy);
  const Vec q_yz = pulled_back(ix, iy, iz, s.yz);
  const Vec q_zx = pulled_back(ix, iy, iz, s.zx);
  const Vec q_xyz = pulled_back(ix, iy, iz, s.xyz);

  const realv nu = load_lanes(parameters + MATERIAL_NU * TLED_LANES);
  const realv bend_x = load_lanes(parameters + MATERIAL_BEND_X * TLED_LANES);
  const realv bend_y = load_lanes(parameters + MATERIAL_BEND_Y * TLED_LANES);
  const realv bend_z = load_lanes(parameters + MATERIAL_BEND_Z * TLED_LANES);
  const realv twist = load_lanes(parameters + MATERIAL_TWIST * TLED_LANES);
  const realv odd = load_lanes(parameters + MATERIAL_XYZ * TLED_LANES);
  const realv xy = ratio.xy, yx = ratio.yx, yz = ratio.yz, zy = ratio.zy, zx = ratio.zx,
              xz = ratio.xz;

  const realv twist_z = twist * (xy * q_yz.x + yx * q_zx.y);
  const realv twist_x = twist * (yz * q_zx.y + zy * q_xy.z);
  const realv twist_y = twist * (xz * q_yz.x + zx * q_xy.z);

  Hourglass f;
  f.xy = scaled_sum(ix, bend_y * (q_xy.x + nu * q_yz.z), iy, bend_x * (q_xy.y + nu * q_zx.z), iz,
                    zy * twist_x + zx * twist_y);
  subtract_product(P_scaled, f.xy, q_xy);
  f.yz = scaled_sum(ix, xy * twist_z + xz * twist_y, iy, bend_z * (q_yz.y + nu * q_zx.x), iz,
                    bend_y * (q_yz.z + nu * q_xy.x));
  subtract_product(P_scaled, f.yz, q_yz);
  f.zx = scaled_sum(ix, bend_z * (q_zx.x + nu * q_yz.y), iy, yx * twist_z + yz * twist_x, iz,
                    bend_x * (q_zx.z + nu * q_xy.y));
  subtract_product(P_scaled, f.zx, q_zx);
  f.xyz = scaled_sum(ix, odd * q_xyz.x, iy, odd * q_xyz.y, iz, odd * q_xyz.z);
  subtract_product(P_scaled, f.xyz, q_xyz);
  return f;
}

// Of a voxel; cof, inverse_J: of the centre's F.
INLINE Hourglass physical_hourglass(__global const real* parameters, __global const real* shape,
                                    Hourglass s, Tensor cof, realv inverse_J, Tensor* P_scaled) {
  const realv jx = inverse_J * shape[SHAPE_GRADIENT], jy = inverse_J * shape[SHAPE_GRADIENT + 1],
              jz = inverse_J * shape[SHAPE_GRADIENT + 2];
  Vec ix, iy, iz;
  ix.x = cof.xx * jx;
  ix.y = cof.yx * jx;
  ix.z = cof.zx * jx;
  iy.x = cof.xy * jy;
  iy.y = cof.yy * jy;
  iy.z = cof.zy * jy;
  iz.x = cof.xz * jz;
  iz.y = cof.yz * jz;
  iz.z = cof.zz * jz;
  BoxRatios ratio;
  ratio.xy = broadcast(shape[SHAPE_RATIO_XY]);
  ratio.yx = broadcast(shape[SHAPE_RATIO_YX]);
  ratio.yz = broadcast(shape[SHAPE_RATIO_YZ]);
  ratio.zy = broadcast(shape[SHAPE_RATIO_ZY]);
  ratio.zx = broadcast(shape[SHAPE_RATIO_ZX]);
  ratio.xz = broadcast(shape[SHAPE_RATIO_XZ]);
  return hourglass_of_box(parameters, ratio, s, ix, iy, iz, P_scaled);
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
