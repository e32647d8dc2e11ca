// Levels 2 to 4 of sliding.cl for the nodes that wait in the queue of sliding_still.cl, a work-group a node:
// its items take a border of a zone each, a candidate each, or cells and triangles of a search
// (sliding_seek.cl). What they find is put together by every item alike, in an order that does not depend
// on which was first, so that none waits for another more often than once for each such list.
//
// The slowest node sets the time of this kernel: what is read for a node follows from as little as can be,
// and what does not depend on each other is read at once; and the code is short, since it is fetched anew.

// The zone of a place as zone_of. `guess`: the zone that is probably behind, read together with the
// first; -1: none.
INLINE int zone_together(const SlideSurfaces* s, int zone, int guess, Point p, int free,
                         __local Together* w, int item, real* left, int* nearest) {
  const int mine = item % ZONE_MOST_BORDERS, is_first = item < ZONE_MOST_BORDERS;
  int found = -1, hop = 0, before = -1;
  while (zone >= 0) {
    const int first = zone, second = guess < 0 ? first : guess;
    __global const real* in = s->zones + (long)(is_first ? first : second) * ZONE_UNIT;
    __global const real* border = in + ZONE_BORDER_AT(mine);
    // Read without waiting for their number: behind the last zone there is room (csrc/sim/sliding).
    const real ahead = ahead_of(borders_at(border), p), behind = border[4 * ZONE_GROUP];
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
    const ZoneBorders border = borders_at(in + ZONE_BORDER_AT(item));
    w->farther[item] = ahead_of(border, p) - left;
    w->nears[item] = nears_along(border, border_normal(in, nearest));
  }
  local_barrier();
  real most = MOST_GROWTH;
  for (int k = 0; k < count; ++k)
    if (k != nearest) most = growth_before(most, w->farther[k], w->nears[k]);
  return grown(left, most);
}

INLINE Point local_point(__local const real* at) {
  const Point p = {at[0], at[1], at[2]};
  return p;
}
INLINE void keep_point(Point p, __local real* at) {
  at[0] = p.x;
  at[1] = p.y;
  at[2] = p.z;
}

// What is nearest to a place among a node's candidates, an item each; those are sought where they may miss
// it.
typedef struct {
  int face;  // -1: no number is near anything
  Nearest nearest;
  real reach;  // how far the candidates hold
  // Of the item's own candidate: whether there is one, its distance.
  int is;
  __global const real* other;
  real there;
} Found;
INLINE Found nearest_candidate(const SlideSurfaces* s, const SlideNode* node, Point p,
                               __local Together* w, int item) {
  __global int* candidates = node->candidates;
  __global real* reals = node->candidate_reals;
  const Point off = minus(p, point_at(reals));
  real moved = square_root_of(inner(off, off));
  if (!(moved < reals[3])) {
    seek_together(s, node->surface, p, node->record[RECORD_DISTANCE], candidates, reals, w, item);
    moved = R(0.0);
  }
  Found found;
  found.reach = reals[3] - moved;
  // All there is room for, so that none waits for their number.
  const int count = candidates[0], listed = candidates[1 + (item < SLIDE_MOST ? item : 0)];
  found.is = item < count;
  const int t = found.is ? listed : 0;
  found.other = s->triangles + (long)t * TRIANGLE_REALS;
  Nearest mine = {p, R(0.0), 0};
  if (found.is) mine = closest_on_triangle(found.other, p);
  found.there = square_root_of(mine.square);
  w->square[item] = mine.square;
  w->number[item] = t;
  w->feature[item] = mine.feature;
  keep_point(mine.at, w->at + 3 * item);
  local_barrier();
  // None that the serial code leaves out is nearer.
  int which = 0;
  real square = R(0.0);
  found.face = -1;
#pragma unroll 4
  for (int k = 0; k < SLIDE_MOST; ++k)
    if (k < count && is_nearer(w->square[k], w->number[k], square, found.face)) {
      which = k;
      square = w->square[k];
      found.face = w->number[k];
    }
  const Nearest best = {local_point(w->at + 3 * which), square, w->feature[which]};
  found.nearest = best;
  return found;
}

