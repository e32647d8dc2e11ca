// One element of a row (rows.cl) or of a tile (tile.cl), in an order that keeps few values in registers: the same
// arithmetic as compute_element_modes of element.cl, but the pulled-back modes first, then the
// moments, the pushed-forward forces, and at the end the stress row by row of P, each used up at
// once. Sixteen vector registers hold each of these parts; the whole they do not.

// Modes of the four corner values of a face, by component.
typedef struct { realv s[3], x[3], y[3], xy[3]; } Face;

// What the rows of an element's stress are made of: column d of
// P_scaled = along_F F + along_cof cof + own - sum_m f^m (x) q^m, times V/(4 h_d) where F, cof stand.
// own: the stress of one muscle (has_fibre), which needs fewer values than a tensor, or whatever else there
// is (has_own). One value of three kinds instead cost 2 % of a step natively and 9 % through PoCL.
typedef struct {
  Tensor F, cof, own;
  FibreStress fibre;
  Vec along_F, along_cof;
  Hourglass q, f;
  int has_fibre, has_own;
} ElementForce;

INLINE Tensor linear_modes(const Face* low, const Face* high) {
  Tensor linear;
  linear.xx = low->x[0] + high->x[0];
  linear.xy = low->y[0] + high->y[0];
  linear.xz = high->s[0] - low->s[0];
  linear.yx = low->x[1] + high->x[1];
  linear.yy = low->y[1] + high->y[1];
  linear.yz = high->s[1] - low->s[1];
  linear.zx = low->x[2] + high->x[2];
  linear.zy = low->y[2] + high->y[2];
  linear.zz = high->s[2] - low->s[2];
  return linear;
}

INLINE Vec mode_xy(const Face* low, const Face* high) {
  Vec s;
  s.x = low->xy[0] + high->xy[0];
  s.y = low->xy[1] + high->xy[1];
  s.z = low->xy[2] + high->xy[2];
  return s;
}
INLINE Vec mode_yz(const Face* low, const Face* high) {
  Vec s;
  s.x = high->y[0] - low->y[0];
  s.y = high->y[1] - low->y[1];
  s.z = high->y[2] - low->y[2];
  return s;
}
INLINE Vec mode_zx(const Face* low, const Face* high) {
  Vec s;
  s.x = high->x[0] - low->x[0];
  s.y = high->x[1] - low->x[1];
  s.z = high->x[2] - low->x[2];
  return s;
}
INLINE Vec mode_xyz(const Face* low, const Face* high) {
  Vec s;
  s.x = high->xy[0] - low->xy[0];
  s.y = high->xy[1] - low->xy[1];
  s.z = high->xy[2] - low->xy[2];
  return s;
}

#if TLED_VECTOR_ROWS
// What the laws of a block's entries give, from its faces, so that the fused loop keeps no room for
// it; column d times V/(4 h_d). The volumetric part is left out: it is in along_cof.
OUT_OF_LINE void laws_of_row(const ElementTables* t, const Face* low, const Face* high, int block,
                             int store, Tensor* own) {
  __global const int* links = t->blocks + (long)block * TLED_BLOCK_INTS;
  __global const real* parameters =
      t->materials + (long)links[BLOCK_MATERIAL] * (TLED_MATERIAL_ROWS * TLED_LANES);
  const Kinematics k = kinematics(
      deformation_gradient(linear_modes(low, high), voxel_gradient(t->shape, 0)), parameters);
  stress_of_laws(t, &k, parameters, links, 0, store, own);
  scale_columns(own, t->shape);
}
#endif

