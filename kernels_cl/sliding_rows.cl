// Row kernels put sliding nodes back themselves, while they are in a near cache: those of surfaces that
// stand still, without laws and without other conditions on them (csrc/sim/sliding). Nodes that have to
// be looked at wait while what that reads is fetched: first what is known of the nodes that left their
// balls, with the next batch of rows the zones, with the one after they are looked at.

// Nodes that may wait in each of the two queues, those of a row together; past that they are looked at
// without.
#define SLIDING_WAIT 32
typedef struct { int place, lane; } WaitingNode;
typedef struct {
  int n_records, n_zones;
  WaitingNode records[SLIDING_WAIT], zones[SLIDING_WAIT];
} SlidingQueue;

// Rows of finished nodes that are not back yet.
typedef struct { int begin, end; } FinishedRows;

// SLIDE_AHEAD rows are put back together: one by one they wait for each other, and after too many their
// nodes have left the near caches. What as many rows on from those of a row of blocks read is fetched when
// that is finished: all at once it would keep the row kernel waiting for its own.
#if TLED_OPENCL
// One and a half rows, whose number is not asked: with a loop in it LLVM's row kernel takes 3 % longer.
INLINE void fetch_ahead(const SlideArrays* arrays, int first, int count) {
  const int place = first + SLIDE_AHEAD;
  __global const real* lanes = arrays->rows + (long)place * (SLIDE_ROWS * TLED_LANES);
  prefetch_line((__global const real*)(arrays->heads + (place + SLIDE_AHEAD) * SLIDE_HEAD));
  for (int k = 0; k < SLIDE_ROWS * TLED_LANES * 3 / 2; k += LINE_REALS) prefetch_to_second(lanes + k);
}
#else
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
INLINE void fetch_ahead(const SlideArrays* arrays, int first, int count) {
  for (int row = 0; row < count; ++row) fetch_row_ahead(arrays, first + row + SLIDE_AHEAD);
}
#endif

INLINE Point node_at(__global const real* u, const SlideRow* row, int lane) {
  __global const real* at = u + row->dof + lane;
  const Point p = {at[0], at[TLED_LANES], at[2 * TLED_LANES]};
  return p;
}

// Looks at all whose zones are there, and puts their rows back.
INLINE void look_at_nodes(const SlideArrays* arrays, const SlideSurfaces* surfaces, const SlidingQueue* q,
                          __global real* u_next) {
  FirstZone first[SLIDING_WAIT];
  for (int i = 0; i < q->n_zones; ++i) {
    const int lane = q->zones[i].lane;
    const SlideRow row = row_of(arrays, q->zones[i].place, 0);
    first[i] = first_zone(surfaces, row.records + lane * RECORD_REALS, node_at(u_next, &row, lane));
  }
  for (int i = 0; i < q->n_zones; ++i) {
    const int lane = q->zones[i].lane;
    const SlideRow row = row_of(arrays, q->zones[i].place, 0);
    SlideNode node;
    if (!name_node(&row, lane, &node)) continue;
    const int round = look_from(first[i], surfaces, &node, node_at(u_next, &row, lane));
    *row.shape = shape_with(*row.shape, lane, round);
  }
  for (int i = 0; i < q->n_zones; ++i) {
    const int place = q->zones[i].place;
    if (i + 1 < q->n_zones && q->zones[i + 1].place == place) continue;
    const SlideRow row = row_of(arrays, place, 0);
    const Points u = lanes_of(u_next + row.dof);
    store_points(moved_back(way_back(plane_of(row.rows), row.regions, *row.shape, u), u),
                 u_next + row.dof);
  }
}

// One step on for all that wait.
OUT_OF_LINE void advance_queue(const SlideArrays* arrays, const SlideSurfaces* surfaces, SlidingQueue* q,
                               __global real* u_next) {
  look_at_nodes(arrays, surfaces, q, u_next);
  for (int i = 0; i < q->n_records; ++i) {
    const WaitingNode node = q->zones[i] = q->records[i];
    const SlideRow row = row_of(arrays, node.place, 0);
    fetch_zone(&row, surfaces, node.lane, node_at(u_next, &row, node.lane));
  }
  q->n_zones = q->n_records;
  q->n_records = 0;
}

// Of a row whose lanes `left` are to be looked at; 0: there is no room.
INLINE int wait_for_look(const SlideArrays* arrays, SlidingQueue* q, int place, int left) {
  int count = q->n_records;
  for (int lanes = left; lanes; lanes &= lanes - 1) {
    if (count == SLIDING_WAIT) return 0;
    const WaitingNode node = {place, lowest_bit(lanes)};
    prefetch_line(arrays->records + ((long)place * TLED_LANES + node.lane) * RECORD_REALS);
    q->records[count++] = node;
  }
  q->n_records = count;
  return 1;
}

// Puts rows back, or has their nodes wait for a look; first, one step on for those that wait.
OUT_OF_LINE void put_rows_back(const SlideArrays* arrays, const SlideSurfaces* surfaces, SlidingQueue* q,
                               FinishedRows rows, __global real* u_next) {
  if (q->n_zones || q->n_records) advance_queue(arrays, surfaces, q, u_next);
  for (int place = rows.begin; place < rows.end; ++place) {
    __global const int* head = arrays->heads + place * SLIDE_HEAD;
    __global const real* lanes = arrays->rows + (long)place * (SLIDE_ROWS * TLED_LANES);
    __global const real* region = arrays->regions + (long)place * (REGION_ROWS * TLED_LANES);
    __global real* nodes = u_next + (long)head[HEAD_BLOCK] * (3 * TLED_LANES);
    const Points u = lanes_of(nodes);
    const int left = lanes_that_left(ball_of(lanes), u);
    if (!left) {
      store_points(moved_back(way_back(plane_of(lanes), region, head[HEAD_SHAPE], u), u), nodes);
    } else if (!wait_for_look(arrays, q, place, left)) {
      const SlideRow row = row_of(arrays, place, 0);
      slide_row(&row, surfaces, u_next, 0, 0, 0, 0);
    }
  }
}

// A row of blocks is finished that has `count` rows of sliding nodes from `first` on; `rows`: those that
// were not back before. The result: those that are not yet.
INLINE FinishedRows finish_rows(const SlideArrays* arrays, const SlideSurfaces* surfaces,
                                SlidingQueue* q, FinishedRows rows, int first, int count,
                                __global real* u_next) {
  fetch_ahead(arrays, first, count);
  if (count == 0) return rows;
  if (first != rows.end || first + count > rows.begin + SLIDE_AHEAD) {
    put_rows_back(arrays, surfaces, q, rows, u_next);
    rows.begin = first;
  }
  rows.end = first + count;
  return rows;
}

INLINE void finish_queue(const SlideArrays* arrays, const SlideSurfaces* surfaces, SlidingQueue* q,
                         FinishedRows rows, __global real* u_next) {
  put_rows_back(arrays, surfaces, q, rows, u_next);
  while (q->n_zones || q->n_records) advance_queue(arrays, surfaces, q, u_next);
}
