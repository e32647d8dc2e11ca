// Distorted hexahedra of a conforming mesh: two kernels on every device. A work-item stores the 24
// corner forces of an element (of a block of them where rows are vectors), one a node gathers those of
// its elements in a fixed order and integrates, so results repeat bit for bit. Gradients, hourglass
// vectors and box of each element are stored (csrc/precompute/hexahedron.hpp), where voxels have
// constants; laws, muscles and conditions are the same.

// Where the element's own numbers are, at this work-item's lane.
typedef struct {
  __global const int* nodes;
  __global const real* rows;
} HexElement;

INLINE realv hex_row(HexElement e, int row) { return load_lanes(e.rows + row * TLED_LANES); }

INLINE HexElement hex_element(__global const int* hex_nodes, __global const real* hex_rows, int block,
                              int lane) {
  HexElement e;
  e.nodes = hex_nodes + (long)block * (8 * TLED_LANES) + lane;
  e.rows = hex_rows + (long)block * (TLED_HEX_ROWS * TLED_LANES) + lane;
  return e;
}

// One component: gradient g (x, y, z) and hourglass amplitudes s (xy, yz, zx, xyz) of the corner values.
INLINE void hex_component(HexElement e, __global const real* u, int component, Vec* g, realv* s_xy,
                          realv* s_yz, realv* s_zx, realv* s_xyz) {
  __global const real* p = u + component * TLED_LANES;
  const realv v0 = gather_lanes(p, e.nodes), v1 = gather_lanes(p, e.nodes + TLED_LANES),
              v2 = gather_lanes(p, e.nodes + 2 * TLED_LANES),
              v3 = gather_lanes(p, e.nodes + 3 * TLED_LANES),
              v4 = gather_lanes(p, e.nodes + 4 * TLED_LANES),
              v5 = gather_lanes(p, e.nodes + 5 * TLED_LANES),
              v6 = gather_lanes(p, e.nodes + 6 * TLED_LANES),
              v7 = gather_lanes(p, e.nodes + 7 * TLED_LANES);
  realv along[3];
  for (int j = 0; j < 3; ++j)
    along[j] = v0 * hex_row(e, HEX_GRADIENT + j) + v1 * hex_row(e, HEX_GRADIENT + 3 + j) +
               v2 * hex_row(e, HEX_GRADIENT + 6 + j) + v3 * hex_row(e, HEX_GRADIENT + 9 + j) +
               v4 * hex_row(e, HEX_GRADIENT + 12 + j) + v5 * hex_row(e, HEX_GRADIENT + 15 + j) +
               v6 * hex_row(e, HEX_GRADIENT + 18 + j) + v7 * hex_row(e, HEX_GRADIENT + 21 + j);
  g->x = along[0];
  g->y = along[1];
  g->z = along[2];
  const realv d0 = v1 - v0, d1 = v3 - v2, d2 = v5 - v4, d3 = v7 - v6;
  const realv xy = (d1 - d0) + (d3 - d2), zx = (d2 + d3) - (d0 + d1), xyz = (d0 - d1) + (d3 - d2);
  const realv yz = ((v0 + v1) - (v2 + v3)) - ((v4 + v5) - (v6 + v7));
  realv s[4] = {xy, yz, zx, xyz};
  for (int m = 0; m < 4; ++m)
    s[m] -= along[0] * hex_row(e, HEX_OFFSET + 3 * m) + along[1] * hex_row(e, HEX_OFFSET + 3 * m + 1) +
            along[2] * hex_row(e, HEX_OFFSET + 3 * m + 2);
  *s_xy = s[0];
  *s_yz = s[1];
  *s_zx = s[2];
  *s_xyz = s[3];
}

