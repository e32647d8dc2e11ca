// Two kernels for GPUs: a work-item an element stores its 24 corner forces, a work-item a node
// gathers those of its eight elements and integrates. Lanes of a block are neighbouring work-items,
// so every access is coalesced; a node always adds in the same order, so results repeat bit for bit.

// element_forces[((block * 8 + corner) * 3 + component) * TLED_LANES + lane], corner = x + 2 y + 4 z.
#define CORNER_REALS (3 * TLED_LANES)

// Work-item: an element (block * TLED_LANES + lane). Reads u of 8 nodes, writes 24 reals.
INLINE void element_forces_item(ElementTables t, __global const real* u,
                                __global real* element_forces, int n_blocks, int store,
                                const int physical) {
  const int block = (int)(get_global_id(0) / TLED_LANES), lane = (int)(get_global_id(0) % TLED_LANES);
  if (block >= n_blocks) return;
  __global const int* blocks = t.blocks;
  __global const int* links = blocks + (long)block * TLED_BLOCK_INTS;
  if (links[BLOCK_MATERIAL] < 0) return;
  __global real* out = element_forces + (long)block * (8 * CORNER_REALS) + lane;
  // Slots of the lower corner in x of the four x edges, and of their far ends.
  const int next_z = links[BLOCK_NEXT_Z];
  const int corner_block[4] = {block, links[BLOCK_NEXT_Y], next_z,
                               blocks[(long)next_z * TLED_BLOCK_INTS + BLOCK_NEXT_Y]};
  real modes[3][8];
  for (int c = 0; c < 3; ++c) {
    real v[8];
    for (int e = 0; e < 4; ++e) {
      const int b = corner_block[e];
      const int far = lane + 1 < TLED_LANES ? b : blocks[(long)b * TLED_BLOCK_INTS + BLOCK_NEXT_X];
      v[2 * e] = u[((long)b * 3 + c) * TLED_LANES + lane];
      v[2 * e + 1] = u[((long)far * 3 + c) * TLED_LANES + (lane + 1) % TLED_LANES];
    }
    for (int bit = 1; bit < 8; bit *= 2)  // Walsh-Hadamard: sums where the bit is 0, differences where 1
      for (int i = 0; i < 8; ++i)
        if (!(i & bit)) {
          const real a = v[i], b = v[i + bit];
          v[i] = a + b;
          v[i + bit] = b - a;
        }
    for (int i = 0; i < 8; ++i) modes[c][i] = v[i];
  }
  real forces[3][8];
  modes_as_arrays(compute_element_modes(t, named_modes(modes), block, lane, store, physical), forces);
  for (int c = 0; c < 3; ++c) {
    real v[8];
    for (int i = 0; i < 8; ++i) v[i] = forces[c][i];
    for (int bit = 1; bit < 8; bit *= 2)  // transposed: the low corner takes the difference
      for (int i = 0; i < 8; ++i)
        if (!(i & bit)) {
          const real a = v[i], b = v[i + bit];
          v[i] = a - b;
          v[i + bit] = a + b;
        }
    for (int i = 0; i < 8; ++i) out[(i * 3 + c) * TLED_LANES] = v[i];
  }
}

#define TLED_ELEMENT_KERNEL(name, physical)                                                        \
  __kernel void name(                                                                              \
      __global const real* restrict u, __global real* restrict element_forces,                     \
      __global const int* restrict blocks, __global const real* restrict materials,                \
      __global const int* restrict law_entries, __global const real* restrict law_sets,            \
      __global const real* restrict history, __global real* restrict next_history,                 \
      __global const int* restrict muscle_entries, __global const real* restrict muscle_sets,      \
      __global const real* restrict muscle_constants, __global const real* restrict shape,         \
      __global const real* restrict step_table, int n_blocks, int step_index, int step_reals,      \
      int store) {                                                                                 \
    const ElementTables t = {blocks,           materials,    law_entries,                          \
                             law_sets,         history,      next_history,                         \
                             muscle_entries,   muscle_sets,  muscle_constants,                     \
                             shape,            step_table + step_index * step_reals};              \
    element_forces_item(t, u, element_forces, n_blocks, store, physical);                          \
  }

TLED_ELEMENT_KERNEL(element_forces_physical, 1)
TLED_ELEMENT_KERNEL(element_forces_kappa, 0)

// Sum over the eight elements around a node of the force on it; Vec of one real a component.
INLINE Vec gather_force(__global const real* element_forces, __global const int* blocks,
                               int block, int lane) {
  Vec f;
  f.x = R(0.0);
  f.y = R(0.0);
  f.z = R(0.0);
  for (int corner = 0; corner < 8; ++corner) {
    int b = block, l = lane;
    if (corner & 1) {
      if (l == 0) b = blocks[(long)b * TLED_BLOCK_INTS + BLOCK_PREV_X];
      l = (l + TLED_LANES - 1) % TLED_LANES;
    }
    if (corner & 2) b = blocks[(long)b * TLED_BLOCK_INTS + BLOCK_PREV_Y];
    if (corner & 4) b = blocks[(long)b * TLED_BLOCK_INTS + BLOCK_PREV_Z];
    __global const real* p = element_forces + ((long)b * 8 + corner) * CORNER_REALS + l;
    f.x += p[0];
    f.y += p[TLED_LANES];
    f.z += p[2 * TLED_LANES];
  }
  return f;
}

// Work-item: a node. u_prev is replaced by the displacement after the step.
__kernel void integrate_nodes(__global const real* restrict u, __global real* restrict u_prev,
                              __global const real* restrict element_forces,
                              __global const int* restrict blocks,
                              __global const real* restrict node_sets,
                              __global const real* restrict step_table, int n_blocks,
                              int step_index, int step_reals) {
  const int block = (int)(get_global_id(0) / TLED_LANES), lane = (int)(get_global_id(0) % TLED_LANES);
  if (block >= n_blocks) return;
  NodeMotion motion;
  set_motion(step_table + step_index * step_reals, &motion);
  __global const real* w =
      node_sets + (long)blocks[(long)block * TLED_BLOCK_INTS + BLOCK_NODE] *
                      (TLED_NODE_ROWS * TLED_LANES) + lane;
  const Vec f = gather_force(element_forces, blocks, block, lane);
  const long at = (long)block * (3 * TLED_LANES) + lane;
  u_prev[at] = next_displacement(u[at], u_prev[at], w[0], &motion, f.x, 0);
  u_prev[at + TLED_LANES] = next_displacement(u[at + TLED_LANES], u_prev[at + TLED_LANES],
                                              w[TLED_LANES], &motion, f.y, 1);
  u_prev[at + 2 * TLED_LANES] = next_displacement(
      u[at + 2 * TLED_LANES], u_prev[at + 2 * TLED_LANES], w[2 * TLED_LANES], &motion, f.z, 2);
}

// Work-item: a node. f: internal force, N.
__kernel void gather_forces(__global real* restrict f, __global const real* restrict element_forces,
                            __global const int* restrict blocks, int n_blocks) {
  const int block = (int)(get_global_id(0) / TLED_LANES), lane = (int)(get_global_id(0) % TLED_LANES);
  if (block >= n_blocks) return;
  const Vec g = gather_force(element_forces, blocks, block, lane);
  const long at = (long)block * (3 * TLED_LANES) + lane;
  f[at] = g.x;
  f[at + TLED_LANES] = g.y;
  f[at + 2 * TLED_LANES] = g.z;
}
