// Nodes that slide on triangle surfaces at a fixed distance (Warburton & Maddock 2014, section 5.4):
// after each step a node is put back along the normal of its closest point. Four levels, so that
// nearly every node costs a few multiplications:
//
// 1. While the closest point is on one face the surface is that face's plane, while it is on one edge
//    or corner the surface is that line or point (sliding_plane.cl). What is known to hold is looked at
//    only when the node leaves a ball within which it does.
// 2. Past it, the zone of its face, edge or corner (sliding_zone.cl), which is the same for all nodes, or the
//    zone behind the border that it crossed: there is a new ball.
// 3. Where no zone is known to hold, the exact closest point (face, edge or vertex; side by
//    angle-weighted pseudonormals, Baerentzen & Aanaes 2005) among the node's own candidates: with d_1
//    the nearest distance and d_k the nearest of a triangle that is none, no other can be closest
//    within (d_k - d_1)/2. It is in a zone, or has a region of its own: a ball about the place, less
//    what lies past some borders.
// 4. Past that, the candidates are sought again in a uniform grid of the triangles.
//
// What a node gets does not depend on when levels 2 to 4 were last run for it, but for rounding where
// two of these places meet: a checkpoint holds them. All positions are relative to a point amid the
// nodes. Arrays: sliding_layout.cl.
//
// Of a surface that moves, all this is done as seen from the surface. Friction is Coulomb's with what
// the surface has to push or pull as the normal force: the way along the surface in this step is
// shortened by the coefficient times the way back to the distance, at most to nothing.

// Rows between one and the one that is fetched meanwhile.
#define AHEAD 8

// Displacement of a node at X as seen from a surface in a pose, and a vector turned out of the pose.
INLINE Point seen_from(__global const real* pose, Point X, Point u) {
  const Point p = {X.x + u.x - pose[9], X.y + u.y - pose[10], X.z + u.z - pose[11]};
  const Point seen = {pose[0] * p.x + pose[3] * p.y + pose[6] * p.z - X.x,
                      pose[1] * p.x + pose[4] * p.y + pose[7] * p.z - X.y,
                      pose[2] * p.x + pose[5] * p.y + pose[8] * p.z - X.z};
  return seen;
}
INLINE Points lanes_seen_from(__global const real* pose, Points X, Points u) {
  const realv x = X.x + u.x - pose[9], y = X.y + u.y - pose[10], z = X.z + u.z - pose[11];
  Points seen;
  seen.x = pose[0] * x + pose[3] * y + pose[6] * z - X.x;
  seen.y = pose[1] * x + pose[4] * y + pose[7] * z - X.y;
  seen.z = pose[2] * x + pose[5] * y + pose[8] * z - X.z;
  return seen;
}
INLINE Points lanes_turned(__global const real* pose, Points a) {
  Points b;
  b.x = pose[0] * a.x + pose[1] * a.y + pose[2] * a.z;
  b.y = pose[3] * a.x + pose[4] * a.y + pose[5] * a.z;
  b.z = pose[6] * a.x + pose[7] * a.y + pose[8] * a.z;
  return b;
}
// How far rubbing shortens the way along the surface in a step, as a share of it. off: the way back to
// the distance, along the normal.
INLINE realv rubbed_share(realv coefficient, realv off, realv way) {
  const realv share = coefficient * absolute(off) / (way + R(1e-30));
  return share < R(1.0) ? share : broadcast(R(1.0));
}

// What is known of all nodes.
typedef struct {
  __global real *rows, *regions, *records;
  __global int *heads, *ints, *candidates;
  __global real* candidate_reals;
} SlideArrays;

// A row of nodes and what it slides on; `first` to `last`: the lanes of the work-item.
typedef struct {
  __global real *rows, *regions, *records;
  __global int *ints, *shape, *candidates;
  __global real* candidate_reals;
  // Of a surface that moves, at the begin and at the end of the nodes' step.
  __global const real *pose_before, *pose;
  int moves, first, last;
  long dof;  // of the x component of its first lane
} SlideRow;

