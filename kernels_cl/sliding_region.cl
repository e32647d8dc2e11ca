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
  int n_borders;
  real within[REGION_MOST_BORDERS];
  Point outward[REGION_MOST_BORDERS];
} Region;

INLINE void hold_within(Region* region, real distance) {
  region->ball = distance < region->ball ? distance : region->ball;
}
// A border: the nearest are kept, the others shrink the ball.
INLINE void hold_before(Region* region, real distance, Point outward) {
  if (distance >= region->ball) return;
  int at = region->n_borders;
  if (at == REGION_MOST_BORDERS) {
    --at;
    if (distance >= region->within[at]) {
      hold_within(region, distance);
      return;
    }
    hold_within(region, region->within[at]);
  } else {
    ++region->n_borders;
  }
  for (; at > 0 && region->within[at - 1] > distance; --at) {
    region->within[at] = region->within[at - 1];
    region->outward[at] = region->outward[at - 1];
  }
  region->within[at] = distance;
  region->outward[at] = outward;
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

// The region of a face, without the other triangles: the prism over it.
INLINE void hold_over_face(Region* region, __global const real* triangle, Point p) {
  const Point n = point_at(triangle + TRIANGLE_NORMAL);
  for (int side = 0; side < 3; ++side) {
    const Point a = point_at(triangle + 3 * side),
                along = minus(point_at(triangle + 3 * ((side + 1) % 3)), a);
    // Inwards where the corners run counter-clockwise about n; an axis order may have turned that.
    Point inwards = unit_of(across(n, along));
    if (inner(inwards, minus(point_at(triangle + 3 * ((side + 2) % 3)), a)) < R(0.0))
      inwards = times(R(-1.0), inwards);
    hold_before(region, inner(inwards, minus(p, a)), times(R(-1.0), inwards));
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
  __global int *zone, *candidates;
  __global real* candidate_reals;
} SlideNode;

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
    seek_candidates(s, node->surface, p, candidates, reals);
    moved = R(0.0);
  }
  const int count = candidates[0];
  for (int k = 0; k < count && k < 8; ++k)
    for (int line = 0; line < TRIANGLE_NORMAL + 3; line += LINE_REALS)
      prefetch_line(s->triangles + (long)candidates[1 + k] * TRIANGLE_REALS + line);
  // A candidate is at least as far as it was, less the way since.
  real known[SLIDE_MOST];
  int n_known = 0, face = -1;
  Nearest best;
  best.at = p;
  best.square = R(0.0);
  best.feature = 0;
  real distance = R(0.0);
  for (; n_known < count; ++n_known) {
    // A little farther, for rounding.
    if (face >= 0 && R(0.9999) * reals[4 + n_known] - moved > distance) break;
    const int t = candidates[1 + n_known];
    const Nearest n = closest_on_triangle(s->triangles + (long)t * TRIANGLE_REALS, p);
    known[n_known] = square_root_of(n.square);
    if (face < 0 || n.square < best.square || (n.square == best.square && t < face)) {
      best = n;
      face = t;
      distance = known[n_known];
    }
  }
  if (face < 0) return 0;  // no number is near anything
  if (best.feature < 4) {
    const int behind = node->record[RECORD_DISTANCE] < R(0.0);
    const int part = (behind ? TRIANGLE_ZONES / 2 : 0) + best.feature;
    *zone = zone_of(s, s->triangle_zones[(long)face * TRIANGLE_ZONES + part], p, node->free, left, nearest);
    if (*zone >= 0) {
      const SlideShape shape = shape_of_zone(s->zones + (long)*zone * ZONE_UNIT, p);
      write_shape(shape, node->record, node->free, node->row_shape, node->lane, node->rows,
              node->region);
      return shape.round != R(0.0);
    }
  }
  __global const real* triangle = s->triangles + (long)face * TRIANGLE_REALS;
  const Point away = minus(p, best.at);
  const Point first = point_at(triangle), normal = point_at(triangle + TRIANGLE_NORMAL);
  const real size = square_root_of(inner(minus(point_at(triangle + 3), first),
                                         minus(point_at(triangle + 3), first)));
  // What rounding may lift a corner of a flat neighbour off the plane.
  const real flat = FLAT * square_root_of(inner(p, p)) + FLAT * size;
  Region region;
  region.ball = reals[3] - moved;
  region.n_borders = 0;
  Point n = normal, on = first, axis = {R(0.0), R(0.0), R(0.0)}, far_end = first;
  real side, round = R(0.0);
  if (best.feature == 0) {
    side = inner(away, normal) < R(0.0) ? R(-1.0) : R(1.0);
    hold_over_face(&region, triangle, p);
  } else {
    const Point pseudo =
        point_at(triangle + (best.feature < 4 ? TRIANGLE_EDGES + 3 * (best.feature - 1)
                                              : TRIANGLE_VERTICES + 3 * (best.feature - 4)));
    side = inner(away, pseudo) < R(0.0) ? R(-1.0) : R(1.0);
    // Within rounding of the surface the way to it has no direction: the pseudonormal has.
    const int has_way = distance > R(1e-6) * size;
    n = has_way ? times(side / distance, away) : pseudo;
    on = best.at;
    // Held components, and no way: a plane for this step alone.
    if (node->free == 7 && has_way) {
      round = side;
      hold_within(&region, distance);
      if (best.feature < 4) {
        on = point_at(triangle + 3 * (best.feature - 1));
        far_end = point_at(triangle + 3 * (best.feature % 3));
        // The same end whichever of its two triangles the edge was found by.
        if (on.x > far_end.x || (on.x == far_end.x && (on.y > far_end.y || (on.y == far_end.y &&
                                                                           on.z > far_end.z)))) {
          const Point swap = on;
          on = far_end;
          far_end = swap;
        }
        const Point along = minus(far_end, on);
        axis = unit_of(along);
        const real at = inner(axis, minus(p, on));
        hold_before(&region, at, times(R(-1.0), axis));
        hold_before(&region, square_root_of(inner(along, along)) - at, axis);
      } else {
        on = point_at(triangle + 3 * (best.feature - 4));
      }
    } else {
      region.ball = R(0.0);
    }
  }
  // The triangles beside an edge: what lies behind both is never nearer than the edge.
  __global const real* beside[2] = {triangle, triangle};
  int n_beside = 0;
  if (round != R(0.0))
    for (int k = 0; k < count; ++k) {
      __global const real* other = s->triangles + (long)candidates[1 + k] * TRIANGLE_REALS;
      Point inwards;
      if (best.feature < 4) {
        if (!beside_edge(other, on, far_end, axis, &inwards)) continue;
        hold_before(&region, -inner(inwards, minus(p, on)), inwards);
        if (n_beside < 2) beside[n_beside] = other;
        ++n_beside;
      } else if (is_corner(other, on)) {
        for (int corner = 0; corner < 3; ++corner) {
          const Point v = point_at(other + 3 * corner);
          if (same(v, on)) continue;
          const Point along = unit_of(minus(v, on));
          hold_before(&region, -inner(along, minus(p, on)), along);
        }
      }
    }
  for (int k = 0; k < count && region.ball > R(0.0); ++k) {
    const int t = candidates[1 + k];
    __global const real* other = s->triangles + (long)t * TRIANGLE_REALS;
    if (best.feature == 0 ? t == face : best.feature < 4 ? n_beside && (other == beside[0] || other == beside[1])
                                                         : is_corner(other, on))
      continue;
    const real least = R(0.9999) * reals[4 + k] - moved;
    if (k >= n_known && R(0.49) * (least - distance) >= region.ball) break;
    const real there = k < n_known ? known[k] : square_root_of(closest_on_triangle(other, p).square);
    real hold = R(0.49) * (there - distance);
    if (hold >= region.ball) continue;
    if (best.feature == 0) {
      const Point up = times(side, normal);
      const Point off = minus(p, closest_on_triangle(other, p).at);
      // The plane at the other's closest point, across the way to it, has the other behind it: while
      // the node is higher over that plane than over this triangle's.
      Point tilt = minus(there > R(0.0) ? times(R(1.0) / there, off) : up, up);
      real slope = square_root_of(inner(tilt, tilt)), lead = there - distance;
      if (height_over(other, triangle, up, first) <= flat) {
        // Behind this one's plane: never nearer than that, as long as the node stays before it, or
        // is less deep behind this one's plane than behind the other's.
        const Point facing = times(side, point_at(other + TRIANGLE_NORMAL)), turn = minus(up, facing);
        const real ahead = inner(up, minus(p, first)) - inner(facing, minus(p, point_at(other)));
        const real bend = square_root_of(inner(turn, turn));
        hold = distance > hold ? distance : hold;
        if (bend > R(1e-3) && ahead * slope > lead * bend) {
          tilt = turn;
          slope = bend;
          lead = ahead;
        }
      }
      slope = slope > R(1e-6) ? slope : R(1e-6);
      if (lead > hold * slope) {
        hold_before(&region, lead / slope, times(R(-1.0) / slope, tilt));
        continue;
      }
    } else if (best.feature < 4 && n_beside == 2 && round > R(0.0)) {
      const Point n0 = point_at(beside[0] + TRIANGLE_NORMAL),
                  n1 = point_at(beside[1] + TRIANGLE_NORMAL);
      if (height_over(other, beside[0], n0, on) <= flat && height_over(other, beside[1], n1, on) <= flat)
        hold = distance > hold ? distance : hold;
    }
    hold_within(&region, hold);
  }
  // A little less, for rounding.
  real radius = R(0.98) * region.ball - flat;
  radius = radius > R(0.0) ? radius : R(0.0);
  real slack = radius;
  for (int k = 0; k < REGION_MOST_BORDERS; ++k) {
    __global real* border = node->record + RECORD_BORDERS + 4 * k;
    const int is = k < region.n_borders;
    const real within = is ? R(0.98) * region.within[k] - flat : R(1.0);
    const Point out = is ? region.outward[k] : times(R(0.0), normal);
    border[0] = out.x;
    border[1] = out.y;
    border[2] = out.z;
    border[3] = inner(out, u) + within;
    slack = within < slack ? within : slack;
  }
  const real values[4] = {u.x, u.y, u.z, radius};
  for (int k = 0; k < 4; ++k) node->record[RECORD_ANCHOR + k] = values[k];
  const SlideShape shape = {round != R(0.0) ? axis : n, on, n, round};
  write_shape(shape, node->record, node->free, node->row_shape, node->lane, node->rows,
              node->region);
  *left = slack;
  return round != R(0.0);
}

