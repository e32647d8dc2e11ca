// Nodes that slide on triangle surfaces at a fixed distance (Warburton & Maddock 2014, section 5.4):
// after each step a node is put back along the normal of its closest point. Four levels, so that
// nearly every node costs a few multiplications:
//
// 1. While the closest point is on one face the surface is that face's plane, while it is on one edge
//    or corner the surface is that line or point. What is known to hold is looked at only when the node
//    leaves a ball within which it does.
// 2. Past it, the zone of its face or edge (sliding_zone.cl), which is the same for all nodes, or the
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

// Rows between one and the one whose borders are fetched meanwhile; what leads there as many before each.
#define AHEAD 3
#define LINE_REALS (64 / (int)sizeof(real))

// Displacement of a node at X as seen from a surface in a pose, and a vector turned out of the pose.
INLINE Point seen_from(__global const real* pose, Point X, Point u) {
  const Point p = {X.x + u.x - pose[9], X.y + u.y - pose[10], X.z + u.z - pose[11]};
  const Point seen = {pose[0] * p.x + pose[3] * p.y + pose[6] * p.z - X.x,
                      pose[1] * p.x + pose[4] * p.y + pose[7] * p.z - X.y,
                      pose[2] * p.x + pose[5] * p.y + pose[8] * p.z - X.z};
  return seen;
}
typedef struct { realv x, y, z; } Points;
INLINE Points lanes_of(__global const real* rows) {
  Points p;
  p.x = load_lanes(rows);
  p.y = load_lanes(rows + TLED_LANES);
  p.z = load_lanes(rows + 2 * TLED_LANES);
  return p;
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
INLINE realv lanes_inner(Points a, Points b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// How far rubbing shortens the way along the surface in a step, as a share of it. off: the way back to
// the distance, along the normal.
INLINE realv rubbed_share(realv coefficient, realv off, realv way) {
  const realv share = coefficient * absolute(off) / (way + R(1e-30));
  return share < R(1.0) ? share : broadcast(R(1.0));
}

// A row of nodes and what it slides on; `first` to `last`: the lanes of the work-item.
typedef struct {
  __global real* rows;
  __global real* regions;
  __global int* ints;
  __global int* candidates;
  __global real* candidate_reals;
  // Of a surface that moves, at the begin and at the end of the nodes' step.
  __global const real *pose_before, *pose;
  int moves, first, last;
} SlideRow;

// Where the nodes of a row are as seen from their surface.
INLINE Points lanes_seen(const SlideRow* row, Points u) {
  if (!row->moves) return u;
  return lanes_seen_from(row->pose, lanes_of(row->regions + row->first + REGION_PLACE * TLED_LANES), u);
}

#if TLED_VECTOR_ROWS
// Whether all nodes of a row that is `ahead` rows on are known to be where they were. Surfaces that move
// are not looked ahead for.
INLINE int stays_ahead(const SlideRow* row, __global const real* u, int ahead) {
  __global const real* lanes = row->rows + ahead * SLIDE_ROWS * TLED_LANES;
  const Points now = lanes_of(u + row->ints[ahead * SLIDE_INTS * TLED_LANES]);
  const Points last = lanes_of(lanes + SLIDE_SEEN * TLED_LANES);
  const Points way = {now.x - last.x, now.y - last.y, now.z - last.z};
  const realv slack = load_lanes(lanes + SLIDE_SLACK * TLED_LANES);
  return all_below(lanes_inner(way, way), slack * slack);
}

// What later rows need is on its way meanwhile: their nodes, a little later the places and zones of those
// that are about to be looked at, then the borders there. left: rows behind this one.
INLINE void fetch_ahead(const SlideRow* row, const SlideSurfaces* s, __global const real* u, int left) {
  if (left >= 3 * AHEAD) {
    __global const real* lanes = row->rows + 3 * AHEAD * SLIDE_ROWS * TLED_LANES;
    for (int k = 0; k < SLIDE_ROWS * TLED_LANES; k += LINE_REALS) prefetch_line(lanes + k);
    prefetch_line((__global const real*)(row->ints + 5 * AHEAD * SLIDE_INTS * TLED_LANES));
    __global const real* nodes = u + row->ints[3 * AHEAD * SLIDE_INTS * TLED_LANES];
    for (int k = 0; k < 3 * TLED_LANES; k += LINE_REALS) prefetch_line(nodes + k);
    prefetch_line(nodes + 3 * TLED_LANES - 1);
  }
  if (row->moves) return;
  if (left >= 2 * AHEAD && !stays_ahead(row, u, 2 * AHEAD)) {
    __global const real* places = row->regions + (2 * AHEAD * REGION_ROWS + REGION_PLACE) * TLED_LANES;
    for (int k = 0; k < 3 * TLED_LANES; k += LINE_REALS) prefetch_line(places + k);
    prefetch_line((__global const real*)(row->ints + (2 * AHEAD * SLIDE_INTS + SLIDE_ZONE) * TLED_LANES));
  }
  if (left >= AHEAD && !stays_ahead(row, u, AHEAD))
    for (int lane = 0; lane < TLED_LANES; ++lane) {
      const int zone = row->ints[(AHEAD * SLIDE_INTS + SLIDE_ZONE) * TLED_LANES + lane];
      __global const real* at = u + row->ints[AHEAD * SLIDE_INTS * TLED_LANES + lane];
      __global const real* last = row->rows + AHEAD * SLIDE_ROWS * TLED_LANES + lane;
      const real x = at[0] - last[0], y = at[TLED_LANES] - last[TLED_LANES],
                 z = at[2 * TLED_LANES] - last[2 * TLED_LANES], slack = last[SLIDE_SLACK * TLED_LANES];
      if (zone < 0 || x * x + y * y + z * z < slack * slack) continue;
      __global const real* in = s->zones + (long)zone * ZONE_REALS;
      for (int k = 0; k < ZONE_BORDER + 8 * ZONE_BORDER_REALS; k += LINE_REALS) prefetch_line(in + k);
    }
}
#endif

// Levels 1 to 4: afterwards the row's surfaces are those of the places `seen` of u.
INLINE void find_surfaces(const SlideRow* row, const SlideSurfaces* s, Points seen,
                          __global const real* u) {
  __global real* lanes = row->rows + row->first;
  const Points last = lanes_of(lanes + SLIDE_SEEN * TLED_LANES);
  const Points way = {seen.x - last.x, seen.y - last.y, seen.z - last.z};
  const realv slack = load_lanes(lanes + SLIDE_SLACK * TLED_LANES);
  if (all_below(lanes_inner(way, way), slack * slack)) return;
  __global int* shape = row->ints + SLIDE_SHAPE * TLED_LANES + row->first;
  for (int lane = row->first; lane < row->last; ++lane) {
    const int surface = row->ints[SLIDE_SURFACE * TLED_LANES + lane];
    if (surface < 0) continue;
    __global real* mine = row->rows + lane;
    __global real* region = row->regions + lane;
    const int dof = row->ints[lane];
    Point v = {u[dof], u[dof + TLED_LANES], u[dof + 2 * TLED_LANES]};
    if (row->moves) {
      const Point X = {region[REGION_PLACE * TLED_LANES], region[(REGION_PLACE + 1) * TLED_LANES],
                       region[(REGION_PLACE + 2) * TLED_LANES]};
      v = seen_from(row->pose, X, v);
    }
    const Point since = {v.x - mine[SLIDE_SEEN * TLED_LANES], v.y - mine[(SLIDE_SEEN + 1) * TLED_LANES],
                         v.z - mine[(SLIDE_SEEN + 2) * TLED_LANES]};
    const real holds = mine[SLIDE_SLACK * TLED_LANES];
    if (inner(since, since) < holds * holds) continue;
    // Held components are looked after by whoever turns the way back, where the surface may turn.
    const int round = look_at_node(s, v, surface >> 3, row->moves ? 7 : surface & 7, mine, region,
                                   row->ints + SLIDE_ZONE * TLED_LANES + lane,
                                   row->candidates + lane * SLIDE_CANDIDATES,
                                   row->candidate_reals + lane * SLIDE_CANDIDATE_REALS);
    *shape = (*shape & ~(2 << lane)) | round << (lane + 1);
  }
}

// How far off their distance nodes are, which way is back, and the unit normal.
typedef struct {
  realv off;
  Points back, normal;
} WayBack;

INLINE WayBack way_back(const SlideRow* row, Points seen) {
  __global const real* lanes = row->rows + row->first;
  const int shape = row->ints[SLIDE_SHAPE * TLED_LANES + row->first];
  const realv target = load_lanes(lanes + SLIDE_TARGET * TLED_LANES);
  // The normal, or the edge's direction.
  const Points n = lanes_of(lanes + SLIDE_NORMAL * TLED_LANES);
  WayBack way;
  way.off = target - lanes_inner(n, seen);
  way.normal = way.back = n;
  if (shape & 1) way.back = lanes_of(row->regions + row->first + REGION_ALONG * TLED_LANES);
  if (shape > 1) {
    __global const real* region = row->regions + row->first;
    const realv round = load_lanes(region + REGION_ROUND * TLED_LANES);
    const Points on = lanes_of(region + REGION_ON * TLED_LANES);
    Points q = {seen.x - on.x, seen.y - on.y, seen.z - on.z};
    const realv along = lanes_inner(n, q);
    q.x -= along * n.x;
    q.y -= along * n.y;
    q.z -= along * n.z;
    const realv length = square_root(lanes_inner(q, q));
    const realv scale = round / length;
    way.off = round != R(0.0) ? target - round * length : way.off;
    way.normal.x = round != R(0.0) ? scale * q.x : n.x;
    way.normal.y = round != R(0.0) ? scale * q.y : n.y;
    way.normal.z = round != R(0.0) ? scale * q.z : n.z;
    way.back.x = round != R(0.0) ? way.normal.x : way.back.x;
    way.back.y = round != R(0.0) ? way.normal.y : way.back.y;
    way.back.z = round != R(0.0) ? way.normal.z : way.back.z;
  }
  return way;
}

// A node that may leave is only ever pushed to its side of the surface.
INLINE realv released(realv off, __global const real* region, __global const real* laws) {
  const realv pushed = load_lanes(region + REGION_DISTANCE * TLED_LANES) < R(0.0) ? -off : off;
  const realv held =
      load_lanes(laws + SLIDE_RELEASE * TLED_LANES) > R(0.5) ? pushed : absolute(off);
  return held < R(0.0) ? broadcast(R(0.0)) : off;
}

// Work-item: a row of TLED_LANES nodes, those of one block, from `first_row` on, or one node where rows are no
// vectors. Moves them to their distance in u_next. pose_column: of the step table; -1: surfaces that
// stand still. has_laws: slide_laws is there. keep_ways: whether the ways back are to be kept, for
// reactions. has_levels: 0 where all nodes are on level 0.
__kernel void slide_nodes(__global real* restrict u_next, __global const real* restrict u_now,
                          __global real* restrict slide_rows,
                          __global real* restrict slide_regions, __global int* restrict slide_ints,
                          __global const real* restrict slide_laws,
                          __global int* restrict candidates,
                          __global real* restrict candidate_reals,
                          __global const real* restrict triangles, __global const int* restrict grids,
                          __global const real* restrict grid_reals,
                          __global const int* restrict cell_begin,
                          __global const int* restrict cell_triangles,
                          __global const real* restrict zones,
                          __global const int* restrict triangle_zones,
                          __global const int* restrict blocks,
                          __global const real* restrict step_table, int n_items, int first_row,
                          int has_laws, int pose_column, int step_reals, int step_index,
                          int keep_ways, int has_levels) {
  const int item = (int)get_global_id(0);
  if (item >= n_items) return;
#if TLED_VECTOR_ROWS
  const int place = first_row + item, first = 0, last = TLED_LANES;
#else
  const int place = first_row + item / TLED_LANES, first = item % TLED_LANES, last = first + 1;
#endif
  __global const real* step = step_table + (long)step_index * step_reals;
  const long node = (long)place * TLED_LANES;
  const long dof = slide_ints[node * SLIDE_INTS + first];
  const long links = dof / (3 * TLED_LANES) * TLED_BLOCK_INTS;
  const int level = has_levels ? NODE_LEVEL(blocks[links + BLOCK_LEVELS]) : 0;
  __global const real* of_level = step + level * TLED_STEP_LEVEL;
  if (of_level[STEP_DUE] == R(0.0)) return;
  // The last of the shortest steps in the nodes' own.
  __global const real* end = step + ((1 << level) - 1) * step_reals;
  const SlideRow row = {slide_rows + node * SLIDE_ROWS,
                        slide_regions + node * REGION_ROWS,
                        slide_ints + node * SLIDE_INTS,
                        candidates + node * SLIDE_CANDIDATES,
                        candidate_reals + node * SLIDE_CANDIDATE_REALS,
                        step + (pose_column < 0 ? 0 : pose_column),
                        end + (pose_column < 0 ? 0 : pose_column + POSE_REALS),
                        pose_column >= 0,
                        first,
                        last};
  const SlideSurfaces surfaces = {triangles,      grids, grid_reals,    cell_begin,
                                  cell_triangles, zones, triangle_zones};
  __global real* lanes = row.rows + first;
  __global real* region = row.regions + first;
#if TLED_VECTOR_ROWS
  fetch_ahead(&row, &surfaces, u_next, n_items - 1 - item);
#endif
  Points u = lanes_of(u_next + dof);
  Points seen = lanes_seen(&row, u);
  find_surfaces(&row, &surfaces, seen, u_next);
  WayBack way = way_back(&row, seen);
  if (has_laws) {
    __global const real* laws = slide_laws + node * SLIDE_LAWS + first;
    const Points may = lanes_of(laws + SLIDE_MAY * TLED_LANES);
    const realv coefficient = load_lanes(laws + SLIDE_FRICTION * TLED_LANES);
    if (!all_below(coefficient, broadcast(R(1e-30)))) {
      // The way in this step as seen from the surface, and of it the part along the surface.
      Points rubbed = lanes_of(u_now + dof);
      if (row.moves)
        rubbed = lanes_seen_from(row.pose_before,
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
      if (row.moves) rubbed = lanes_turned(row.pose, rubbed);
      u.x -= share * may.x * rubbed.x;
      u.y -= share * may.y * rubbed.y;
      u.z -= share * may.z * rubbed.z;
      store_lanes(u.x, u_next + dof);
      store_lanes(u.y, u_next + dof + TLED_LANES);
      store_lanes(u.z, u_next + dof + 2 * TLED_LANES);
      seen = lanes_seen(&row, u);
      find_surfaces(&row, &surfaces, seen, u_next);
      way = way_back(&row, seen);
    }
    way.off = released(way.off, region, laws);
    if (row.moves) {
      const Points to = lanes_turned(row.pose, way.normal);
      const Points free = {may.x * to.x, may.y * to.y, may.z * to.z};
      const realv part = lanes_inner(free, to);
      const realv scale = part > R(0.01) ? R(1.0) / part : broadcast(R(0.0));
      way.back.x = scale * free.x;
      way.back.y = scale * free.y;
      way.back.z = scale * free.z;
    }
  }
  store_lanes(u.x + way.off * way.back.x, u_next + dof);
  store_lanes(u.y + way.off * way.back.y, u_next + dof + TLED_LANES);
  store_lanes(u.z + way.off * way.back.z, u_next + dof + 2 * TLED_LANES);
  if (keep_ways) {
    store_lanes(way.back.x, region + REGION_ALONG * TLED_LANES);
    store_lanes(way.back.y, region + (REGION_ALONG + 1) * TLED_LANES);
    store_lanes(way.back.z, region + (REGION_ALONG + 2) * TLED_LANES);
  }
}
