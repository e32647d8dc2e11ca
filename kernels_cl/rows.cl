// Fused element + node kernel for CPUs: vector rows of a block's lanes, no barrier, no atomics.
//
// One work-item owns a band of blocks that follow each other in memory. It walks them chunk by chunk in
// x, row by row in y, and plane by plane in z:
//
//        z ^   as: forces on the shared face, from the element below
//          |   +-------+        what an element gives a node row of the next y goes into `scratch`
//        k |   | elem  |  --->  (rows a plane), what its last lanes in x give the first of the
//          |   +-------+        block behind goes into `edge`.
//          +-----------> y
//
// The transform of the face between two elements of a column is done once and stays in registers.
// A node is finished as soon as all its elements have given their forces: it is integrated on the
// spot, u_next over u_prev, which nobody else reads. A chunk and a row of elements before the band are
// computed here too (its seeds), so bands do not wait for each other. The order in which a node's
// forces are added does not depend on how rows are dealt to bands: results are the same bits for any
// number of threads.

// One component of a face's modes from the values at its four edges in x.
INLINE void load_face_component(__global const real* lower, __global const real* lower_next,
                                __global const real* upper, __global const real* upper_next,
                                Face* face, const int component) {
  const int row = component * TLED_LANES;
  const realv l = load_lanes(lower + row), right = load_lanes(lower_next + row);
  const realv h = next_in_y(l, load_lanes(upper + row));
  const realv ln = next_in_x(l, right);
  const realv hn = next_in_x(h, next_in_y(right, load_lanes(upper_next + row)));
  const realv a = l + ln, b = ln - l, c = h + hn, d = hn - h;
  face->s[component] = a + c;
  face->x[component] = b + d;
  face->y[component] = c - a;
  face->xy[component] = d - b;
}

// Modes of the four corner values that the elements of `block` have at the block's own z.
INLINE void load_face(__global const real* u, __global const int* blocks, int block, Face* face) {
  __global const int* links = blocks + (long)block * TLED_BLOCK_INTS;
  __global const real* l = u + (long)block * (3 * TLED_LANES);
  __global const real* ln = u + (long)links[BLOCK_NEXT_X] * (3 * TLED_LANES);
  __global const real* h = u + (long)links[BLOCK_NEXT_Y] * (3 * TLED_LANES);
  __global const real* hn = u + (long)links[BLOCK_NEXT_XY] * (3 * TLED_LANES);
  load_face_component(l, ln, h, hn, face, 0);
  load_face_component(l, ln, h, hn, face, 1);
  load_face_component(l, ln, h, hn, face, 2);
}

INLINE void clear_face(Face* f) {
  const realv zero = broadcast(R(0.0));
  for (int c = 0; c < 3; ++c) f->s[c] = f->x[c] = f->y[c] = f->xy[c] = zero;
}

// Corner forces of one component from the face's; those at high y go into scratch. Returns the
// force on the block's own nodes; *next: on those one on in x, the last of which are the next block's.
INLINE realv distribute(FaceForce f, __global const real* from_left, __global real* scratch,
                        realv* next, const int component) {
  const realv lower = f.s - f.y, lower_x = f.x - f.xy, upper = f.s + f.y, upper_x = f.x + f.xy;
  __global real* scratch_next = scratch + 3 * TLED_LANES;
  const realv upper_own = upper - upper_x, upper_next = upper + upper_x;
  const realv own = lower - lower_x + previous_in_y(upper_own, load_lanes(scratch));
  *next = lower + lower_x + previous_in_y(upper_next, load_lanes(scratch_next));
  store_lanes(upper_own, scratch);
  store_lanes(upper_next, scratch_next);
  return own + previous_behind_edge(*next, from_left, component);
}

// u_next = u + velocity (u - u_prev) - force f / m + gravity, zero increment where 1/m is 0.
INLINE void integrate(__global const real* u, __global real* u_prev,
                      __global const real* inverse_mass, __global const real* step, int has_gravity,
                      realv f, int component) {
  const int row = component * TLED_LANES;
  const realv now = load_lanes(u + row), before = load_lanes(u_prev + row),
              w = load_lanes(inverse_mass + row);
  realv next = now + step[STEP_VELOCITY] * (now - before) - (step[STEP_FORCE] * w) * f;
  if (has_gravity)
    next += w > R(0.0) ? broadcast(step[STEP_GRAVITY + component]) : broadcast(R(0.0));
  store_lanes(next, u_prev + row);
}