// linear: the displacement gradient, no sums over corners as of voxels.
INLINE ElementModes hex_modes(HexElement e, __global const real* u) {
  ElementModes m;
  Vec x, y, z;
  hex_component(e, u, 0, &x, &m.hourglass.xy.x, &m.hourglass.yz.x, &m.hourglass.zx.x,
                &m.hourglass.xyz.x);
  hex_component(e, u, 1, &y, &m.hourglass.xy.y, &m.hourglass.yz.y, &m.hourglass.zx.y,
                &m.hourglass.xyz.y);
  hex_component(e, u, 2, &z, &m.hourglass.xy.z, &m.hourglass.yz.z, &m.hourglass.zx.z,
                &m.hourglass.xyz.z);
  m.linear.xx = x.x;
  m.linear.xy = x.y;
  m.linear.xz = x.z;
  m.linear.yx = y.x;
  m.linear.yy = y.y;
  m.linear.yz = y.z;
  m.linear.zx = z.x;
  m.linear.zy = z.y;
  m.linear.zz = z.z;
  return m;
}

INLINE Tensor plus_identity(Tensor F) {
  F.xx += R(1.0);
  F.yy += R(1.0);
  F.zz += R(1.0);
  return F;
}

// Row of F^-1 along the box's axis d, over 4 h_d.
INLINE Vec hex_inverse_row(HexElement e, int d, Tensor cof, realv inverse_J) {
  const realv ax = hex_row(e, HEX_AXES + 3 * d) * inverse_J,
              ay = hex_row(e, HEX_AXES + 3 * d + 1) * inverse_J,
              az = hex_row(e, HEX_AXES + 3 * d + 2) * inverse_J;
  Vec row;
  row.x = ax * cof.xx + ay * cof.xy + az * cof.xz;
  row.y = ax * cof.yx + ay * cof.yy + az * cof.yz;
  row.z = ax * cof.zx + ay * cof.zy + az * cof.zz;
  return row;
}

// Q += column (x) the box's axis d times 4 h_d.
INLINE void hex_add_column(HexElement e, int d, realv cx, realv cy, realv cz, Tensor* Q) {
  const realv square = hex_row(e, HEX_SQUARE + d);
  const realv ax = hex_row(e, HEX_AXES + 3 * d) * square,
              ay = hex_row(e, HEX_AXES + 3 * d + 1) * square,
              az = hex_row(e, HEX_AXES + 3 * d + 2) * square;
  Q->xx += cx * ax;
  Q->xy += cx * ay;
  Q->xz += cx * az;
  Q->yx += cy * ax;
  Q->yy += cy * ay;
  Q->yz += cy * az;
  Q->zx += cz * ax;
  Q->zy += cz * ay;
  Q->zz += cz * az;
}

// Mode forces (N); adds the centre term to *VP, volume times P.
INLINE Hourglass hex_hourglass(HexElement e, __global const real* parameters, Hourglass s, Kinematics k,
                               const int physical, Tensor* VP) {
  if (!physical) return kappa_hourglass(parameters, s);
  BoxRatios ratio;
  ratio.xy = hex_row(e, HEX_RATIO);
  ratio.yx = hex_row(e, HEX_RATIO + 1);
  ratio.yz = hex_row(e, HEX_RATIO + 2);
  ratio.zy = hex_row(e, HEX_RATIO + 3);
  ratio.zx = hex_row(e, HEX_RATIO + 4);
  ratio.xz = hex_row(e, HEX_RATIO + 5);
  const realv zero = broadcast(R(0.0));
  Tensor centre = {zero, zero, zero, zero, zero, zero, zero, zero, zero};
  const Hourglass f = hourglass_of_box(
      parameters, ratio, s, hex_inverse_row(e, 0, k.cof, k.inverse_J),
      hex_inverse_row(e, 1, k.cof, k.inverse_J), hex_inverse_row(e, 2, k.cof, k.inverse_J), &centre);
  hex_add_column(e, 0, centre.xx, centre.yx, centre.zx, VP);
  hex_add_column(e, 1, centre.xy, centre.yy, centre.zy, VP);
  hex_add_column(e, 2, centre.xz, centre.yz, centre.zz, VP);
  return f;
}