INLINE SlideRow row_of(const SlideArrays* a, long place, int first) {
  SlideRow row;
  row.rows = a->rows + place * (SLIDE_ROWS * TLED_LANES);
  row.regions = a->regions + place * (REGION_ROWS * TLED_LANES);
  row.records = a->records + place * (RECORD_REALS * TLED_LANES);
  row.ints = a->ints + place * (SLIDE_INTS * TLED_LANES);
  row.candidates = a->candidates + place * (SLIDE_CANDIDATES * TLED_LANES);
  row.candidate_reals = a->candidate_reals + place * (SLIDE_CANDIDATE_REALS * TLED_LANES);
#if TLED_VECTOR_ROWS
  row.shape = a->heads + place * SLIDE_HEAD + HEAD_SHAPE;
  row.last = TLED_LANES;
  row.dof = (long)a->heads[place * SLIDE_HEAD + HEAD_BLOCK] * (3 * TLED_LANES);
#else
  row.shape = row.ints + SLIDE_SHAPE * TLED_LANES + first;
  row.last = first + 1;
  row.dof = row.ints[first];
#endif
  row.first = first;
  row.moves = 0;
  row.pose_before = row.pose = 0;
  return row;
}

// Where the nodes of a row are as seen from their surface.
INLINE Points lanes_seen(const SlideRow* row, Points u) {
  if (!row->moves) return u;
  return lanes_seen_from(row->pose, lanes_of(row->regions + row->first + REGION_PLACE * TLED_LANES), u);
}

#if TLED_VECTOR_ROWS
// What a row needs is on its way to the cache: what every step reads of it.
INLINE void fetch_row(const SlideRow* row) {
  for (int k = 0; k < SLIDE_ROWS * TLED_LANES; k += LINE_REALS) prefetch_line(row->rows + k);
}
INLINE void fetch_nodes(const SlideRow* row, __global const real* u) {
  for (int k = 0; k < 3 * TLED_LANES; k += LINE_REALS) prefetch_line(u + row->dof + k);
  prefetch_line(u + row->dof + 3 * TLED_LANES - 1);
}
// The zone that a look at a node at displacement u tries first is on its way, or, where there is none, are its
// candidates; the zone, -1.
INLINE int fetch_zone(const SlideArrays* arrays, const SlideSurfaces* s, int place, Point u) {
  __global const real* record = arrays->records + (long)place * RECORD_REALS;
  const real zone = zone_to_try(record, place_of(record, u));
  if (zone >= R(0.0)) {
    __global const real* in = s->zones + (long)zone * ZONE_UNIT;
    for (int k = 0; k < ZONE_BORDERS + ZONE_GROUP_REALS; k += LINE_REALS) prefetch_to_read(in + k);
    if (zone != (real)(int)zone)
      for (int k = ZONE_BORDERS + ZONE_GROUP_REALS; k < ZONE_BORDERS + 2 * ZONE_GROUP_REALS; k += LINE_REALS)
        prefetch_to_read(in + k);
  } else {
    __global const real* reals = arrays->candidate_reals + (long)place * SLIDE_CANDIDATE_REALS;
    __global const int* candidates = arrays->candidates + (long)place * SLIDE_CANDIDATES;
    for (int k = 0; k < SLIDE_CANDIDATE_REALS; k += LINE_REALS) prefetch_line(reals + k);
    prefetch_line((__global const real*)candidates);
    prefetch_line((__global const real*)(candidates + LINE_REALS));
  }
  return (int)zone;
}
#endif

// A lane of a row. Whether a node is there.
INLINE int name_node(const SlideRow* row, int lane, SlideNode* node) {
  node->record = row->records + lane * RECORD_REALS;
  const int surface = (int)node->record[RECORD_SURFACE];
  node->surface = surface >> 3;
  // Held components are looked after by whoever turns the way back, where the surface may turn.
  node->free = row->moves ? 7 : surface & 7;
  node->row_shape = *row->shape;
  node->lane = lane;
  node->rows = row->rows + lane;
  node->region = row->regions + lane;
  node->candidates = row->candidates + lane * SLIDE_CANDIDATES;
  node->candidate_reals = row->candidate_reals + lane * SLIDE_CANDIDATE_REALS;
  return surface >= 0;
}
INLINE int shape_with(int shape, int lane, int round) {
  return (shape & ~(2 << lane)) | round << (lane + 1);
}