// The nodes of a block whose elements' forces on them are complete but for what lies in scratch and
// edge. out: u_prev, which becomes the next displacement, or the forces (forces_only).
typedef struct {
  __global const real *u, *inverse_mass, *step, *from_left;  // step: of their level
  __global real *out, *scratch, *to_right;
  int seed, has_gravity;
} RowNodes;

// Returns the forces on the nodes one on in x.
INLINE realv finish_component(RowNodes n, FaceForce f, const int component, const int forces_only) {
  realv next;
  const realv force =
      distribute(f, n.from_left, n.scratch + component * TLED_LANES, &next, component);
  if (n.seed) return next;
  if (forces_only)
    store_lanes(force, n.out + component * TLED_LANES);
  else
    integrate(n.u, n.out, n.inverse_mass, n.step, n.has_gravity, force, component);
  return next;
}

// What a band's rows read and write: out as above, scratch and edge the band's own.
typedef struct {
  __global const real *u, *node_sets;
  __global real *out, *scratch, *edge;
} RowArrays;

// What holds for a row of blocks.
#define ROW_SEED 1     // forces only into scratch and edge; nodes belong to the band before
#define ROW_GRAVITY 2  // there is gravity

#define EDGE_REALS TLED_EDGE_REALS(TLED_WIDTH, TLED_LANES)

INLINE RowNodes row_nodes(ElementTables t, RowArrays a, __global const int* links, int block,
                          int flags, const int has_levels) {
  const long at = (long)block * (3 * TLED_LANES);
  const int levels = has_levels ? links[BLOCK_LEVELS] : 0;
  RowNodes n;
  n.seed = flags & ROW_SEED;
  n.has_gravity = flags & ROW_GRAVITY;
  n.step = t.step + NODE_LEVEL(levels) * TLED_STEP_LEVEL;
  n.u = a.u + at;
  n.out = a.out + at;
  n.inverse_mass = a.node_sets + (long)links[BLOCK_NODE] * (TLED_NODE_ROWS * TLED_LANES);
  n.scratch = a.scratch + (long)links[BLOCK_PLANE] * (SCRATCH_ROWS * TLED_LANES);
  const int edge = links[BLOCK_EDGE];
  n.to_right = a.edge + (long)(edge < 0 ? -edge : edge) * EDGE_REALS;
  // What a block that rests has left there is of an earlier step.
  const int nothing = edge < 0 ||
      (has_levels && t.step[PREV_X_LEVEL(levels) * TLED_STEP_LEVEL + STEP_DUE] == R(0.0));
  n.from_left = nothing ? a.edge + TLED_NO_EDGE * EDGE_REALS : n.to_right;
  return n;
}

// What the forces of a block's elements count: 0 where there are none or, of a block whose nodes are
// due, where they rest, since their neighbours are stiffer.
INLINE real element_weight(ElementTables t, __global const int* links, const int has_levels) {
  if (links[BLOCK_MATERIAL] < 0) return R(0.0);
  if (!has_levels) return R(1.0);
  return t.step[ELEMENT_LEVEL(links[BLOCK_LEVELS]) * TLED_STEP_LEVEL + STEP_DUE];
}

// One block of a row that ends before block `end`. Its elements lie between the faces `low` and
// `high`, the first *n_faces of which are there already. Where it pays (LOADS_AHEAD) the face above
// the next block is loaded into `low` before this block's forces are dealt out: the next one's long
// chain of sums and products then begins while these are waited for. `high` is the next block's `low`.
INLINE void process_block(ElementTables t, RowArrays a, int block, int end, int flags, Face* low,
                          Face* high, Face* carried, int* n_faces, const int physical,
                          const int cube, const int forces_only, const int has_levels) {
  __global const int* links = t.blocks + (long)block * TLED_BLOCK_INTS;
  const RowNodes nodes = row_nodes(t, a, links, block, flags, has_levels);
  const real weight = element_weight(t, links, has_levels);
  realv next_x, next_y, next_z;
  if (weight != R(0.0)) {
    if (*n_faces < 1) load_face(a.u, t.blocks, block, low);
    if (*n_faces < 2) load_face(a.u, t.blocks, block + 1, high);
    ElementForce e;
    row_element(t, low, high, links, links[BLOCK_MATERIAL], block, 0, !forces_only && !nodes.seed,
                physical, cube, &e);
    *n_faces = 1;
    if (LOADS_AHEAD && block + 1 < end &&
        element_weight(t, links + TLED_BLOCK_INTS, has_levels) != R(0.0)) {
      load_face(a.u, t.blocks, block + 2, low);
      *n_faces = 2;
    }
    if (weight != R(1.0)) weigh_element(&e, weight);
    next_x = finish_component(nodes, element_force_x(&e, carried, physical), 0, forces_only);
    next_y = finish_component(nodes, element_force_y(&e, carried, physical), 1, forces_only);
    next_z = finish_component(nodes, element_force_z(&e, carried, physical), 2, forces_only);
  } else {
    next_x = finish_component(nodes, carried_only(carried, 0), 0, forces_only);
    next_y = finish_component(nodes, carried_only(carried, 1), 1, forces_only);
    next_z = finish_component(nodes, carried_only(carried, 2), 2, forces_only);
    *n_faces = 0;
  }
  store_last(next_x, next_y, next_z, nodes.to_right);
}

