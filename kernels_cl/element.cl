// One element: from the modes of its eight corner displacements to the modes of its corner forces.
// At the centre of a box dN_a/dX_d = +-1/(4 h_d), so the un-normalised Walsh-Hadamard sums of the
// corner values give F (x, y, z modes) and the hourglass amplitudes (the rest), and the same
// transform turns stresses into corner forces (total Lagrangian, one point: f_a = V P dN_a/dX).

// linear.xy: y mode of component x.
typedef struct { Tensor linear; Hourglass hourglass; } ElementModes;

INLINE Tensor deformation_gradient(Tensor linear, Axes gradient) {
  const real gx = gradient.x, gy = gradient.y, gz = gradient.z;
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

// J of F, whose cofactors are there.
INLINE realv determinant(Tensor F, Tensor cof) {
  return F.xx * cof.xx + F.xy * cof.xy + F.xz * cof.xz;
}

// A lane without element is not present. Its corners may belong to other elements and its F be
// anything, so J is set to 1 there: every stress is then 0 times something finite.
INLINE realv volume_ratio(Tensor F, Tensor cof, __global const real* parameters) {
  const realv present = load_lanes(parameters + MATERIAL_PRESENT * TLED_LANES);
  return present > R(0.0) ? determinant(F, cof) : broadcast(R(1.0));
}

// F, cof and J are there.
INLINE void complete_kinematics(Kinematics* k) {
  k->inverse_J = R(1.0) / k->J;
  k->cube_root = inverse_cube_root(k->J);
  k->I1 = squared_norm(k->F);
}

INLINE Kinematics kinematics(Tensor F, __global const real* parameters) {
  Kinematics k;
  k.F = F;
  k.cof = cofactors(F);
  k.J = volume_ratio(F, k.cof, parameters);
  complete_kinematics(&k);
  return k;
}

// Where everything that an element needs stands; see layout.cl.
typedef struct {
  __global const int* blocks;
  __global const real* materials;
  __global const int* law_entries;
  __global const real* law_sets;
  __global const real* history;   // before the step
  __global real* next_history;    // after it
  __global const int* muscle_entries;
  __global const real* muscle_sets;
  __global const real* muscle_constants;
  __global const real* shape;
  __global const real* step;      // this step's row of the table
} ElementTables;

// One law's entry: its rows and its history, of this lane or these lanes.
INLINE LawState law_state(ElementTables t, __global const int* entry, int lane, int store) {
  LawState state;
  const long at = entry[2] < 0 ? 0 : (long)entry[2] * TLED_LANES + lane;
  state.before = t.history + at;
  state.after = t.next_history + at;
  state.store = store;
  state.dt = t.step[STEP_DT];
  state.time = t.step[STEP_TIME];
  return state;
}

// Isochoric and own stresses of all laws of a block besides the volumetric part: *P in Pa.
OUT_OF_LINE void stress_of_laws(const ElementTables* t, const Kinematics* k,
                                __global const real* parameters, __global const int* links,
                                int lane, int store, Tensor* P) {
  const IsotropicStress s =
      isochoric_neo_hookean(load_lanes(parameters + MATERIAL_MU * TLED_LANES), *k);
  Tensor sum;
  clear_tensor(&sum);
  add_scaled(&sum, s.along_F, k->F, s.along_cof, k->cof);
  for (int i = links[BLOCK_LAW_BEGIN]; i < links[BLOCK_LAW_END]; ++i) {
    __global const int* entry = t->law_entries + TLED_LAW_ENTRY * i;
    add_law_stress(entry[0], *k, t->law_sets + (long)entry[1] * TLED_LANES + lane,
                   law_state(*t, entry, lane, store), &sum);
  }
  *P = sum;
}

INLINE void scale_columns(Tensor* P, __global const real* shape) {
  const real x = shape[SHAPE_FORCE], y = shape[SHAPE_FORCE + 1], z = shape[SHAPE_FORCE + 2];
  P->xx *= x;
  P->yx *= x;
  P->zx *= x;
  P->xy *= y;
  P->yy *= y;
  P->zy *= y;
  P->xz *= z;
  P->yz *= z;
  P->zz *= z;
}

// Stress of one muscle: along (x) pull, column d times V/(4 h_d).
typedef struct { Vec along, pull; } FibreStress;

// Which muscle, and its row set for a block.
typedef struct { int muscle, set; } MuscleEntry;
INLINE MuscleEntry muscle_entry(ElementTables t, int entry) {
  const MuscleEntry e = {t.muscle_entries[2 * entry], t.muscle_entries[2 * entry + 1]};
  return e;
}

// Of one of the block's entries of muscles. Lanes without fibre have weight 0 and a zero direction; their
// stretch is 0 then, which the law takes. force: V/(4 h_d).
INLINE FibreStress fibre_stress(ElementTables t, MuscleEntry entry, Axes force, Tensor F, realv J,
                                int lane) {
  const int muscle = entry.muscle;
  __global const real* rows = t.muscle_sets + (long)entry.set * (TLED_MUSCLE_ROWS * TLED_LANES) + lane;
  const realv dx = load_lanes(rows), dy = load_lanes(rows + TLED_LANES),
              dz = load_lanes(rows + 2 * TLED_LANES);
  const realv scale = load_lanes(rows + 3 * TLED_LANES) * J;
  FibreStress s;
  s.along.x = F.xx * dx + F.xy * dy + F.xz * dz;
  s.along.y = F.yx * dx + F.yy * dy + F.yz * dz;
  s.along.z = F.zx * dx + F.zy * dy + F.zz * dz;
  const realv tension =
      muscle_tension(t.muscle_constants + muscle * TLED_MUSCLE_CONSTANTS,
                     t.step[STEP_ACTIVATION + muscle], square_root(dot_product(s.along, s.along)));
  s.pull.x = tension * (scale * force.x * dx);
  s.pull.y = tension * (scale * force.y * dy);
  s.pull.z = tension * (scale * force.z * dz);
  return s;
}

// Adds the stress of every muscle with fibres in the block, of entries begin to end, to P_scaled. first: what
// stands at begin, if there is any.
INLINE void add_muscles(ElementTables t, Tensor F, realv J, int begin, int end, MuscleEntry first,
                        Axes force, int lane, Tensor* P_scaled) {
  for (int entry = begin; entry < end;) {
    const FibreStress s = fibre_stress(t, first, force, F, J, lane);
    if (++entry < end) first = muscle_entry(t, entry);
    P_scaled->xx += s.along.x * s.pull.x;
    P_scaled->xy += s.along.x * s.pull.y;
    P_scaled->xz += s.along.x * s.pull.z;
    P_scaled->yx += s.along.y * s.pull.x;
    P_scaled->yy += s.along.y * s.pull.y;
    P_scaled->yz += s.along.y * s.pull.z;
    P_scaled->zx += s.along.z * s.pull.x;
    P_scaled->zy += s.along.z * s.pull.y;
    P_scaled->zz += s.along.z * s.pull.z;
  }
}

// Stress of everything but the hourglass modes; column d times V/(4 h_d). lane: this work-item's in
// its block, 0 where it does all. Blocks without law entries, most of them, take the fused base.
INLINE Tensor scaled_stress(ElementTables t, Kinematics k, __global const real* parameters,
                            __global const int* links, int lane, int store) {
  Tensor P;
  const BaseModuli moduli = base_moduli(parameters);
  const realv volumetric = volumetric_stress(moduli, k);
  if (!TLED_LAWS || links[BLOCK_LAW_BEGIN] == links[BLOCK_LAW_END]) {
    const IsotropicStress s = isochoric_neo_hookean(moduli.mu, k);
    const realv along_cof = s.along_cof + volumetric;
    const real x = t.shape[SHAPE_FORCE], y = t.shape[SHAPE_FORCE + 1], z = t.shape[SHAPE_FORCE + 2];
    const realv ax = s.along_F * x, cx = along_cof * x, ay = s.along_F * y, cy = along_cof * y,
                az = s.along_F * z, cz = along_cof * z;
    P.xx = ax * k.F.xx + cx * k.cof.xx;
    P.xy = ay * k.F.xy + cy * k.cof.xy;
    P.xz = az * k.F.xz + cz * k.cof.xz;
    P.yx = ax * k.F.yx + cx * k.cof.yx;
    P.yy = ay * k.F.yy + cy * k.cof.yy;
    P.yz = az * k.F.yz + cz * k.cof.yz;
    P.zx = ax * k.F.zx + cx * k.cof.zx;
    P.zy = ay * k.F.zy + cy * k.cof.zy;
    P.zz = az * k.F.zz + cz * k.cof.zz;
  } else {
    // Copies, so that only they need an address.
    const ElementTables tables = t;
    const Kinematics copy = k;
    Tensor laws;
    stress_of_laws(&tables, &copy, parameters, links, lane, store, &laws);
    P = laws;
    add_scaled(&P, broadcast(R(0.0)), k.F, volumetric, k.cof);
    scale_columns(&P, t.shape);
  }
  const int begin = links[BLOCK_MUSCLE_BEGIN], end = links[BLOCK_MUSCLE_END];
  MuscleEntry first = {0, 0};
  if (begin < end) first = muscle_entry(t, begin);
  add_muscles(t, k.F, k.J, begin, end, first, voxel_force(t.shape, 0), lane, &P);
  return P;
}

// store: 1 where this work-item keeps the history of the block's elements.
INLINE ElementModes compute_element_modes(ElementTables t, ElementModes u, int block, int lane,
                                          int store, const int physical) {
  __global const int* links = t.blocks + (long)block * TLED_BLOCK_INTS;
  __global const real* parameters =
      t.materials + (long)links[BLOCK_MATERIAL] * (TLED_MATERIAL_ROWS * TLED_LANES) + lane;
  const Kinematics k = kinematics(
      deformation_gradient(u.linear, voxel_gradient(t.shape, 0)), parameters);
  ElementModes f;
  f.linear = scaled_stress(t, k, parameters, links, lane, store);
  if (physical)
    f.hourglass =
        physical_hourglass(parameters, t.shape, u.hourglass, k.cof, k.inverse_J, &f.linear);
  else
    f.hourglass = kappa_hourglass(parameters, u.hourglass);
  return f;
}
