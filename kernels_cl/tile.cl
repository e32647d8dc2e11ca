// Fused element + node kernel for GPUs: one launch a step, no element forces in global memory, no
// atomics. docs/explanation/gpu-kernels.md has the reasons in numbers.
//
// A work-group owns a tile of (width - 1) x (rows - 1) columns of nodes and walks up its planes in
// z. Work-item (i, j) computes element (i, j) of a plane, then finishes the node at its low corner:
//
//     y ^  +---+---+---+---+    o: nodes of the tile. Their elements are all in it: those of the
//       |  | . |   |   |   |    first column and row (.), and the plane below the first, are
//       |  +---o---o---o---+    computed by the tiles beside this one too.
//       |  | . |   |   |   |
//       |  +---o---o---o---+    Each item keeps its element's force on its own node and hands the
//       |  | . | . | . | . |    three others of the face to its neighbours through local memory.
//       |  +---+---+---+---+-> x
//
// What two elements of a column share, the transform of the face between them and the forces on it,
// stays in the item's registers. Two buffers in local memory take turns, so that one barrier a
// plane is enough: who writes a buffer again has passed the barrier behind its last reading.
// A node adds its forces in an order that tiles have no part in: shapes of tiles do not change a bit.

// Modes of the four corner values of a face; at: where their x components are in u.
INLINE void load_face_modes(__global const real* u, const int at[4], real face[3][4]) {
  for (int c = 0; c < 3; ++c) {
    const real lower = u[at[0] + c * TLED_LANES], lower_next = u[at[1] + c * TLED_LANES],
               upper = u[at[2] + c * TLED_LANES], upper_next = u[at[3] + c * TLED_LANES];
    const real a = lower + lower_next, b = lower_next - lower;
    const real d = upper + upper_next, e = upper_next - upper;
    face[c][0] = a + d;
    face[c][1] = b + e;
    face[c][2] = d - a;
    face[c][3] = e - b;
  }
}

// place: of this row of the tile, and the next `across` behind it; x: this item's in its chunks.
INLINE void load_face_at(__global const real* u, __global const int* place, int across, int x,
                         real face[3][4]) {
  const int low = x / TLED_LANES, lane = x % TLED_LANES;
  const int far = (x + 1) / TLED_LANES, far_lane = (x + 1) % TLED_LANES;
  const int at[4] = {place[low] * (3 * TLED_LANES) + lane,
                     place[far] * (3 * TLED_LANES) + far_lane,
                     place[across + low] * (3 * TLED_LANES) + lane,
                     place[across + far] * (3 * TLED_LANES) + far_lane};
  load_face_modes(u, at, face);
}

INLINE int has_element(__global const int* blocks, __global const real* materials, int block,
                       int lane) {
  const int set = blocks[(long)block * TLED_BLOCK_INTS + BLOCK_MATERIAL];
  return set >= 0 && materials[((long)set * TLED_MATERIAL_ROWS + MATERIAL_PRESENT) * TLED_LANES +
                               lane] > R(0.0);
}

