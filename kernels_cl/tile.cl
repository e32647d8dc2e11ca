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
// own node two planes ahead, some bring one of the last column or row besides. They and the links of
// blocks are asked for a plane before, what moves the node at the begin of its plane. Of all that is in
// local memory there are two buffers that take turns: one barrier a plane is enough, since who writes
// a buffer again has passed the barrier behind its last reading.
// A node adds its forces in an order that tiles have no part in: shapes of tiles do not change a bit.
// Nodes that slide are put back as soon as they are moved (level 1 of sliding.cl), or wait in its queue.

// Real by real: vectors would need local memory that is aligned better than some drivers align it.
INLINE Vec local_vec(__local const real* p) {
  const Vec v = {p[0], p[1], p[2]};
  return v;
}
INLINE void put_local(real x, real y, real z, __local real* p) {
  p[0] = x;
  p[1] = y;
  p[2] = z;
}

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

INLINE Vec fetch_node(__global const real* u, int block, int lane) {
  const int at = block * (3 * TLED_LANES) + lane;
  const Vec node = {u[at], u[at + TLED_LANES], u[at + 2 * TLED_LANES]};
  return node;
}

// Component c of the modes of a face, of the displacements at its corners.
INLINE void modes_of(real lower, real lower_next, real upper, real upper_next, const int c, Face* face) {
  const real a = lower + lower_next, b = lower_next - lower;
  const real d = upper + upper_next, e = upper_next - upper;
  face->s[c] = a + d;
  face->x[c] = b + e;
  face->y[c] = d - a;
  face->xy[c] = e - b;
}
// corner: displacement of the low one, next: from a row of nodes to the one behind it.
INLINE void face_of(__local const real* corner, int next, Face* face) {
  const Vec lower = local_vec(corner), lower_next = local_vec(corner + 3),
            upper = local_vec(corner + next), upper_next = local_vec(corner + next + 3);
  modes_of(lower.x, lower_next.x, upper.x, upper_next.x, 0, face);
  modes_of(lower.y, lower_next.y, upper.y, upper_next.y, 1, face);
  modes_of(lower.z, lower_next.z, upper.z, upper_next.z, 2, face);
}

// An element's forces on its low face by corner: the item's own, those behind it in x, in y and in both.
typedef struct { real own, x, y, xy; } CornerForce;
INLINE CornerForce by_corner(FaceForce f) {
  const real lower = f.s - f.y, lower_x = f.x - f.xy, upper = f.s + f.y, upper_x = f.x + f.xy;
  const CornerForce force = {lower - lower_x, lower + lower_x, upper - upper_x, upper + upper_x};
  return force;
}

// Sliding nodes of a tile; of_block: the row of those of a block, -1: none.
typedef struct {
  __global const real *rows, *regions;
  __global const int *ints, *of_block;
  volatile __global int* queue;
  int parity;
} TileSliding;

// What an item walks with, that stays.
typedef struct {
  __global const real *u, *node_sets;
  __global real* out;
  __local real *handed, *planes;
  Column own, more;
  NodeMotion motion;
  int item, n_items, width, row_reals, plane_reals, plane_places, last, n_blocks, n_planes;
  int brings_more, has_column, integrates;
} TileWalk;
// Where it is.
typedef struct {
  // Blocks of the item's node on this plane and the next two; of the other column on the one after.
  int block, next_block, ahead, ahead_block, more_block;
  int material, node_set, levels, slide_row;  // of block
  Face carried;  // forces on the face between this plane's elements and those below
} TilePlace;

// What the end of a plane and the planes to come need of global memory.
typedef struct {
  Vec coming, more_coming, before, inverse_mass;
  SlidingNode held;
  int far_block, material, node_set, levels, slide_row;
} TileFetch;

// Whether the item has a node on this plane that the tile owns.
INLINE int owns_node(const TileWalk* w, const TilePlace* at, int plane) {
  return w->has_column && plane > 0 && at->block < w->n_blocks;
}

