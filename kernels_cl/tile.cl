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
// stays in the item's registers. Displacements come through local memory: an item brings that of its
// own node two planes ahead, some bring one of the last column or row besides. They and whatever else
// a plane needs are asked for a plane before, so that nothing waits for memory. Of all that is in
// local memory there are two buffers that take turns: one barrier a plane is enough, since who writes
// a buffer again has passed the barrier behind its last reading.
// A node adds its forces in an order that tiles have no part in: shapes of tiles do not change a bit.
// Nodes that slide are put back as soon as they are moved (level 1 of sliding.cl), or wait in its queue.

// Where a work-item finds a column of nodes: its blocks, plane by plane, and its place in local memory.
typedef struct {
  __global const int* place;
  int lane, at;
} Column;

// (i, j): of a node of the tile's, the first of its elements at (0, 0).
INLINE Column column_of(__global const int* tile, __global const int* places, int i, int j, int width,
                        int across) {
  const int x = tile[TILE_LANE] + i;
  Column c;
  c.place = places + j * across + x / TLED_LANES;
  c.lane = x % TLED_LANES;
  c.at = 3 * (j * (width + 1) + i);
  return c;
}

INLINE void fetch_node(__global const real* u, int block, int lane, real node[3]) {
  const int at = block * (3 * TLED_LANES) + lane;
  node[0] = u[at];
  node[1] = u[at + TLED_LANES];
  node[2] = u[at + 2 * TLED_LANES];
}
INLINE void put_node(const real node[3], __local real* plane) {
  plane[0] = node[0];
  plane[1] = node[1];
  plane[2] = node[2];
}

// Modes of the displacements at the corners of a face; corner: the low one's, next: from a row of
// nodes to the one behind it.
INLINE void face_of(__local const real* corner, int next, Face* face) {
  for (int c = 0; c < 3; ++c) {
    const real lower = corner[c], lower_next = corner[3 + c], upper = corner[next + c],
               upper_next = corner[next + 3 + c];
    const real a = lower + lower_next, b = lower_next - lower;
    const real d = upper + upper_next, e = upper_next - upper;
    face->s[c] = a + d;
    face->x[c] = b + e;
    face->y[c] = d - a;
    face->xy[c] = e - b;
  }
}

// A component of an element's forces on its low face, split among the corners: the item's own is
// returned, those of the corners behind it in x, in y and in both are handed on.
INLINE real hand_on(FaceForce f, const int component, __local real* mine) {
  const real lower = f.s - f.y, lower_x = f.x - f.xy, upper = f.s + f.y, upper_x = f.x + f.xy;
  mine[component] = lower + lower_x;
  mine[3 + component] = upper - upper_x;
  mine[6 + component] = upper + upper_x;
  return lower - lower_x;
}

// Sliding nodes of a tile; of_block: the row of those of a block, -1: none.
typedef struct {
  __global const real *rows, *regions;
  __global const int *ints, *of_block;
  volatile __global int* queue;
  int parity;
} TileSliding;