// material: the block's row set; lane: this work-item's, which has an element, 0 where it does all.
INLINE void row_element(ElementTables t, const Face* low, const Face* high,
                        __global const int* links, int material, int block, int lane, int store,
                        const int physical, const int cube, ElementForce* e) {
  __global const real* parameters =
      t.materials + (long)material * (TLED_MATERIAL_ROWS * TLED_LANES) + lane;
  const Axes gradient = voxel_gradient(t.shape, cube), force = voxel_force(t.shape, cube);
  const int muscle = links[BLOCK_MUSCLE_BEGIN], muscle_end = links[BLOCK_MUSCLE_END];
  MuscleEntry first = {0, 0};
  BaseModuli moduli;
  BoxModuli box;
  // A work-item of one lane waits for memory: it asks before the branches of the cube root and of the muscles
  // for what compilers would ask for behind them. Vectors have no registers for that.
  if (!TLED_VECTOR_ROWS) {
    moduli = base_moduli(parameters);
    if (muscle < muscle_end) first = muscle_entry(t, muscle);
  }
  Kinematics k;
  k.F = deformation_gradient(linear_modes(low, high), gradient);
  k.cof = cofactors(k.F);
  // A work-item of one lane comes here only where there is an element.
  k.J = TLED_VECTOR_ROWS ? volume_ratio(k.F, k.cof, parameters) : determinant(k.F, k.cof);
  complete_kinematics(&k);
  e->F = k.F;
  e->cof = k.cof;
  if (TLED_VECTOR_ROWS) moduli = base_moduli(parameters);
  realv along_F = broadcast(R(0.0)), along_cof = volumetric_stress(moduli, k);
  const int has_laws = TLED_LAWS && links[BLOCK_LAW_BEGIN] != links[BLOCK_LAW_END];
  if (!has_laws) {
    const IsotropicStress s = isochoric_neo_hookean(moduli.mu, k);
    along_F = s.along_F;
    along_cof += s.along_cof;
  }
  e->along_F.x = along_F * force.x;
  e->along_F.y = along_F * force.y;
  e->along_F.z = along_F * force.z;
  e->along_cof.x = along_cof * force.x;
  e->along_cof.y = along_cof * force.y;
  e->along_cof.z = along_cof * force.z;
  if (physical && !TLED_VECTOR_ROWS) box = box_moduli(parameters);
  const int n_muscles = muscle_end - muscle;
  if (TLED_VECTOR_ROWS && n_muscles > 0) first = muscle_entry(t, muscle);
  // A GPU's work-item would hold the room for both in registers: there one muscle is a tensor as well.
  e->has_fibre = TLED_VECTOR_ROWS && !has_laws && n_muscles == 1;
  e->has_own = has_laws || n_muscles > (TLED_VECTOR_ROWS ? 1 : 0);
  if (e->has_fibre) {
    e->fibre = fibre_stress(t, first, force, k.F, k.J, lane);
  } else if (e->has_own) {
    Tensor own;
    clear_tensor(&own);
    if (has_laws) {
      // Copies, so that only they need an address.
      const ElementTables tables = t;
      Tensor laws;
#if TLED_VECTOR_ROWS
      const Face below = *low, above = *high;
      laws_of_row(&tables, &below, &above, block, store, &laws);
#else
      const Kinematics copy = k;
      stress_of_laws(&tables, &copy, parameters, links, lane, store, &laws);
      scale_columns(&laws, t.shape);
#endif
      own = laws;
    }
    add_muscles(t, k.F, k.J, muscle, muscle_end, first, force, lane, &own);
    e->own = own;
  }
  if (physical) {
    Vec ix, iy, iz;
    inverse_rows(gradient, k.cof, k.inverse_J, &ix, &iy, &iz);
    e->q.xy = pulled_back(ix, iy, iz, mode_xy(low, high));
    e->q.yz = pulled_back(ix, iy, iz, mode_yz(low, high));
    e->q.zx = pulled_back(ix, iy, iz, mode_zx(low, high));
    e->q.xyz = pulled_back(ix, iy, iz, mode_xyz(low, high));
    if (TLED_VECTOR_ROWS) box = box_moduli(parameters);
    const Hourglass g = hourglass_moments(box, voxel_ratios(t.shape, cube), e->q);
    e->f.xy = pushed_forward(ix, iy, iz, g.xy);
    e->f.yz = pushed_forward(ix, iy, iz, g.yz);
    e->f.zx = pushed_forward(ix, iy, iz, g.zx);
    e->f.xyz = pushed_forward(ix, iy, iz, g.xyz);
  } else {
    const realv kappa = load_lanes(parameters + MATERIAL_KAPPA * TLED_LANES);
    e->f.xy = scaled(mode_xy(low, high), kappa);
    e->f.yz = scaled(mode_yz(low, high), kappa);
    e->f.zx = scaled(mode_zx(low, high), kappa);
    e->f.xyz = scaled(mode_xyz(low, high), kappa);
  }
}

// An element's forces times `weight`: of a level of subcycling above 0.
INLINE void weigh_element(ElementForce* e, real weight) {
  e->along_F = scaled(e->along_F, broadcast(weight));
  e->along_cof = scaled(e->along_cof, broadcast(weight));
  if (e->has_fibre) {
    e->fibre.pull = scaled(e->fibre.pull, broadcast(weight));
  } else if (e->has_own) {
    e->own.xx *= weight;
    e->own.xy *= weight;
    e->own.xz *= weight;
    e->own.yx *= weight;
    e->own.yy *= weight;
    e->own.yz *= weight;
    e->own.zx *= weight;
    e->own.zy *= weight;
    e->own.zz *= weight;
  }
  e->f.xy = scaled(e->f.xy, broadcast(weight));
  e->f.yz = scaled(e->f.yz, broadcast(weight));
  e->f.zx = scaled(e->f.zx, broadcast(weight));
  e->f.xyz = scaled(e->f.xyz, broadcast(weight));
}

