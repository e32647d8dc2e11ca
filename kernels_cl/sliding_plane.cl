// Level 1 of sliding.cl: a row of nodes on the surfaces that are known for its places, planes and what
// is round about edges and corners.

typedef struct { realv x, y, z; } Points;
INLINE Points lanes_of(__global const real* rows) {
  Points p;
  p.x = load_lanes(rows);
  p.y = load_lanes(rows + TLED_LANES);
  p.z = load_lanes(rows + 2 * TLED_LANES);
  return p;
}
INLINE realv lanes_inner(Points a, Points b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// What level 1 reads of a row of slide_rows.
typedef struct { Points seen; realv slack; } Ball;
typedef struct { Points normal; realv target; } Plane;
INLINE Ball ball_of(__global const real* lanes) {
  const Ball ball = {lanes_of(lanes + SLIDE_SEEN * TLED_LANES),
                     load_lanes(lanes + SLIDE_SLACK * TLED_LANES)};
  return ball;
}
// normal: or the edge's direction.
INLINE Plane plane_of(__global const real* lanes) {
  const Plane plane = {lanes_of(lanes + SLIDE_NORMAL * TLED_LANES),
                       load_lanes(lanes + SLIDE_TARGET * TLED_LANES)};
  return plane;
}

// Nodes of a row that are no longer where its surfaces are known to hold: lanes, as bits.
INLINE realv square_from(Ball ball, Points seen) {
  const Points way = {seen.x - ball.seen.x, seen.y - ball.seen.y, seen.z - ball.seen.z};
  return lanes_inner(way, way);
}
INLINE int lanes_that_left(Ball ball, Points seen) {
  return lanes_not_below(square_from(ball, seen), ball.slack * ball.slack);
}
// `to` of those that are still there; the others as they are.
INLINE Points points_within(Ball ball, Points seen, Points to) {
  const realv square = square_from(ball, seen), most = ball.slack * ball.slack;
  to.x = square < most ? to.x : seen.x;
  to.y = square < most ? to.y : seen.y;
  to.z = square < most ? to.z : seen.z;
  return to;
}

// How far off their distance nodes are, which way is back, and the unit normal.
typedef struct {
  realv off;
  Points back, normal;
} WayBack;

// region: of slide_regions; shape: SLIDE_SHAPE.
INLINE WayBack way_back(Plane plane, __global const real* region, int shape, Points seen) {
  const realv target = plane.target;
  const Points n = plane.normal;
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

INLINE Points moved_back(WayBack way, Points u) {
  u.x = u.x + way.off * way.back.x;
  u.y = u.y + way.off * way.back.y;
  u.z = u.z + way.off * way.back.z;
  return u;
}
INLINE void store_points(Points u, __global real* nodes) {
  store_lanes(u.x, nodes);
  store_lanes(u.y, nodes + TLED_LANES);
  store_lanes(u.z, nodes + 2 * TLED_LANES);
}
