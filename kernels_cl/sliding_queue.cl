// Levels 2 to 4 of sliding.cl for the nodes that wait in the queue of sliding_still.cl, a work-group a node:
// its items take a border of a zone each, a candidate each, or cells and triangles of a search
// (sliding_seek.cl). What they find is put together in the order in which a single work-item goes through
// it, by every item alike, so that none waits for another more often than once for each such list.
//
// The slowest node sets the time of this kernel: what is read for a node follows from as little as can be,
// and what does not depend on each other is read at once.

// The zone of a place as zone_of. `guess`: the zone that is probably behind, read together with the
// first; -1: none.
INLINE int zone_together(const SlideSurfaces* s, int zone, int guess, Point p, int free,
                         __local Together* w, int item, real* left, int* nearest) {
  const int mine = item % ZONE_MOST_BORDERS, is_first = item < ZONE_MOST_BORDERS;
  int found = -1, hop = 0, before = -1;
  while (zone >= 0) {
    const int first = zone, second = guess < 0 ? first : guess;
    __global const real* in = s->zones + (long)(is_first ? first : second) * ZONE_UNIT;
    __global const real* border = in + ZONE_BORDER + mine * ZONE_BORDER_REALS;
    // Read without waiting for their number: behind the last zone there is room (csrc/sim/sliding).
    const real ahead = ahead_of(border, p), behind = border[4];
    w->ahead[item] = mine < (int)in[ZONE_COUNT] ? ahead : NO_BORDER;
    w->behind[item] = behind;
    local_barrier();
    for (; hop <= MOST_HOPS && zone >= 0 && (zone == first || zone == second); ++hop) {
      const int at = zone == first ? 0 : ZONE_MOST_BORDERS;
      *left = NO_BORDER;
      *nearest = 0;
#pragma unroll
      for (int k = 0; k < ZONE_MOST_BORDERS; ++k)
        if (w->ahead[at + k] < *left) {
          *left = w->ahead[at + k];
          *nearest = k;
        }
      const int holds = *left > R(0.0);
      if (holds && stays_in(s->zones + (long)zone * ZONE_UNIT, free)) found = zone;
      const int behind = (int)w->behind[at + *nearest];
      const int next = holds || behind == before ? -1 : behind;
      before = zone;
      zone = next;
    }
    zone = hop <= MOST_HOPS ? zone : -1;
    guess = -1;
    local_barrier();
  }
  return found;
}

// As ball_in_zone.
INLINE real ball_together(const SlideSurfaces* s, int zone, Point p, int nearest, real left,
                          __local Together* w, int item) {
  __global const real* in = s->zones + (long)zone * ZONE_UNIT;
  const int count = (int)in[ZONE_COUNT];
  if (item < count) {
    const Point outward = point_at(in + ZONE_BORDER + nearest * ZONE_BORDER_REALS);
    __global const real* border = in + ZONE_BORDER + item * ZONE_BORDER_REALS;
    w->farther[item] = ahead_of(border, p) - left;
    w->nears[item] = nears_along(border, outward);
  }
  local_barrier();
  real most = MOST_GROWTH;
  for (int k = 0; k < count; ++k) most = growth_before(most, w->farther[k], w->nears[k]);
  return grown(left, most);
}

// Number of the first bit that is set; -1: none.
INLINE int first_of(int bits) { return 31 - (int)clz(bits & -bits); }

INLINE Point local_point(__local const real* at) {
  const Point p = {at[0], at[1], at[2]};
  return p;
}
INLINE void keep_point(Point p, __local real* at) {
  at[0] = p.x;
  at[1] = p.y;
  at[2] = p.z;
}