// Asks for that, and goes on to the places after the next two.
INLINE void fetch_for(ElementTables t, const TileWalk* w, TilePlace* at, int plane, TileSliding sliding,
                      const int slides, TileFetch* f) {
  const Vec zero = {R(0.0), R(0.0), R(0.0)};
  f->coming = fetch_node(w->u, at->ahead_block, w->own.lane);
  if (w->brings_more) f->more_coming = fetch_node(w->u, at->more_block, w->more.lane);
  at->ahead = min(at->ahead + w->plane_places, w->last);
  f->far_block = w->own.place[at->ahead];
  if (w->brings_more) at->more_block = w->more.place[at->ahead];
  __global const int* links = t.blocks + at->next_block * TLED_BLOCK_INTS;
  f->material = links[BLOCK_MATERIAL];
  f->node_set = links[BLOCK_NODE];
  f->levels = links[BLOCK_LEVELS];
  f->slide_row = slides ? sliding.of_block[at->next_block] : -1;
  f->before = f->inverse_mass = zero;
  if (owns_node(w, at, plane)) {
    if (slides && at->slide_row >= 0)
      f->held = sliding_node(sliding.rows, sliding.ints, at->slide_row, w->own.lane);
    f->before = fetch_node(w->out, at->block, w->own.lane);
    f->inverse_mass = fetch_node(w->node_sets, at->node_set, w->own.lane);
  }
}