// Levels 1 to 4: afterwards the row's surfaces are those of the places `seen` of u.
INLINE void find_surfaces(const SlideRow* row, const SlideSurfaces* s, Points seen,
                          __global const real* u) {
  for (int left = lanes_that_left(ball_of(row->rows + row->first), seen); left; left &= left - 1) {
    const int lane = row->first + lowest_bit(left);
    SlideNode node;
    if (!name_node(row, lane, &node)) continue;
    __global const real* at = u + row->dof + (lane - row->first);
    Point v = {at[0], at[TLED_LANES], at[2 * TLED_LANES]};
    if (row->moves) v = seen_from(row->pose, point_at(node.record + RECORD_PLACE), v);
    const int round = look_at_node(s, &node, v);
    *row->shape = shape_with(*row->shape, lane, round);
  }
}

INLINE void keep_way(WayBack way, __global real* region) {
  store_lanes(way.back.x, region + REGION_ALONG * TLED_LANES);
  store_lanes(way.back.y, region + (REGION_ALONG + 1) * TLED_LANES);
  store_lanes(way.back.z, region + (REGION_ALONG + 2) * TLED_LANES);
}

// A node that may leave is only ever pushed to its side of the surface.
INLINE realv released(realv off, __global const real* region, __global const real* laws) {
  const realv pushed = load_lanes(region + REGION_DISTANCE * TLED_LANES) < R(0.0) ? -off : off;
  const realv held =
      load_lanes(laws + SLIDE_RELEASE * TLED_LANES) > R(0.5) ? pushed : absolute(off);
  return held < R(0.0) ? broadcast(R(0.0)) : off;
}

// Moves a row's nodes to their distance in u_next. laws: 0 where there are none; of_level: of the step
// table, of their level; keep_ways: for reactions.
INLINE void slide_row(const SlideRow* row, const SlideSurfaces* s, __global real* u_next,
                      __global const real* u_now, __global const real* laws,
                      __global const real* of_level, int keep_ways) {
  const long dof = row->dof;
  __global const real* lanes = row->rows + row->first;
  __global real* region = row->regions + row->first;
  Points u = lanes_of(u_next + dof);
  Points seen = lanes_seen(row, u);
  find_surfaces(row, s, seen, u_next);
  WayBack way = way_back(plane_of(lanes), region, *row->shape, seen);
  if (laws) {
    const Points may = lanes_of(laws + SLIDE_MAY * TLED_LANES);
    const realv coefficient = load_lanes(laws + SLIDE_FRICTION * TLED_LANES);
    if (!all_below(coefficient, broadcast(R(1e-30)))) {
      // The way in this step as seen from the surface, and of it the part along the surface.
      Points rubbed = lanes_of(u_now + dof);
      if (row->moves)
        rubbed = lanes_seen_from(row->pose_before,
                                 lanes_of(region + REGION_PLACE * TLED_LANES), rubbed);
      rubbed.x = seen.x - rubbed.x;
      rubbed.y = seen.y - rubbed.y;
      rubbed.z = seen.z - rubbed.z;
      const realv steep = lanes_inner(rubbed, way.normal);
      rubbed.x -= steep * way.normal.x;
      rubbed.y -= steep * way.normal.y;
      rubbed.z -= steep * way.normal.z;
      const realv length = square_root(lanes_inner(rubbed, rubbed));
      const realv share = rubbed_share(coefficient, released(way.off, region, laws), length);
      store_lanes(load_lanes(region + REGION_LOSS * TLED_LANES) +
                      share * length * length * (R(1.0) - share) /
                          (of_level[STEP_FORCE] * of_level[STEP_DUE]),
                  region + REGION_LOSS * TLED_LANES);
      if (row->moves) rubbed = lanes_turned(row->pose, rubbed);
      u.x -= share * may.x * rubbed.x;
      u.y -= share * may.y * rubbed.y;
      u.z -= share * may.z * rubbed.z;
      store_points(u, u_next + dof);
      seen = lanes_seen(row, u);
      find_surfaces(row, s, seen, u_next);
      way = way_back(plane_of(lanes), region, *row->shape, seen);
    }
    way.off = released(way.off, region, laws);
    if (row->moves) {
      const Points to = lanes_turned(row->pose, way.normal);
      const Points free = {may.x * to.x, may.y * to.y, may.z * to.z};
      const realv part = lanes_inner(free, to);
      const realv scale = part > R(0.01) ? R(1.0) / part : broadcast(R(0.0));
      way.back.x = scale * free.x;
      way.back.y = scale * free.y;
      way.back.z = scale * free.z;
    }
  }
  store_points(moved_back(way, u), u_next + dof);
  if (keep_ways) keep_way(way, region);
}