// Work-item: an element, and a node, of each plane of its tile. integrates: out is u_prev, replaced
// by the displacement after the step, and histories are kept; else out is the force, N. slides: there
// are sliding nodes, `sliding`.
INLINE void process_tile(ElementTables t, __global const real* u, __global real* out,
                         __global const int* tiles, __global const int* places,
                         __global const real* node_sets, __local real* handed, int n_blocks,
                         int width, int integrates, TileSliding sliding, const int physical,
                         const int cube, const int slides) {
  const int item = (int)get_local_id(0), n_items = (int)get_local_size(0), rows = n_items / width;
  const int i = item % width, j = item / width, across = TLED_TILE_BLOCKS(width, TLED_LANES);
  const int plane_places = (rows + 1) * across, row_reals = 3 * (width + 1);
  __global const int* tile = tiles + (long)get_group_id(0) * TLED_TILE_INTS;
  const int n_planes = tile[TILE_PLANES], first = tile[TILE_FIRST],
            last = (n_planes + 1 - first) * plane_places;
  places += tile[TILE_PLACES] + first * plane_places;
  const Column own = column_of(tile, places, i, j, width, across);
  // The nodes behind the last column, then those behind the last row.
  const int brings_more = item < rows + 1 + width;
  const Column more = item <= rows ? column_of(tile, places, width, item, width, across)
                                   : column_of(tile, places, item - rows - 1, rows, width, across);
  __local real* planes = handed + 2 * n_items * TLED_TILE_HANDED;
  const int plane_reals = (rows + 1) * row_reals;

  // Blocks of the item's node on this plane and the next two; of the other column on the one after.
  int block = own.place[0], next_block = own.place[plane_places];
  int ahead = min(2 * plane_places, last), ahead_block = own.place[ahead], more_block = 0;
  real node[3];
  fetch_node(u, block, own.lane, node);
  put_node(node, planes + own.at);
  fetch_node(u, next_block, own.lane, node);
  put_node(node, planes + plane_reals + own.at);
  if (brings_more) {
    fetch_node(u, more.place[0], more.lane, node);
    put_node(node, planes + more.at);
    fetch_node(u, more.place[plane_places], more.lane, node);
    put_node(node, planes + plane_reals + more.at);
    more_block = more.place[ahead];
  }
  int material = t.blocks[block * TLED_BLOCK_INTS + BLOCK_MATERIAL],
      node_set = t.blocks[block * TLED_BLOCK_INTS + BLOCK_NODE];
  int slide_row = slides ? sliding.of_block[block] : -1;
  barrier(CLK_LOCAL_MEM_FENCE);
  Face low, carried;  // between this plane's elements and those below: modes, forces
  face_of(planes + own.at, row_reals, &low);
  barrier(CLK_LOCAL_MEM_FENCE);  // the first plane's buffer is written again
  for (int c = 0; c < 3; ++c)
    carried.s[c] = carried.x[c] = carried.y[c] = carried.xy[c] = R(0.0);
  NodeMotion motion;
  set_motion(t.step, &motion);
  for (int plane = first, turn = 0; plane <= n_planes; ++plane, turn = 1 - turn) {
    const int owned = i > 0 && j > 0 && plane > 0 && block < n_blocks;
    // What the end of this plane and the planes to come need.
    real coming[3], more_coming[3], before[3] = {R(0.0), R(0.0), R(0.0)},
                                    inverse_mass[3] = {R(0.0), R(0.0), R(0.0)};
    SlidingNode held;
    if (slides && owned && slide_row >= 0)
      held = sliding_node(sliding.rows, sliding.ints, slide_row, own.lane);
    fetch_node(u, ahead_block, own.lane, coming);
    if (brings_more) fetch_node(u, more_block, more.lane, more_coming);
    ahead = min(ahead + plane_places, last);
    const int far_block = own.place[ahead];
    if (brings_more) more_block = more.place[ahead];
    const int next_material = t.blocks[next_block * TLED_BLOCK_INTS + BLOCK_MATERIAL],
              next_node_set = t.blocks[next_block * TLED_BLOCK_INTS + BLOCK_NODE],
              next_slide_row = slides ? sliding.of_block[next_block] : -1;
    if (owned) {
      fetch_node(out, block, own.lane, before);
      fetch_node(node_sets, node_set, own.lane, inverse_mass);
    }
    __local real* above = planes + (1 - turn) * plane_reals + own.at;
    __local real* here = planes + turn * plane_reals;
    __local real* mine = handed + (turn * n_items + item) * TLED_TILE_HANDED;
    Face high;
    face_of(above, row_reals, &high);
    real force[3];
    if (material >= 0 &&
        t.materials[(long)material * (TLED_MATERIAL_ROWS * TLED_LANES) +
                    MATERIAL_PRESENT * TLED_LANES + own.lane] > R(0.0)) {
      ElementForce e;
      row_element(t, &low, &high, t.blocks + block * TLED_BLOCK_INTS, material, block, own.lane,
                  integrates && owned, physical, cube, &e);
      force[0] = hand_on(element_force_x(&e, &carried, physical), 0, mine);
      force[1] = hand_on(element_force_y(&e, &carried, physical), 1, mine);
      force[2] = hand_on(element_force_z(&e, &carried, physical), 2, mine);
    } else {
      for (int c = 0; c < 3; ++c) force[c] = hand_on(carried_only(&carried, c), c, mine);
    }
    low = high;
    for (int c = 0; c < 3; ++c) node[c] = here[own.at + c];
    put_node(coming, here + own.at);
    if (brings_more) put_node(more_coming, here + more.at);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (owned) {
      __local const real* left = mine - TLED_TILE_HANDED;
      __local const real* below = mine - width * TLED_TILE_HANDED;
      __local const real* before_it = below - TLED_TILE_HANDED;
      const int at = block * (3 * TLED_LANES) + own.lane;
      real next[3];
      for (int c = 0; c < 3; ++c) {
        const real f = (force[c] + left[c]) + (below[3 + c] + before_it[6 + c]);
        next[c] =
            integrates ? next_displacement(node[c], before[c], inverse_mass[c], &motion, f, c) : f;
      }
      if (slides && slide_row >= 0)
        hold_node(held, sliding.regions, sliding.queue, sliding.parity, slide_row, own.lane, next);
      for (int c = 0; c < 3; ++c) out[at + c * TLED_LANES] = next[c];
    }
    block = next_block;
    next_block = ahead_block;
    ahead_block = far_block;
    material = next_material;
    node_set = next_node_set;
    slide_row = next_slide_row;
  }
}