// Work-item: an element, and a node, of each plane of its tile. integrates: out is u_prev, replaced
// by the displacement after the step, and histories are kept; else out is the force, N.
INLINE void process_tile(ElementTables t, __global const real* u, __global real* out,
                         __global const int* tiles, __global const int* places,
                         __global const real* node_sets, __local real* handed, int n_blocks,
                         int width, int integrates, const int physical) {
  const int item = (int)get_local_id(0), n_items = (int)get_local_size(0);
  const int i = item % width, j = item / width, across = TLED_TILE_BLOCKS(width, TLED_LANES);
  __global const int* tile = tiles + (long)get_group_id(0) * TLED_TILE_INTS;
  const int n_planes = tile[TILE_PLANES], x = tile[TILE_LANE] + i;
  const int lane = x % TLED_LANES, plane_places = (n_items / width + 1) * across;
  __global const int* place = places + tile[TILE_PLACES] + j * across;
  int has_face = 0;
  real face[3][4], carried[3][4];  // between this plane's elements and those below: modes, forces
  for (int c = 0; c < 3; ++c)
    for (int k = 0; k < 4; ++k) face[c][k] = carried[c][k] = R(0.0);
  for (int plane = 0; plane <= n_planes; ++plane, place += plane_places) {
    const int block = place[x / TLED_LANES], owned = i > 0 && j > 0 && plane > 0;
    real on_face[3][4];
    if (has_element(t.blocks, t.materials, block, lane)) {
      real high[3][4], modes[3][8], forces[3][8];
      if (!has_face) load_face_at(u, place, across, x, face);
      load_face_at(u, place + plane_places, across, x, high);
      for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 4; ++k) {
          modes[c][k] = face[c][k] + high[c][k];
          modes[c][4 + k] = high[c][k] - face[c][k];
          face[c][k] = high[c][k];
        }
      has_face = 1;
      modes_as_arrays(compute_element_modes(t, named_modes(modes), block, lane,
                                            integrates && owned, physical),
                      forces);
      for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 4; ++k) {
          on_face[c][k] = carried[c][k] + (forces[c][k] - forces[c][4 + k]);
          carried[c][k] = forces[c][k] + forces[c][4 + k];
        }
    } else {
      has_face = 0;
      for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 4; ++k) {
          on_face[c][k] = carried[c][k];
          carried[c][k] = R(0.0);
        }
    }
    __local real* mine = handed + ((plane & 1) * n_items + item) * TLED_TILE_HANDED;
    real own[3];
    for (int c = 0; c < 3; ++c) {
      const real lower = on_face[c][0] - on_face[c][2], lower_x = on_face[c][1] - on_face[c][3];
      const real upper = on_face[c][0] + on_face[c][2], upper_x = on_face[c][1] + on_face[c][3];
      own[c] = lower - lower_x;
      mine[c] = lower + lower_x;
      mine[3 + c] = upper - upper_x;
      mine[6 + c] = upper + upper_x;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (owned && block < n_blocks) {
      __local const real* left = mine - TLED_TILE_HANDED;
      __local const real* below = mine - width * TLED_TILE_HANDED;
      __local const real* before = below - TLED_TILE_HANDED;
      const long at = (long)block * (3 * TLED_LANES) + lane;
      __global const real* w =
          node_sets + (long)t.blocks[(long)block * TLED_BLOCK_INTS + BLOCK_NODE] *
                          (TLED_NODE_ROWS * TLED_LANES) + lane;
      for (int c = 0; c < 3; ++c) {
        const real f = (own[c] + left[c]) + (below[3 + c] + before[6 + c]);
        const long dof = at + c * TLED_LANES;
        out[dof] = integrates ? next_displacement(u[dof], out[dof], w[c * TLED_LANES], t.step, f, c)
                              : f;
      }
    }
  }
}

// tiles, places: see layout.cl. handed: TLED_TILE_HANDED reals a work-item, twice. Work-group: a
// tile of `width` elements in x and as many rows of them as fill it.
#define TLED_TILE_KERNEL(name, physical)                                                           \
  __kernel void name(                                                                              \
      __global const real* restrict u, __global real* restrict out,                                \
      __global const int* restrict tiles, __global const int* restrict places,                     \
      __global const int* restrict blocks, __global const real* restrict materials,                \
      __global const real* restrict node_sets, __global const int* restrict law_entries,           \
      __global const real* restrict law_sets, __global const real* restrict history,               \
      __global real* restrict next_history, __global const int* restrict muscle_entries,           \
      __global const real* restrict muscle_sets, __global const real* restrict muscle_constants,   \
      __global const real* restrict shape, __global const real* restrict step_table,               \
      __local real* handed, int n_blocks, int width, int step_index, int step_reals,               \
      int integrates) {                                                                            \
    const ElementTables t = {blocks,           materials,    law_entries,                          \
                             law_sets,         history,      next_history,                         \
                             muscle_entries,   muscle_sets,  muscle_constants,                     \
                             shape,            step_table + step_index * step_reals};              \
    process_tile(t, u, out, tiles, places, node_sets, handed, n_blocks, width, integrates,         \
                 physical);                                                                        \
  }

TLED_TILE_KERNEL(step_tile_physical, 1)
TLED_TILE_KERNEL(step_tile_kappa, 0)