// Which rows there are, and the bands they are dealt to (layout.cl).
typedef struct {
  __global const int *bands, *row_begin, *rows;
  int n_planes, n_edges, n_y;
} RowTable;

INLINE void process_rows(ElementTables t, __global const real* u, __global real* out, RowTable table,
                         __global const real* node_sets, __global real* all_scratch,
                         __global real* all_edges, const SlideArrays* slides,
                         const SlideSurfaces* surfaces, const int physical, const int cube,
                         const int forces_only, const int has_levels) {
  const int band = (int)get_global_id(0);
  __global real* scratch = all_scratch + band * SCRATCH_REALS((long)table.n_planes, TLED_LANES);
  __global real* edge =
      all_edges + band * BAND_EDGE_REALS((long)table.n_edges, TLED_WIDTH, TLED_LANES);
  const RowArrays arrays = {u, node_sets, out, scratch, edge};
  const int gravity = t.step[STEP_GRAVITY] != R(0.0) || t.step[STEP_GRAVITY + 1] != R(0.0) ||
                              t.step[STEP_GRAVITY + 2] != R(0.0)
                          ? ROW_GRAVITY
                          : 0;
  SlidingQueue queue;
  queue.n_zones = queue.n_records = 0;
  const SlidingRows rows = {slides, surfaces, &queue};
  const SlidingRows* sliding = slides ? &rows : 0;  // 0: no nodes are put back here
  const int begin_cell = table.bands[2 * band], end_cell = table.bands[2 * band + 1];
  // Whose elements have nodes in the band: the rows behind its first one's neighbour in the chunk before.
  const int from_cell = begin_cell > table.n_y ? begin_cell - table.n_y - 1 : 0;
  const int own = table.row_begin[begin_cell];
  Face one, other, carried;
  int y = from_cell % table.n_y, is_clear = 0;
  for (int cell = from_cell; cell < end_cell; ++cell, ++y) {
    if (y == table.n_y) y = is_clear = 0;
    // Where nothing is walked nothing reads it: of the rows that are due there may be few.
    if (!is_clear && table.row_begin[cell] < table.row_begin[cell + 1]) {
      for (int i = 0; i < table.n_planes * SCRATCH_ROWS; ++i)
        store_lanes(broadcast(R(0.0)), scratch + i * TLED_LANES);
      is_clear = 1;
    }
    for (int i = table.row_begin[cell]; i < table.row_begin[cell + 1]; ++i) {
      __global const int* row = table.rows + TLED_RUN * i;
      const int begin = row[RUN_BLOCK], end = begin + row[RUN_BLOCKS];
      const int flags = (i < own ? ROW_SEED : 0) | gravity;
      int n_faces = 0;
      clear_face(&carried);
      for (int block = begin; block < end; ++block) {
        process_block(t, arrays, block, end, flags, &one, &other, &carried, &n_faces, physical, cube,
                      forces_only, has_levels);
#if LOADS_AHEAD
        if (++block == end) break;
        process_block(t, arrays, block, end, flags, &other, &one, &carried, &n_faces, physical, cube,
                      forces_only, has_levels);
#else
        one = other;
#endif
      }
      if (sliding && i >= own) put_rows_back(sliding, row[RUN_SLIDING], row[RUN_SLIDING_COUNT], out);
    }
  }
  if (sliding) finish_queue(sliding, out);
}