// One plane. low, high: modes of the faces below and above its elements; turn: which of two buffers.
INLINE void walk_plane(ElementTables t, const TileWalk* w, TilePlace* at, int plane, const int turn,
                       const Face* low, Face* high, TileSliding sliding, const int physical,
                       const int cube, const int slides) {
  const int lane = w->own.lane, block = at->block;
  __local real* here = w->planes + turn * w->plane_reals;
  __local real* mine = w->handed + (turn * w->n_items + w->item) * TLED_TILE_HANDED;
  TileFetch f;
  fetch_for(t, w, at, plane, sliding, slides, &f);
  face_of(w->planes + (1 - turn) * w->plane_reals + w->own.at, w->row_reals, high);
  CornerForce x, y, z;
  if (HAS_ELEMENT(at->levels, lane)) {
    ElementForce e;
    row_element(t, low, high, t.blocks + block * TLED_BLOCK_INTS, at->material, block, lane,
                w->integrates && owns_node(w, at, plane), physical, cube, &e);
    x = by_corner(element_force_x(&e, &at->carried, physical));
    y = by_corner(element_force_y(&e, &at->carried, physical));
    z = by_corner(element_force_z(&e, &at->carried, physical));
  } else {
    x = by_corner(carried_only(&at->carried, 0));
    y = by_corner(carried_only(&at->carried, 1));
    z = by_corner(carried_only(&at->carried, 2));
  }
  put_local(x.x, y.x, z.x, mine);
  put_local(x.y, y.y, z.y, mine + 3);
  put_local(x.xy, y.xy, z.xy, mine + 6);
  const Vec node = local_vec(here + w->own.at);
  put_local(f.coming.x, f.coming.y, f.coming.z, here + w->own.at);
  if (w->brings_more) put_local(f.more_coming.x, f.more_coming.y, f.more_coming.z, here + w->more.at);
  barrier(CLK_LOCAL_MEM_FENCE);
  if (owns_node(w, at, plane)) {
    __local const real* behind = mine - w->width * TLED_TILE_HANDED;
    const Vec left = local_vec(mine - TLED_TILE_HANDED), below = local_vec(behind + 3),
              before_it = local_vec(behind - TLED_TILE_HANDED + 6);
    real next[3] = {(x.own + left.x) + (below.x + before_it.x), (y.own + left.y) + (below.y + before_it.y),
                    (z.own + left.z) + (below.z + before_it.z)};
    if (w->integrates) {
      next[0] = next_displacement(node.x, f.before.x, f.inverse_mass.x, &w->motion, next[0], 0);
      next[1] = next_displacement(node.y, f.before.y, f.inverse_mass.y, &w->motion, next[1], 1);
      next[2] = next_displacement(node.z, f.before.z, f.inverse_mass.z, &w->motion, next[2], 2);
    }
    if (slides && at->slide_row >= 0)
      hold_node(f.held, sliding.regions, sliding.queue, sliding.parity, at->slide_row, lane, next);
    __global real* to = w->out + block * (3 * TLED_LANES) + lane;
    for (int c = 0; c < 3; ++c) to[c * TLED_LANES] = next[c];
  }
  at->block = at->next_block;
  at->next_block = at->ahead_block;
  at->ahead_block = f.far_block;
  at->material = f.material;
  at->node_set = f.node_set;
  at->levels = f.levels;
  at->slide_row = f.slide_row;
}

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
  __global const int* tile = tiles + (long)get_group_id(0) * TLED_TILE_INTS;
  const int first = tile[TILE_FIRST];
  TileWalk w;
  w.u = u;
  w.out = out;
  w.node_sets = node_sets;
  w.item = item;
  w.n_items = n_items;
  w.width = width;
  w.n_blocks = n_blocks;
  w.integrates = integrates;
  w.row_reals = 3 * (width + 1);
  w.plane_reals = (rows + 1) * w.row_reals;
  w.plane_places = (rows + 1) * across;
  w.n_planes = tile[TILE_PLANES];
  w.last = (w.n_planes + 1 - first) * w.plane_places;
  w.handed = handed;
  w.planes = handed + 2 * n_items * TLED_TILE_HANDED;
  places += tile[TILE_PLACES] + first * w.plane_places;
  w.own = column_of(tile, places, i, j, width, across);
  w.has_column = i > 0 && j > 0;
  // The nodes behind the last column, then those behind the last row.
  w.brings_more = item < rows + 1 + width;
  w.more = item <= rows ? column_of(tile, places, width, item, width, across)
                        : column_of(tile, places, item - rows - 1, rows, width, across);
  set_motion(t.step, &w.motion);

  TilePlace at;
  at.block = w.own.place[0];
  at.next_block = w.own.place[w.plane_places];
  at.ahead = min(2 * w.plane_places, w.last);
  at.ahead_block = w.own.place[at.ahead];
  at.more_block = 0;
  const Vec node = fetch_node(u, at.block, w.own.lane), next = fetch_node(u, at.next_block, w.own.lane);
  put_local(node.x, node.y, node.z, w.planes + w.own.at);
  put_local(next.x, next.y, next.z, w.planes + w.plane_reals + w.own.at);
  if (w.brings_more) {
    const Vec corner = fetch_node(u, w.more.place[0], w.more.lane),
              above = fetch_node(u, w.more.place[w.plane_places], w.more.lane);
    put_local(corner.x, corner.y, corner.z, w.planes + w.more.at);
    put_local(above.x, above.y, above.z, w.planes + w.plane_reals + w.more.at);
    at.more_block = w.more.place[at.ahead];
  }
  __global const int* links = t.blocks + at.block * TLED_BLOCK_INTS;
  at.material = links[BLOCK_MATERIAL];
  at.node_set = links[BLOCK_NODE];
  at.levels = links[BLOCK_LEVELS];
  at.slide_row = slides ? sliding.of_block[at.block] : -1;
  for (int c = 0; c < 3; ++c)
    at.carried.s[c] = at.carried.x[c] = at.carried.y[c] = at.carried.xy[c] = R(0.0);
  barrier(CLK_LOCAL_MEM_FENCE);
  Face low, high;
  face_of(w.planes + w.own.at, w.row_reals, &low);
  barrier(CLK_LOCAL_MEM_FENCE);  // the first plane's buffer is written again
  for (int plane = first, turn = 0; plane <= w.n_planes; ++plane, turn = 1 - turn) {
    walk_plane(t, &w, &at, plane, turn, &low, &high, sliding, physical, cube, slides);
    low = high;
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