// The region of a node's own about a foot: the largest ball in that of find_surface, which has borders
// besides; a look costs less here than to find them. The result, how far that holds, is item 0's.
INLINE real own_ball_together(const Foot* foot, Point u, const SlideNode* node, const Found* found,
                              __local Together* w, int item) {
  __global const real* other = found->other;
  real hold = NO_BORDER, ball = foot->lasts ? found->reach : R(0.0);
  if (found->is && foot->feature == 0 && other == foot->triangle) {
#pragma unroll 1
    for (int side = 0; side < 3; ++side) {
      const real inside = inside_of(other, side, inwards_of(other, side), foot->p);
      hold = inside < hold ? inside : hold;
    }
  } else if (found->is) {
    Border one, two;
    const int n_borders = foot->feature ? borders_beside(foot, other, &one, &two) : 0;
    hold = n_borders ? one.distance : held_by_distance(foot, found->there);
    if (n_borders > 1 && two.distance < hold) hold = two.distance;
  }
  w->hold[item] = hold;
  full_barrier();  // all have read what is known
  if (item < 4 * REGION_MOST_BORDERS)  // none
    node->candidate_reals[CANDIDATE_BORDERS + item] = item % 4 == 3 ? R(1.0) : R(0.0);
  if (foot->feature) ball = foot->distance < ball ? foot->distance : ball;
  if (foot->feature && foot->feature < 4) {
    const real end = foot->length - foot->at;
    ball = foot->at < ball ? foot->at : ball;
    ball = end < ball ? end : ball;
  }
  if (item > 0) return R(0.0);
#pragma unroll 4
  for (int k = 0; k < SLIDE_MOST; ++k) ball = w->hold[k] < ball ? w->hold[k] : ball;
  return write_region_ball(ball, foot, u, node->record);
}

// As look_at_node and find_surface; what is written is item 0's to write. Each part stands here once: few
// groups come by most of it, and wait for their instructions then.
INLINE int look_together(const SlideSurfaces* s, const SlideNode* node, Point u,
                         __local Together* w, int item) {
  __global real* record = node->record;
  const int before = (int)record[RECORD_ZONE];
  const Point X = point_at(record + RECORD_PLACE);
  const Point p = {X.x + u.x, X.y + u.y, X.z + u.z};
  if (is_lost(p)) {
    full_barrier();  // all have read what item 0 writes
    return 0;
  }
  Found found;
  real left = R(0.0);
  int zone = before, now, guess = before < 0 ? -1 : (int)record[RECORD_NEXT], nearest = 0, sought = 0;
  for (;;) {
    now = zone_together(s, zone, guess, p, node->free, w, item, &left, &nearest);
    if (now >= 0 || sought) break;
    left = before < 0 ? left_in_region(node, u) : R(0.0);
    if (left > R(0.0)) break;
    found = nearest_candidate(s, node, p, w, item);
    sought = 1;
    guess = -1;
    zone = found.face < 0 ? -1 : zone_of_part(s, node, found.face, found.nearest.feature);
  }
  SlideShape shape;
  int round = node->row_shape >> (node->lane + 1) & 1, is_new = sought || now != before;
  if (now >= 0) {
    shape = shape_of_zone(s->zones + (long)now * ZONE_UNIT, p);
    round = shape.round != R(0.0);
  } else if (sought && found.face < 0) {
    left = R(0.0);
    round = is_new = 0;
  } else if (sought) {
    Foot foot;
    find_foot(s->triangles + (long)found.face * TRIANGLE_REALS, found.nearest, p,
              square_root_of(found.nearest.square), node->free, &foot);
    left = own_ball_together(&foot, u, node, &found, w, item);
    shape = shape_of_foot(&foot);
    round = foot.round != R(0.0);
  }
  if (is_new && item == 0) write_node_shape(node, shape);
  const real ball = now >= 0 ? ball_together(s, now, p, nearest, left, w, item) : R(0.0);
  full_barrier();  // all have read what item 0 writes
  if (item == 0) write_look(s, node, u, p, now, nearest, left, ball);
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
    name_node(&row, lane, &node);
    __global real* at = u_next + row.dof;
    const Points seen = lanes_of(at);
    const Point u = {seen.x, seen.y, seen.z};
    const int round = look_together(&surfaces, &node, u, &w, item);
    if (item == 0) {
      const int shape = shape_with(node.row_shape, lane, round);
      *row.shape = shape;
      const WayBack way =
          way_back(plane_of(row.rows + lane), row.regions + lane, shape, seen);
      store_points(moved_back(way, seen), at);
    }
    k += (int)get_num_groups(0);
    if (k < n_waiting) place = slide_queue[SLIDE_WAITING + k];
    local_barrier();
  }
}
