// Row kernels put sliding nodes back themselves, as soon as a block's are done: those of surfaces that
// stand still, without laws and without other conditions on them (csrc/sim/sliding). Rows with nodes that
// have to be looked at wait while what that reads is fetched: first what is known of the nodes that left their
// balls, the next time that the queue is gone through their zones, then they are looked at.

// Rows that may wait in each of the two queues; and how many do in the first when it is gone through: the more,
// the less of them is still in a near cache.
#define SLIDING_WAIT 32
#define SLIDING_ENOUGH 2
typedef struct { int place, left; } WaitingRow;  // left: lanes that left their balls, as bits
typedef struct {
  int n_records, n_zones;
  WaitingRow records[SLIDING_WAIT], zones[SLIDING_WAIT];
} SlidingQueue;

// A band's sliding nodes. place, end: the rows of them that the row of blocks has which are not back yet;
// block: whose the first is, -1: there is none.
typedef struct {
  const SlideArrays* arrays;
  const SlideSurfaces* surfaces;
  SlidingQueue* queue;
  int place, end, block;
} SlidingRows;

INLINE void next_rows(SlidingRows* s, int place, int end) {
  s->place = place;
  s->end = end;
  s->block = place < end ? s->arrays->heads[place * SLIDE_HEAD + HEAD_BLOCK] : -1;
}

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

INLINE Point node_at(__global const real* u, const SlideRow* row, int lane) {
  __global const real* at = u + row->dof + lane;
  const Point p = {at[0], at[TLED_LANES], at[2 * TLED_LANES]};
  return p;
}

typedef struct {
  int place, lane;
  FirstZone first;
} LookedAt;

// Looks at all nodes whose zones are there, those of a few rows beside each other, and puts the rows back.
INLINE void look_at_rows(const SlideArrays* arrays, const SlideSurfaces* surfaces, const SlidingQueue* q,
                         __global real* u_next) {
  LookedAt nodes[2 * TLED_LANES];
  for (int begin = 0, end = 0; begin < q->n_zones; begin = end) {
    int count = 0;
    for (; end < q->n_zones && count <= TLED_LANES; ++end) {
      const int place = q->zones[end].place;
      const SlideRow row = row_of(arrays, place, 0);
      for (int left = q->zones[end].left; left; left &= left - 1) {
        const int lane = lowest_bit(left);
        nodes[count].place = place;
        nodes[count].lane = lane;
        nodes[count++].first =
            first_zone(surfaces, row.records + lane * RECORD_REALS, node_at(u_next, &row, lane));
      }
    }
    for (int i = 0; i < count; ++i) {
      const int lane = nodes[i].lane;
      const SlideRow row = row_of(arrays, nodes[i].place, 0);
      SlideNode node;
      if (!name_node(&row, lane, &node)) continue;
      const int round = look_from(nodes[i].first, surfaces, &node, node_at(u_next, &row, lane));
      *row.shape = shape_with(*row.shape, lane, round);
    }
    for (int i = begin; i < end; ++i) {
      const SlideRow row = row_of(arrays, q->zones[i].place, 0);
      const Points u = lanes_of(u_next + row.dof);
      store_points(moved_back(way_back(plane_of(row.rows), row.regions, *row.shape, u), u),
                   u_next + row.dof);
    }
  }
}

// One step on for all that wait.
OUT_OF_LINE void advance_queue(const SlideArrays* arrays, const SlideSurfaces* surfaces, SlidingQueue* q,
                               __global real* u_next) {
  look_at_rows(arrays, surfaces, q, u_next);
  for (int i = 0; i < q->n_records; ++i) {
    const WaitingRow waiting = q->zones[i] = q->records[i];
    const SlideRow row = row_of(arrays, waiting.place, 0);
    for (int left = waiting.left; left; left &= left - 1)
      fetch_zone(&row, surfaces, lowest_bit(left), node_at(u_next, &row, lowest_bit(left)));
  }
  q->n_zones = q->n_records;
  q->n_records = 0;
}

// Puts the nodes of a finished block back, which are the next row, or has them wait for a look. There is room
// for them, and no call here: what the row kernel holds in vectors would have to be given up for it.
INLINE void put_row_back(SlidingRows* s, __global real* u_next) {
  const int place = s->place;
  const SlideArrays* arrays = s->arrays;
  __global const real* lanes = arrays->rows + (long)place * (SLIDE_ROWS * TLED_LANES);
  __global const real* region = arrays->regions + (long)place * (REGION_ROWS * TLED_LANES);
  __global real* nodes = u_next + (long)s->block * (3 * TLED_LANES);
  fetch_row_ahead(arrays, place + SLIDE_AHEAD);
  const Points u = lanes_of(nodes);
  const int left = lanes_that_left(ball_of(lanes), u);
  if (!left) {
    const int shape = arrays->heads[place * SLIDE_HEAD + HEAD_SHAPE];
    store_points(moved_back(way_back(plane_of(lanes), region, shape, u), u), nodes);
  } else {
    const WaitingRow waiting = {place, left};
    s->queue->records[s->queue->n_records++] = waiting;
    for (int bits = left; bits; bits &= bits - 1)
      prefetch_line(arrays->records + ((long)place * TLED_LANES + lowest_bit(bits)) * RECORD_REALS);
  }
  next_rows(s, place + 1, s->end);
}

// Before a row of blocks that has `count` rows of sliding nodes from `first` on: there is room for them in the
// queue, or, of more than it holds, they are left for later.
INLINE void begin_rows(SlidingRows* s, int first, int count, __global real* u_next) {
  SlidingQueue* q = s->queue;
  if (q->n_records >= SLIDING_ENOUGH || q->n_records + count > SLIDING_WAIT)
    advance_queue(s->arrays, s->surfaces, q, u_next);
  next_rows(s, first, count <= SLIDING_WAIT ? first + count : first);
}

// Rows of a row of blocks that has more of them than may wait, behind it.
OUT_OF_LINE void put_rows_back(const SlideArrays* arrays, const SlideSurfaces* surfaces, int begin, int end,
                               __global real* u_next) {
  for (int place = begin; place < end; ++place) {
    const SlideRow row = row_of(arrays, place, 0);
    slide_row(&row, surfaces, u_next, 0, 0, 0, 0);
  }
}
INLINE void end_rows(SlidingRows* s, int first, int count, __global real* u_next) {
  if (count > SLIDING_WAIT) put_rows_back(s->arrays, s->surfaces, first, first + count, u_next);
}

INLINE void finish_queue(SlidingRows* s, __global real* u_next) {
  while (s->queue->n_zones || s->queue->n_records)
    advance_queue(s->arrays, s->surfaces, s->queue, u_next);
}