// Row c of P_scaled, from the rows c of its parts and component c of each mode's force.
INLINE Vec stress_row(const ElementForce* e, realv F_x, realv F_y, realv F_z, realv cof_x,
                      realv cof_y, realv cof_z, realv own_x, realv own_y, realv own_z, realv fibre,
                      realv f_xy, realv f_yz, realv f_zx, realv f_xyz, const int physical) {
  Vec P;
  P.x = e->along_F.x * F_x + e->along_cof.x * cof_x;
  P.y = e->along_F.y * F_y + e->along_cof.y * cof_y;
  P.z = e->along_F.z * F_z + e->along_cof.z * cof_z;
  if (e->has_fibre) {
    P.x += fibre * e->fibre.pull.x;
    P.y += fibre * e->fibre.pull.y;
    P.z += fibre * e->fibre.pull.z;
  } else if (e->has_own) {
    P.x += own_x;
    P.y += own_y;
    P.z += own_z;
  }
  if (physical) {
    P.x -= f_xy * e->q.xy.x;
    P.y -= f_xy * e->q.xy.y;
    P.z -= f_xy * e->q.xy.z;
    P.x -= f_yz * e->q.yz.x;
    P.y -= f_yz * e->q.yz.y;
    P.z -= f_yz * e->q.yz.z;
    P.x -= f_zx * e->q.zx.x;
    P.y -= f_zx * e->q.zx.y;
    P.z -= f_zx * e->q.zx.z;
    P.x -= f_xyz * e->q.xyz.x;
    P.y -= f_xyz * e->q.xyz.y;
    P.z -= f_xyz * e->q.xyz.z;
  }
  return P;
}

// Forces of one component on the two faces of an element from its row of the stress: what the
// element gives its low face is added to `carried`, which has what the element below gave, and
// returned; `carried` then holds what it gives its high face.
typedef struct { realv s, x, y, xy; } FaceForce;

INLINE FaceForce split_forces(Vec P, realv f_xy, realv f_yz, realv f_zx, realv f_xyz, Face* carried,
                              const int component) {
  FaceForce low;
  low.s = carried->s[component] - P.z;
  low.x = carried->x[component] + (P.x - f_zx);
  low.y = carried->y[component] + (P.y - f_yz);
  low.xy = carried->xy[component] + (f_xy - f_xyz);
  carried->s[component] = P.z;
  carried->x[component] = P.x + f_zx;
  carried->y[component] = P.y + f_yz;
  carried->xy[component] = f_xy + f_xyz;
  return low;
}

INLINE FaceForce element_force_x(const ElementForce* e, Face* carried, const int physical) {
  const Hourglass* f = &e->f;
  const Vec P = stress_row(e, e->F.xx, e->F.xy, e->F.xz, e->cof.xx, e->cof.xy, e->cof.xz, e->own.xx,
                           e->own.xy, e->own.xz, e->fibre.along.x, f->xy.x, f->yz.x, f->zx.x, f->xyz.x,
                           physical);
  return split_forces(P, f->xy.x, f->yz.x, f->zx.x, f->xyz.x, carried, 0);
}
INLINE FaceForce element_force_y(const ElementForce* e, Face* carried, const int physical) {
  const Hourglass* f = &e->f;
  const Vec P = stress_row(e, e->F.yx, e->F.yy, e->F.yz, e->cof.yx, e->cof.yy, e->cof.yz, e->own.yx,
                           e->own.yy, e->own.yz, e->fibre.along.y, f->xy.y, f->yz.y, f->zx.y, f->xyz.y,
                           physical);
  return split_forces(P, f->xy.y, f->yz.y, f->zx.y, f->xyz.y, carried, 1);
}
INLINE FaceForce element_force_z(const ElementForce* e, Face* carried, const int physical) {
  const Hourglass* f = &e->f;
  const Vec P = stress_row(e, e->F.zx, e->F.zy, e->F.zz, e->cof.zx, e->cof.zy, e->cof.zz, e->own.zx,
                           e->own.zy, e->own.zz, e->fibre.along.z, f->xy.z, f->yz.z, f->zx.z, f->xyz.z,
                           physical);
  return split_forces(P, f->xy.z, f->yz.z, f->zx.z, f->xyz.z, carried, 2);
}

// What the elements below give a block that has none.
INLINE FaceForce carried_only(Face* carried, const int component) {
  FaceForce f;
  f.s = carried->s[component];
  f.x = carried->x[component];
  f.y = carried->y[component];
  f.xy = carried->xy[component];
  const realv zero = broadcast(R(0.0));
  carried->s[component] = carried->x[component] = zero;
  carried->y[component] = carried->xy[component] = zero;
  return f;
}
