// Checks of a state that copy nothing of it to the host, and the largest of an array: each work-item
// goes through some rows, then reduce_largest through what they found until one is left. A largest
// value does not depend on the order, and of equal ones the lowest place counts, so nothing depends on
// how rows are dealt.

// A row is a block's lanes where rows are vectors, else one lane. Rows of a work-item in a loop over
// many: a run of them, or every n_items-th, so that neighbouring work-items read neighbours.
#if TLED_VECTOR_ROWS
#define ROW_LANES TLED_LANES
#define ROW_BLOCK(row) (row)
#define ROW_LANE(row) 0
#define FIRST_ROW(item, n_rows, n_items) ((int)((long)(n_rows) * (item) / (n_items)))
#define END_ROW(item, n_rows, n_items) FIRST_ROW((item) + 1, n_rows, n_items)
#define ROW_STEP(n_items) 1
#else
#define ROW_LANES 1
#define ROW_BLOCK(row) ((row) / TLED_LANES)
#define ROW_LANE(row) ((row) % TLED_LANES)
#define FIRST_ROW(item, n_rows, n_items) (item)
#define END_ROW(item, n_rows, n_items) (n_rows)
#define ROW_STEP(n_items) (n_items)
#endif
#define ROWS_OF_BLOCKS(n_blocks) ((n_blocks) * (TLED_LANES / ROW_LANES))

// Work-item i: the largest of those at i, i + n_left, ... of what n_items work-items found.
__kernel void reduce_largest(__global const real* restrict values, __global const int* restrict slots,
                             __global real* restrict values_left, __global int* restrict slots_left,
                             int n_items, int n_left) {
  const int item = (int)get_global_id(0);
  if (item >= n_left) return;
  real highest = values[item], since = values[n_items + item], reach = values[2 * n_items + item];
  int slot = slots[item];
  for (int i = item + n_left; i < n_items; i += n_left) {
    const real value = values[i], grown = values[n_items + i], reaching = values[2 * n_items + i];
    if (value > highest || (value == highest && slots[i] < slot)) {
      highest = value;
      slot = slots[i];
    }
    since = grown > since ? grown : since;
    reach = reaching > reach ? reaching : reach;
  }
  values_left[item] = highest;
  values_left[n_left + item] = since;
  values_left[2 * n_left + item] = reach;
  slots_left[item] = slot;
}

// Work-item: some rows of u. values[i]: 1 where something is not finite, else 0.
__kernel void find_non_finite(__global const real* restrict u, __global real* restrict values,
                              __global int* restrict slots, int n_rows, int n_items) {
  const int item = (int)get_global_id(0);
  if (item >= n_items) return;
  const int end = END_ROW(item, n_rows, n_items);
  const realv zero = broadcast(R(0.0)), one = broadcast(R(1.0));
  realv lost = zero;
  for (int row = FIRST_ROW(item, n_rows, n_items); row < end; row += ROW_STEP(n_items)) {
    const realv value = load_lanes(u + (long)row * ROW_LANES);
    lost = value - value == zero ? lost : one;
  }
  real any = R(0.0);
  for (int lane = 0; lane < ROW_LANES; ++lane) any += lane_of(lost, lane);
  values[item] = any > R(0.0) ? R(1.0) : R(0.0);
  values[n_items + item] = values[2 * n_items + item] = R(0.0);
  slots[item] = 0;
}

// Work-item: a row of u. The last step is made `ratio` times as long, at the velocity it had.
__kernel void scale_last_step(__global const real* restrict u, __global real* restrict u_prev,
                              __global const real* restrict ratio, int n_rows) {
  const int row = (int)get_global_id(0);
  if (row >= n_rows) return;
  const long at = (long)row * ROW_LANES;
  const realv now = load_lanes(u + at);
  store_lanes(now - (now - load_lanes(u_prev + at)) * ratio[0], u_prev + at);
}
