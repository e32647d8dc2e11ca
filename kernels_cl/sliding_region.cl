// Level 3 of sliding.cl: the face, edge or corner that is nearest to a node, exactly, and the region of
// places for which that is known to hold.

// Places farther than this from the middle of the nodes are lost, m.
#define LOST R(1e3)
// Share of a coordinate that rounding is worth, twice over.
#if TLED_DOUBLE
#define FLAT R(4e-16)
#else
#define FLAT R(2e-7)
#endif

// Where a closest point is known to stay on its face, edge or corner: within `ball` of the node, but
// not past borders that are `within` of it in the directions `outward`, the nearest first.
typedef struct {
  real ball;
  real within[REGION_MOST_BORDERS];  // NO_BORDER: none
  Point outward[REGION_MOST_BORDERS];
} Region;

INLINE void begin_region(Region* region, real ball) {
  const Point nowhere = {R(0.0), R(0.0), R(0.0)};
  region->ball = ball;
  for (int k = 0; k < REGION_MOST_BORDERS; ++k) {
    region->within[k] = NO_BORDER;
    region->outward[k] = nowhere;
  }
}
INLINE void hold_within(Region* region, real distance) {
  region->ball = distance < region->ball ? distance : region->ball;
}
// A border: the nearest are kept, the others shrink the ball. Each goes through all places, so that none
// is looked up by a number and registers hold them.
INLINE void hold_before(Region* region, real distance, Point outward) {
  if (distance >= region->ball) return;
  int found = 0;
  for (int k = 0; k < REGION_MOST_BORDERS; ++k) {
    const real within = region->within[k];
    const Point other = region->outward[k];
    found |= distance < within;
    region->within[k] = found ? distance : within;
    region->outward[k].x = found ? outward.x : other.x;
    region->outward[k].y = found ? outward.y : other.y;
    region->outward[k].z = found ? outward.z : other.z;
    distance = found ? within : distance;
    outward.x = found ? other.x : outward.x;
    outward.y = found ? other.y : outward.y;
    outward.z = found ? other.z : outward.z;
  }
  hold_within(region, distance);
}

