// What a constitutive law gets, and small helpers for writing one.
//
// A law is one file material/<name>.cl: a header comment (TOML between "/* @law" and "*/": see
// material/mooney_rivlin.cl) and two functions,
//   <name>_stress(Kinematics k, rows, LawState state, Tensor* P): adds weight x first
//     Piola-Kirchhoff stress to *P (Pa); laws of stage 1 change the isochoric stress in *P instead,
//   <name>_energy(Kinematics k, rows, LawState state): weight x energy density, J/m3.
// rows: the law's parameters, one row of lanes each; row 0 is the overlap weight of the law in the
// voxel (0 in lanes without it), the others come in the order of the header's parameters.
// Stresses of stage 0 are isochoric parts: the volumetric part is common to all laws (base.cl),
// unless the header says volumetric = "own".

// Constants of a voxel along its axes. `cube`: its sides are equal, so that what is computed with one
// serves all three.
typedef struct { real x, y, z; } Axes;

INLINE Axes voxel_axes(__global const real* values, const int cube) {
  Axes a;
  a.x = values[0];
  a.y = cube ? a.x : values[1];
  a.z = cube ? a.x : values[2];
  return a;
}
INLINE Axes voxel_gradient(__global const real* shape, const int cube) {
  return voxel_axes(shape + SHAPE_GRADIENT, cube);
}
INLINE Axes voxel_force(__global const real* shape, const int cube) {
  return voxel_axes(shape + SHAPE_FORCE, cube);
}

typedef struct {
  Tensor F, cof;
  realv J, inverse_J, cube_root;  // cube_root: J^(-1/3)
  realv I1;                       // tr F^T F, not isochoric
} Kinematics;

// History of one law in one block: rows before the step and where those after it go (store: 0 in
// rows of elements that another work-item stores). dt in s; time in s. dt < 0, with no size to speak
// of: the answer to a sudden change, without flow; its slope sets the time step.
typedef struct {
  __global const real* before;
  __global real* after;
  int store;
  real dt, time;
} LawState;

INLINE realv law_row(__global const real* rows, int row) {
  return load_lanes(rows + row * TLED_LANES);
}

// *P += a F + c cof.
INLINE void add_scaled(Tensor* P, realv a, Tensor F, realv c, Tensor cof) {
  P->xx += a * F.xx + c * cof.xx;
  P->xy += a * F.xy + c * cof.xy;
  P->xz += a * F.xz + c * cof.xz;
  P->yx += a * F.yx + c * cof.yx;
  P->yy += a * F.yy + c * cof.yy;
  P->yz += a * F.yz + c * cof.yz;
  P->zx += a * F.zx + c * cof.zx;
  P->zy += a * F.zy + c * cof.zy;
  P->zz += a * F.zz + c * cof.zz;
}

// Symmetric tensors: right Cauchy-Green, second Piola-Kirchhoff.
typedef struct { realv xx, yy, zz, xy, yz, xz; } Symmetric;

INLINE Symmetric right_cauchy_green(Tensor F) {
  Symmetric C;
  C.xx = F.xx * F.xx + F.yx * F.yx + F.zx * F.zx;
  C.yy = F.xy * F.xy + F.yy * F.yy + F.zy * F.zy;
  C.zz = F.xz * F.xz + F.yz * F.yz + F.zz * F.zz;
  C.xy = F.xx * F.xy + F.yx * F.yy + F.zx * F.zy;
  C.yz = F.xy * F.xz + F.yy * F.yz + F.zy * F.zz;
  C.xz = F.xx * F.xz + F.yx * F.yz + F.zx * F.zz;
  return C;
}

INLINE realv second_invariant(Symmetric C) {
  return C.xx * C.yy + C.yy * C.zz + C.zz * C.xx - C.xy * C.xy - C.yz * C.yz - C.xz * C.xz;
}

// F S.
INLINE Tensor times_symmetric(Tensor F, Symmetric S) {
  Tensor P;
  P.xx = F.xx * S.xx + F.xy * S.xy + F.xz * S.xz;
  P.xy = F.xx * S.xy + F.xy * S.yy + F.xz * S.yz;
  P.xz = F.xx * S.xz + F.xy * S.yz + F.xz * S.zz;
  P.yx = F.yx * S.xx + F.yy * S.xy + F.yz * S.xz;
  P.yy = F.yx * S.xy + F.yy * S.yy + F.yz * S.yz;
  P.yz = F.yx * S.xz + F.yy * S.yz + F.yz * S.zz;
  P.zx = F.zx * S.xx + F.zy * S.xy + F.zz * S.xz;
  P.zy = F.zx * S.xy + F.zy * S.yy + F.zz * S.yz;
  P.zz = F.zx * S.xz + F.zy * S.yz + F.zz * S.zz;
  return P;
}

// S A.
INLINE Tensor times_symmetric_left(Symmetric S, Tensor A) {
  Tensor P;
  P.xx = S.xx * A.xx + S.xy * A.yx + S.xz * A.zx;
  P.xy = S.xx * A.xy + S.xy * A.yy + S.xz * A.zy;
  P.xz = S.xx * A.xz + S.xy * A.yz + S.xz * A.zz;
  P.yx = S.xy * A.xx + S.yy * A.yx + S.yz * A.zx;
  P.yy = S.xy * A.xy + S.yy * A.yy + S.yz * A.zy;
  P.yz = S.xy * A.xz + S.yy * A.yz + S.yz * A.zz;
  P.zx = S.xz * A.xx + S.yz * A.yx + S.zz * A.zx;
  P.zy = S.xz * A.xy + S.yz * A.yy + S.zz * A.zy;
  P.zz = S.xz * A.xz + S.yz * A.yz + S.zz * A.zz;
  return P;
}

INLINE void add_tensor(Tensor* P, realv w, Tensor T) {
  P->xx += w * T.xx;
  P->xy += w * T.xy;
  P->xz += w * T.xz;
  P->yx += w * T.yx;
  P->yy += w * T.yy;
  P->yz += w * T.yz;
  P->zx += w * T.zx;
  P->zy += w * T.zy;
  P->zz += w * T.zz;
}

// F^-1 P, symmetric for any P = F S.
INLINE Symmetric second_piola_kirchhoff(Tensor cof, realv inverse_J, Tensor P) {
  Symmetric S;
  S.xx = (cof.xx * P.xx + cof.yx * P.yx + cof.zx * P.zx) * inverse_J;
  S.yy = (cof.xy * P.xy + cof.yy * P.yy + cof.zy * P.zy) * inverse_J;
  S.zz = (cof.xz * P.xz + cof.yz * P.yz + cof.zz * P.zz) * inverse_J;
  S.xy = (cof.xx * P.xy + cof.yx * P.yy + cof.zx * P.zy) * inverse_J;
  S.yz = (cof.xy * P.xz + cof.yy * P.yz + cof.zy * P.zz) * inverse_J;
  S.xz = (cof.xx * P.xz + cof.yx * P.yz + cof.zx * P.zz) * inverse_J;
  return S;
}