// How far a node is in its own region; not above 0 outside.
INLINE real left_in_region(__global const real* record, Point u) {
  const Point way = minus(u, point_at(record + RECORD_ANCHOR));
  real left = record[RECORD_RADIUS] - square_root_of(inner(way, way));
  for (int k = 0; k < REGION_MOST_BORDERS; ++k) {
    __global const real* border = record + RECORD_BORDERS + 4 * k;
    const real to = border[3] - inner(point_at(border), u);
    left = to < left ? to : left;
  }
  return left;
}

// Looks at a node at displacement u that may have left its zone or region. The result says whether
// it is on an edge or corner.
OUT_OF_LINE int look_at_node(const SlideSurfaces* s, const SlideNode* node, Point u) {
  __global real* record = node->record;
  const Point X = point_at(record + RECORD_PLACE);
  const Point p = {X.x + u.x, X.y + u.y, X.z + u.z};
  // A state that has run away is for the watch to report, not to be sought for.
  const real square = inner(p, p);
  if (!(square < LOST * LOST)) return 0;
  const int before = *node->zone;
  real left = R(0.0);
  int nearest = 0, now = zone_of(s, before, p, node->free, &left, &nearest), round;
  if (now >= 0) {
    __global const real* in = s->zones + (long)now * ZONE_UNIT;
    round = in[ZONE_ROUND] != R(0.0);
    if (now != before)
      write_shape(shape_of_zone(in, p), record, node->free, node->row_shape, node->lane, node->rows,
                  node->region);
  } else {
    left = before < 0 ? left_in_region(record, u) : R(0.0);
    round = node->row_shape >> (node->lane + 1) & 1;
    if (!(left > R(0.0))) round = find_surface(s, node, u, p, &now, &left, &nearest);
  }
  if (now != before) *node->zone = now;
  Point middle = u;
  if (now >= 0) {
    __global const real* in = s->zones + (long)now * ZONE_UNIT;
    __global const real* border = in + ZONE_BORDER + nearest * ZONE_BORDER_REALS;
    const real ball = ball_in_zone(in, p, nearest, left);
    middle = plus_scaled(u, left - ball, point_at(border));
    // A little less, for rounding.
    left = R(0.99999) * ball - FLAT * square_root_of(square);
    for (int k = 0; k < 4; ++k) record[RECORD_EXIT + k] = border[k];
    record[RECORD_NEXT] = border[4];
  } else {
    record[RECORD_NEXT] = R(-1.0);
  }
  const real values[4] = {middle.x, middle.y, middle.z, left > R(0.0) ? left : R(0.0)};
  for (int k = 0; k < 4; ++k) node->rows[(SLIDE_SEEN + k) * TLED_LANES] = values[k];
  return round;
}