// What the kernels share: what is known of the nodes, and the surfaces. exclusive: restrict, where no
// work-item reads what another has written.
#define TLED_SLIDING_ARGUMENTS_OF(exclusive)                                                       \
  __global real* exclusive slide_rows, __global real* exclusive slide_regions,                     \
      __global real* exclusive slide_records, __global int* exclusive slide_heads,                 \
      __global int* exclusive slide_ints, __global int* exclusive candidates,                      \
      __global real* exclusive candidate_reals, __global const real* restrict triangles,           \
      __global const int* restrict grids, __global const real* restrict grid_reals,                \
      __global const int* restrict cell_begin, __global const int* restrict cell_triangles,        \
      __global const real* restrict zones, __global const int* restrict triangle_zones
#define TLED_SLIDING_ARGUMENTS TLED_SLIDING_ARGUMENTS_OF(restrict)
#define TLED_SLIDE_ARRAYS \
  {slide_rows, slide_regions, slide_records, slide_heads, slide_ints, candidates, candidate_reals}
#define TLED_SLIDE_SURFACES \
  {triangles, grids, grid_reals, cell_begin, cell_triangles, zones, triangle_zones}

// Work-item: a row of TLED_LANES nodes, those of one block, from `first_row` on, or one node where rows are no
// vectors. Moves them to their distance in u_next. pose_column: of the step table; -1: surfaces that
// stand still. has_laws: slide_laws is there. keep_ways: whether the ways back are to be kept, for
// reactions. has_levels: 0 where all nodes are on level 0.
__kernel void slide_nodes(TLED_SLIDING_ARGUMENTS, __global real* restrict u_next,
                          __global const real* restrict u_now,
                          __global const real* restrict slide_laws,
                          __global const int* restrict blocks,
                          __global const real* restrict step_table, int n_items, int first_row,
                          int has_laws, int pose_column, int step_reals, int step_index,
                          int keep_ways, int has_levels) {
  const int item = (int)get_global_id(0);
  if (item >= n_items) return;
#if TLED_VECTOR_ROWS
  const int place = first_row + item, first = 0;
#else
  const int place = first_row + item / TLED_LANES, first = item % TLED_LANES;
#endif
  __global const real* step = step_table + (long)step_index * step_reals;
  const SlideArrays arrays = TLED_SLIDE_ARRAYS;
  const SlideSurfaces surfaces = TLED_SLIDE_SURFACES;
  SlideRow row = row_of(&arrays, place, first);
  const long links = row.dof / (3 * TLED_LANES) * TLED_BLOCK_INTS;
  const int level = has_levels ? NODE_LEVEL(blocks[links + BLOCK_LEVELS]) : 0;
  __global const real* of_level = step + level * TLED_STEP_LEVEL;
  if (of_level[STEP_DUE] == R(0.0)) return;
  if (pose_column >= 0) {
    row.moves = 1;
    row.pose_before = step + pose_column;
    // At the end of the last of the shortest steps in the nodes' own.
    row.pose = step + ((1 << level) - 1) * step_reals + pose_column + POSE_REALS;
  }
#if TLED_VECTOR_ROWS
  if (n_items - 1 - item >= AHEAD) {
    const SlideRow later = row_of(&arrays, place + AHEAD, 0);
    fetch_row(&later);
    fetch_nodes(&later, u_next);
  }
#endif
  __global const real* laws =
      has_laws ? slide_laws + (long)place * TLED_LANES * SLIDE_LAWS + first : 0;
  slide_row(&row, &surfaces, u_next, u_now, laws, of_level, keep_ways);
}

// After a step of kernels that do not keep them: the ways back, for reactions. Work-item: a row, or one node
// where rows are no vectors.
__kernel void keep_ways_back(TLED_SLIDING_ARGUMENTS, __global const real* restrict u_next, int n_items) {
  const int item = (int)get_global_id(0);
  if (item >= n_items) return;
#if TLED_VECTOR_ROWS
  const int place = item, first = 0;
#else
  const int place = item / TLED_LANES, first = item % TLED_LANES;
#endif
  const SlideArrays arrays = TLED_SLIDE_ARRAYS;
  const SlideRow row = row_of(&arrays, place, first);
  keep_way(way_back(plane_of(row.rows + first), row.regions + first, *row.shape,
                    lanes_of(u_next + row.dof)),
           row.regions + first);
}