// The region of a node's own about its nearest part, that of triangle `face` at `distance`, among the
// candidates of the last search, `moved` since then: as the end of find_surface, but for borders past the
// ball. mine: nearest of the item's own candidate, at `there`. The result, how far that holds, is item 0's.
//
// An item has the borders of its candidate, of the first behind the candidates those of the foot itself.
// Each finds the place of its own by how many are nearer.
INLINE real own_region_together(const SlideSurfaces* s, const SlideNode* node, Point u, Point p,
                                int count, int face, Nearest best, real distance, real moved,
                                Nearest mine, real there, __local Together* w, int item,
                                int* round) {
  const int is = item < count, t = w->number[item];
  __global const real* other = s->triangles + (long)t * TRIANGLE_REALS;
  Region region;
  Foot foot;
  find_foot(s->triangles + (long)face * TRIANGLE_REALS, best, p, distance, node->free,
            node->candidate_reals[3] - moved, &foot, &region);
  const Border none = {NO_BORDER, {R(0.0), R(0.0), R(0.0)}};
  Border border[3] = {none, none, none};
  const int n_borders =
      is && foot.round != R(0.0) ? borders_beside(&foot, other, border, border + 1) : 0;
  w->n_borders[item] = n_borders;
  local_barrier();
  int beside = 0;  // as bits
#pragma unroll
  for (int k = 0; k < SLIDE_MOST; ++k) beside |= (w->n_borders[k] > 0) << k;
  // The first two triangles beside an edge.
  const int beside0 = first_of(beside), beside1 = first_of(beside & (beside - 1));
  const int has_both = best.feature < 4 && beside1 >= 0 && !(beside & (beside - 1) & ~(1 << beside1));
  const int is_foot = best.feature == 0  ? t == face
                      : best.feature < 4 ? item == beside0 || item == beside1
                                         : n_borders > 0;
  real hold = NO_BORDER;
  if (is && !is_foot) {
    const Held held =
        held_by(&foot, other, there, mine.at, held_by_distance(&foot, there),
                has_both ? s->triangles + (long)w->number[beside0] * TRIANGLE_REALS : 0,
                has_both ? s->triangles + (long)w->number[beside1] * TRIANGLE_REALS : 0);
    if (held.is_border) {
      border[2].distance = held.distance;
      border[2].outward = held.outward;
    } else {
      hold = held.distance;
    }
  }
  for (int k = 0; k < FOOT_BORDERS; ++k)
    if (item == SLIDE_MOST + k) {
      border[0].distance = region.within[k];
      border[0].outward = region.outward[k];
    }
  w->hold[item] = hold;
  for (int i = 0; i < 3; ++i) w->border[3 * item + i] = border[i].distance;
  if (item < REGION_MOST_BORDERS + 1) {
    w->nearest_border[item] = NO_BORDER;
    for (int c = 0; c < 3; ++c) w->outward[3 * item + c] = R(0.0);
  }
  local_barrier();
  int rank[3] = {0, 0, 0};
#pragma unroll
  for (int k = 0; k < 3 * (SLIDE_MOST + FOOT_BORDERS); ++k) {
    const real one = w->border[k];
    for (int i = 0; i < 3; ++i)
      rank[i] += one < border[i].distance || (one == border[i].distance && k < 3 * item + i);
  }
  for (int i = 0; i < 3; ++i)
    if (border[i].distance < NO_BORDER && rank[i] <= REGION_MOST_BORDERS) {
      w->nearest_border[rank[i]] = border[i].distance;
      keep_point(border[i].outward, w->outward + 3 * rank[i]);
    }
  real ball = region.ball;
#pragma unroll
  for (int k = 0; k < SLIDE_MOST; ++k) ball = w->hold[k] < ball ? w->hold[k] : ball;
  local_barrier();
  // Those that there is no room for shrink the ball.
  const real next = w->nearest_border[REGION_MOST_BORDERS];
  *round = foot.round != R(0.0);
  real slack = R(0.0);
  if (item == 0) {
    slack = write_region_ball(next < ball ? next : ball, &foot, u, node->record);
    for (int k = 0; k < REGION_MOST_BORDERS; ++k) {
      const real within = write_border(k, w->nearest_border[k], local_point(w->outward + 3 * k),
                                       &foot, u, node->record);
      slack = within < slack ? within : slack;
    }
    write_node_shape(node, shape_of_foot(&foot));
  }
  return slack;
}