INLINE int same(Point a, Point b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

INLINE int is_corner(__global const real* triangle, Point v) {
  return same(point_at(triangle), v) || same(point_at(triangle + 3), v) ||
         same(point_at(triangle + 6), v);
}

// Height of a triangle's highest corner over a plane, of those that are none of the plane's triangle:
// the ones both have are on it, whatever the rounding.
INLINE real height_over(__global const real* other, __global const real* triangle, Point n,
                        Point on) {
  real most = R(-1.0);
  for (int corner = 0; corner < 3; ++corner) {
    const Point v = point_at(other + 3 * corner);
    if (is_corner(triangle, v)) continue;
    const real height = inner(n, minus(v, on));
    most = height > most ? height : most;
  }
  return most;
}

// Inwards from a side of a face, in its plane.
INLINE Point inwards_of(__global const real* triangle, int side) {
  const Point a = point_at(triangle + 3 * side),
              along = minus(point_at(triangle + 3 * ((side + 1) % 3)), a),
              inwards = unit_of(across(point_at(triangle + TRIANGLE_NORMAL), along));
  // Where the corners run counter-clockwise about the normal; an axis order may have turned that.
  return inner(inwards, minus(point_at(triangle + 3 * ((side + 2) % 3)), a)) < R(0.0)
             ? times(R(-1.0), inwards)
             : inwards;
}
INLINE real inside_of(__global const real* triangle, int side, Point inwards, Point p) {
  return inner(inwards, minus(p, point_at(triangle + 3 * side)));
}

// The region of a face, without the other triangles: the prism over it.
INLINE void hold_over_face(Region* region, __global const real* triangle, Point p) {
  for (int side = 0; side < 3; ++side) {
    const Point inwards = inwards_of(triangle, side);
    hold_before(region, inside_of(triangle, side, inwards, p), times(R(-1.0), inwards));
  }
}

// Whether a triangle has both ends of an edge; if so, the direction in its plane from the edge to its
// third corner.
INLINE int beside_edge(__global const real* triangle, Point a, Point b, Point along,
                       Point* inwards) {
  if (!is_corner(triangle, a) || !is_corner(triangle, b)) return 0;
  for (int corner = 0; corner < 3; ++corner) {
    const Point v = point_at(triangle + 3 * corner);
    if (same(v, a) || same(v, b)) continue;
    const Point off = minus(v, a);
    *inwards = unit_of(plus_scaled(off, -inner(off, along), along));
    return 1;
  }
  return 0;
}

// A node and what is known of it: its lane of the rows of lanes.
typedef struct {
  int surface, free, row_shape, lane;
  __global real *rows, *region, *record;
  __global int* candidates;
  __global real* candidate_reals;
} SlideNode;

// A candidate is at least as far as it was, less the way since. Candidates are in the order of how far
// they were, so that none behind one that is beyond is nearer either; a little farther, for rounding.
INLINE real least_distance(real was, real moved) { return R(0.9999) * was - moved; }

// Number of the zone of a triangle's part.
INLINE int zone_of_part(const SlideSurfaces* s, const SlideNode* node, int face, int feature) {
  const int behind = node->record[RECORD_DISTANCE] < R(0.0);
  const int part = (behind ? TRIANGLE_ZONES / 2 : 0) + feature;
  return s->triangle_zones[(long)face * TRIANGLE_ZONES + part];
}

// What is nearest to a place p, at a distance: a face, edge or corner of a triangle.
typedef struct {
  __global const real* triangle;
  int feature;
  Point p, normal, first;  // of the triangle: its normal, a corner
  real distance, side;
  // As SlideShape has them; and the edge's other end.
  real round;
  Point n, on, axis, far_end;
  real at, length;  // of an edge: where on it, and its own
  real flat;  // what rounding may lift a corner of a flat neighbour off the plane
  int lasts;  // 0: a plane for this step alone
} Foot;

INLINE void find_foot(__global const real* triangle, Nearest best, Point p, real distance, int free,
                      Foot* foot) {
  const Point away = minus(p, best.at);
  foot->triangle = triangle;
  foot->feature = best.feature;
  foot->p = p;
  foot->distance = distance;
  foot->first = point_at(triangle);
  foot->normal = point_at(triangle + TRIANGLE_NORMAL);
  const real size = square_root_of(inner(minus(point_at(triangle + 3), foot->first),
                                         minus(point_at(triangle + 3), foot->first)));
  foot->flat = FLAT * square_root_of(inner(p, p)) + FLAT * size;
  foot->lasts = 1;
  foot->n = foot->normal;
  foot->on = foot->far_end = foot->first;
  const Point nowhere = {R(0.0), R(0.0), R(0.0)};
  foot->axis = nowhere;
  foot->round = foot->at = foot->length = R(0.0);
  if (best.feature == 0) {
    foot->side = inner(away, foot->normal) < R(0.0) ? R(-1.0) : R(1.0);
    return;
  }
  const Point pseudo =
      point_at(triangle + (best.feature < 4 ? TRIANGLE_EDGES + 3 * (best.feature - 1)
                                            : TRIANGLE_VERTICES + 3 * (best.feature - 4)));
  foot->side = inner(away, pseudo) < R(0.0) ? R(-1.0) : R(1.0);
  // Within rounding of the surface the way to it has no direction: the pseudonormal has.
  const int has_way = distance > R(1e-6) * size;
  foot->n = has_way ? times(foot->side / distance, away) : pseudo;
  foot->on = best.at;
  // Held components, and no way.
  if (free != 7 || !has_way) {
    foot->lasts = 0;
    return;
  }
  foot->round = foot->side;
  if (best.feature > 3) {
    foot->on = point_at(triangle + 3 * (best.feature - 4));
    return;
  }
  Point on = point_at(triangle + 3 * (best.feature - 1)),
        far_end = point_at(triangle + 3 * (best.feature % 3));
  // The same end whichever of its two triangles the edge was found by.
  if (on.x > far_end.x ||
      (on.x == far_end.x && (on.y > far_end.y || (on.y == far_end.y && on.z > far_end.z)))) {
    const Point swap = on;
    on = far_end;
    far_end = swap;
  }
  foot->on = on;
  foot->far_end = far_end;
  const Point along = minus(far_end, on);
  foot->axis = unit_of(along);
  foot->at = inner(foot->axis, minus(p, on));
  foot->length = square_root_of(inner(along, along));
}

// The region of a foot without other triangles; `ball` holds the candidates.
INLINE void begin_region_of(const Foot* foot, real ball, Region* region) {
  begin_region(region, foot->lasts ? ball : R(0.0));
  if (foot->feature == 0) hold_over_face(region, foot->triangle, foot->p);
  if (foot->round == R(0.0)) return;
  hold_within(region, foot->distance);
  if (foot->feature > 3) return;
  hold_before(region, foot->at, times(R(-1.0), foot->axis));
  hold_before(region, foot->length - foot->at, foot->axis);
}

// Borders that a triangle beside the foot's edge or about its corner adds: how many. What lies behind both
// triangles beside an edge is never nearer than the edge.
typedef struct {
  real distance;
  Point outward;
} Border;
INLINE int borders_beside(const Foot* foot, __global const real* other, Border* one, Border* two) {
  if (foot->feature < 4) {
    if (!beside_edge(other, foot->on, foot->far_end, foot->axis, &one->outward)) return 0;
    one->distance = -inner(one->outward, minus(foot->p, foot->on));
    return 1;
  }
  if (!is_corner(other, foot->on)) return 0;
  int count = 0;
  for (int corner = 0; corner < 3; ++corner) {
    const Point v = point_at(other + 3 * corner);
    if (same(v, foot->on)) continue;
    Border border;
    border.outward = unit_of(minus(v, foot->on));
    border.distance = -inner(border.outward, minus(foot->p, foot->on));
    if (count++)
      *two = border;
    else
      *one = border;
  }
  return 2;
}

// How far a foot is the nearest at least, with another triangle at distance `there`.
INLINE real held_by_distance(const Foot* foot, real there) {
  return R(0.49) * (there - foot->distance);
}

// What holds with a triangle that is neither the foot's nor beside it, at distance `there`, whose closest
// point is `at` (asked for where the foot is a face): a ball of no less than `hold`, or before a border,
// which is no nearer than that. beside: the triangles beside an edge; 0: they are not known to be two.
typedef struct {
  int is_border;
  real distance;
  Point outward;
} Held;
INLINE Held held_by(const Foot* foot, __global const real* other, real there, Point at, real hold,
                    __global const real* beside0, __global const real* beside1) {
  Held held = {0, hold, {R(0.0), R(0.0), R(0.0)}};
  if (foot->feature == 0) {
    const Point up = times(foot->side, foot->normal);
    const Point off = minus(foot->p, at);
    // The plane at the other's closest point, across the way to it, has the other behind it: while
    // the node is higher over that plane than over this triangle's.
    Point tilt = minus(there > R(0.0) ? times(R(1.0) / there, off) : up, up);
    real slope = square_root_of(inner(tilt, tilt)), lead = there - foot->distance;
    if (height_over(other, foot->triangle, up, foot->first) <= foot->flat) {
      // Behind this one's plane: never nearer than that, as long as the node stays before it, or
      // is less deep behind this one's plane than behind the other's.
      const Point facing = times(foot->side, point_at(other + TRIANGLE_NORMAL)),
                  turn = minus(up, facing);
      const real ahead =
          inner(up, minus(foot->p, foot->first)) - inner(facing, minus(foot->p, point_at(other)));
      const real bend = square_root_of(inner(turn, turn));
      held.distance = foot->distance > hold ? foot->distance : hold;
      if (bend > R(1e-3) && ahead * slope > lead * bend) {
        tilt = turn;
        slope = bend;
        lead = ahead;
      }
    }
    slope = slope > R(1e-6) ? slope : R(1e-6);
    if (lead > held.distance * slope) {
      held.is_border = 1;
      held.distance = lead / slope;
      held.outward = times(R(-1.0) / slope, tilt);
    }
  } else if (foot->feature < 4 && beside0 && foot->round > R(0.0)) {
    const Point n0 = point_at(beside0 + TRIANGLE_NORMAL), n1 = point_at(beside1 + TRIANGLE_NORMAL);
    if (height_over(other, beside0, n0, foot->on) <= foot->flat &&
        height_over(other, beside1, n1, foot->on) <= foot->flat)
      held.distance = foot->distance > hold ? foot->distance : hold;
  }
  return held;
}
INLINE void take(Region* region, Held held) {
  if (held.is_border)
    hold_before(region, held.distance, held.outward);
  else
    hold_within(region, held.distance);
}

// Writes the ball of a node's own region about displacement u; its radius.
INLINE real write_region_ball(real ball, const Foot* foot, Point u, __global real* record) {
  // A little less, for rounding.
  const real less = R(0.98) * ball - foot->flat, radius = less > R(0.0) ? less : R(0.0);
  const real values[4] = {u.x, u.y, u.z, radius};
  for (int k = 0; k < 4; ++k) record[RECORD_ANCHOR + k] = values[k];
  return radius;
}

// And its borders; how far the region holds.
INLINE real write_region(const Region* region, const Foot* foot, Point u, const SlideNode* node) {
  real slack = write_region_ball(region->ball, foot, u, node->record);
  for (int k = 0; k < REGION_MOST_BORDERS; ++k) {
    __global real* border = node->candidate_reals + CANDIDATE_BORDERS + 4 * k;
    const int is = region->within[k] < NO_BORDER;
    const real within = is ? R(0.98) * region->within[k] - foot->flat : R(1.0);
    const Point out = region->outward[k];
    border[0] = out.x;
    border[1] = out.y;
    border[2] = out.z;
    border[3] = inner(out, u) + within;
    slack = within < slack ? within : slack;
  }
  return slack;
}

INLINE SlideShape shape_of_foot(const Foot* foot) {
  const SlideShape shape = {foot->round != R(0.0) ? foot->axis : foot->n, foot->on, foot->n,
                            foot->round};
  return shape;
}

INLINE void write_node_shape(const SlideNode* node, SlideShape shape) {
  write_shape(shape, node->record, node->free, node->row_shape, node->lane, node->rows,
              node->region);
}

// Levels 3 and 4 for one node at displacement u, at p: its surface, its zone and how far that holds.
// The result says whether it is on an edge or corner.
OUT_OF_LINE int find_surface(const SlideSurfaces* s, const SlideNode* node, Point u, Point p, int* zone,
                             real* left, int* nearest) {
  __global int* candidates = node->candidates;
  __global real* reals = node->candidate_reals;
  *zone = -1;
  *left = R(0.0);
  Point off = minus(p, point_at(reals));
  real moved = square_root_of(inner(off, off));
  if (!(moved < reals[3])) {
    seek_candidates(s, node->surface, p, node->record[RECORD_DISTANCE], candidates, reals);
    moved = R(0.0);
  }
  const int count = candidates[0];
  for (int k = 0; k < count && k < 8; ++k)
    for (int line = 0; line < TRIANGLE_NORMAL + 3; line += LINE_REALS)
      prefetch_line(s->triangles + (long)candidates[1 + k] * TRIANGLE_REALS + line);
  real known[SLIDE_MOST];
  int n_known = 0, face = -1;
  Nearest best;
  best.at = p;
  best.square = R(0.0);
  best.feature = 0;
  real distance = R(0.0);
  for (; n_known < count; ++n_known) {
    if (face >= 0 && least_distance(reals[4 + n_known], moved) > distance) break;
    const int t = candidates[1 + n_known];
    const Nearest n = closest_on_triangle(s->triangles + (long)t * TRIANGLE_REALS, p);
    known[n_known] = square_root_of(n.square);
    if (is_nearer(n.square, t, best.square, face)) {
      best = n;
      face = t;
      distance = known[n_known];
    }
  }
  if (face < 0) return 0;  // no number is near anything
  *zone = zone_of(s, zone_of_part(s, node, face, best.feature), p, node->free, left, nearest);
  if (*zone >= 0) {
    const SlideShape shape = shape_of_zone(s->zones + (long)*zone * ZONE_UNIT, p);
    write_node_shape(node, shape);
    return shape.round != R(0.0);
  }
  __global const real* triangle = s->triangles + (long)face * TRIANGLE_REALS;
  Region region;
  Foot foot;
  find_foot(triangle, best, p, distance, node->free, &foot);
  begin_region_of(&foot, reals[3] - moved, &region);
  __global const real* beside[2] = {triangle, triangle};
  int n_beside = 0;
  if (foot.round != R(0.0))
    for (int k = 0; k < count; ++k) {
      __global const real* other = s->triangles + (long)candidates[1 + k] * TRIANGLE_REALS;
      Border one, two;
      const int n_borders = borders_beside(&foot, other, &one, &two);
      if (!n_borders) continue;
      hold_before(&region, one.distance, one.outward);
      if (n_borders > 1) hold_before(&region, two.distance, two.outward);
      if (n_beside < 2) beside[n_beside] = other;
      ++n_beside;
    }
  for (int k = 0; k < count && region.ball > R(0.0); ++k) {
    const int t = candidates[1 + k];
    __global const real* other = s->triangles + (long)t * TRIANGLE_REALS;
    if (best.feature == 0 ? t == face : best.feature < 4 ? n_beside && (other == beside[0] || other == beside[1])
                                                         : is_corner(other, foot.on))
      continue;
    // What is skipped here and by the next would shrink nothing: held_by gives no less than this.
    if (k >= n_known && held_by_distance(&foot, least_distance(reals[4 + k], moved)) >= region.ball) break;
    const real there = k < n_known ? known[k] : square_root_of(closest_on_triangle(other, p).square);
    const real hold = held_by_distance(&foot, there);
    if (hold >= region.ball) continue;
    take(&region, held_by(&foot, other, there, best.feature == 0 ? closest_on_triangle(other, p).at : p,
                          hold, n_beside == 2 ? beside[0] : 0, beside[1]));
  }
  *left = write_region(&region, &foot, u, node);
  write_node_shape(node, shape_of_foot(&foot));
  return foot.round != R(0.0);
}
