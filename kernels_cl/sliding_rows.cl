// Row kernels put sliding nodes back themselves, as soon as a row of blocks is done: those of surfaces that
// stand still, without laws and without other conditions on them (csrc/sim/sliding). Nodes that have to be
// looked at wait while what that reads is fetched: first what is known of them, the next time that the queue
// is gone through their zones, then they are looked at.

// Nodes that may wait in each of the two queues, no fewer than a row has (room for many more costs: it is in the
// near cache as well); and how many do in the first when it is gone through.
#define SLIDING_WAIT (2 * TLED_LANES)
#define SLIDING_ENOUGH 2
// place: row of nodes * TLED_LANES + lane; dof: of its x component in u; zone: that is tried first, -1: none.
typedef struct { int place, dof, zone; } WaitingNode;
typedef struct {
  int n_records, n_zones;
  WaitingNode records[SLIDING_WAIT], zones[SLIDING_WAIT];
} SlidingQueue;

// A band's sliding nodes.
typedef struct {
  const SlideArrays* arrays;
  const SlideSurfaces* surfaces;
  SlidingQueue* queue;
} SlidingRows;

// What a row reads that comes SLIDE_AHEAD later, and the head of one that comes as much later again.
INLINE void fetch_row_ahead(const SlideArrays* arrays, int place) {
  __global const int* head = arrays->heads + place * SLIDE_HEAD;
  __global const real* lanes = arrays->rows + (long)place * (SLIDE_ROWS * TLED_LANES);
  prefetch_line((__global const real*)(head + SLIDE_AHEAD * SLIDE_HEAD));
  for (int k = 0; k < SLIDE_ROWS * TLED_LANES; k += LINE_REALS) prefetch_to_second(lanes + k);
  // Of rows with edges or corners. What another band has to say of the first of its own is a hint.
  if (head[HEAD_SHAPE] > 1) {
    __global const real* region = arrays->regions + (long)place * (REGION_ROWS * TLED_LANES);
    for (int k = REGION_ROUND * TLED_LANES; k < (REGION_ON + 3) * TLED_LANES; k += LINE_REALS)
      prefetch_line(region + k);
  }
}

INLINE Point lane_at(__global const real* at) {
  const Point p = {at[0], at[TLED_LANES], at[2 * TLED_LANES]};
  return p;
}

// Moves a node that was looked at to its distance: way_back and moved_back of one lane.
INLINE void put_node_back(const SlideNode* node, int round, Point u, __global real* at) {
  __global const real *plane = node->rows + SLIDE_NORMAL * TLED_LANES, *region = node->region;
  const Point n = lane_at(plane);
  const real target = plane[3 * TLED_LANES];
  Point back = n;
  real off = target - inner(n, u);
  if (round) {
    const Point q = minus(u, lane_at(region + REGION_ON * TLED_LANES)), out = plus_scaled(q, -inner(n, q), n);
    const real side = region[REGION_ROUND * TLED_LANES], length = square_root_of(inner(out, out));
    off = target - side * length;
    back = times(side / length, out);
  } else if (node->row_shape & 1) {
    back = lane_at(region + REGION_ALONG * TLED_LANES);
  }
  at[0] = u.x + off * back.x;
  at[TLED_LANES] = u.y + off * back.y;
  at[2 * TLED_LANES] = u.z + off * back.z;
}

// Looks at all nodes whose zones are there, a few beside each other, and puts them back.
INLINE void look_at_nodes(const SlideArrays* arrays, const SlideSurfaces* surfaces, const SlidingQueue* q,
                          __global real* u_next) {
  FirstZone first[TLED_LANES];
  for (int begin = 0; begin < q->n_zones; begin += TLED_LANES) {
    const int end = q->n_zones < begin + TLED_LANES ? q->n_zones : begin + TLED_LANES;
    for (int i = begin; i < end; ++i) {
      const WaitingNode waiting = q->zones[i];
      __global const real* record = arrays->records + (long)waiting.place * RECORD_REALS;
      first[i - begin] = first_zone(surfaces, waiting.zone, record, lane_at(u_next + waiting.dof));
    }
    for (int i = begin; i < end; ++i) {
      const WaitingNode waiting = q->zones[i];
      const int lane = (unsigned)waiting.place % TLED_LANES;
      const SlideRow row = row_of(arrays, (unsigned)waiting.place / TLED_LANES, 0);
      SlideNode node;
      if (!name_node(&row, lane, &node)) continue;
      __global real* at = u_next + waiting.dof;
      const Point u = lane_at(at);
      const int round = look_from(first[i - begin], surfaces, &node, u);
      *row.shape = shape_with(*row.shape, lane, round);
      put_node_back(&node, round, u, at);
    }
  }
}

// One step on for all that wait.
OUT_OF_LINE void advance_queue(const SlideArrays* arrays, const SlideSurfaces* surfaces, SlidingQueue* q,
                               __global real* u_next) {
  look_at_nodes(arrays, surfaces, q, u_next);
  for (int i = 0; i < q->n_records; ++i) {
    WaitingNode waiting = q->records[i];
    waiting.zone = fetch_zone(arrays, surfaces, waiting.place, lane_at(u_next + waiting.dof));
    q->zones[i] = waiting;
  }
  q->n_zones = q->n_records;
  q->n_records = 0;
}

// Puts the nodes of a row back, but for those that have to be looked at, which wait: there is room for them.
INLINE void put_row_back(const SlidingRows* s, int place, __global real* u_next) {
  const SlideArrays* arrays = s->arrays;
  __global const real* lanes = arrays->rows + (long)place * (SLIDE_ROWS * TLED_LANES);
  __global const real* region = arrays->regions + (long)place * (REGION_ROWS * TLED_LANES);
  const int dof = arrays->heads[place * SLIDE_HEAD + HEAD_BLOCK] * (3 * TLED_LANES);
  __global real* nodes = u_next + dof;
  fetch_row_ahead(arrays, place + SLIDE_AHEAD);
  const Points u = lanes_of(nodes);
  const Ball ball = ball_of(lanes);
  const int left = lanes_that_left(ball, u), shape = arrays->heads[place * SLIDE_HEAD + HEAD_SHAPE];
  Points back = moved_back(way_back(plane_of(lanes), region, shape, u), u);
  if (left) {
    back = points_within(ball, u, back);
    for (int bits = left; bits; bits &= bits - 1) {
      const int lane = lowest_bit(bits);
      const WaitingNode waiting = {place * TLED_LANES + lane, dof + lane, 0};
      s->queue->records[s->queue->n_records++] = waiting;
      __global const real* record = arrays->records + (long)waiting.place * RECORD_REALS;
      for (int k = 0; k < RECORD_REALS; k += LINE_REALS) prefetch_line(record + k);
    }
  }
  store_points(back, nodes);
}

// Behind a row of blocks: puts back its `count` rows of sliding nodes from `first` on.
INLINE void put_rows_back(const SlidingRows* s, int first, int count, __global real* u_next) {
  SlidingQueue* q = s->queue;
  if (q->n_records >= SLIDING_ENOUGH) advance_queue(s->arrays, s->surfaces, q, u_next);
  for (int place = first; place < first + count; ++place) {
    if (q->n_records > SLIDING_WAIT - TLED_LANES) advance_queue(s->arrays, s->surfaces, q, u_next);
    put_row_back(s, place, u_next);
  }
}

INLINE void finish_queue(const SlidingRows* s, __global real* u_next) {
  while (s->queue->n_zones || s->queue->n_records)
    advance_queue(s->arrays, s->surfaces, s->queue, u_next);
}
