// A look at a node that left the ball in which nothing changes: levels 2 to 4 of sliding.cl, and its next
// ball.

// How far a node is in its own region; not above 0 outside.
INLINE real left_in_region(const SlideNode* node, Point u) {
  __global const real* record = node->record;
  const Point way = minus(u, point_at(record + RECORD_ANCHOR));
  real left = record[RECORD_RADIUS] - square_root_of(inner(way, way));
  for (int k = 0; k < REGION_MOST_BORDERS; ++k) {
    __global const real* border = node->candidate_reals + CANDIDATE_BORDERS + 4 * k;
    const real to = border[3] - inner(point_at(border), u);
    left = to < left ? to : left;
  }
  return left;
}

// A state that has run away is for the watch to report, not to be sought for.
INLINE int is_lost(Point p) { return !(inner(p, p) < LOST * LOST); }

// What is known of a node at displacement u, at p, after a look: its zone `now` and how far that
// holds, of `now` >= 0 to its border `nearest`, and the ball in it.
INLINE void write_look(const SlideSurfaces* s, const SlideNode* node, Point u, Point p, int now,
                       int nearest, real left, real ball) {
  __global real* record = node->record;
  record[RECORD_ZONE] = now < 0 ? R(-1.0) : zone_name(s, now);
  Point middle = u;
  if (now >= 0) {
    __global const real* zone = s->zones + (long)now * ZONE_UNIT;
    middle = plus_scaled(u, left - ball, border_normal(zone, nearest));
    // A little less, for rounding.
    left = R(0.99999) * ball - FLAT * square_root_of(inner(p, p));
    __global const real* border = zone + ZONE_BORDER_AT(nearest);
    for (int k = 0; k < 4; ++k) record[RECORD_EXIT + k] = border[k * ZONE_GROUP];
    record[RECORD_NEXT] = border[4 * ZONE_GROUP];
  } else {
    record[RECORD_NEXT] = R(-1.0);
  }
  const real values[4] = {middle.x, middle.y, middle.z, left > R(0.0) ? left : R(0.0)};
  for (int k = 0; k < 4; ++k) node->rows[(SLIDE_SEEN + k) * TLED_LANES] = values[k];
}

INLINE Point place_of(__global const real* record, Point u) {
  const Point X = point_at(record + RECORD_PLACE), p = {X.x + u.x, X.y + u.y, X.z + u.z};
  return p;
}

// A node at displacement u, at p, is in the zone `now`, `left` from its border `nearest`: its surface and
// its ball. The result says whether it is on an edge or corner.
INLINE int keep_in_zone(const SlideSurfaces* s, const SlideNode* node, Point u, Point p, int now, int nearest,
                        real left) {
  __global const real* in = s->zones + (long)now * ZONE_UNIT;
  if (now != (int)node->record[RECORD_ZONE]) write_node_shape(node, shape_of_zone(in, p));
  write_look(s, node, u, p, now, nearest, left, ball_in_zone(in, p, nearest, left));
  return in[ZONE_ROUND] != R(0.0);
}

// Looks at a node at displacement u that may have left its zone or region. The result says whether
// it is on an edge or corner.
OUT_OF_LINE int look_at_node(const SlideSurfaces* s, const SlideNode* node, Point u) {
  __global real* record = node->record;
  // Not by place_of: Oclgrind does not know what its compiler says of a struct that is returned and then
  // handed on to what is out of line.
  const Point X = point_at(record + RECORD_PLACE), p = {X.x + u.x, X.y + u.y, X.z + u.z};
  if (is_lost(p)) return 0;
  const int before = (int)record[RECORD_ZONE];
  real left = R(0.0);
  int nearest = 0, now = zone_of(s, (int)zone_to_try(record, p), p, node->free, &left, &nearest);
  if (now >= 0) return keep_in_zone(s, node, u, p, now, nearest, left);
  left = before < 0 ? left_in_region(node, u) : R(0.0);
  int round = node->row_shape >> (node->lane + 1) & 1;
  if (!(left > R(0.0))) round = find_surface(s, node, u, p, &now, &left, &nearest);
  const real ball =
      now >= 0 ? ball_in_zone(s->zones + (long)now * ZONE_UNIT, p, nearest, left) : R(0.0);
  write_look(s, node, u, p, now, nearest, left, ball);
  return round;
}

// The same in two parts, so that several nodes go through each one after the other: what one look waits
// for is then worked out beside the next. First how far the zone holds that is tried first (zone_to_try); -1:
// there is none.
typedef struct {
  int zone, nearest;
  real left;
} FirstZone;
INLINE FirstZone first_zone(const SlideSurfaces* s, int zone, __global const real* record, Point u) {
  FirstZone first = {zone, 0, R(0.0)};
  const Point p = place_of(record, u);
  if (zone >= 0) first.left = left_in_zone(s->zones + (long)zone * ZONE_UNIT, p, &first.nearest);
  return first;
}
INLINE int look_from(FirstZone first, const SlideSurfaces* s, const SlideNode* node, Point u) {
  const Point p = place_of(node->record, u);
  if (!(first.left > R(0.0)) || is_lost(p) ||
      !stays_in(s->zones + (long)first.zone * ZONE_UNIT, node->free))
    return look_at_node(s, node, u);
  return keep_in_zone(s, node, u, p, first.zone, first.nearest, first.left);
}