// Forces on the eight corners of one component: row c of VP and of the mode forces.
INLINE void hex_store_component(HexElement e, __global real* out, realv qx, realv qy, realv qz,
                                realv xy, realv yz, realv zx, realv xyz) {
  // gamma^m = h^m - c_m . dN/dX.
  qx -= xy * hex_row(e, HEX_OFFSET) + yz * hex_row(e, HEX_OFFSET + 3) +
        zx * hex_row(e, HEX_OFFSET + 6) + xyz * hex_row(e, HEX_OFFSET + 9);
  qy -= xy * hex_row(e, HEX_OFFSET + 1) + yz * hex_row(e, HEX_OFFSET + 4) +
        zx * hex_row(e, HEX_OFFSET + 7) + xyz * hex_row(e, HEX_OFFSET + 10);
  qz -= xy * hex_row(e, HEX_OFFSET + 2) + yz * hex_row(e, HEX_OFFSET + 5) +
        zx * hex_row(e, HEX_OFFSET + 8) + xyz * hex_row(e, HEX_OFFSET + 11);
  const realv a = xyz - xy - zx, b = xy - zx - xyz, c = zx - xy - xyz, d = xy + zx + xyz;
  const realv low[4] = {yz - a, -yz - b, -yz - c, yz - d};
  const realv high[4] = {yz + a, -yz + b, -yz + c, yz + d};
  for (int corner = 0; corner < 8; ++corner) {
    const int row = HEX_GRADIENT + 3 * corner;
    const realv f = qx * hex_row(e, row) + qy * hex_row(e, row + 1) + qz * hex_row(e, row + 2);
    store_lanes(f + (corner & 1 ? high[corner >> 1] : low[corner >> 1]),
                out + corner * (3 * TLED_LANES));
  }
}

// Work-item: a block of elements, or an element where rows are no vectors. Reads u of 8 nodes,
// writes element_forces[((block * 8 + corner) * 3 + component) * TLED_LANES + lane].
INLINE void hex_forces_item(ElementTables t, __global const int* hex_nodes,
                            __global const real* hex_rows, __global const real* u,
                            __global real* element_forces, int n_blocks, int store,
                            const int physical) {
#if TLED_VECTOR_ROWS
  const int block = (int)get_global_id(0), lane = 0;
#else
  const int block = (int)(get_global_id(0) / TLED_LANES), lane = (int)(get_global_id(0) % TLED_LANES);
#endif
  if (block >= n_blocks) return;
  __global const int* links = t.blocks + (long)block * TLED_BLOCK_INTS;
  if (links[BLOCK_MATERIAL] < 0) return;
  __global const real* parameters =
      t.materials + (long)links[BLOCK_MATERIAL] * (TLED_MATERIAL_ROWS * TLED_LANES) + lane;
  const HexElement e = hex_element(hex_nodes, hex_rows, block, lane);
  const ElementModes m = hex_modes(e, u);
  const Kinematics k = kinematics(plus_identity(m.linear), parameters);
  Tensor P = scaled_stress(t, k, parameters, links, lane, store);
  const realv volume = hex_row(e, HEX_VOLUME);
  const realv zero = broadcast(R(0.0));
  Tensor VP = {zero, zero, zero, zero, zero, zero, zero, zero, zero};
  add_tensor(&VP, volume, P);
  const Hourglass f = hex_hourglass(e, parameters, m.hourglass, k, physical, &VP);
  __global real* out = element_forces + (long)block * (24 * TLED_LANES) + lane;
  hex_store_component(e, out, VP.xx, VP.xy, VP.xz, f.xy.x, f.yz.x, f.zx.x, f.xyz.x);
  hex_store_component(e, out + TLED_LANES, VP.yx, VP.yy, VP.yz, f.xy.y, f.yz.y, f.zx.y, f.xyz.y);
  hex_store_component(e, out + 2 * TLED_LANES, VP.zx, VP.zy, VP.zz, f.xy.z, f.yz.z, f.zx.z,
                      f.xyz.z);
}