// One explicit step. u: displacement now; u_prev: the one before, replaced by the next.
// step_table: row `step_index` of `step_reals` reals. has_levels: 0 where all are on level 0, which
// saves 7 % of the instructions. Work-item: a band.
#define TLED_ROWS_ARGUMENTS                                                                        \
  __global const real* restrict u, __global real* restrict u_prev,                                 \
      __global const int* restrict bands, __global const int* restrict row_begin,                  \
      __global const int* restrict rows,                                                           \
      __global const int* restrict blocks, __global const real* restrict materials,                \
      __global const real* restrict node_sets, __global const int* restrict law_entries,           \
      __global const real* restrict law_sets, __global const real* restrict history,               \
      __global real* restrict next_history, __global const int* restrict muscle_entries,           \
      __global const real* restrict muscle_sets, __global const real* restrict muscle_constants,   \
      __global const real* restrict shape, __global const real* restrict step_table,               \
      __global real* restrict scratch, __global real* restrict edge, int n_bands, int n_planes,    \
      int n_edges, int n_y, int step_index, int step_reals
#define TLED_ROWS_TABLES                                                           \
  {blocks,         materials,    law_entries, law_sets,                            \
   history,        next_history, muscle_entries, muscle_sets,                      \
   muscle_constants, shape,      step_table + step_index * step_reals}
#define TLED_ROWS_TABLE {bands, row_begin, rows, n_planes, n_edges, n_y}

#define TLED_ROWS_KERNEL(name, physical, cube, forces_only, has_levels)                            \
  __kernel void name(TLED_ROWS_ARGUMENTS) {                                                        \
    if ((int)get_global_id(0) >= n_bands) return;                                                  \
    const ElementTables t = TLED_ROWS_TABLES;                                                      \
    const RowTable table = TLED_ROWS_TABLE;                                                        \
    process_rows(t, u, u_prev, table, node_sets, scratch, edge, 0, 0, physical, cube, forces_only, \
                 has_levels);                                                                      \
  }

// The same with sliding nodes put back behind their row of blocks (sliding_rows.cl).
#define TLED_SLIDING_ROWS_KERNEL(name, physical, cube)                                             \
  __kernel void name(TLED_ROWS_ARGUMENTS, TLED_SLIDING_ARGUMENTS) {                                \
    if ((int)get_global_id(0) >= n_bands) return;                                                  \
    const ElementTables t = TLED_ROWS_TABLES;                                                      \
    const SlideArrays sliding = TLED_SLIDE_ARRAYS;                                                 \
    const SlideSurfaces surfaces = TLED_SLIDE_SURFACES;                                            \
    const RowTable table = TLED_ROWS_TABLE;                                                        \
    process_rows(t, u, u_prev, table, node_sets, scratch, edge, &sliding, &surfaces, physical,     \
                 cube, 0, 0);                                                                      \
  }

// Subcycling: exchanges displacement and the one before of blocks that were due and are above level
// 0, since steps of level 0 write them in turns. Work-item: a block of `list`.
__kernel void swap_blocks(__global real* restrict u, __global real* restrict u_prev,
                          __global const int* restrict list, int n) {
  if ((int)get_global_id(0) >= n) return;
  const long at = (long)list[get_global_id(0)] * (3 * TLED_LANES);
  for (int row = 0; row < 3; ++row) {
    const realv a = load_lanes(u + at + row * TLED_LANES);
    store_lanes(load_lanes(u_prev + at + row * TLED_LANES), u + at + row * TLED_LANES);
    store_lanes(a, u_prev + at + row * TLED_LANES);
  }
}

TLED_ROWS_KERNEL(step_rows_physical, 1, 0, 0, 0)
TLED_ROWS_KERNEL(step_rows_cubes, 1, 1, 0, 0)
TLED_ROWS_KERNEL(step_rows_kappa, 0, 0, 0, 0)
TLED_SLIDING_ROWS_KERNEL(step_sliding_physical, 1, 0)
TLED_SLIDING_ROWS_KERNEL(step_sliding_cubes, 1, 1)
TLED_SLIDING_ROWS_KERNEL(step_sliding_kappa, 0, 0)
TLED_ROWS_KERNEL(step_levels_physical, 1, 0, 0, 1)
TLED_ROWS_KERNEL(step_levels_cubes, 1, 1, 0, 1)
TLED_ROWS_KERNEL(step_levels_kappa, 0, 0, 0, 1)
TLED_ROWS_KERNEL(force_rows_physical, 1, 0, 1, 1)
TLED_ROWS_KERNEL(force_rows_kappa, 0, 0, 1, 1)