// Levels 3 and 4 as find_surface: an item a candidate. What is written is item 0's to write, `round` is
// left alone where nothing is found. The result: the zone, -1: a region of its own.
INLINE int find_together(const SlideSurfaces* s, const SlideNode* node, Point u, Point p,
                         __local Together* w, int item, real* left, int* nearest, int* round) {
  __global int* candidates = node->candidates;
  __global real* reals = node->candidate_reals;
  const Point off = minus(p, point_at(reals));
  real moved = square_root_of(inner(off, off));
  if (!(moved < reals[3])) {
    seek_together(s, node->surface, p, node->record[RECORD_DISTANCE], candidates, reals, w, item);
    moved = R(0.0);
  }
  // All there is room for, so that none waits for their number.
  const int count = candidates[0], is = item < count,
            listed = candidates[1 + (item < SLIDE_MOST ? item : 0)], t = is ? listed : 0;
  Nearest mine = {p, R(0.0), 0};
  if (is) mine = closest_on_triangle(s->triangles + (long)t * TRIANGLE_REALS, p);
  const real there = square_root_of(mine.square);
  w->square[item] = mine.square;
  w->number[item] = t;
  w->feature[item] = mine.feature;
  keep_point(mine.at, w->at + 3 * item);
  local_barrier();
  // None that the serial code leaves out is nearer.
  int face = -1, which = 0;
  real square = R(0.0);
#pragma unroll
  for (int k = 0; k < SLIDE_MOST; ++k)
    if (k < count && is_nearer(w->square[k], w->number[k], square, face)) {
      which = k;
      square = w->square[k];
      face = w->number[k];
    }
  const real distance = square_root_of(square);
  *left = R(0.0);
  if (face < 0) {  // no number is near anything
    *round = 0;
    return -1;
  }
  const Nearest best = {local_point(w->at + 3 * which), square, w->feature[which]};
  const int part = best.feature < 4 ? zone_of_part(s, node, face, best.feature) : -1;
  const int found = zone_together(s, part, -1, p, node->free, w, item, left, nearest);
  if (found >= 0) {
    const SlideShape shape = shape_of_zone(s->zones + (long)found * ZONE_UNIT, p);
    *round = shape.round != R(0.0);
    if (item == 0) write_node_shape(node, shape);
  } else {
    *left = own_region_together(s, node, u, p, count, face, best, distance, moved, mine, there, w,
                                item, round);
  }
  return found;
}

// As look_at_node; what is written is item 0's to write.
INLINE int look_together(const SlideSurfaces* s, const SlideNode* node, Point u,
                         __local Together* w, int item) {
  __global const real* record = node->record;
  const int before = *node->zone;
  const Point X = point_at(record + RECORD_PLACE);
  const Point p = {X.x + u.x, X.y + u.y, X.z + u.z};
  if (is_lost(p)) return 0;
  real left = R(0.0);
  int nearest = 0, round = node->row_shape >> (node->lane + 1) & 1;
  int now = zone_together(s, before, before < 0 ? -1 : (int)record[RECORD_NEXT], p, node->free, w,
                          item, &left, &nearest);
  if (now >= 0) {
    const SlideShape shape = shape_of_zone(s->zones + (long)now * ZONE_UNIT, p);
    round = shape.round != R(0.0);
    if (now != before && item == 0) write_node_shape(node, shape);
  } else {
    left = before < 0 ? left_in_region(record, u) : R(0.0);
    if (!(left > R(0.0)))
      now = find_together(s, node, u, p, w, item, &left, &nearest, &round);
  }
  const real ball = now >= 0 ? ball_together(s, now, p, nearest, left, w, item) : R(0.0);
  full_barrier();  // all have read what item 0 writes
  if (item == 0) write_look(s, node, u, p, before, now, nearest, left, ball);
  return round;
}

// Work-group: a node of the queue at a time. Moves it to its distance in u_next, as slide_nodes. The number
// of those that wait for the next step becomes 0.
__kernel __attribute__((reqd_work_group_size(SLIDE_ITEMS, 1, 1))) void slide_queued(
    TLED_SLIDING_ARGUMENTS_OF(), __global int* slide_queue, __global real* u_next, int parity) {
  __local Together w;
  const int item = (int)get_local_id(0);
  const SlideArrays arrays = TLED_SLIDE_ARRAYS;
  const SlideSurfaces surfaces = TLED_SLIDE_SURFACES;
  // Read with their number: there are no more groups than places.
  int place = slide_queue[SLIDE_WAITING + (int)get_group_id(0)];
  const int n_waiting = slide_queue[parity];
  if (get_global_id(0) == 0) slide_queue[1 - parity] = 0;
  for (int k = (int)get_group_id(0); k < n_waiting;) {
    const int lane = place % TLED_LANES;
    const SlideRow row = row_of(&arrays, place / TLED_LANES, lane);
    SlideNode node;
    name_node(&row, lane, row.ints[SLIDE_SURFACE * TLED_LANES + lane], &node);
    __global real* at = u_next + row.dof;
    const Points seen = lanes_of(at);
    const Point u = {seen.x, seen.y, seen.z};
    const int round = look_together(&surfaces, &node, u, &w, item);
    if (item == 0) {
      const int shape = shape_with(node.row_shape, lane, round);
      *row.shape = shape;
      store_points(moved_back(way_back(plane_of(row.rows + lane), row.regions + lane, shape, seen), seen), at);
    }
    k += (int)get_num_groups(0);
    if (k < n_waiting) place = slide_queue[SLIDE_WAITING + k];
    local_barrier();
  }
}