#define TLED_HEX_KERNEL(name, physical)                                                            \
  __kernel void name(                                                                              \
      __global const real* restrict u, __global real* restrict element_forces,                     \
      __global const int* restrict blocks, __global const real* restrict materials,                \
      __global const int* restrict law_entries, __global const real* restrict law_sets,            \
      __global const real* restrict history, __global real* restrict next_history,                 \
      __global const int* restrict muscle_entries, __global const real* restrict muscle_sets,      \
      __global const real* restrict muscle_constants, __global const real* restrict shape,         \
      __global const real* restrict step_table, __global const int* restrict hex_nodes,            \
      __global const real* restrict hex_rows, int n_blocks, int step_index, int step_reals,        \
      int store) {                                                                                 \
    const ElementTables t = {blocks,           materials,    law_entries,                          \
                             law_sets,         history,      next_history,                         \
                             muscle_entries,   muscle_sets,  muscle_constants,                     \
                             shape,            step_table + step_index * step_reals};              \
    hex_forces_item(t, hex_nodes, hex_rows, u, element_forces, n_blocks, store, physical);         \
  }

TLED_HEX_KERNEL(hex_forces_physical, 1)
TLED_HEX_KERNEL(hex_forces_kappa, 0)

// Force on a node, component by component.
INLINE void hex_gather(__global const real* element_forces, __global const int* begin,
                       __global const int* places, int slot, real* fx, real* fy, real* fz) {
  real x = R(0.0), y = R(0.0), z = R(0.0);
  for (int i = begin[slot]; i < begin[slot + 1]; ++i) {
    __global const real* p = element_forces + places[i];
    x += p[0];
    y += p[TLED_LANES];
    z += p[2 * TLED_LANES];
  }
  *fx = x;
  *fy = y;
  *fz = z;
}

// Work-item: a node (block * TLED_LANES + lane). u_prev is replaced by the displacement after the step.
__kernel void hex_integrate_nodes(__global const real* restrict u, __global real* restrict u_prev,
                                  __global const real* restrict element_forces,
                                  __global const int* restrict blocks,
                                  __global const real* restrict node_sets,
                                  __global const real* restrict step_table,
                                  __global const int* restrict begin,
                                  __global const int* restrict places, int n_slots, int step_index,
                                  int step_reals) {
  const int slot = (int)get_global_id(0);
  if (slot >= n_slots) return;
  const int block = slot / TLED_LANES, lane = slot % TLED_LANES;
  NodeMotion motion;
  set_motion(step_table + step_index * step_reals, &motion);
  __global const real* w =
      node_sets + (long)blocks[(long)block * TLED_BLOCK_INTS + BLOCK_NODE] *
                      (TLED_NODE_ROWS * TLED_LANES) + lane;
  real fx, fy, fz;
  hex_gather(element_forces, begin, places, slot, &fx, &fy, &fz);
  const long at = (long)block * (3 * TLED_LANES) + lane;
  u_prev[at] = next_displacement(u[at], u_prev[at], w[0], &motion, fx, 0);
  u_prev[at + TLED_LANES] = next_displacement(u[at + TLED_LANES], u_prev[at + TLED_LANES],
                                              w[TLED_LANES], &motion, fy, 1);
  u_prev[at + 2 * TLED_LANES] = next_displacement(
      u[at + 2 * TLED_LANES], u_prev[at + 2 * TLED_LANES], w[2 * TLED_LANES], &motion, fz, 2);
}

// Work-item: a node. f: internal force, N.
__kernel void hex_gather_forces(__global real* restrict f, __global const real* restrict element_forces,
                                __global const int* restrict begin,
                                __global const int* restrict places, int n_slots) {
  const int slot = (int)get_global_id(0);
  if (slot >= n_slots) return;
  real fx, fy, fz;
  hex_gather(element_forces, begin, places, slot, &fx, &fy, &fz);
  const long at = (long)(slot / TLED_LANES) * (3 * TLED_LANES) + slot % TLED_LANES;
  f[at] = fx;
  f[at + TLED_LANES] = fy;
  f[at + 2 * TLED_LANES] = fz;
}
