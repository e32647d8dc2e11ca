// One element: from the modes of its eight corner displacements to the modes of its corner forces.
// At the centre of a box dN_a/dX_d = +-1/(4 h_d), so the un-normalised Walsh-Hadamard sums of the
// corner values give F (x, y, z modes) and the hourglass amplitudes (the rest), and the same
// transform turns stresses into corner forces (total Lagrangian, one point: f_a = V P dN_a/dX).

// linear.xy: y mode of component x.
typedef struct { Tensor linear; Hourglass hourglass; } ElementModes;

INLINE Tensor deformation_gradient(Tensor linear, __global const real* shape) {
  const real gx = shape[SHAPE_GRADIENT], gy = shape[SHAPE_GRADIENT + 1],
             gz = shape[SHAPE_GRADIENT + 2];
  Tensor F;
  F.xx = R(1.0) + gx * linear.xx;
  F.xy = gy * linear.xy;
  F.xz = gz * linear.xz;
  F.yx = gx * linear.yx;
  F.yy = R(1.0) + gy * linear.yy;
  F.yz = gz * linear.yz;
  F.zx = gx * linear.zx;
  F.zy = gy * linear.zy;
  F.zz = R(1.0) + gz * linear.zz;
  return F;
}

// Adds one muscle's stress to P_scaled (column d times V/(4 h_d)). Lanes without fibre have weight 0
// and a zero direction; their stretch is 0 then, which the law takes.
INLINE void add_muscle_stress(__global const real* constants, __global const real* rows,
                                     __global const real* shape, real activation, Tensor F, realv J,
                                     Tensor* P_scaled) {
  const realv dx = load_lanes(rows), dy = load_lanes(rows + TLED_LANES),
              dz = load_lanes(rows + 2 * TLED_LANES), weight = load_lanes(rows + 3 * TLED_LANES);
  const realv vx = F.xx * dx + F.xy * dy + F.xz * dz;
  const realv vy = F.yx * dx + F.yy * dy + F.yz * dz;
  const realv vz = F.zx * dx + F.zy * dy + F.zz * dz;
  const realv stretch = square_root(vx * vx + vy * vy + vz * vz);
  const realv tension = weight * J * muscle_tension(constants, activation, stretch);
  const realv tx = tension * dx * shape[SHAPE_FORCE], ty = tension * dy * shape[SHAPE_FORCE + 1],
              tz = tension * dz * shape[SHAPE_FORCE + 2];
  P_scaled->xx += vx * tx;
  P_scaled->xy += vx * ty;
  P_scaled->xz += vx * tz;
  P_scaled->yx += vy * tx;
  P_scaled->yy += vy * ty;
  P_scaled->yz += vy * tz;
  P_scaled->zx += vz * tx;
  P_scaled->zy += vz * ty;
  P_scaled->zz += vz * tz;
}

// A lane without element has mu = 0. Its corners may belong to other elements and its F be
// anything, so J is set to 1 there: every stress is then 0 times something finite.
INLINE realv volume_ratio(Tensor F, Tensor cof, __global const real* parameters) {
  const realv J = F.xx * cof.xx + F.xy * cof.xy + F.xz * cof.xz;
  const realv mu = load_lanes(parameters + MATERIAL_MU * TLED_LANES);
  return mu > R(0.0) ? J : broadcast(R(1.0));
}

INLINE ElementModes compute_element_modes(
    ElementModes u, __global const real* parameters, __global const int* muscle_entries,
    int muscle_begin, int muscle_end, __global const real* muscle_sets,
    __global const real* muscle_constants, __global const real* activations,
    __global const real* shape, const int physical) {
  const Tensor F = deformation_gradient(u.linear, shape);
  const Tensor cof = cofactors(F);
  const realv J = volume_ratio(F, cof, parameters);
  const realv inverse_J = R(1.0) / J;
  const IsotropicStress stress = neo_hookean_stress(parameters, J, inverse_J,
                                                    inverse_cube_root(absolute(J)), squared_norm(F));
  ElementModes f;
  {
    const realv ax = stress.along_F * shape[SHAPE_FORCE], cx = stress.along_cof * shape[SHAPE_FORCE];
    const realv ay = stress.along_F * shape[SHAPE_FORCE + 1],
                cy = stress.along_cof * shape[SHAPE_FORCE + 1];
    const realv az = stress.along_F * shape[SHAPE_FORCE + 2],
                cz = stress.along_cof * shape[SHAPE_FORCE + 2];
    f.linear.xx = ax * F.xx + cx * cof.xx;
    f.linear.xy = ay * F.xy + cy * cof.xy;
    f.linear.xz = az * F.xz + cz * cof.xz;
    f.linear.yx = ax * F.yx + cx * cof.yx;
    f.linear.yy = ay * F.yy + cy * cof.yy;
    f.linear.yz = az * F.yz + cz * cof.yz;
    f.linear.zx = ax * F.zx + cx * cof.zx;
    f.linear.zy = ay * F.zy + cy * cof.zy;
    f.linear.zz = az * F.zz + cz * cof.zz;
  }
  for (int entry = muscle_begin; entry < muscle_end; ++entry) {
    const int muscle = muscle_entries[2 * entry], set = muscle_entries[2 * entry + 1];
    add_muscle_stress(muscle_constants + muscle * TLED_MUSCLE_CONSTANTS,
                      muscle_sets + (long)set * (TLED_MUSCLE_ROWS * TLED_LANES), shape,
                      activations[muscle], F, J, &f.linear);
  }
  if (physical)
    f.hourglass =
        physical_hourglass(parameters, shape, u.hourglass, cof, inverse_J, &f.linear);
  else
    f.hourglass = kappa_hourglass(parameters, u.hourglass);
  return f;
}