// tiles, places: see layout.cl. handed: of each work-item twice TLED_TILE_HANDED reals, of each node of
// a plane twice three. Work-group: a tile of `width` elements in x and as many rows of them as fill it.
#define TLED_TILE_ARGUMENTS                                                                        \
  __global const real* restrict u, __global real* restrict out, __global const int* restrict tiles, \
      __global const int* restrict places, __global const int* restrict blocks,                    \
      __global const real* restrict materials, __global const real* restrict node_sets,            \
      __global const int* restrict law_entries, __global const real* restrict law_sets,            \
      __global const real* restrict history, __global real* restrict next_history,                 \
      __global const int* restrict muscle_entries, __global const real* restrict muscle_sets,      \
      __global const real* restrict muscle_constants, __global const real* restrict shape,         \
      __global const real* restrict step_table, __local real* handed, int n_blocks, int width,     \
      int step_index, int step_reals
#define TLED_TILE_TABLES                                                                           \
  {blocks, materials, law_entries, law_sets, history, next_history, muscle_entries, muscle_sets,   \
   muscle_constants, shape, step_table + step_index * step_reals}

// cube: voxels with equal sides.
#define TLED_TILE_KERNEL(name, physical, cube)                                                     \
  __kernel void step_tile_##name(TLED_TILE_ARGUMENTS, int integrates) {                            \
    const ElementTables t = TLED_TILE_TABLES;                                                      \
    const TileSliding none = {0, 0, 0, 0, 0, 0};                                                   \
    process_tile(t, u, out, tiles, places, node_sets, handed, n_blocks, width, integrates, none,   \
                 physical, cube, 0);                                                               \
  }                                                                                                \
  __kernel void slide_tile_##name(                                                                 \
      TLED_TILE_ARGUMENTS, __global const real* restrict slide_rows,                               \
      __global const real* restrict slide_regions, __global const int* restrict slide_ints,        \
      __global const int* restrict slide_row_of_block, __global int* restrict slide_queue,         \
      int parity) {                                                                                \
    const ElementTables t = TLED_TILE_TABLES;                                                      \
    const TileSliding sliding = {slide_rows,         slide_regions, slide_ints,                    \
                                 slide_row_of_block, slide_queue,   parity};                       \
    process_tile(t, u, out, tiles, places, node_sets, handed, n_blocks, width, 1, sliding,         \
                 physical, cube, 1);                                                               \
  }

TLED_TILE_KERNEL(physical, 1, 0)
TLED_TILE_KERNEL(cubes, 1, 1)
TLED_TILE_KERNEL(kappa, 0, 0)
