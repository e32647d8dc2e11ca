// Level 1 of sliding.cl: a row of nodes on the surfaces that are known for its places, planes and what
// is round about edges and corners. In the row kernels it is done as soon as a row's nodes are
// finished, while they are in the nearest cache.

// Reals of a line of the cache.
#define LINE_REALS (64 / (int)sizeof(real))

typedef struct { realv x, y, z; } Points;
INLINE Points lanes_of(__global const real* rows) {
  Points p;
  p.x = load_lanes(rows);
  p.y = load_lanes(rows + TLED_LANES);
  p.z = load_lanes(rows + 2 * TLED_LANES);
  return p;
}
INLINE realv lanes_inner(Points a, Points b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Whether all nodes of a row (of slide_rows) are where its surfaces are known to hold.
INLINE int all_stay(__global const real* lanes, Points seen) {
  const Points last = lanes_of(lanes + SLIDE_SEEN * TLED_LANES);
  const Points way = {seen.x - last.x, seen.y - last.y, seen.z - last.z};
  const realv slack = load_lanes(lanes + SLIDE_SLACK * TLED_LANES);
  return all_below(lanes_inner(way, way), slack * slack);
}

// How far off their distance nodes are, which way is back, and the unit normal.
typedef struct {
  realv off;
  Points back, normal;
} WayBack;

// lanes: of slide_rows, region: of slide_regions; shape: SLIDE_SHAPE.
INLINE WayBack way_back(__global const real* lanes, __global const real* region, int shape,
                        Points seen) {
  const realv target = load_lanes(lanes + SLIDE_TARGET * TLED_LANES);
  // The normal, or the edge's direction.
  const Points n = lanes_of(lanes + SLIDE_NORMAL * TLED_LANES);
  WayBack way;
  way.off = target - lanes_inner(n, seen);
  way.normal = way.back = n;
  if (shape & 1) way.back = lanes_of(region + REGION_ALONG * TLED_LANES);
  if (shape > 1) {
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

INLINE void put_back(WayBack way, Points u, __global real* nodes) {
  store_lanes(u.x + way.off * way.back.x, nodes);
  store_lanes(u.y + way.off * way.back.y, nodes + TLED_LANES);
  store_lanes(u.z + way.off * way.back.z, nodes + 2 * TLED_LANES);
}

#if TLED_VECTOR_ROWS
// Rows of sliding nodes that a row kernel puts back itself: those of surfaces that stand still, without
// laws and without other conditions on their nodes (csrc/sim/sliding).
typedef struct {
  __global const real *rows, *regions;
  __global const int* heads;
  __global int* looks;
} SlidingRows;

// Rows whose memory is fetched ahead of the one at hand: a row of blocks has but a few.
#define SLIDING_AHEAD 6

// Puts back the rows from `row` on whose blocks are below `end`, all of which are finished; those that
// left their balls are marked instead, for look_at_rows of sliding.cl.
OUT_OF_LINE void put_rows_back(const SlidingRows* s, int row, int end, __global real* u_next) {
  for (;; ++row) {
    __global const int* head = s->heads + row * SLIDE_HEAD;
    const int block = head[HEAD_BLOCK];
    if (block >= end) return;
    __global const real* lanes = s->rows + (long)row * (SLIDE_ROWS * TLED_LANES);
    for (int k = 0; k < SLIDE_ROWS * TLED_LANES; k += LINE_REALS)
      prefetch_line(lanes + SLIDING_AHEAD * SLIDE_ROWS * TLED_LANES + k);
    __global real* nodes = u_next + (long)block * (3 * TLED_LANES);
    const Points u = lanes_of(nodes);
    if (!all_stay(lanes, u)) {
      s->looks[row] = 1;
      continue;
    }
    put_back(way_back(lanes, s->regions + (long)row * (REGION_ROWS * TLED_LANES), head[HEAD_SHAPE], u), u,
             nodes);
  }
}
#endif
